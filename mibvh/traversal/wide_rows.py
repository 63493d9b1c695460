"""The wide layout: a wide tree and its triangles as rows of 16 words, for the wide kernel.

All rows stand in one buffer; a node's children side by side, inner nodes first, in the order of the
tree. A leaf stands there with its first triangle; word 13 of a triangle's row is the row of the
leaf's next one, or 0.

With boxes of 8 bits a node is one row, as in the compressed wide BVH of Ylitie, Karras and Laine
(2017): the origin of the node's grid (3 words; the lowest six bits of each, which are no part of
it, are the exponent of that axis's grid), the row of the first child with the number of inner
children in the upper four bits (1), lower planes (x, y, z: 2 each, a byte per child), upper planes
(6). Where children are to be visited in an order of the tree's, that stands in a buffer of its own,
a word per row.

With float32 boxes a node of two, four or eight children takes one, two or four rows: lower planes
(x, y, z; one per child), upper planes, the word of the first child, and the order. Boxes stand in
the tree's order of children, so that the order also tells which place beside its siblings each
child has.

An order is a list of four bits per child, first child lowest: 8 plus its place beside its siblings.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.collapsing import collapse, unfold
from mibvh.errors import MibvhError
from mibvh.measures.area import Measure
from mibvh.quantise import finest_step, grid, quantised
from mibvh.traversal.pages import pages_of
from mibvh.tree import Tree
from mibvh.triangles import F32, Triangles
from mibvh.wide_tree import WideTree

U32 = npt.NDArray[np.uint32]

#: Entries of a list of children are this plus the child's place.
ENTRY = 8
#: Bits of a node's word that tell the row of the first child.
BASE_BITS = 28
#: An axis's grid is ``2**(LARGEST - exponent)`` long, in 256 steps.
LARGEST = 2
#: Rows of a node with float32 boxes, by width.
SPAN = {2: 1, 4: 2, 8: 4}
#: Batcher's sorting networks.
NETWORKS: dict[int, tuple[tuple[int, int], ...]] = {
    2: ((0, 1),),
    4: ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)),
    8: (
        (0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (1, 2), (5, 6),
        (0, 4), (1, 5), (2, 6), (3, 7), (2, 4), (3, 5), (1, 2), (3, 4), (5, 6),
    ),
}  # fmt: skip


def as_wide(
    tree: Tree | WideTree, triangles: Triangles, measure: Measure | None = None
) -> WideTree:
    """The tree that the wide kernel walks for a tree: a wide one itself.

    Of a binary one, the nodes of eight children whose areas, or measures, have the least sum, with
    every triangle a child, on 8-bit grids.
    """
    if isinstance(tree, WideTree):
        return tree
    wide = collapse(unfold(tree, triangles), 8, c_box=0.0, measure=measure)
    # Boxes may be larger than the scene; grids are not.
    lower, upper = (np.clip(box, *triangles.bounds) for box in (wide.lower, wide.upper))
    return quantised(wide.replace(lower=lower, upper=upper))


def wide_rows(tree: WideTree, shapes: F32, scale: np.float32) -> tuple[F32, U32, int]:
    """Rows of a wide tree.

    Parameters
    ----------
    tree : WideTree
    shapes : (R, 16) float32
        A row for each of the tree's references.
    scale : float32
        From scene units to the records', a power of two.

    Returns
    -------
    rows : (K, 16) float32
        At the beginning of a page.
    order : (K,) uint32
        The order of each node's children.
    root : int
        1 if the root is an inner node, 0 if it is a leaf.

    Raises
    ------
    MibvhError
        If the tree's boxes reach so far beyond its triangles that no grid holds them.
    """
    span = 1 if tree.quantised else SPAN[tree.width]
    inners = int(np.count_nonzero(tree.child >= 0))
    rows = pages_of(len(shapes) + span * inners)
    order, ok = _emit(
        tree.lower * scale,
        tree.upper * scale,
        tree.child,
        tree.children,
        tree.first,
        tree.count,
        tree.width,
        tree.quantised,
        span,
        shapes,
        rows,
    )
    if not ok:
        raise MibvhError("the wide tree's 8-bit boxes are too large or too fine for its triangles")
    return rows, order, int(tree.child[0] >= 0)


@njit
def _emit(lower, upper, child, children, first, count, width, small, span, shapes, rows):
    """Write rows that were zero, depth first; return orders, and whether all boxes fit grids."""
    order = np.zeros(len(rows), np.uint32)
    finest = finest_step(lower[0], upper[0])
    stack = np.empty((len(child) + 1, 2), np.int64)  # node, row
    stack[0, 0], stack[0, 1], top = 0, 0, 1
    end = span if child[0] >= 0 else 1
    ok = True
    place = np.empty(width, np.int64)
    while top > 0:
        top -= 1
        node, row = stack[top, 0], stack[top, 1]
        if child[node] < 0:
            end = _leaf(rows, row, end, shapes[first[node] : first[node] + count[node]])
            continue
        group = slice(child[node], child[node] + children[node])
        inner = 0
        for c in range(child[node], child[node] + children[node]):
            inner += child[c] >= 0
        # -- places beside the siblings: inner nodes, then leaves
        a, b = 0, inner
        for i in range(children[node]):
            if child[child[node] + i] >= 0:
                place[i] = a
                a += 1
            else:
                place[i] = b
                b += 1
            order[row] |= np.uint32((ENTRY + place[i]) << (4 * i))
        word = np.uint32(end) | np.uint32(inner) << np.uint32(BASE_BITS)
        if small:
            ok &= _small_node(rows[row], word, place, lower[group], upper[group], finest)
        else:
            _plain_node(
                rows[row : row + span].reshape(-1),
                word,
                order[row],
                lower[group],
                upper[group],
                width,
            )
        for i in range(children[node] - 1, -1, -1):
            at = end + place[i] + (span - 1) * min(place[i], inner)
            stack[top, 0], stack[top, 1] = child[node] + i, at
            top += 1
        end += children[node] + (span - 1) * inner
    return order, ok


@njit
def _leaf(rows, row, end, shapes):
    """A leaf's triangles: the first in a row beside its siblings, the others at the end."""
    bits = rows.view(np.int32)
    for i in range(len(shapes)):
        rows[row] = shapes[i]
        bits[row, 13] = end if i + 1 < len(shapes) else 0
        if i + 1 < len(shapes):
            row = end
            end += 1
    return end


