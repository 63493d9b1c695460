"""From a draft to a tree: bounds, SAH leaf collapse, de-duplication, depth, memory layout.

Every builder's draft goes through here. The collapse is the optimal one: bottom-up, a
subtree becomes a leaf where ``C_tri * triangles * area`` is no dearer than the best the
subtree can do (Karras and Aila 2013, section 4; the sum of Aila et al. 2013, eq. 1).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F32

#: A leaf of a split tree may hold a triangle twice; ranges up to this many references are
#: counted without repetition before they are refused as a leaf.
_MAX_DUPLICATED = 32


@njit
def _preorder(left, right, reference):
    """Order nodes parent-first, and references as the leaves come.

    Returns the nodes in preorder, the reference ids in leaf order, and for each preorder
    position: its parent's position, the first of its references, their number, and the
    size of its subtree. Subtrees are contiguous, so a node's left child is the next one.
    """
    nodes = len(left)
    order = np.empty(nodes, np.int32)
    parent = np.empty(nodes, np.int32)
    first = np.empty(nodes, np.int32)
    count = np.zeros(nodes, np.int32)
    leaf_order = np.empty((nodes + 1) // 2, np.int32)
    stack = np.empty(nodes + 1, np.int32)
    stack_parent = np.empty(nodes + 1, np.int32)
    stack[0], stack_parent[0], depth = 0, -1, 1
    position, leaves = 0, 0
    while depth > 0:
        depth -= 1
        node = stack[depth]
        order[position] = node
        parent[position] = stack_parent[depth]
        first[position] = leaves
        if left[node] < 0:
            leaf_order[leaves] = reference[node]
            leaves += 1
            count[position] = 1
        else:
            stack[depth], stack_parent[depth] = right[node], position
            stack[depth + 1], stack_parent[depth + 1] = left[node], position
            depth += 2
        position += 1
    for p in range(position - 1, 0, -1):
        count[parent[p]] += count[p]
    return order[:position], leaf_order[:leaves], parent[:position], first[:position], count[:position]


@njit
def _bounds(parent, count, first, leaf_order, lower, upper):
    """Bottom-up node boxes: (P, 6) float32, lower corner then upper, by preorder position."""
    nodes = len(parent)
    box = np.empty((nodes, 6), np.float32)
    for p in range(nodes):
        for k in range(3):
            box[p, k] = np.inf
            box[p, k + 3] = -np.inf
    for p in range(nodes - 1, -1, -1):
        if count[p] == 1:
            r = leaf_order[first[p]]
            for k in range(3):
                box[p, k] = lower[r, k]
                box[p, k + 3] = upper[r, k]
        q = parent[p]
        if q >= 0:
            for k in range(3):
                if box[p, k] < box[q, k]:
                    box[q, k] = box[p, k]
                if box[p, k + 3] > box[q, k + 3]:
                    box[q, k + 3] = box[p, k + 3]
    return box


@njit
def _distinct(leaf_order, triangle, first, count, limit):
    """Count the distinct triangles of a range; ``limit + 1`` for "more than limit"."""
    distinct = 0
    for i in range(first, first + count):
        t = triangle[leaf_order[i]]
        seen = False
        for j in range(first, i):
            if triangle[leaf_order[j]] == t:
                seen = True
                break
        if not seen:
            distinct += 1
            if distinct > limit:
                break
    return distinct


@njit
def _collapse(parent, first, count, box, leaf_order, triangle, split, c_inner, c_tri, max_leaf):
    """Decide which positions become leaves.

    Returns (P,) bool, and (P,) float64: the least cost of each subtree, times its area.
    """
    nodes = len(parent)
    cost = np.zeros(nodes, np.float64)
    leaf = np.zeros(nodes, np.bool_)
    for p in range(nodes - 1, -1, -1):
        x = np.float64(box[p, 3]) - box[p, 0]
        y = np.float64(box[p, 4]) - box[p, 1]
        z = np.float64(box[p, 5]) - box[p, 2]
        area = x * y + y * z + z * x
        if count[p] == 1:
            leaf[p] = True
            cost[p] = c_tri * area
        else:
            cost[p] += c_inner * area
            size = count[p]
            if split and size <= _MAX_DUPLICATED:
                size = _distinct(leaf_order, triangle, first[p], size, max_leaf)
            if size <= max_leaf and c_tri * size * area <= cost[p]:
                leaf[p] = True
                cost[p] = c_tri * size * area
        if parent[p] >= 0:
            cost[parent[p]] += cost[p]
    return leaf, cost


@njit
def _emit(parent, first, count, box, leaf, leaf_order, triangle, split):
    """Write the final arrays: depth-first, siblings adjacent, no repeated triangle in a leaf."""
    nodes = len(parent)
    # A node of the tree is one with no leaf above it; the size of a subtree of n references
    # is 2n - 1, so a left child stands at p + 1 and a right child at p + 2 * count(left).
    kept = np.zeros(nodes, np.bool_)
    kept[0] = True
    total = 1
    for p in range(1, nodes):
        q = parent[p]
        if kept[q] and not leaf[q]:
            kept[p] = True
            total += 1
    lower = np.empty((total, 3), np.float32)
    upper = np.empty((total, 3), np.float32)
    left = np.full(total, -1, np.int32)
    out_first = np.empty(total, np.int32)
    out_count = np.zeros(total, np.int32)
    depth = np.zeros(total, np.int32)
    references = np.empty(len(leaf_order), np.int32)
    stack = np.empty(total + 1, np.int32)
    place = np.empty(total + 1, np.int32)
    stack[0], place[0], top = 0, 0, 1
    used, written = 1, 0
    while top > 0:
        top -= 1
        p, n = stack[top], place[top]
        for k in range(3):
            lower[n, k] = box[p, k]
            upper[n, k] = box[p, k + 3]
        out_first[n] = written
        if leaf[p]:
            for i in range(first[p], first[p] + count[p]):
                t = triangle[leaf_order[i]]
                repeated = False
                if split:
                    for j in range(out_first[n], written):
                        if references[j] == t:
                            repeated = True
                            break
                if not repeated:
                    references[written] = t
                    written += 1
            out_count[n] = written - out_first[n]
        else:
            left[n] = used
            depth[used] = depth[n] + 1
            depth[used + 1] = depth[n] + 1
            a = p + 1
            stack[top], place[top] = a + 2 * count[a] - 1, used + 1
            stack[top + 1], place[top + 1] = a, used
            top += 2
            used += 2
    for n in range(total - 1, -1, -1):  # children stand behind their parents
        if left[n] >= 0:
            out_count[n] = out_count[left[n]] + out_count[left[n] + 1]
    return lower, upper, left, out_first, out_count, references[:written].copy(), depth.max()


def _rebuild_balanced(draft: Draft, arrays: tuple[Any, ...]) -> Draft:
    """Halve the subtrees that would overrun the traversal stack, by object median.

    Legal input can need it: a Morton tree over clustered points, say. What stands above
    ``MAX_DEPTH - 24`` levels is left alone; below, no real subtree has over 2**24
    references, so halving them fits.
    """
    order, leaf_order, parent, first, count = arrays
    depth = np.zeros(len(parent), np.int32)
    height = np.zeros(len(parent), np.int32)
    _levels(parent, depth, height)
    left, right, reference = draft.left.copy(), draft.right.copy(), draft.reference.copy()
    refs = draft.references
    centers = refs.lower + refs.upper
    start = MAX_DEPTH - 24
    for p in np.flatnonzero((depth == start) & (depth + height > MAX_DEPTH)):
        slots = iter(order[p : p + 2 * count[p] - 1])  # a subtree is contiguous in preorder
        work = [(next(slots), leaf_order[first[p] : first[p] + count[p]])]
        while work:
            node, ids = work.pop()
            left[node] = right[node] = reference[node] = -1
            if len(ids) == 1:
                reference[node] = ids[0]
                continue
            axis = np.ptp(centers[ids], axis=0).argmax()
            ids = ids[np.argsort(centers[ids, axis], kind="stable")]
            left[node], right[node] = next(slots), next(slots)
            work += [(left[node], ids[: len(ids) // 2]), (right[node], ids[len(ids) // 2 :])]
    return Draft(refs, left, right, reference, draft.report)


@njit
def _levels(parent, depth, height):
    for p in range(1, len(parent)):
        depth[p] = depth[parent[p]] + 1
    for p in range(len(parent) - 1, 0, -1):
        height[parent[p]] = max(height[parent[p]], height[p] + 1)


def finish(
    draft: Draft, *, c_inner: float, c_tri: float, max_leaf: int, meta: dict[str, Any]
) -> Tree:
    """Make the tree of a draft.

    Parameters
    ----------
    draft : Draft
        One reference per leaf.
    c_inner, c_tri : float
        Cost constants of the collapse.
    max_leaf : int
        Largest number of triangles in a leaf.
    meta : dict
        Kept as ``tree.meta``.

    Returns
    -------
    Tree
        Boxes in scene units, at most :data:`~mibvh.tree.MAX_DEPTH` deep.
    """
    refs = draft.references
    split = meta["triangles"] < len(refs)
    arrays = _preorder(draft.left, draft.right, draft.reference)
    out = _finish_arrays(arrays, refs, split, c_inner, c_tri, max_leaf)
    if out[6] > MAX_DEPTH:
        draft = _rebuild_balanced(draft, arrays)
        arrays = _preorder(draft.left, draft.right, draft.reference)
        out = _finish_arrays(arrays, refs, split, c_inner, c_tri, max_leaf)
        meta = {**meta, "depth_repaired": True}
    lower, upper, left, first, count, references, _ = out
    unscale = np.float32(1.0 / refs.scale)
    return Tree(lower * unscale, upper * unscale, left, first, count, references, meta)


def _finish_arrays(
    arrays: tuple[Any, ...],
    refs: References,
    split: bool,
    c_inner: float,
    c_tri: float,
    max_leaf: int,
) -> tuple[Any, ...]:
    _, leaf_order, parent, first, count = arrays
    box = _bounds(parent, count, first, leaf_order, refs.lower, refs.upper)
    leaf, _ = _collapse(
        parent, first, count, box, leaf_order, refs.triangle, split, c_inner, c_tri, max_leaf
    )
    return _emit(parent, first, count, box, leaf, leaf_order, refs.triangle, split)


def draft_sah(draft: Draft, *, c_inner: float, c_tri: float, max_leaf: int) -> float:
    """SAH of the tree that a draft will become (before any repair of its depth).

    Optimisers judge their progress by this: what counts is the tree after the collapse.
    """
    refs = draft.references
    _, leaf_order, parent, first, count = _preorder(draft.left, draft.right, draft.reference)
    box = _bounds(parent, count, first, leaf_order, refs.lower, refs.upper)
    split = len(np.unique(refs.triangle)) < len(refs)
    _, cost = _collapse(
        parent, first, count, box, leaf_order, refs.triangle, split, c_inner, c_tri, max_leaf
    )
    x, y, z = (box[0, 3:].astype(np.float64) - box[0, :3]).tolist()
    area = x * y + y * z + z * x
    return float(cost[0] / area) if area > 0 else 0.0


def draft_boxes(draft: Draft) -> F32:
    """(2R - 1, 6) float32: box of each node of a draft, lower corner then upper, builder units."""
    refs = draft.references
    order, leaf_order, parent, first, count = _preorder(draft.left, draft.right, draft.reference)
    boxes = np.empty((len(order), 6), np.float32)
    boxes[order] = _bounds(parent, count, first, leaf_order, refs.lower, refs.upper)
    return boxes
