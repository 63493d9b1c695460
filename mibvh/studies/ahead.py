"""Compile a study's kernels on two cores, while its first scene loads.

Numba compiles under a lock, so threads do not help. A second process does: this process finds what
it compiled in Numba's cache. The helper starts at the end of the list, this process at the
beginning. Building starts after that, so that no reported build time includes compilation.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mibvh._jit import cache_folder
from mibvh.builders import get, names, next_to_nothing, warm_up
from mibvh.code import code_digest
from mibvh.metrics.epo import epo
from mibvh.morton import morton_codes
from mibvh.parallel import thread_count
from mibvh.tree import Tree
from mibvh.triangles import Triangles

#: Parts that are compiled besides the builders: exact EPO with the checks of a tree, and the
#: further checks of a tree with split triangles.
METRICS, SPLIT_CHECKS = "metrics", "checks of split triangles"


@contextlib.contextmanager
def compiled_ahead(
    builders: Sequence[str], say: Callable[[str], None]
) -> Iterator[Callable[[], None]]:
    """Start compiling in a second process, and yield a function that finishes the work.

    Nothing happens on a single core, or if everything is known to be compiled.

    Parameters
    ----------
    builders : sequence of str
        Names of builders; those outside :func:`mibvh.builders.names` are ignored.
    say : callable
        Called with the name of each part before this process compiles it.

    Yields
    ------
    callable
        Compiles the rest and ends the second process. A second call does nothing.
    """
    parts = _parts(builders)
    known = _note(parts)
    if thread_count() < 2 or len(parts) < 3 or known.exists():
        yield lambda: None
        return
    helper = _start(parts[::-1])

    def finish() -> None:
        while parts:
            say(parts[0])
            compile_part(parts.pop(0))
        if helper.poll() is None:  # builds are timed, so nothing may run beside them
            helper.kill()
            helper.wait()
        with contextlib.suppress(OSError):  # without the note, the next run checks again
            known.touch()

    try:
        yield finish
    finally:
        helper.kill()
        helper.wait()


def compile_part(part: str) -> None:
    """Compile one part by running it on a few triangles.

    Parameters
    ----------
    part : str
        The name of a builder, :data:`METRICS` or :data:`SPLIT_CHECKS`.
    """
    triangles = next_to_nothing()
    if part == METRICS:
        tree = _two_leaves(triangles, np.arange(len(triangles)))
        tree.validate(triangles)
        epo(tree, triangles, threads=1)
    elif part == SPLIT_CHECKS:
        _two_leaves(triangles, np.tile(np.arange(len(triangles)), 2)).validate(triangles)
    else:
        warm_up(part)


def _parts(builders: Sequence[str]) -> list[str]:
    """Return the parts that trees of these builders need."""
    known = [name for name in dict.fromkeys(builders) if name in names()]
    splits = any(get(name).references(100, get(name).options()) > 100 for name in known)
    return [*known, METRICS, *([SPLIT_CHECKS] if splits else [])]


def _two_leaves(triangles: Triangles, references: npt.NDArray[np.int64]) -> Tree:
    """Make a tree of two leaves, each with half of the references and the box of all."""
    corners, half = triangles.corners.reshape(-1, 3), len(references) // 2
    lower, upper = (np.tile(bound, (3, 1)) for bound in (corners.min(0), corners.max(0)))
    return Tree.from_arrays(
        lower,
        upper,
        left=np.array([1, -1, -1]),
        first=np.array([0, 0, half]),
        count=np.array([0, half, half]),
        references=references,
    )


def _start(parts: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a process that compiles parts. Its errors are ignored: they show up here again."""
    paths = [str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    silent = subprocess.DEVNULL
    command = [sys.executable, "-m", __name__, *parts]
    return subprocess.Popen(command, env=environment, stdin=silent, stdout=silent, stderr=silent)


def _note(parts: Sequence[str]) -> Path:
    """Return the file, beside the compiled code, whose existence says that all is compiled."""
    code = [get(part).code() for part in parts if part in names()]
    key = f"{sys.version} {code_digest('mibvh.validation', 'mibvh.metrics.epo')} {parts} {code}"
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    return cache_folder(morton_codes) / f"mibvh-compiled-{digest}"


if __name__ == "__main__":
    for part in sys.argv[1:]:
        compile_part(part)
