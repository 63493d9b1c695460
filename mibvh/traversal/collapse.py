"""The wide layout: a binary tree collapsed to nodes of eight children, boxes in 8 bits.

As the compressed wide BVH of Ylitie, Karras and Laine (*Efficient Incoherent Ray Traversal on GPUs
Through Compressed Wide BVHs*, HPG 2017): which binary nodes become wide ones is chosen by dynamic
programming over their areas, and a node stores its children's boxes on a grid of its own. Other
than there, every triangle is a child with a box of its own, and nodes and triangles are rows of
equal length in one buffer, a node's children side by side, inner nodes first.

A node's row of 16 words: the grid's origin (3; the lowest six bits of each are the exponent of
that axis's grid), the row of the first child with the number of inner children in the upper four
bits (1), lower planes (x, y, z: 2 each, a byte per child), upper planes (6).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.tree import Tree
from mibvh.triangles import F32, I32

WIDTH = 8
#: Bits of a row's word 3 that tell the row of the first child.
BASE_BITS = 28
#: An axis's grid is ``2**(LARGEST - exponent)`` long, in 256 steps.
LARGEST = 2
#: Boxes are widened by this share of a grid step: far more than the kernel's rounding can lose.
_SLACK = 1.0 / 256


@dataclasses.dataclass(frozen=True, eq=False)
class Collapsed:
    """A binary tree with one reference per leaf, and which of its nodes become wide ones."""

    lower: F32
    upper: F32
    left: I32
    reference: I32
    cut: Any

    def rows(self, triangle_rows: F32) -> tuple[F32, int, int]:
        """Rows of the wide tree, whether its root is an inner node, and its depth.

        Takes a row for each of the tree's references.
        """
        if self.left[0] < 0:
            return triangle_rows, 0, 0
        rows, depth = _emit(
            self.lower, self.upper, self.left, self.reference, self.cut, triangle_rows
        )
        return rows, 1, depth


def collapse(tree: Tree, corners: F32, lower: F32, upper: F32) -> Collapsed:
    """Choose the wide nodes of a tree.

    Parameters
    ----------
    tree : Tree
    corners : (N, 3, 3) float32
        Triangles in the records' units, between -1 and 1.
    lower, upper : (M, 3) float32
        The tree's boxes in the same units.
    """
    lo, hi, left, reference = _unfold(
        lower, upper, tree.left, tree.first, tree.count, tree.references, corners
    )
    return Collapsed(lo, hi, left, reference, _choose(lo, hi, left))


@njit
def _unfold(lower, upper, left, first, count, references, corners):
    """Halve leaves until each holds one reference, boxed by its part of the leaf's box."""
    nodes, size = len(left), len(left) + 2 * len(references)
    lo, hi = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    child, reference = np.full(size, -1, np.int32), np.full(size, -1, np.int32)
    lo[:nodes], hi[:nodes], child[:nodes] = lower, upper, left
    begin, end = np.zeros(size, np.int32), np.zeros(size, np.int32)
    size = nodes
    for leaf in range(nodes):
        if left[leaf] >= 0:
            continue
        begin[leaf], end[leaf] = first[leaf], first[leaf] + count[leaf]
        # -- halve, parents before children
        new = size
        n = leaf
        while n < size:
            if end[n] - begin[n] > 1:
                child[n] = size
                begin[size], end[size + 1] = begin[n], end[n]
                end[size] = begin[size + 1] = (begin[n] + end[n]) // 2
                size += 2
            n = max(n + 1, new)
        # -- boxes, children before parents
        for i in range(size - 1, new - 2, -1):
            n = i if i >= new else leaf
            if child[n] >= 0:
                for k in range(3):
                    lo[n, k] = min(lo[child[n], k], lo[child[n] + 1, k])
                    hi[n, k] = max(hi[child[n], k], hi[child[n] + 1, k])
                continue
            reference[n] = begin[n]
            t = references[begin[n]]
            for k in range(3):
                a = min(corners[t, 0, k], corners[t, 1, k], corners[t, 2, k])
                b = max(corners[t, 0, k], corners[t, 1, k], corners[t, 2, k])
                lo[n, k] = min(max(a, lower[leaf, k]), upper[leaf, k])
                hi[n, k] = max(min(b, upper[leaf, k]), lower[leaf, k])
    return lo[:size], hi[:size], child[:size], reference[:size]


