"""`bbvh`: top-down full-sweep SAH.

MacDonald and Booth: *Heuristics for ray tracing using space subdivision* (The Visual
Computer 1990). Every node tries all splits between neighbours in the order of box centres,
on all three axes, and takes the one of least ``A_left N_left + A_right N_right`` (ties: the
most even one, then the lower axis, then the lower position).

Stages
------
1. Sort the references once per axis (:func:`sort_axes`), by box centre, then by index. The
   sorted lists hold the boxes themselves, so that everything after reads memory in order.
2. Sweep each axis (:func:`_sweep`), from both ends to the middle and on to the other ends.
   A side's ``A N`` only grows with the side, so a sweep ends, and the far splits are out,
   where one side alone costs more than the best split so far. No split that could win or
   tie is left out.
3. Part the three lists stably (:func:`_part`), so that they stay sorted, into a second set
   of lists; the next level goes the other way.
4. Large nodes are tasks of one split, small ones tasks of a subtree, which threads take as
   they are free (:func:`mibvh.parallel.run_tasks`). Each has its own ranges of the lists and
   of the nodes: a range of n references owns 2n - 1 nodes. So the result does not depend on
   the threads.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.measured import cost_of
from mibvh.builders.options import Options
from mibvh.builders.radix import argsort_keys, float_keys
from mibvh.builders.registry import Context, builder
from mibvh.builders.simd import load, load_corners, nothing, store, union
from mibvh.parallel import run_blocks, run_tasks, thread_count
from mibvh.triangles import F32, I32, Triangles

#: Up to so many references, the three axes are swept side by side.
SMALL = 16

#: Subtrees smaller than this are not worth a task of their own.
_TASK = 4096

#: Tasks per thread, so that uneven ones still add up to even shares.
_TASKS_PER_THREAD = 16

#: A reference's id stands in the first spare lane of its box as the id-th float after one:
#: ids compare as floats, and no arithmetic meets a denormal number. So does its triangle's
#: in the second, for `sbvh`.
ID_ZERO = np.int32(0x3F800000)

#: First place in the lists, number of references, node, and which set of lists.
_Task = tuple[int, int, int, int]


@njit
def _sort_axis(lower, upper, axis, lists):
    """Fill the first list of one axis: the references' boxes by centre, then by index."""
    n = len(lower)
    # Twice the centre, that is. Box centres, not triangle centroids: on mixed triangle sizes
    # centroids cost a peer 21% in SAH.
    centers = lower[:, axis] + upper[:, axis]
    order = argsort_keys(float_keys(centers), 32)
    ids = lists.view(np.int32)
    first = np.uint64(axis * (len(lists) // 6))
    for i in range(np.uint64(n)):
        store(lists, first + i, load_corners(lower, upper, np.uint64(order[i])))
        ids[first + i, 3] = ids[first + i, 7] = order[i] + ID_ZERO


def sort_axes(lower: F32, upper: F32, lists: F32) -> None:
    """Fill the first set of lists: (6 N, 8) float32, or more rows for more references."""
    run_blocks(lambda _, axis, end: _sort_axis(lower, upper, axis, lists), 3, 1)


@njit(allocates=False)
def _better(cost, even, axis, at, best):
    """Whether a split of no greater cost than the best goes before it."""
    best_cost, best_even, best_axis, best_at = best
    if cost != best_cost or even != best_even:
        return cost < best_cost or even < best_even
    return axis < best_axis or (axis == best_axis and at < best_at)


@njit(allocates=False)
def _sweep(measure, lists, first, n, axis, best, areas):
    """Try the splits of one axis.

    Parameters
    ----------
    lists : (6 N, 8) float32
        The boxes.
    first, n : uint64
        Rows of the node's references, in order along the axis.
    axis : int
    best : (cost, unevenness, axis, number of references on the left)
        The best split of the axes before.
    areas : (N,) float32
        Scratch: for each split, the area of the side that has been swept.

    Returns
    -------
    tuple
        The best split so far.
    """
    one = np.uint64(1)
    middle = n >> one
    least = best[0]
    # Right sides, shrinking splits from the right end to the middle: splits up to
    # `left_out` are found to be too dear.
    right = nothing()
    left_out = np.uint64(0)
    at = n
    while at > middle:
        at -= one
        right = union(right, load(lists, first + at))
        area = cost_of(measure, right)
        areas[at] = area
        if area * np.float32(n - at) > least:
            left_out = at
            break
    # Left sides, from the left end to before the middle: splits from `right_out` on are out.
    left = nothing()
    right_out = n
    for at in range(one, middle):
        left = union(left, load(lists, first + at - one))
        area = cost_of(measure, left)
        areas[at] = area
        if area * np.float32(at) > least:
            right_out = at
            break
    # On to the right: the left sides of the splits whose right sides are known.
    if right_out == n:
        at = middle
        while at <= left_out:
            left = union(left, load(lists, first + at - one))
            at += one
        while at < n:
            left = union(left, load(lists, first + at - one))
            cost = cost_of(measure, left) * np.float32(at)
            if cost > least:
                break
            cost += areas[at] * np.float32(n - at)
            if cost <= least:
                even = abs(np.int64(n) - np.int64(at + at))
                if _better(cost, even, axis, np.int64(at), best):
                    best = (cost, even, axis, np.int64(at))
                    least = cost
            at += one
    # On to the left, likewise.
    if left_out == np.uint64(0):
        at = middle
        while at > right_out:
            at -= one
            right = union(right, load(lists, first + at))
        while at > one:
            at -= one
            right = union(right, load(lists, first + at))
            cost = cost_of(measure, right) * np.float32(n - at)
            if cost > least:
                break
            cost = areas[at] * np.float32(at) + cost
            if cost <= least:
                even = abs(np.int64(n) - np.int64(at + at))
                if _better(cost, even, axis, np.int64(at), best):
                    best = (cost, even, axis, np.int64(at))
                    least = cost
    return best


@njit(allocates=False)
def best_split(measure, lists, first, total, n, areas):
    """Find the best object split of a node.

    Parameters
    ----------
    lists : (6 N, 8) float32
    first, total, n : uint64
        The node's first row on axis 0, from there to that on the next, and its references.
    areas : (max(n, 3 SMALL),) float32
        Scratch.

    Returns
    -------
    (cost, unevenness, axis, number of references on the left)
    """
    if n == 2:  # the same on each axis
        cost = cost_of(measure, load(lists, first))
        return cost + cost_of(measure, load(lists, first + np.uint64(1))), 0, 0, 1
    if n <= SMALL:
        return _best_split_small(measure, lists, first, total, n, areas)
    # The axis of the farthest centres first: it bounds the others best.
    widest, width = 0, np.float32(-1)
    for axis in range(3):
        row = first + np.uint64(axis) * total
        end = row + n - np.uint64(1)
        extent = (lists[end, axis] - lists[end, axis + 4]) - (
            lists[row, axis] - lists[row, axis + 4]
        )
        if extent > width:
            widest, width = axis, extent
    best = (np.float32(np.inf), np.int64(n), np.int64(3), np.int64(0))
    for step in range(3):
        axis = (widest + step) % 3
        best = _sweep(measure, lists, first + np.uint64(axis) * total, n, axis, best, areas)
    return best


@njit(allocates=False)
def _best_split_small(measure, lists, first, total, n, areas):
    """Sweep the three axes side by side: for few references, loops cost more than sweeps."""
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    x, y, z = first, first + total, first + two * total
    a, b, c = nothing(), nothing(), nothing()
    at = n
    while at > one:
        at -= one
        a = union(a, load(lists, x + at))
        b = union(b, load(lists, y + at))
        c = union(c, load(lists, z + at))
        rest = np.float32(n - at)
        areas[three * at] = cost_of(measure, a) * rest
        areas[three * at + one] = cost_of(measure, b) * rest
        areas[three * at + two] = cost_of(measure, c) * rest
    best = (np.float32(np.inf), np.int64(n), np.int64(3), np.int64(0))
    a, b, c = nothing(), nothing(), nothing()
    for at in range(one, n):
        a = union(a, load(lists, x + at - one))
        b = union(b, load(lists, y + at - one))
        c = union(c, load(lists, z + at - one))
        part = np.float32(at)
        cost_a = cost_of(measure, a) * part + areas[three * at]
        cost_b = cost_of(measure, b) * part + areas[three * at + one]
        cost_c = cost_of(measure, c) * part + areas[three * at + two]
        # Of equals, the lower axis.
        axis = 0 if cost_a <= cost_b else 1
        cost = cost_a if cost_a <= cost_b else cost_b
        axis = axis if cost <= cost_c else 2
        cost = cost if cost <= cost_c else cost_c
        if cost <= best[0]:
            even = abs(np.int64(n) - np.int64(at + at))
            if _better(cost, even, axis, np.int64(at), best):
                best = (cost, even, axis, np.int64(at))
    return best


@njit(allocates=False)
def _goes_left(lists, row, axis, bound, bound_id):
    """Whether a reference does not come behind the last one on the left."""
    center = lists[row, axis] - lists[row, axis + 4]
    return (center < bound) | ((center == bound) & (lists[row, 3] <= bound_id))


@njit(allocates=False)
def part(lists, source, left_target, right_target, total, n, axis, at):
    """Write the lists of a node to the other set: the first ``at`` of one axis and the rest.

    Parameters
    ----------
    lists : (6 N, 8) float32
    source, left_target, right_target : uint64
        First rows on axis 0.
    total, n, at : uint64
    axis : int
    """
    if n <= SMALL:
        _part_small(lists, source, left_target, right_target, total, n, axis, at)
        return
    row = source + np.uint64(axis) * total + at - np.uint64(1)
    bound, bound_id = lists[row, axis] - lists[row, axis + 4], lists[row, 3]
    one = np.uint64(1)
    for k in range(np.uint64(3)):
        row, left, right = source + k * total, left_target + k * total, right_target + k * total
        if k == axis:
            for i in range(at):
                store(lists, left + i, load(lists, row + i))
            for i in range(n - at):
                store(lists, right + i, load(lists, row + at + i))
            continue
        for end in range(row, row + n):
            is_left = _goes_left(lists, end, axis, bound, bound_id)
            store(lists, left if is_left else right, load(lists, end))
            step = np.uint64(is_left)
            left += step
            right += one - step


@njit(allocates=False)
def _part_small(lists, source, left_target, right_target, total, n, axis, at):
    """Do the same with the three lists side by side."""
    row = source + np.uint64(axis) * total + at - np.uint64(1)
    bound, bound_id = lists[row, axis] - lists[row, axis + 4], lists[row, 3]
    y, z = total, np.uint64(2) * total
    left_a, left_b, left_c = left_target, left_target + y, left_target + z
    right_a, right_b, right_c = right_target, right_target + y, right_target + z
    one = np.uint64(1)
    for end in range(source, source + n):
        is_left = _goes_left(lists, end, axis, bound, bound_id)
        store(lists, left_a if is_left else right_a, load(lists, end))
        left_a, right_a = left_a + np.uint64(is_left), right_a + one - np.uint64(is_left)
        is_left = _goes_left(lists, end + y, axis, bound, bound_id)
        store(lists, left_b if is_left else right_b, load(lists, end + y))
        left_b, right_b = left_b + np.uint64(is_left), right_b + one - np.uint64(is_left)
        is_left = _goes_left(lists, end + z, axis, bound, bound_id)
        store(lists, left_c if is_left else right_c, load(lists, end + z))
        left_c, right_c = left_c + np.uint64(is_left), right_c + one - np.uint64(is_left)


@njit(allocates=False)
def _split(measure, lists, total, begin, n, side, areas):
    """Split one node and part its lists; return how many references go left."""
    source = np.uint64(begin + 3 * total * side)
    target = np.uint64(begin + 3 * total * (1 - side))
    rows, count = np.uint64(total), np.uint64(n)
    _, _, axis, at = best_split(measure, lists, source, rows, count, areas)
    part(lists, source, target, target + np.uint64(at), rows, count, axis, np.uint64(at))
    return at


@njit
def _subtree(measure, lists, total, begin, n, node, side, left, right, reference):
    """Build all below one node."""
    ids = lists.view(np.int32)
    areas = np.empty(max(n, 3 * SMALL), np.float32)
    stack = np.empty((64, 4), np.int64)
    top = np.uint64(0)
    one = np.uint64(1)
    while True:
        row = np.uint64(begin + 3 * total * side)
        if n > 2:
            at = _split(measure, lists, total, begin, n, side, areas)
            left[node], right[node], reference[node] = node + 1, node + 2 * at, -1
            side = 1 - side
            # The larger child waits, so that few wait at a time.
            if at < n - at:
                stack[top, 0], stack[top, 1] = begin + at, n - at
                stack[top, 2], stack[top, 3] = node + 2 * at, side
                n, node = at, node + 1
            else:
                stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = (
                    begin,
                    at,
                    node + 1,
                    side,
                )
                begin, n, node = begin + at, n - at, node + 2 * at
            top += one
            continue
        if n == 2:
            # All splits are equal, so the lowest axis decides.
            left[node], right[node], reference[node] = node + 1, node + 2, -1
            left[node + 2], right[node + 2] = -1, -1
            reference[node + 2] = ids[row + one, 3] - ID_ZERO
            node += 1
        left[node], right[node], reference[node] = -1, -1, ids[row, 3] - ID_ZERO
        if top == np.uint64(0):
            break
        top -= one
        begin, n, node, side = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]


@njit
def _split_once(measure, lists, total, begin, n, node, side, left, right, reference):
    """Split one node; return how many references go left."""
    at = _split(measure, lists, total, begin, n, side, np.empty(max(n, 3 * SMALL), np.float32))
    left[node], right[node], reference[node] = node + 1, node + 2 * at, -1
    return at


def _build(measure: Any, lists: F32, links: tuple[I32, I32, I32], context: Context) -> None:
    """Build the tree: the top node by node, the rest subtree by subtree."""
    total = len(lists) // 6
    threads = thread_count()
    limit = max(total // (_TASKS_PER_THREAD * threads), _TASK)

    def work(task: _Task) -> list[_Task]:
        begin, n, node, side = task
        # The root is split here at any size, so that a small tree compiles all that a large
        # one runs.
        if n <= limit and (node > 0 or n == 1):
            _subtree(measure, lists, total, *task, *links)
            return []
        at = _split_once(measure, lists, total, *task, *links)
        return [(begin, at, node + 1, 1 - side), (begin + at, n - at, node + 2 * at, 1 - side)]

    report = functools.partial(context.progress, "sweep")
    run_tasks(work, (0, total, 0, 0), lambda task: task[1], threads, report)


@builder(
    "bbvh",
    summary="top-down full sweep: the split of least A_l N_l + A_r N_r, all axes, all positions",
    source="MacDonald and Booth 1990",
    memory=300,
)
def bbvh(triangles: Triangles, options: Options, context: Context) -> Draft:
    """Build the full-sweep SAH tree; O(n log n)."""
    refs = References.of(triangles)
    lists = np.empty((6 * len(refs), 8), np.float32)
    context.progress("sort", 0.0)
    sort_axes(refs.lower, refs.upper, lists)
    links = tuple(np.empty(2 * len(refs) - 1, np.int32) for _ in range(3))
    _build(context.compiled_measure(refs.scale), lists, links, context)
    return Draft(refs, *links)
