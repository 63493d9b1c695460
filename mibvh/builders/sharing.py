"""Drafts that several builders start from, built once for the same triangles.

The paper's optimisers start from another builder's tree, which a study usually builds anyway. Its
draft is kept here for them, in a file if it is large. The time that it took still counts for each
of them; the time of keeping and copying it does not.

A study that makes other trees of the drafts later, with leaves of other sizes, has them kept in
files until then.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import pickle
import shutil
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
#: Share of the free disk space that a draft may take that is only kept to spare a second build.
_SPARE = 0.05


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
    later : frozenset of (str, options)
        Those whose drafts are kept in files, as far as the disk has room, until the end of the
        outermost :func:`shared_drafts`.
    spared : float
        Seconds of building that kept drafts have saved so far, less those of keeping them.
    """

    digest: str
    folder: Path | None
    wanted: frozenset[Any] = frozenset()
    later: frozenset[Any] = frozenset()
    spared: float = 0.0
    _kept: dict[Any, tuple[Callable[[], Any], float]] = dataclasses.field(default_factory=dict)

    def want(self, builders: frozenset[Any]) -> None:
        """Keep drafts of these builders and options, besides :attr:`later`; drop all others."""
        self.wanted = builders
        for key in [key for key in self._kept if key[:2] not in builders | self.later]:
            again, _ = self._kept.pop(key)
            if isinstance(again, _InFile):
                again.close()

    def draft(self, key: Any, make: Callable[[], T]) -> T:
        """Return a copy of the draft that is kept under a key, or make and keep it."""
        if key in self._kept:
            again, seconds = self._kept[key]
            self.spared += seconds
            with self._not_building():
                return cast(T, again())
        started, spared = time.perf_counter(), self.spared
        made = make()
        seconds = time.perf_counter() - started + self.spared - spared
        with self._not_building():
            kept = self._keep(made, key[:2])
            if kept is not None:
                self._kept[key] = kept, seconds
            # A file is a copy; what is kept in memory must not be given away.
            return made if kept is None or isinstance(kept, _InFile) else cast(T, kept())

    @contextlib.contextmanager
    def _not_building(self) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.spared -= time.perf_counter() - started

    def _keep(self, made: Any, of: tuple[Any, ...]) -> Callable[[], Any] | None:
        """Return a function that makes copies, because builders may change the arrays.

        None if the draft is not kept: nothing starts from it, and there is little room.
        """
        size = _size(made)
        has_file = getattr(made, "measure", None) is None  # compiled code has none
        if has_file and of in self.later and size < _SPARE * self._free_space():
            with contextlib.suppress(OSError):
                return _InFile(made, self.folder)
        if of not in self.wanted:
            return None
        if has_file and size >= LARGE:
            return _InFile(made, self.folder)
        return functools.partial(copy.deepcopy, made)

    def _free_space(self) -> int:
        return shutil.disk_usage(self.folder or tempfile.gettempdir()).free


class _InFile:
    """A draft in a temporary file, which is deleted once it is closed."""

    def __init__(self, made: Any, folder: Path | None) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - goes with the draft
        try:
            pickle.dump(made, self._file, protocol=5)
        except OSError:  # the disk is full
            self._file.close()
            raise

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

    Within a block of the same triangles it is that block's drafts that are shared.

    Parameters
    ----------
    digest : str
    folder : Path, optional
        Folder for the files of large drafts; by default the system's temporary folder.
    """
    outer = _current.get()
    if outer is not None and outer.digest == digest:
        try:
            yield outer
        finally:
            outer.want(frozenset())
        return
    drafts = Drafts(digest, folder)
    token = _current.set(drafts)
    try:
        yield drafts
    finally:
        _current.reset(token)
        drafts.later = frozenset()
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
    if drafts is None or (name, options) not in drafts.wanted | drafts.later:
        return make()
    if getattr(triangles, "digest", None) != drafts.digest:
        return make()
    asked = [getattr(context, f.name) for f in dataclasses.fields(context) if f.name != "progress"]
    return drafts.draft((name, options, *asked), make)