@njit
def _choose(lower, upper, left):
    """How each node's subtree is best cut into at most j = 1..8 roots.

    The cost of a cut is the area of the wide nodes in it. ``cut[n, j]`` is how many of the
    roots the left child gets, or 0 where one root, the node itself, is best.
    """
    nodes = len(left)
    cost = np.zeros((nodes, WIDTH), np.float32)
    cut = np.zeros((nodes, WIDTH + 1), np.int8)
    for n in range(nodes - 1, -1, -1):
        if left[n] < 0:
            continue
        x, y, z = upper[n, 0] - lower[n, 0], upper[n, 1] - lower[n, 1], upper[n, 2] - lower[n, 2]
        a, b = left[n], left[n] + 1
        for j in range(WIDTH, 1, -1):
            best = np.float32(np.inf)
            for k in range(max(1, j - WIDTH + 1), min(j, WIDTH)):
                if cost[a, k] + cost[b, j - k] < best:
                    best = cost[a, k] + cost[b, j - k]
                    cut[n, j] = k
            if j == WIDTH:
                cost[n, 1] = best + (x * y + y * z + z * x)
            elif cost[n, 1] <= best:
                cost[n, j], cut[n, j] = cost[n, 1], 0
            else:
                cost[n, j] = best
    return cut


@njit
def _emit(lower, upper, left, reference, cut, triangle_rows):
    """Rows of the wide tree, depth first; and its depth."""
    rows = np.zeros((len(triangle_rows) + len(left), 16), np.float32)
    end, depth, top = 1, 0, 1
    stack = np.zeros((len(left), 3), np.int32)  # node, row, depth
    while top:
        top -= 1
        node, row, level = stack[top, 0], stack[top, 1], stack[top, 2]
        depth = max(depth, level)
        roots, inner = _roots(node, left, cut)
        base = end
        end += len(roots)
        _node_row(rows[row], base, inner, lower[roots], upper[roots])
        for i in range(len(roots) - 1, -1, -1):
            if i < inner:
                stack[top, 0], stack[top, 1], stack[top, 2] = roots[i], base + i, level + 1
                top += 1
            else:
                rows[base + i] = triangle_rows[reference[roots[i]]]
    return rows[:end].copy(), depth


@njit
def _roots(node, left, cut):
    """Children of a wide node, inner ones first, and how many those are."""
    inner, leaves = np.empty(WIDTH, np.int32), np.empty(WIDTH, np.int32)
    inners, leafs = 0, 0
    todo = np.empty((WIDTH, 2), np.int32)
    k = cut[node, WIDTH]
    todo[0, 0], todo[0, 1] = left[node] + 1, WIDTH - k
    todo[1, 0], todo[1, 1] = left[node], k
    top = 2
    while top:
        top -= 1
        n, j = todo[top, 0], todo[top, 1]
        k = cut[n, j] if j > 1 else 0
        if left[n] < 0:
            leaves[leafs] = n
            leafs += 1
        elif k == 0:
            inner[inners] = n
            inners += 1
        else:
            todo[top, 0], todo[top, 1] = left[n] + 1, j - k
            todo[top + 1, 0], todo[top + 1, 1] = left[n], k
            top += 2
    return np.concatenate((inner[:inners], leaves[:leafs])), inners


@njit
def _node_row(row, base, inner, lower, upper):
    bits = row.view(np.uint32)
    for k in range(3):
        low, high = np.float64(lower[:, k].min()), np.float64(upper[:, k].max())
        exponent = min(63, LARGEST - math.frexp(high - low)[1]) if high > low else 63
        while True:
            step = 2.0 ** (LARGEST - 8 - exponent)
            origin = np.float64(_with_exponent(low - step * _SLACK, exponent))
            if (high - origin) / step + _SLACK <= 255:
                break
            exponent -= 1
        row[k] = origin
        for i in range(WIDTH):
            a, b = 255, 0  # no ray enters an empty child
            if i < len(lower):
                a = int(np.floor((np.float64(lower[i, k]) - origin) / step - _SLACK))
                b = int(np.ceil((np.float64(upper[i, k]) - origin) / step + _SLACK))
            shift = np.uint32(8 * (i % 4))
            bits[4 + 2 * k + i // 4] |= np.uint32(max(a, 0)) << shift
            bits[10 + 2 * k + i // 4] |= np.uint32(b) << shift
    bits[3] = np.uint32(base) | (np.uint32(inner) << np.uint32(BASE_BITS))


@njit
def _with_exponent(limit, exponent):
    """Largest float32 not above the limit whose lowest six bits are the exponent."""
    value = np.empty(1, np.float32)
    bits = value.view(np.int32)
    # Nothing in the records' units is smaller than the finest grid step.
    value[0] = limit if abs(limit) > 2.0**-60 else -(2.0**-60)
    bits[0] = (bits[0] & ~63) | exponent
    while value[0] > limit:
        bits[0] += 64 if value[0] < 0 else -64
    return value[0]