@njit
def _plain_node(row, word, order, lower, upper, width):
    bits = row.view(np.uint32)
    for k in range(3):
        for i in range(width):
            there = i < len(lower)  # no ray enters a box at infinity before infinity
            row[width * k + i] = lower[i, k] if there else np.inf
            row[width * (3 + k) + i] = upper[i, k] if there else np.inf
    bits[6 * width] = word
    bits[6 * width + 1] = order


@njit
def _small_node(row, word, place, lower, upper, finest):
    bits = row.view(np.uint32)
    for k in range(3):
        origin, exponent = grid(lower[:, k].min(), upper[:, k].max(), finest)
        if not 0 <= LARGEST - 8 - exponent < 64:
            return False
        row[k] = origin
        bits[k] |= np.uint32(LARGEST - 8 - exponent)
        step = 2.0**exponent
        for i in range(8):
            a, b, at = 255, 0, i  # no ray enters an empty child
            if i < len(lower):
                a = int((np.float64(lower[i, k]) - origin) / step)
                b = int((np.float64(upper[i, k]) - origin) / step)
                at = place[i]
            shift = np.uint32(8 * (at % 4))
            bits[4 + 2 * k + at // 4] |= np.uint32(a) << shift
            bits[10 + 2 * k + at // 4] |= np.uint32(b) << shift
    bits[3] = word
    return True
