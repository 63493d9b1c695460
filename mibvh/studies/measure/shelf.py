"""The trees of a scene: in memory while there is room for them, and else read when asked for."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Callable, Iterator, Mapping

from mibvh.errors import MibvhError
from mibvh.tree import Tree

#: Bytes of trees that stay in memory, whatever there are: nine of 700,000 triangles.
ROOM = 3e8


@dataclasses.dataclass(frozen=True)
class _Entry:
    """A tree of the shelf.

    Attributes
    ----------
    digest : str
    size : int
        Bytes of its arrays.
    again : callable
        Reads it.
    """

    digest: str
    size: int
    again: Callable[[], Tree]


class Shelf(Mapping[str, Tree]):
    """Trees by name.

    As many as there is room for stay in memory, those last asked for first; the others are read
    when they are asked for, so that who goes through all of a large scene has one at a time.

    Parameters
    ----------
    room : float, optional
        Bytes, by default :data:`ROOM`; the tree that was last asked for is in memory in any case.
    """

    def __init__(self, room: float | None = None) -> None:
        self._room = ROOM if room is None else room
        self._entries: dict[str, _Entry] = {}
        self._held: dict[str, Tree] = {}
        # A tree that somebody else has in memory need not be read.
        self._alive: weakref.WeakValueDictionary[str, Tree] = weakref.WeakValueDictionary()

    def put(self, name: str, tree: Tree, again: Callable[[], Tree]) -> None:
        """Add a tree.

        Parameters
        ----------
        name : str
        tree : Tree
        again : callable
            Returns the same tree; called where it is no longer in memory.
        """
        size = sum(array.nbytes for array in tree.to_arrays().values())
        self._entries[name] = _Entry(tree.digest, size, again)
        self._hold(name, tree)

    def digest(self, name: str) -> str:
        """Return the digest of a tree, without reading it."""
        return self._entries[name].digest

    def tidy(self) -> None:
        """Let go of what there is no room for, before something else takes memory."""
        self._make_room(0)

    def __getitem__(self, name: str) -> Tree:
        """Return a tree.

        Raises
        ------
        MibvhError
            If what is read is another tree than the one that was put.
        """
        entry = self._entries[name]
        tree = self._alive.get(name)
        if tree is None:
            self._make_room(entry.size)
            tree = entry.again()
            if tree.digest != entry.digest:
                raise MibvhError(f"the tree {name} was changed while it was studied")
        self._hold(name, tree)
        return tree

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names, in the order of the trees' coming."""
        return iter(self._entries)

    def __len__(self) -> int:
        """Return the number of trees."""
        return len(self._entries)

    def _hold(self, name: str, tree: Tree) -> None:
        self._held.pop(name, None)
        self._make_room(self._entries[name].size)
        self._held[name] = self._alive[name] = tree

    def _make_room(self, size: int) -> None:
        """Let go of trees, those not asked for longest first, until so many bytes fit in."""
        while self._held and size + sum(self._entries[n].size for n in self._held) > self._room:
            self._held.pop(next(iter(self._held)))
