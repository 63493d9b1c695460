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
from mibvh.builders.measured import exact_cost_of
from mibvh.builders.simd import (
    load,
    load_corners,
    prefetch,
    store,
    store_corners,
    union,
)
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F32, I32

#: A leaf of a split tree may hold a triangle twice; ranges up to this many references are
#: counted without repetition before they are refused as a leaf.
_MAX_DUPLICATED = 32

#: How many nodes before its turn a leaf's reference is asked for from memory: the walk goes
#: backwards, mostly through nodes side by side.
_AHEAD = np.uint64(12)

#: Subtrees this far down are rebuilt if they reach below ``MAX_DEPTH``. No real subtree has
#: over 2**24 references, so halving what is below fits into the levels that are left.
_REPAIR_DEPTH = MAX_DEPTH - 24


@njit(allocates=False)
def _holds(run, count, value):
    """Whether a value is among the first ``count``; quicker to compile than ``in``."""
    i = 0
    while i < count and run[i] != value:
        i += 1
    return i < count


@njit(allocates=False)
def _distinct(ids, first, count, limit):
    """Count the distinct values of ``ids[first : first + count]``; at most ``limit + 1``."""
    distinct = 0
    run = ids[first : first + np.uint64(count)]
    for i in range(count):
        if not _holds(run, i, run[i]):
            distinct += 1
            if distinct > limit:
                break
    return distinct


@njit(allocates=False)
def _drop_repeats(ids, first, count):
    """Keep the first of equal values of ``ids[first : first + count]``; return their new start.

    They are moved to the end of the run, since writing goes on in front of it.
    """
    run = ids[first : first + np.uint64(count)]
    kept = count
    for i in range(count - 1, -1, -1):
        if not _holds(run, i, run[i]):
            kept -= 1
            run[kept] = run[i]
    return first + np.uint64(kept)


