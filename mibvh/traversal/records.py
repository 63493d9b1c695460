"""The records that the kernels read: a tree and its triangles as rows of floats.

One row of 16 floats per inner node holds both children, so that a node visit is one cache
line; one row of 16 floats per reference holds its triangle, in leaf order. Both stand in one
buffer, so that a step fetches its row before it asks of which kind it is. Coordinates are
scaled by a power of two to an extent near 1: products neither overflow nor underflow in
float32, and scaling back is exact.

A row of an inner node: left lower, left upper, right lower, right upper, two child codes, two
spare. Of a triangle, one per reference: three corners, normal, id, 1 for the last of its leaf, two
spare. A child code is the row of an inner node, or, complemented, that of the first triangle of a
leaf.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.parallel import run_blocks
from mibvh.traversal.pages import ROW, in_place, own_memory, pages_of
from mibvh.traversal.wide_rows import as_wide, wide_rows
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F32, Triangles, as_triangles
from mibvh.variant import mitsuba
from mibvh.wide_tree import WideTree

Layout = Literal["binary", "wide"]

#: References whose rows a thread writes at a time.
_BLOCK = 32_768
#: The code of "nothing left to do".
DONE = -(2**31)


class Records:
    """A tree in Dr.Jit's own memory.

    A plain class: Dr.Jit would take the fields of a dataclass for variables of its loop.

    Attributes
    ----------
    rows : Float
        Rows of :data:`ROW` floats: inner nodes, then triangles in leaf order; in the wide
        layout as :mod:`mibvh.traversal.wide_rows` has them.
    root : int
        Code of the root; in the wide layout 1 for an inner node and 0 for a triangle.
    scale : float
        From scene units to the records' units; a power of two.
    layout : str
        ``binary`` or ``wide``.
    wide : WideTree or None
        What the wide layout was made of.
    order : UInt32 or None
        In the wide layout, the order of each node's children, where the tree has one
        (:meth:`mibvh.WideTree.ordered`).
    single : bool
        In the wide layout, whether every leaf is one triangle.
    seen : UInt32 or None
        Where there is one, kernels of the binary layout mark in it each row that they read.
    """

    __slots__ = ("layout", "order", "root", "rows", "scale", "seen", "single", "wide")

    def __init__(
        self,
        rows: Any,
        root: int,
        scale: float,
        layout: Layout,
        wide: Any = None,
        order: Any = None,
    ) -> None:
        self.rows = rows
        self.root = root
        self.scale = scale
        self.layout = layout
        self.wide = wide
        self.order = order
        self.seen: Any = None
        self.single = wide is not None and bool((wide.count[wide.is_leaf] == 1).all())

    @property
    def size(self) -> int:
        """Bytes of the rows."""
        import drjit as dr

        return 4 * dr.width(self.rows)


@njit
def _node_rows(lower, upper, left, first, scale, rows):
    """Write the rows of the inner nodes, in the order of the tree's nodes; return the root's code.

    What is not written is zero before.
    """
    nodes = len(left)
    inners = (nodes - 1) // 2
    code = np.empty(nodes, np.int32)
    inner = 0
    for n in range(nodes):
        if left[n] >= 0:
            code[n] = inner
            inner += 1
        else:
            code[n] = ~(inners + first[n])
    bits = rows.view(np.int32)
    row = 0
    for n in range(nodes):
        if left[n] >= 0:
            for c in range(2):
                child = left[n] + c
                for k in range(3):
                    rows[row, 6 * c + k] = lower[child, k] * scale
                    rows[row, 6 * c + 3 + k] = upper[child, k] * scale
                bits[row, 12 + c] = code[child]
            row += 1
    return code[0]


@njit
def _triangle_rows(corners, references, last, scale, rows):
    """Write the rows of the references, which are zero before."""
    bits = rows.view(np.int32)
    e = np.empty((2, 3))
    for i in range(len(references)):
        t = references[i]
        for k in range(3):
            for c in range(3):
                rows[i, 3 * c + k] = corners[t, c, k] * scale
            e[0, k] = np.float64(rows[i, 3 + k]) - rows[i, k]
            e[1, k] = np.float64(rows[i, 6 + k]) - rows[i, k]
        normal = (
            e[0, 1] * e[1, 2] - e[0, 2] * e[1, 1],
            e[0, 2] * e[1, 0] - e[0, 0] * e[1, 2],
            e[0, 0] * e[1, 1] - e[0, 1] * e[1, 0],
        )
        # Of any length: scaled so that float32 holds that of the smallest triangle.
        largest = max(abs(normal[0]), abs(normal[1]), abs(normal[2]))
        for k in range(3):
            rows[i, 9 + k] = normal[k] / largest if largest > 0.0 else 0.0
        bits[i, 12] = t
        bits[i, 13] = last[i]


def make_records(tree: Tree | WideTree, triangles: Any, layout: Layout = "binary") -> Records:
    """Prepare a tree for tracing.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    layout : "binary" or "wide"
        A binary tree as it is; or a wide one, to which a binary one is collapsed
        (:func:`mibvh.traversal.wide_rows.as_wide`).

    Raises
    ------
    MibvhError
        If the tree was built for another geometry, is too deep for the stack, or is a wide one
        where a binary one is asked for.
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    scale = unit_scale(triangles)
    if layout == "wide":
        return _wide_records(as_wide(tree, triangles), triangles, scale)
    if isinstance(tree, WideTree):
        raise MibvhError("a wide tree is traced in the wide style, not in those of binary trees")
    rows, root = binary_rows(tree, triangles)
    return Records(in_place(rows), root, float(scale), layout)


