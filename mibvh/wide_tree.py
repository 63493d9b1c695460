"""WideTree: a BVH with up to eight children per node, and the binary tree it is measured as."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.hierarchy import Hierarchy
from mibvh.nodes import WIDTHS
from mibvh.tree import Tree
from mibvh.triangles import F32, F64, I32, Triangles

__all__ = ["C_BOX", "WIDTHS", "BinaryView", "WideTree", "as_binary"]

#: Cost of each child box that a node has beyond two, in units of a triangle's. With a node of two
#: at 1.2, a node of four costs 1.6 and one of eight 2.4.
C_BOX = 0.2


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class WideTree(Hierarchy):
    """A bounding volume hierarchy of two, four or eight children per node. An immutable value.

    Node 0 is the root; the children of an inner node ``n`` are the ``children[n]`` nodes from
    ``child[n]`` on; parents come before their children. Made by :func:`mibvh.collapse`, by
    :meth:`from_nodes`, or of arrays like these.

    Attributes
    ----------
    lower, upper : (M, 3) float32
        Closed node boxes in scene units.
    child : (M,) int32
        First child; -1 for a leaf.
    children : (M,) int32
        How many; 0 for a leaf.
    first, count : (M,) int32
        The node's range in ``references``. Those of a node's children make up its own, in any
        order.
    references : (R,) int32
        Triangle ids in leaf order; more than once where a triangle is split. All arrays are
        read-only; ones that can be written to are copied.
    width : int
        Children that a node may have: 2, 4 or 8.
    quantised : bool
        Whether the boxes lie on grids of 8 bits (:func:`mibvh.quantise.quantised`).
    meta : dict
        JSON-able: as :class:`mibvh.Tree` has it, and ``c_box``, the cost of each child box beyond
        a node's second.
    """

    _ARRAYS = ("lower", "upper", "child", "children", "first", "count", "references")
    _KIND = "wide tree"

    lower: F32
    upper: F32
    child: I32
    children: I32
    first: I32
    count: I32
    references: I32
    width: int = 8
    quantised: bool = False
    meta: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.child)

    def __reduce__(self) -> tuple[Any, ...]:
        # Through the constructor: copied arrays can be written to, and are not checked.
        arrays = (getattr(self, name) for name in self._ARRAYS)
        return WideTree, (*arrays, self.width, self.quantised, self.meta)

    def __repr__(self) -> str:
        boxes = "8-bit boxes" if self.quantised else "float32 boxes"
        return (
            f"WideTree({self.meta.get('builder', 'of arrays')}, width {self.width}, "
            f"{len(self):,} nodes, {len(self.references):,} references, {boxes})"
        )

    # ------------------------------------------------------------ derived arrays

    @property
    def is_leaf(self) -> npt.NDArray[np.bool_]:
        """(M,) bool."""
        return self.child < 0

    @property
    def left(self) -> I32:
        """(M,) int32: the first child, as binary trees call it."""
        return self.child

    @functools.cached_property
    def parents(self) -> I32:
        """(M,) int32: each node's parent; -1 for the root."""
        self.check()
        return _parents(self.child, self.children)

    @functools.cached_property
    def depths(self) -> I32:
        """(M,) int32: edges from the root."""
        self.check()
        return _depths(self.child, self.children)

    @functools.cached_property
    def binary(self) -> BinaryView:
        """The tree with two children per node, for all code that walks binary ones.

        Between a node of more children and these stand virtual nodes, which cost nothing: a ray
        or a point that is in a child's box is in theirs.
        """
        self.check()
        lower, upper, left, first, count, node = _binary(
            self.lower, self.upper, self.child, self.children, self.first, self.count
        )
        return BinaryView(
            lower, upper, left, first, count, self.references, self.meta, node=node, wide=self
        )

    def stats(self) -> dict[str, Any]:
        """Counts of nodes, leaves and references, leaf sizes, depth, bytes, children per node."""
        facts = super().stats()
        inner = facts["nodes"] - facts["leaves"]
        return {**facts, "mean_children": float(self.children.sum() / inner) if inner else 0.0}

    def ordered(self, priority: npt.ArrayLike) -> WideTree:
        """Put every node's children in the order in which any-hit rays are to visit them.

        Parameters
        ----------
        priority : (M,) array
            The greatest of the siblings comes first; equal ones stay as they are.
            :mod:`mibvh.traversal.child_order` has some.

        Returns
        -------
        WideTree
            With ``meta["ordered"]``, which kernels look for.
        """
        self.check()
        wanted = np.asarray(priority, np.float64)
        if wanted.shape != (len(self),) or np.isnan(wanted).any():
            raise MibvhError(f"a priority needs {len(self)} numbers, one per node of the tree")
        place = _ordered(self.child, self.children, wanted)
        # Nodes are exchanged only among siblings: each group of them begins where it did.
        nodes = {name: self._arrays()[name][place] for name in self._ARRAYS[:-1]}
        return self.replace(**nodes, meta={**self.meta, "ordered": True})

    # ------------------------------------------------------------ made of another program's nodes

    @classmethod
    def from_nodes(
        cls,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        children: npt.ArrayLike,
        first: npt.ArrayLike,
        count: npt.ArrayLike,
        references: npt.ArrayLike,
        *,
        root: int = 0,
        meta: dict[str, Any] | None = None,
    ) -> WideTree:
        """Take nodes in any order, as other programs have them.

        Parameters
        ----------
        lower, upper : (K, 3) float
            Boxes of the nodes; those of wider types than float32 are rounded outwards.
        children : (K, W) int array
            Node numbers of the children in any places of the row, -1 for none; all -1 for a
            leaf. W is 2 to 8; a tree's width is the next of 2, 4, 8.
        first, count : (K,) int array
            A leaf's range in ``references``; of inner nodes they are not looked at.
        references : (R,) int array
            Triangle ids.
        root : int
        meta : dict, optional

        Returns
        -------
        WideTree
            Without the nodes that the root does not reach, and the references in no leaf.

        Raises
        ------
        MibvhError
            If the arrays do not fit each other, or the nodes are no tree.
        """
        from mibvh.layouts.arrays import box_column, int_column, triangle_ids

        rows = np.asarray(children)
        fits = rows.ndim == 2 and 2 <= rows.shape[1] <= max(WIDTHS) and rows.dtype.kind in "iu"
        if not fits:
            raise MibvhError(
                f"children need an array of whole numbers, (K, 2) to (K, {max(WIDTHS)}), not "
                f"{rows.dtype} {rows.shape}"
            )
        nodes = len(rows)
        low, high = (
            box_column("lower", lower, nodes, -np.inf),
            box_column("upper", upper, nodes, np.inf),
        )
        ids = int_column("references", references)
        if not 0 <= root < nodes:
            raise MibvhError(f"the root, {root}, is none of the {nodes} nodes")
        violation, node, order, child, number, begin, size, taken = _gather(
            rows.astype(np.int64),
            int_column("first", first, nodes),
            int_column("count", count, nodes),
            len(ids),
            root,
        )
        if violation:
            raise MibvhError(f"node {node} {_GATHER[violation]}")
        return cls(
            low[order],
            high[order],
            child,
            number,
            begin,
            size,
            triangle_ids(ids[taken]),
            width=min(w for w in WIDTHS if w >= rows.shape[1]),
            meta=dict(meta or {}),
        )

    # ------------------------------------------------------------ invariants

    def validate(self, triangles: Triangles | None = None) -> list[str]:
        """Check every invariant and return the first that is violated, as a sentence.

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
        if self._violations or triangles is None:
            return list(self._violations)
        return self._geometry_violations(triangles)

    def check(self) -> None:
        """Refuse arrays that are no valid tree, as far as can be told without its triangles.

        Raises
        ------
        MibvhError
            With the first violation.
        """
        self._refuse(self._violations)

    @functools.cached_property
    def _violations(self) -> list[str]:
        from mibvh.wide_validation import violations

        return violations(self)

    def _geometry_violations(self, triangles: Triangles) -> list[str]:
        from mibvh.validation import geometry_violations

        return geometry_violations(self, triangles)[:1]

    # ------------------------------------------------------------ files

    def _header(self) -> dict[str, Any]:
        return {"width": self.width, "quantised": self.quantised, "tree": self.meta}

    @classmethod
    def _restored(cls, arrays: dict[str, npt.NDArray[Any]], header: dict[str, Any]) -> Self:
        if set(header) != {"width", "quantised", "tree"}:
            raise MibvhError("not a wide tree file of mibvh")
        facts: dict[str, Any] = {**arrays, "width": header["width"], "meta": header["tree"]}
        tree = cls(**facts, quantised=header["quantised"])
        tree.check()
        return tree


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class BinaryView(Tree):
    """A wide tree with two children per node.

    Attributes
    ----------
    node : (B,) int32
        The wide tree's node that each of these is; -1 for a virtual one.
    wide : WideTree
    """

    node: I32
    wide: WideTree

    @functools.cached_property
    def place(self) -> I32:
        """(M,) int32: where each of the wide tree's nodes stands here."""
        place = np.empty(len(self.wide), np.int32)
        real = np.flatnonzero(self.node >= 0).astype(np.int32)
        place[self.node[real]] = real
        return place

    def spread(self, values: npt.NDArray[Any]) -> F64:
        """(B,) float64: values of the wide tree's nodes, and 0 for virtual ones."""
        return np.where(self.node >= 0, values[self.node], 0.0)

    def check(self) -> None:
        """As :meth:`WideTree.check`: virtual nodes may make it deeper than binary trees may be."""
        self.wide.check()

    def check_matches(self, triangles: Triangles) -> None:
        """As :meth:`WideTree.check_matches`."""
        self.wide.check_matches(triangles)


