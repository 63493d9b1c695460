"""From a draft to a tree: bounds, SAH leaf collapse, de-duplication, depth, memory layout.

Every builder's draft goes through here. The collapse is the optimal one: bottom-up, a
subtree becomes a leaf where ``C_tri * triangles * area`` is no dearer than the best the
subtree can do (Karras and Aila 2013, section 4; the sum of Aila et al. 2013, eq. 1).

All of it happens in one walk over the draft that leaves each subtree behind as a finished
piece of the tree (:func:`_walk`). The walk goes backwards, right before left and children
before parents, and writes nodes from the end of the arrays towards their beginning: what
comes out stands parents first, siblings adjacent, the left subtree before the right one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F32, I32

#: A leaf of a split tree may hold a triangle twice; ranges up to this many references are
#: counted without repetition before they are refused as a leaf.
_MAX_DUPLICATED = 32

#: Subtrees this far down are rebuilt if they reach below ``MAX_DEPTH``. No real subtree has
#: over 2**24 references, so halving what is below fits into the levels that are left.
_REPAIR_DEPTH = MAX_DEPTH - 24


@njit
def _distinct(ids, first, end, limit):
    """Count the distinct values of ``ids[first:end]``; ``limit + 1`` for "more than limit"."""
    distinct = 0
    for i in range(first, end):
        seen = False
        for j in range(first, i):
            if ids[j] == ids[i]:
                seen = True
                break
        if not seen:
            distinct += 1
            if distinct > limit:
                break
    return distinct


@njit
def _drop_repeats(ids, first, end):
    """Keep the first of equal values of ``ids[first:end]``, moved to its end; return its start."""
    kept = end
    for i in range(end - 1, first - 1, -1):
        seen = False
        for j in range(first, i):
            if ids[j] == ids[i]:
                seen = True
                break
        if not seen:
            kept -= 1
            ids[kept] = ids[i]
    return kept


@njit
def _half_area(x0, y0, z0, x1, y1, z1):
    """Half the surface area of a box, float64."""
    x, y, z = np.float64(x1) - x0, np.float64(y1) - y0, np.float64(z1) - z0
    return x * y + y * z + z * x


@njit
def _write(out, n, box, unscale, child, first, count):
    """Write node n. Taking its box back to scene units is exact, the factor a power of two."""
    lower, upper, left, out_first, out_count, _ = out
    x0, y0, z0, x1, y1, z1 = box
    lower[n, 0], lower[n, 1], lower[n, 2] = x0 * unscale, y0 * unscale, z0 * unscale
    upper[n, 0], upper[n, 1], upper[n, 2] = x1 * unscale, y1 * unscale, z1 * unscale
    left[n], out_first[n], out_count[n] = child, first, count


@njit
def _walk(left, right, reference, lower, upper, triangle, split, costs, max_leaf, unscale, out):
    """Walk a draft once, backwards, and write the tree.

    A finished subtree is a handful of numbers: its box, its least cost times its area, its
    range of references, its height, and where its children were written. Only the pairs of
    nodes below it are in memory; it is written itself together with its sibling, when both
    are known. A subtree that is better off as a leaf takes back what was written below it
    by setting the write position back.

    Parameters
    ----------
    left, right, reference : (2R - 1,) int32
        The draft.
    lower, upper : (R, 3) float32; triangle : (R,) int32
        Its references.
    split : bool
        Whether a triangle may have several references.
    costs : (float, float)
        ``C_inner``, ``C_tri``.
    max_leaf : int
    unscale : float32
        What takes builder units back to scene units.
    out : tuple of arrays
        lower, upper (2R - 1, 3); left, first, count (2R - 1,); references (R,): written
        from their ends.

    Returns
    -------
    nodes, references, height : int
        How many were written, and the edges on the longest path.
    cost, area : float
        Of the root, in builder units.
    """
    ids = out[5]
    c_inner, c_tri = costs
    # One frame per ancestor of the current node. While its right child is being worked on
    # ("waiting"), it knows only where writing stood before; then it keeps that child.
    frames = len(ids) + 1
    node_of = np.empty(frames, np.int32)
    place_of = np.empty(frames, np.int32)
    waiting = np.empty(frames, np.bool_)
    box_of = np.empty((frames, 6), np.float32)
    cost_of = np.empty(frames, np.float64)
    rest_of = np.empty((frames, 4), np.int32)
    place, written = np.int32(len(out[2])), np.int32(len(ids))
    node, top = np.int32(0), 0
    while True:
        while left[node] >= 0:
            node_of[top], place_of[top], waiting[top] = node, place, True
            top += 1
            node = right[node]
        # A leaf: the finished subtree is one reference.
        r = reference[node]
        x0, y0, z0 = lower[r, 0], lower[r, 1], lower[r, 2]
        x1, y1, z1 = upper[r, 0], upper[r, 1], upper[r, 2]
        area = _half_area(x0, y0, z0, x1, y1, z1)
        cost = c_tri * area
        written -= np.int32(1)
        ids[written] = triangle[r]
        child, first, count, height = np.int32(-1), written, np.int32(1), np.int32(0)
        # Where the finished subtree is a left child, its sibling is finished too: join them.
        while top > 0 and not waiting[top - 1]:
            top -= 1
            u0, v0, w0 = box_of[top, 0], box_of[top, 1], box_of[top, 2]
            u1, v1, w1 = box_of[top, 3], box_of[top, 4], box_of[top, 5]
            child_b, first_b, count_b, height_b = rest_of[top]
            place -= np.int32(2)
            _write(out, place, (x0, y0, z0, x1, y1, z1), unscale, child, first, count)
            _write(out, place + 1, (u0, v0, w0, u1, v1, w1), unscale, child_b, first_b, count_b)
            x0, y0, z0 = min(x0, u0), min(y0, v0), min(z0, w0)
            x1, y1, z1 = max(x1, u1), max(y1, v1), max(z1, w1)
            area = _half_area(x0, y0, z0, x1, y1, z1)
            cost = cost_of[top] + cost + c_inner * area
            child, count, height = place, count + count_b, max(height, height_b) + np.int32(1)
            size = count
            if split and count <= _MAX_DUPLICATED:
                size = np.int32(_distinct(ids, written, written + count, max_leaf))
            if size <= max_leaf and c_tri * size * area <= cost:
                cost = c_tri * size * area
                if size < count:
                    written = np.int32(_drop_repeats(ids, written, written + count))
                child, first, count, height = np.int32(-1), written, size, np.int32(0)
                place = place_of[top]
        if top == 0:
            break
        # It is a right child: keep it, and turn to the left one.
        top -= 1
        box_of[top, 0], box_of[top, 1], box_of[top, 2] = x0, y0, z0
        box_of[top, 3], box_of[top, 4], box_of[top, 5] = x1, y1, z1
        cost_of[top] = cost
        rest_of[top, 0], rest_of[top, 1] = child, first
        rest_of[top, 2], rest_of[top, 3] = count, height
        waiting[top] = False
        node = left[node_of[top]]
        top += 1
    place -= np.int32(1)
    _write(out, place, (x0, y0, z0, x1, y1, z1), unscale, child, first, count)
    # Positions so far are those in the whole arrays; count them from where writing ended.
    out_left, out_first = out[2], out[3]
    for n in range(place, len(out_left)):
        out_left[n] = out_left[n] - place if out_left[n] >= 0 else np.int32(-1)
        out_first[n] -= written
    return len(out_left) - place, len(ids) - written, height, cost, area


@njit
def _preorder(left, right):
    """Nodes parents first, left subtrees before right ones, and the depth of each."""
    order = np.empty(len(left), np.int32)
    depth = np.empty(len(left), np.int32)
    stack = np.empty((len(left) // 2 + 1, 2), np.int32)
    stack[0, 0], stack[0, 1], top = 0, 0, 1
    used = 0
    while top > 0:
        top -= 1
        node, level = stack[top, 0], stack[top, 1]
        order[used], depth[used] = node, level
        used += 1
        if left[node] >= 0:
            stack[top, 0], stack[top, 1] = right[node], level + 1
            stack[top + 1, 0], stack[top + 1, 1] = left[node], level + 1
            top += 2
    return order, depth


@njit
def _repair(left, right, reference, limit):
    """Halve, in place, the subtrees at depth ``limit`` that reach below ``MAX_DEPTH``.

    Their references keep the order they have in the tree, which is a spatial one.
    """
    order, depth = _preorder(left, right)
    ids = np.empty((len(order) + 1) // 2, np.int32)
    stack = np.empty((MAX_DEPTH + 2, 3), np.int32)
    p = 0
    while p < len(order):
        if depth[p] != limit:
            p += 1
            continue
        # The subtree is the run of nodes that are deeper than its root.
        end, deepest, size = p + 1, limit, 0
        while end < len(order) and depth[end] > limit:
            deepest = max(deepest, depth[end])
            end += 1
        if deepest > MAX_DEPTH:
            for q in range(p, end):
                if left[order[q]] < 0:
                    ids[size] = reference[order[q]]
                    size += 1
            used = p + 1
            stack[0, 0], stack[0, 1], stack[0, 2], top = order[p], 0, size, 1
            while top > 0:
                top -= 1
                node, a, b = stack[top, 0], stack[top, 1], stack[top, 2]
                if b - a == 1:
                    left[node], right[node], reference[node] = -1, -1, ids[a]
                    continue
                left[node], right[node], reference[node] = order[used], order[used + 1], -1
                middle = (a + b) // 2
                stack[top, 0], stack[top, 1], stack[top, 2] = right[node], middle, b
                stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = left[node], a, middle
                used, top = used + 2, top + 2
        p = end


@njit
def _has_repeats(triangle):
    """Whether an id (a small non-negative number) stands in the array twice."""
    seen = np.zeros(triangle.max() + 1, np.bool_)
    for t in triangle:
        if seen[t]:
            return True
        seen[t] = True
    return False


def _outputs(count: int) -> tuple[F32, F32, I32, I32, I32, I32]:
    """Room for the tree of so many references; pages that stay unused cost no memory."""
    nodes = 2 * count - 1
    return (
        np.empty((nodes, 3), np.float32),
        np.empty((nodes, 3), np.float32),
        np.empty(nodes, np.int32),
        np.empty(nodes, np.int32),
        np.empty(nodes, np.int32),
        np.empty(count, np.int32),
    )


def _run(
    draft: Draft, out: tuple[Any, ...], split: bool, c_inner: float, c_tri: float, max_leaf: int
) -> tuple[Any, ...]:
    refs = draft.references
    return _walk(
        draft.left,
        draft.right,
        draft.reference,
        refs.lower,
        refs.upper,
        refs.triangle,
        split,
        (c_inner, c_tri),
        max_leaf,
        np.float32(1.0 / refs.scale),
        out,
    )


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
    split = meta["triangles"] < len(draft.references)
    out = _outputs(len(draft.references))
    nodes, written, height, _, _ = _run(draft, out, split, c_inner, c_tri, max_leaf)
    if height > MAX_DEPTH:
        links = draft.left.copy(), draft.right.copy(), draft.reference.copy()
        _repair(*links, _REPAIR_DEPTH)
        draft = Draft(draft.references, *links, draft.report)
        nodes, written, _, _, _ = _run(draft, out, split, c_inner, c_tri, max_leaf)
        meta = {**meta, "depth_repaired": True}
    lower, upper, left, first, count = (array[len(array) - nodes :] for array in out[:5])
    return Tree(lower, upper, left, first, count, out[5][len(out[5]) - written :], meta)


def draft_sah(draft: Draft, *, c_inner: float, c_tri: float, max_leaf: int) -> float:
    """SAH of the tree that a draft will become (before any repair of its depth).

    Optimisers judge their progress by this: what counts is the tree after the collapse.
    """
    split = bool(_has_repeats(draft.references.triangle))
    out = _outputs(len(draft.references))
    nodes, written, _, cost, area = _run(draft, out, split, c_inner, c_tri, max_leaf)
    if area > 0:
        return float(cost / area)
    # Where the root has no area, the SAH takes every ratio of areas as 1.
    return c_inner * (nodes // 2) + c_tri * written


@njit
def _node_boxes(left, right, reference, lower, upper):
    """Box of each node, children before parents."""
    order, _ = _preorder(left, right)
    boxes = np.empty((len(left), 6), np.float32)
    for p in range(len(order) - 1, -1, -1):
        node = order[p]
        a, b, r = left[node], right[node], reference[node]
        for k in range(3):
            boxes[node, k] = lower[r, k] if a < 0 else min(boxes[a, k], boxes[b, k])
            boxes[node, k + 3] = upper[r, k] if a < 0 else max(boxes[a, k + 3], boxes[b, k + 3])
    return boxes


def draft_boxes(draft: Draft) -> F32:
    """(2R - 1, 6) float32: box of each node of a draft, lower corner then upper, builder units."""
    refs = draft.references
    return _node_boxes(draft.left, draft.right, draft.reference, refs.lower, refs.upper)
