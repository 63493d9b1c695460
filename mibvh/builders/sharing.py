"""Trees that others begin with: built once for all that are built of the same triangles.

The paper's optimisers start from another builder's tree. In a study that tree is mostly built
anyway; here its draft is kept for them, a large one in a file. What they are said to take includes
the time it took.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

T = TypeVar("T")

#: Bytes of a draft from which on it is kept in a file: that of 2.5 million triangles.
LARGE = 1.5e8


@dataclasses.dataclass
class Drafts:
    """Drafts of one geometry.

    Attributes
    ----------
    digest : str
        Of the triangles.
    folder : Path or None
        For files of the large ones.
    wanted : frozenset of (str, options)
        Builders and options whose drafts are worth keeping.
    spared : float
        Seconds that were not spent since a draft was here.
    """

    digest: str
    folder: Path | None
    wanted: frozenset[Any] = frozenset()
    spared: float = 0.0
    _kept: dict[Any, tuple[Callable[[], Any], float]] = dataclasses.field(default_factory=dict)

    def want(self, builders: frozenset[Any]) -> None:
        """Keep drafts of these builders and options from here on, and let go of all others."""
        self.wanted = builders
        for key in [key for key in self._kept if key[:2] not in builders]:
            again, _ = self._kept.pop(key)
            if isinstance(again, _InFile):
                again.close()

    def draft(self, key: Any, make: Callable[[], T]) -> T:
        """Return a copy of the draft that is kept under a key, or make and keep it."""
        if key not in self._kept:
            started, spared = time.perf_counter(), self.spared
            made = make()
            seconds = time.perf_counter() - started + self.spared - spared
            self._kept[key] = self._keep(made), seconds
            if isinstance(self._kept[key][0], _InFile):
                return made  # which nothing else has
        else:
            self.spared += self._kept[key][1]
        return cast(T, self._kept[key][0]())

    def _keep(self, made: Any) -> Callable[[], Any]:
        """Return what makes copies, as nobody promises to leave the arrays as they are."""
        if _size(made) < LARGE or getattr(made, "measure", None) is not None:
            return functools.partial(copy.deepcopy, made)
        return _InFile(made, self.folder)


class _InFile:
    """A draft in a file, which goes when nothing asks for it any more."""

    def __init__(self, made: Any, folder: Path | None) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - goes with the draft
        pickle.dump(made, self._file, protocol=5)

    def __call__(self) -> Any:
        """Read it."""
        self._file.seek(0)
        return pickle.load(self._file)

    def close(self) -> None:
        """Remove it."""
        self._file.close()


def _size(value: Any) -> int:
    """Bytes of the arrays of a dataclass."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if not dataclasses.is_dataclass(value):
        return 0
    return sum(_size(getattr(value, field.name)) for field in dataclasses.fields(value))


_current: ContextVar[Drafts | None] = ContextVar("drafts", default=None)


@contextlib.contextmanager
def shared_drafts(digest: str, folder: Path | None = None) -> Iterator[Drafts]:
    """Share the drafts of triangles of this digest among all builds within the block.

    Parameters
    ----------
    digest : str
    folder : Path, optional
        For files of the large ones; by default the system's for temporary files.
    """
    drafts = Drafts(digest, folder)
    token = _current.set(drafts)
    try:
        yield drafts
    finally:
        _current.reset(token)
        drafts.want(frozenset())


def spared() -> float:
    """Seconds that builds have been spared so far; differences of it tell of one build."""
    drafts = _current.get()
    return drafts.spared if drafts else 0.0


def share(name: str, triangles: Any, options: Any, context: Any, make: Callable[[], T]) -> T:
    """Make a builder's draft, or return the one that is kept.

    Parameters
    ----------
    name : str
        Of the builder.
    triangles, options, context
        What it is given. All of the context counts but its progress.
    make : callable
    """
    drafts = _current.get()
    if drafts is None or (name, options) not in drafts.wanted:
        return make()
    if getattr(triangles, "digest", None) != drafts.digest:
        return make()
    asked = [getattr(context, f.name) for f in dataclasses.fields(context) if f.name != "progress"]
    return drafts.draft((name, options, *asked), make)
