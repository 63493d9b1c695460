"""Tree: a binary BVH as flat arrays, with its invariants, statistics and file format."""

from __future__ import annotations

import dataclasses
import functools
import html
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.files import checksum
from mibvh.hierarchy import Hierarchy
from mibvh.nodes import MAX_DEPTH
from mibvh.triangles import F32, I32, Triangles

__all__ = ["MAX_DEPTH", "Tree"]


@dataclasses.dataclass(frozen=True, eq=False)
class Tree(Hierarchy):
    """A binary bounding volume hierarchy. An immutable value: arrays and a little metadata.

    Node 0 is the root; the children of an inner node ``n`` are ``left[n]`` and
    ``left[n] + 1``; parents come before their children.

    Attributes
    ----------
    lower, upper : (M, 3) float32
        Closed node boxes in scene units.
    left : (M,) int32
        First child; -1 for a leaf.
    first, count : (M,) int32
        The node's range in ``references`` (for inner nodes too: all of their subtree).
    references : (R,) int32
        Triangle ids in leaf order. An id stands more than once where spatial splits made
        several references of one triangle. All arrays are read-only; ones that can be written
        to are copied.
    meta : dict
        JSON-able: builder, options, build_seconds, triangles (count), digest, c_inner,
        c_tri, and what the builder reports.
    """

    _ARRAYS = ("lower", "upper", "left", "first", "count", "references")
    _KIND = "tree"

    lower: F32
    upper: F32
    left: I32
    first: I32
    count: I32
    references: I32
    meta: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.left)

    def __reduce__(self) -> tuple[Any, ...]:
        # Through the constructor: copied arrays can be written to, and are not checked.
        return Tree, (*(getattr(self, name) for name in Tree._ARRAYS), self.meta)

    def __repr__(self) -> str:
        if self._invalid:
            return f"Tree({self._name!r}, invalid)"
        split = f", {len(self.references):,} references" if self.splits_triangles else ""
        return (
            f"Tree({self._name!r}, {self.triangle_count:,} triangles{split}, {len(self):,} nodes, "
            f"depth {self.depth})"
        )

    def _repr_html_(self) -> str:
        """A table, for notebooks."""
        if self._invalid:
            return html.escape(repr(self))
        facts = {"builder": self._name, **self.stats()}
        rows = "".join(
            f"<tr><th style='text-align:left'>{name.replace('_', ' ')}</th>"
            f"<td style='text-align:right'>{html.escape(_figure(value))}</td></tr>"
            for name, value in facts.items()
        )
        return f"<table>{rows}</table>"

    @property
    def _name(self) -> str:
        return str(self.meta.get("builder", "tree"))

    @property
    def _invalid(self) -> bool:
        try:
            self.check()
        except MibvhError:
            return True
        return False

    # ------------------------------------------------------------ derived arrays

    @property
    def is_leaf(self) -> npt.NDArray[np.bool_]:
        """(M,) bool."""
        return self.left < 0

    @functools.cached_property
    def parents(self) -> I32:
        """(M,) int32: each node's parent; -1 for the root."""
        self.check()
        parents = np.full(len(self), -1, np.int32)
        inner = np.flatnonzero(~self.is_leaf).astype(np.int32)
        parents[self.left[inner]] = inner
        parents[self.left[inner] + 1] = inner
        return parents

    @functools.cached_property
    def depths(self) -> I32:
        """(M,) int32: edges from the root."""
        self.check()
        depths = np.zeros(len(self), np.int32)
        level = np.zeros(1, np.int64)
        while len(level := level[self.left[level] >= 0]):
            children = np.concatenate([self.left[level], self.left[level] + 1])
            depths[children] = depths[level[0]] + 1
            level = children
        return depths

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the tree and its cost constants: what is computed from it goes by this."""
        costs = {name: self.meta.get(name) for name in ("c_inner", "c_tri")}
        return checksum(self._arrays(), costs)

    # ------------------------------------------------------------ invariants

    def validate(self, triangles: Triangles | None = None) -> list[str]:
        """Check every invariant and return those that are violated, as sentences.

        Parameters
        ----------
        triangles : Triangles, optional
            With them, also check that leaf boxes hold their triangles, and that every
            split triangle is covered by the leaves it is in.

        Returns
        -------
        list of str
            Empty for a valid tree.
        """
        from mibvh.validation import violations

        return violations(self, triangles)

    def check(self) -> None:
        """Refuse an invalid tree, as far as can be told without its triangles.

        Raises
        ------
        MibvhError
            With the first violation.
        """
        from mibvh.validation import meta_violations, structure_violations

        self._refuse(meta_violations(self.meta))
        if "structure" not in self._sound:
            self._refuse(structure_violations(self))
            self._sound.add("structure")

    def _geometry_violations(self, triangles: Triangles) -> list[str]:
        from mibvh.validation import geometry_violations

        return geometry_violations(self, triangles)

    # ------------------------------------------------------------ trees of other programs

    @classmethod
    def from_arrays(
        cls,
        lower: Any,
        upper: Any,
        left: Any,
        right: Any = None,
        first: Any = None,
        count: Any = None,
        references: Any = None,
        *,
        root: int | None = None,
        name: str = "imported",
    ) -> Tree:
        """Take a binary tree of another program: renumbered, with its own boxes and leaves.

        Nodes may stand in any order, and some may be unused.

        Parameters
        ----------
        lower, upper : (M, 3) float
            Boxes in scene units; those of wider types than float32 are rounded outwards.
        left : (M,) int
            First child of an inner node; what is negative is a leaf. Where ``first`` is left out,
            a leaf's is ``~left``. Where nothing is negative, a node with ``count > 0`` is a leaf
            and ``left`` its first reference.
        right : (M,) int, optional
            Second child; by default the one after the first.
        first, count : (M,) int, optional
            A leaf's range of the references; of inner nodes not looked at. By default one
            reference each.
        references : (R,) int, optional
            Triangle ids; by default ranges are of triangles themselves.
        root : int, optional
            By default node 0, or, where that is a child, the node without a parent.
        name : str
            What the tree is called where builders are named.

        Returns
        -------
        Tree

        Raises
        ------
        MibvhError
            If it is no tree, a leaf is empty or shares its references, or with the first
            violation that :meth:`check` meets.

        Examples
        --------
        >>> import mibvh
        >>> boxes = [[0.0, 0, 0], [0, 0, 0], [2, 0, 0]], [[3.0, 1, 1], [1, 1, 1], [3, 1, 1]]
        >>> mibvh.Tree.from_arrays(*boxes, left=[1, -1, -2], right=[2, 0, 0])
        Tree('imported', 2 triangles, 3 nodes, depth 1)
        """
        from mibvh.layouts.arrays import renumbered

        tree = cls(
            *renumbered(lower, upper, left, right, first, count, references, root=root, name=name)
        )
        tree.check()
        return tree

    def to_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays for another program: what :meth:`from_arrays` takes, by name.

        Returns
        -------
        dict of str to array
            ``lower, upper, left, right, first, count, references``; ``left`` and ``right`` are -1
            of leaves, and inner nodes have the range of all below them.
        """
        from mibvh.layouts.arrays import to_arrays

        self.check()
        return to_arrays(self)


def _figure(value: Any) -> str:
    """A number with commas, or with few digits; text as it is."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{value:,}" if isinstance(value, int) else str(value)