def _wide_records(wide: WideTree, triangles: Triangles, scale: np.float32) -> Records:
    _check_depth(wide.depth)
    shapes = np.zeros((len(wide.references), ROW), np.float32)
    none = np.zeros_like(wide.references)
    _triangle_rows(triangles.corners, wide.references, none, scale, shapes)
    rows, order, root = wide_rows(wide, shapes, scale)
    ordered = None
    if wide.meta.get("ordered"):
        import drjit as dr

        ordered = dr.reinterpret_array(mitsuba().UInt32, own_memory(order.view(np.float32)))
    return Records(in_place(rows), root, float(scale), "wide", wide, ordered)


def binary_rows(tree: Tree, triangles: Triangles) -> tuple[F32, int]:
    """Rows of the binary layout in NumPy's memory, and the root's code.

    Raises
    ------
    MibvhError
        If the tree is too deep for the stack.
    """
    _check_depth(tree.depth)
    scale = unit_scale(triangles)
    inners = (len(tree) - 1) // 2
    rows = pages_of(inners + len(tree.references))
    root = _node_rows(tree.lower, tree.upper, tree.left, tree.first, scale, rows[:inners])
    _leaf_rows(tree, triangles, scale, rows[inners:])
    return rows, int(root)


def leaf_rows(tree: Tree | WideTree, triangles: Triangles, scale: np.float32) -> F32:
    """Rows of the binary layout for a tree's references, by the tree's own places."""
    rows = np.zeros((len(tree.references), ROW), np.float32)
    _leaf_rows(tree, triangles, scale, rows)
    return rows


def _leaf_rows(tree: Tree | WideTree, triangles: Triangles, scale: np.float32, rows: F32) -> None:
    last = np.zeros(len(tree.references), np.int32)
    leaves = tree.is_leaf
    last[tree.first[leaves] + tree.count[leaves] - 1] = 1
    references = tree.references

    def work(_worker: int, begin: int, end: int) -> None:
        some = slice(begin, end)
        _triangle_rows(triangles.corners, references[some], last[some], scale, rows[some])

    run_blocks(work, len(references), _BLOCK)


def _check_depth(depth: int) -> None:
    if depth > MAX_DEPTH:
        raise MibvhError(f"the tree is {depth} levels deep; the traversal stack has {MAX_DEPTH}")


def unit_scale(triangles: Triangles) -> np.float32:
    """Power of two that brings the largest coordinate to between 1/2 and 1."""
    largest = float(np.abs(triangles.bounds).max())
    return np.float32(2.0 ** -np.frexp(largest)[1] if largest > 0 else 1.0)
