"""Drafts that several builders start from, built once for the same triangles.

The paper's optimisers start from another builder's tree, which a study usually builds anyway. Its
draft is kept here for them, in a file if it is large. The time that it took still counts for each
of them.
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

#: Drafts of at least so many bytes are kept in a file: about 2.5 million triangles.
LARGE = 1.5e8


@dataclasses.dataclass
class Drafts:
    """Drafts of one geometry.

    Attributes
    ----------
    digest : str
        Digest of the triangles.
    folder : Path or None
        Folder for the files of large drafts.
    wanted : frozenset of (str, options)
        Builders and options whose drafts are worth keeping.
    spared : float
        Seconds of building that kept drafts have saved so far.
    """

    digest: str
    folder: Path | None
    wanted: frozenset[Any] = frozenset()
    spared: float = 0.0
    _kept: dict[Any, tuple[Callable[[], Any], float]] = dataclasses.field(default_factory=dict)

    def want(self, builders: frozenset[Any]) -> None:
        """Keep drafts of these builders and options from now on, and drop all others."""
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
                return made  # the file is the kept copy
        else:
            self.spared += self._kept[key][1]
        return cast(T, self._kept[key][0]())

    def _keep(self, made: Any) -> Callable[[], Any]:
        """Return a function that makes copies, because builders may change the arrays."""
        if _size(made) < LARGE or getattr(made, "measure", None) is not None:
            return functools.partial(copy.deepcopy, made)
        return _InFile(made, self.folder)


class _InFile:
    """A draft in a temporary file, which is deleted once it is closed."""

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
        Folder for the files of large drafts; by default the system's temporary folder.
    """
    drafts = Drafts(digest, folder)
    token = _current.set(drafts)
    try:
        yield drafts
    finally:
        _current.reset(token)
        drafts.want(frozenset())


def spared() -> float:
    """Return the seconds that kept drafts have saved so far; take differences for one build."""
    drafts = _current.get()
    return drafts.spared if drafts else 0.0


def share(name: str, triangles: Any, options: Any, context: Any, make: Callable[[], T]) -> T:
    """Make a builder's draft, or return the one that is kept.

    Parameters
    ----------
    name : str
        Name of the builder.
    triangles, options, context
        Its arguments. Drafts are shared only if all of them agree; the context's ``progress`` does
        not count.
    make : callable
        Makes the draft.
    """
    drafts = _current.get()
    if drafts is None or (name, options) not in drafts.wanted:
        return make()
    if getattr(triangles, "digest", None) != drafts.digest:
        return make()
    asked = [getattr(context, f.name) for f in dataclasses.fields(context) if f.name != "progress"]
    return drafts.draft((name, options, *asked), make)
