"""Compiling what a study needs on two cores, while its first scene loads.

Numba compiles under locks: threads do not help. A second process does, as what it compiles is found
in Numba's cache: it begins at the end of the list, this one at its beginning. Builds come after
that, so nothing is compiled beside a build whose seconds are reported.
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

from mibvh.builders import get, names, next_to_nothing, warm_up
from mibvh.code import code_digest
from mibvh.metrics.epo import epo
from mibvh.parallel import thread_count
from mibvh.tree import Tree
from mibvh.triangles import Triangles
from mibvh.validation import _structure

#: What is compiled besides builders: the exact EPO and the checks of a tree; and the checks of one
#: that has split triangles.
METRICS, SPLIT_CHECKS = "metrics", "checks of split triangles"


@contextlib.contextmanager
def compiled_ahead(
    builders: Sequence[str], say: Callable[[str], None]
) -> Iterator[Callable[[], None]]:
    """Start to compile; yield what finishes it, and does nothing when called again.

    Without effect where there is one core only, or all of it is known to be compiled.

    Parameters
    ----------
    builders : sequence of str
        Names; those that are not the paper's are left out.
    say : callable
        Told what this process compiles next.
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
        if helper.poll() is None:  # nothing may run beside what is timed
            helper.kill()
            helper.wait()
        with contextlib.suppress(OSError):  # it is only found out again
            known.touch()

    try:
        yield finish
    finally:
        helper.kill()
        helper.wait()


def compile_part(part: str) -> None:
    """Compile a builder, metrics or checks, by running it on next to nothing."""
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
    """Return what is to be compiled for trees of these builders."""
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
    """Start a process that compiles parts; what goes wrong there is met again here."""
    paths = [str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH", "")]
    around = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    silent = subprocess.DEVNULL
    command = [sys.executable, "-m", __name__, *parts]
    return subprocess.Popen(command, env=around, stdin=silent, stdout=silent, stderr=silent)


def _note(parts: Sequence[str]) -> Path:
    """Return the file that is there, beside the compiled code, once all parts are compiled."""
    code = [get(part).code() for part in parts if part in names()]
    key = f"{sys.version} {code_digest('mibvh.validation', 'mibvh.metrics.epo')} {parts} {code}"
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    return Path(_structure.stats.cache_path) / f"mibvh-compiled-{digest}"


if __name__ == "__main__":
    for part in sys.argv[1:]:
        compile_part(part)