@njit
def _walk(
    left, right, reference, lower, upper, triangle, split, costs, max_leaf, unscale, out, measure
):
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
    measure : None or tuple
        Of boxes; None is the area.

    Returns
    -------
    nodes, references, height : int
        How many were written, and the edges on the longest path.
    cost, area : float
        Of the root, in builder units.
    """
    out_lower, out_upper, out_left, out_first, out_count, ids = out
    c_inner, c_tri = costs
    # One frame per ancestor of the current node. While its right child is being worked on
    # ("waiting"), it knows only where writing stood before; then it keeps that child.
    frames = len(ids) + 1
    node_of = np.empty(frames, np.int32)
    place_of = np.empty(frames, np.uint64)
    waiting = np.empty(frames, np.bool_)
    box_of = np.empty((frames, 8), np.float32)
    cost_of = np.empty(frames, np.float64)
    rest_of = np.empty((frames, 4), np.int32)
    one, two = np.uint64(1), np.uint64(2)
    place, written = np.uint64(len(out_left)), np.uint64(len(ids))
    node, top = np.uint64(0), np.uint64(0)
    while True:
        while left[node] >= 0:
            node_of[top], place_of[top], waiting[top] = node, place, True
            top += one
            node = np.uint64(right[node])
        # A leaf: the finished subtree is one reference.
        r = np.uint64(reference[node])
        if node > _AHEAD and reference[node - _AHEAD] >= 0:
            ahead = reference[node - _AHEAD]
            prefetch(lower, 3 * ahead)
            prefetch(upper, 3 * ahead)
            prefetch(triangle, ahead)
        box = load_corners(lower, upper, r)
        area = exact_cost_of(measure, box)
        cost = c_tri * area
        written -= one
        ids[written] = triangle[r]
        child, first, count, height = np.int32(-1), np.int32(written), np.int32(1), np.int32(0)
        # Where the finished subtree is a left child, its sibling is finished too: join them.
        while top > np.uint64(0) and not waiting[top - one]:
            top -= one
            other = load(box_of, top)
            place -= two
            store_corners(out_lower, out_upper, place, box, unscale)
            out_left[place], out_first[place], out_count[place] = child, first, count
            store_corners(out_lower, out_upper, place + one, other, unscale)
            out_left[place + one], out_first[place + one] = rest_of[top, 0], rest_of[top, 1]
            out_count[place + one] = rest_of[top, 2]
            box = union(box, other)
            area = exact_cost_of(measure, box)
            cost = cost_of[top] + cost + c_inner * area
            child, count = np.int32(place), count + rest_of[top, 2]
            height = max(height, rest_of[top, 3]) + np.int32(1)
            size = count
            if split and count <= _MAX_DUPLICATED:
                size = np.int32(_distinct(ids, written, count, max_leaf))
            if size <= max_leaf and c_tri * size * area <= cost:
                cost = c_tri * size * area
                if size < count:
                    written = _drop_repeats(ids, written, count)
                child, first, count, height = np.int32(-1), np.int32(written), size, np.int32(0)
                place = place_of[top]
        if top == np.uint64(0):
            break
        # It is a right child: keep it, and turn to the left one.
        store(box_of, top - one, box)
        cost_of[top - one] = cost
        rest_of[top - one, 0], rest_of[top - one, 1] = child, first
        rest_of[top - one, 2], rest_of[top - one, 3] = count, height
        waiting[top - one] = False
        node = np.uint64(left[np.uint64(node_of[top - one])])
    place -= one
    store_corners(out_lower, out_upper, place, box, unscale)
    out_left[place], out_first[place], out_count[place] = child, first, count
    # Positions so far are those in the whole arrays; count them from where writing ended.
    for n in range(place, np.uint64(len(out_left))):
        out_left[n] = out_left[n] - np.int32(place) if out_left[n] >= 0 else np.int32(-1)
        out_first[n] -= np.int32(written)
    return len(out_left) - np.int64(place), len(ids) - np.int64(written), height, cost, area


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
def _has_repeats(triangle, largest):
    """Whether an id, from 0 to ``largest``, stands in the array twice."""
    seen = np.zeros(largest + 1, np.bool_)
    for t in triangle:
        if seen[t]:
            return True
        seen[t] = True
    return False


def has_repeats(triangle: I32) -> bool:
    """Whether an id stands in the array twice."""
    return bool(_has_repeats(triangle, int(triangle.max())))


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
    draft: Draft,
    out: tuple[Any, ...],
    split: bool,
    costs: tuple[float, float],
    max_leaf: int,
    measure: Any,
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
        costs,
        max_leaf,
        np.float32(1.0 / refs.scale),
        out,
        measure,
    )


def finish(
    draft: Draft,
    *,
    c_inner: float,
    c_tri: float,
    max_leaf: int,
    meta: dict[str, Any],
    measure: Any = None,
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
    measure : None or tuple
        Of boxes, compiled: what the collapse goes by; the area by default.

    Returns
    -------
    Tree
        Boxes in scene units, at most :data:`~mibvh.tree.MAX_DEPTH` deep.
    """
    split = meta["triangles"] < len(draft.references)
    out = _outputs(len(draft.references))
    nodes, written, height, _, _ = _run(draft, out, split, (c_inner, c_tri), max_leaf, measure)
    if height > MAX_DEPTH:
        links = draft.left.copy(), draft.right.copy(), draft.reference.copy()
        _repair(*links, _REPAIR_DEPTH)
        draft = Draft(draft.references, *links, draft.report)
        nodes, written, _, _, _ = _run(draft, out, split, (c_inner, c_tri), max_leaf, measure)
        meta = {**meta, "depth_repaired": True}
    for array in out:
        array.flags.writeable = False  # a tree copies what can be written to
    lower, upper, left, first, count = (array[len(array) - nodes :] for array in out[:5])
    return Tree(lower, upper, left, first, count, out[5][len(out[5]) - written :], meta)


def draft_sah(
    draft: Draft, *, c_inner: float, c_tri: float, max_leaf: int, measure: Any = None
) -> float:
    """SAH of the tree that a draft will become (before any repair of its depth).

    Optimisers judge their progress by this: what counts is the tree after the collapse. With a
    compiled measure, it is the sum of the nodes' costs by that, over the measure of the root.
    """
    split = has_repeats(draft.references.triangle)
    out = _outputs(len(draft.references))
    nodes, written, _, cost, area = _run(draft, out, split, (c_inner, c_tri), max_leaf, measure)
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
