"""A least-recently-used cache of the trees of a scene."""

from __future__ import annotations

import dataclasses
import weakref
from collections.abc import Callable, Iterator, Mapping

from mibvh.errors import MibvhError
from mibvh.tree import Tree

#: Bytes of trees that stay in memory: nine trees of 700,000 triangles.
ROOM = 3e8


@dataclasses.dataclass(frozen=True)
class _Entry:
    """What the shelf knows of a tree that may not be in memory.

    Attributes
    ----------
    digest : str
    size : int
        Bytes of its arrays.
    again : callable
        Reads the tree from its file.
    """

    digest: str
    size: int
    again: Callable[[], Tree]


class Shelf(Mapping[str, Tree]):
    """Trees by name, of which the most recently used stay in memory.

    The others are read from their files on access. A loop over all trees of a large scene thus
    holds one tree at a time.

    Parameters
    ----------
    room : float, optional
        Bytes of trees to hold, by default :data:`ROOM`. The last tree is held in any case.
    """

    def __init__(self, room: float | None = None) -> None:
        self._room = ROOM if room is None else room
        self._entries: dict[str, _Entry] = {}
        self._held: dict[str, Tree] = {}
        # A tree that is still in use elsewhere need not be read again.
        self._alive: weakref.WeakValueDictionary[str, Tree] = weakref.WeakValueDictionary()

    def put(self, name: str, tree: Tree, again: Callable[[], Tree]) -> None:
        """Add a tree.

        Parameters
        ----------
        name : str
        tree : Tree
        again : callable
            Returns the same tree; called once it is no longer in memory.
        """
        size = sum(array.nbytes for array in tree.to_arrays().values())
        self._entries[name] = _Entry(tree.digest, size, again)
        self._hold(name, tree)

    def digest(self, name: str) -> str:
        """Return the digest of a tree, without reading it."""
        return self._entries[name].digest

    def tidy(self) -> None:
        """Release trees beyond the room, before something else needs memory."""
        self._make_room(0)

    def __getitem__(self, name: str) -> Tree:
        """Return a tree.

        Raises
        ------
        MibvhError
            If the tree's file has changed since the tree was added.
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
        """Iterate over the names, in the order of addition."""
        return iter(self._entries)

    def __len__(self) -> int:
        """Return the number of trees."""
        return len(self._entries)

    def _hold(self, name: str, tree: Tree) -> None:
        self._held.pop(name, None)
        self._make_room(self._entries[name].size)
        self._held[name] = self._alive[name] = tree

    def _make_room(self, size: int) -> None:
        """Release the least recently used trees until so many bytes fit in."""
        while self._held and size + sum(self._entries[n].size for n in self._held) > self._room:
            self._held.pop(next(iter(self._held)))
