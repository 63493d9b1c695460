"""Trees that others begin with: built once for all that are built of the same triangles.

The paper's optimisers start from another builder's tree. In a study that tree is mostly built
anyway; here its draft is kept for them. What they are said to take includes the time it took.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import Any, TypeVar, cast

T = TypeVar("T")


@dataclasses.dataclass
class Drafts:
    """Drafts of one geometry.

    Attributes
    ----------
    digest : str
        Of the triangles.
    wanted : frozenset of (str, options)
        Builders and options whose drafts are worth keeping.
    spared : float
        Seconds that were not spent since a draft was here.
    """

    digest: str
    wanted: frozenset[Any] = frozenset()
    spared: float = 0.0
    _kept: dict[Any, tuple[Any, float]] = dataclasses.field(default_factory=dict)

    def want(self, builders: frozenset[Any]) -> None:
        """Keep drafts of these builders and options from here on, and let go of all others."""
        self.wanted = builders
        self._kept = {key: kept for key, kept in self._kept.items() if key[:2] in builders}

    def draft(self, key: Any, make: Callable[[], T]) -> T:
        """Return a copy of the draft that is kept under a key, or make and keep it."""
        if key not in self._kept:
            started, spared = time.perf_counter(), self.spared
            made = make()
            self._kept[key] = made, time.perf_counter() - started + self.spared - spared
        else:
            self.spared += self._kept[key][1]
        # A copy, as nobody promises to leave the arrays as they are.
        return cast(T, copy.deepcopy(self._kept[key][0]))


_current: ContextVar[Drafts | None] = ContextVar("drafts", default=None)


@contextlib.contextmanager
def shared_drafts(digest: str) -> Iterator[Drafts]:
    """Share the drafts of triangles of this digest among all builds within the block."""
    drafts = Drafts(digest)
    token = _current.set(drafts)
    try:
        yield drafts
    finally:
        _current.reset(token)


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