def as_binary(tree: Tree | WideTree) -> Tree:
    """The tree that metrics walk: a binary tree itself, or a wide one's :attr:`WideTree.binary`."""
    return tree.binary if isinstance(tree, WideTree) else tree


@njit
def _parents(child, children):
    parents = np.full(len(child), -1, np.int32)
    for n in range(len(child)):
        for c in range(child[n], child[n] + children[n]):
            parents[c] = n
    return parents


@njit
def _depths(child, children):
    depths = np.zeros(len(child), np.int32)
    for n in range(len(child)):
        for c in range(child[n], child[n] + children[n]):
            depths[c] = depths[n] + 1
    return depths


@njit
def _binary(lower, upper, child, children, first, count):
    """Arrays of the binary view, its nodes' wide ones last.

    Siblings are halved in the order of their references, so that a virtual node has a range of
    these too. Groups of siblings are taken in the order in which they stand, so that a tree of
    width two comes out as it is.
    """
    nodes = len(child)
    size = 1
    for n in range(nodes):
        if children[n] > 0:
            size += 2 * children[n] - 2
    lo, hi = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    left, node = np.full(size, -1, np.int32), np.full(size, -1, np.int32)
    begin, number = np.empty(size, np.int32), np.empty(size, np.int32)
    place = np.zeros(nodes, np.int32)
    node[0], begin[0], number[0] = 0, first[0], count[0]
    lo[0], hi[0] = lower[0], upper[0]
    inner = np.flatnonzero(children > 0)
    stack = np.empty((64, 3), np.int32)  # node of the view, and its siblings from, to
    size = 1
    for parent in inner[np.argsort(child[inner])]:
        group = child[parent] + np.argsort(first[child[parent] : child[parent] + children[parent]])
        stack[0, 0], stack[0, 1], stack[0, 2] = place[parent], 0, children[parent]
        top = 1
        while top > 0:
            top -= 1
            at, low, high = stack[top, 0], np.int64(stack[top, 1]), np.int64(stack[top, 2])
            middle = (low + high) // 2
            left[at] = size
            for a, b in ((low, middle), (middle, high)):
                number[size] = 0
                begin[size] = first[group[a]]
                lo[size], hi[size] = lower[group[a]], upper[group[a]]
                for i in range(a, b):
                    number[size] += count[group[i]]
                    for k in range(3):
                        lo[size, k] = min(lo[size, k], lower[group[i], k])
                        hi[size, k] = max(hi[size, k], upper[group[i], k])
                if b - a == 1:
                    node[size], place[group[a]] = group[a], size
                else:
                    stack[top, 0], stack[top, 1], stack[top, 2] = size, a, b
                    top += 1
                size += 1
    return lo, hi, left, begin, number, node


@njit
def _ordered(child, children, priority):
    """Where each node is to be taken from, so that siblings stand by descending priority."""
    place = np.arange(len(child))
    for n in range(len(child)):
        if children[n] > 0:
            group = slice(child[n], child[n] + children[n])
            place[group] = child[n] + np.argsort(-priority[group], kind="mergesort")
    return place


#: What is wrong with a node, by the number that :func:`_gather` returns.
_GATHER = {
    1: "has a child that is none of the nodes",
    2: "is reached twice",
    3: "has one child only",
    4: "is a leaf without references",
    5: "is a leaf whose references are not all among those given",
}


@njit
def _gather(rows, first, count, references, root):
    """Nodes that the root reaches, breadth first, and their references in the order of a walk."""
    nodes, width = rows.shape
    seen = np.zeros(nodes, np.bool_)
    order = np.empty(nodes, np.int64)
    child, number = np.full(nodes, -1, np.int32), np.zeros(nodes, np.int32)
    begin, size = np.zeros(nodes, np.int32), np.zeros(nodes, np.int32)
    order[0], seen[root], end = root, True, 1
    total = n = 0
    while n < end:
        node = order[n]
        for k in range(width):
            c = rows[node, k]
            if c == -1:
                continue
            if c < 0 or c >= nodes:
                return 1, node, order, child, number, begin, size, order
            if seen[c]:
                return 2, c, order, child, number, begin, size, order
            seen[c], order[end] = True, c
            if number[n] == 0:
                child[n] = end
            number[n] += 1
            end += 1
        if number[n] == 1:
            return 3, node, order, child, number, begin, size, order
        if number[n] == 0:
            if count[node] < 1:
                return 4, node, order, child, number, begin, size, order
            if first[node] < 0 or first[node] + count[node] > references:
                return 5, node, order, child, number, begin, size, order
            size[n] = count[node]
            total += count[node]
        n += 1
    # -- how many references are below each node, children before parents; then where they begin
    for n in range(end - 1, -1, -1):
        for c in range(child[n], child[n] + number[n]):
            size[n] += size[c]
    taken = np.empty(total, np.int64)
    for n in range(end):
        at = begin[n]
        for c in range(child[n], child[n] + number[n]):
            begin[c] = at
            at += size[c]
        if number[n] == 0:
            for i in range(size[n]):
                taken[begin[n] + i] = first[order[n]] + i
    return 0, 0, order[:end], child[:end], number[:end], begin[:end], size[:end], taken
