"""`sbvh`: top-down full-sweep SAH with spatial splits.

Stich, Friedrich, Dietrich: *Spatial Splits in Bounding Volume Hierarchies* (HPG 2009).
A large triangle drags a large box into every node it is in, and boxes overlap. A spatial
split cuts a node at a plane instead: triangles across it are entered on both sides, each
time under the box of only the part that is there.

Stages
------
1. Sort the references once per axis by box centre, as `bbvh` does; the lists hold the boxes
   themselves (:mod:`mibvh.builders.sweep`).
2. At each node, find the best object split: the full sweep of `bbvh`, with its ties, over the
   *references'* boxes.
3. Where the children it would make overlap by ``alpha`` of the root's area, look for a plane
   of lower cost as well (:mod:`mibvh.builders.planes`).
4. If there is one, cut the references across it (:mod:`mibvh.builders.spatial_split`). Each of
   them may yet go whole to one side, if that is the cheapest of the three (*unsplitting*). If
   one side stays empty, or the cost after all is above that of the object split, the object
   split is taken.
5. Part the three sorted lists stably, into a second set of lists; parts of cut references,
   whose centres have moved, are sorted by themselves and merged in.
6. Where a leaf would be cheaper than any split (and not too large for one), spatial
   splits end. Object splits go on down to single references, and the common collapse
   (:mod:`mibvh.builders.finish`) makes the leaves, in which a triangle stands once.

Memory and threads: a node owns a range of the lists with room for the references that may
still be added below it, ids for their parts, and a range of the tree's nodes. Both halves
of a split get their share of that room: by the sizes of their references, or all of it where
only one of them can use any. So nothing is allocated while building, subtrees are
independent, and the tree does not depend on the number of threads.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.measured import cost_of
from mibvh.builders.options import Options, option
from mibvh.builders.planes import best_plane, new_bins
from mibvh.builders.registry import Context, builder
from mibvh.builders.simd import half_area, load, nothing, store, union
from mibvh.builders.spatial_split import cut_node, part_at_plane
from mibvh.builders.sweep import ID_ZERO, SMALL, best_split, part, sort_axes
from mibvh.measures.boxes import of_boxes, of_corners
from mibvh.parallel import run_tasks, thread_count
from mibvh.triangles import Triangles

#: No spatial splits below this depth: they could go on for ever.
_SPATIAL_DEPTH = 48

#: Nodes of more references are split one at a time, so that threads can share the rest.
_TASK = 16384

#: A node of n references has ``_FEWEST_BINS + _BINS_PER_REFERENCE * n`` bins, up to the
#: number asked for: cutting three triangles at 127 planes finds nothing that 20 do not.
_FEWEST_BINS = 8
_BINS_PER_REFERENCE = 4


@njit(allocates=False)
def _box_of(lists, first, n):
    """Box of a run of references."""
    result = nothing()
    for row in range(first, first + n):
        result = union(result, load(lists, row))
    return result


@njit(allocates=False)
def _need(lists, first, n):
    """What a run of references needs for further splits, in pieces of unit size.

    A box cut to pieces of a given size makes about as many as the root of its area says: a few
    long triangles need more of them than many small ones.
    """
    need = 0.0
    for row in range(first, first + n):
        need += math.sqrt(half_area(load(lists, row)))
    return need


@njit(allocates=False)
def _needs_at_plane(lists, first, n, axis, plane):
    """The same for the references left and right of a plane; those across have a part in both."""
    left, right = 0.0, 0.0
    for row in range(first, first + n):
        need = math.sqrt(half_area(load(lists, row)))
        low, high = lists[row, axis], -lists[row, axis + 4]
        share = 1.0 if high <= plane else 0.0
        if low < plane < high:
            share = np.float64(plane - low) / np.float64(high - low)
        left += need * share
        right += need * (1.0 - share)
    return left, right


@njit(allocates=False)
def _overlap(measure, halves):
    """Measure of the box in which two boxes overlap; -1 if they are apart."""
    x0, x1 = max(halves[0, 0], halves[1, 0]), -max(halves[0, 4], halves[1, 4])
    y0, y1 = max(halves[0, 1], halves[1, 1]), -max(halves[0, 5], halves[1, 5])
    z0, z1 = max(halves[0, 2], halves[1, 2]), -max(halves[0, 6], halves[1, 6])
    x, y, z = x1 - x0, y1 - y0, z1 - z0
    if x >= 0 and y >= 0 and z >= 0:
        if measure is None:
            return x * y + (x + y) * z
        return np.float32(of_corners(measure, x0, y0, z0, x1, y1, z1))
    return np.float32(-1)


@njit(allocates=False)
def _plane_for(measure, corners, scale, lists, first, n, slack, limit, rules, halves, bins):
    """Look for a plane cheaper than the object split, and than a leaf.

    Returns
    -------
    (axis, plane)
        Axis -1: the object split is best; -2: a leaf is cheaper than all splits.
    """
    most_bins, _, leaf_cost, max_leaf = rules
    store(halves, 2, union(load(halves, 0), load(halves, 1)))
    area = cost_of(measure, load(halves, 2))
    leaf_wins = n <= max_leaf and leaf_cost * (n * area - limit) <= area
    if leaf_wins:
        limit = min(limit, np.float32(n * area - area / leaf_cost))
    count = min(most_bins, _FEWEST_BINS + _BINS_PER_REFERENCE * n)
    axis, plane = best_plane(
        measure, corners, scale, lists, first, n, slack, count, halves[2], limit, bins
    )
    return -2 if axis < 0 and leaf_wins else axis, plane


@njit(allocates=False)
def _split_node(measure, corners, scale, rules, lists, side, areas, task, children, tally, bins):
    """Split one node; write its children, the larger one first, as tasks.

    Returns
    -------
    int
        How many of the node's places in the tree are the left child's.
    """
    begin, n, slack, first_id, node = task[0], task[1], task[2], task[3], task[4]
    depth, may_cut, half = task[5], task[6], task[7]
    least_overlap = rules[1]
    halves, parts = bins.halves, bins.parts
    total = len(lists) // 6
    source, target = begin + 3 * total * half, begin + 3 * total * (1 - half)
    cost, _, axis, at = best_split(
        measure, lists, np.uint64(source), np.uint64(total), np.uint64(n), areas
    )
    n_left, n_right, added = at, n - at, 0
    left_may, right_may = False, False
    plane_axis, plane = -1, np.float32(0)
    if may_cut and slack > 0 and depth < _SPATIAL_DEPTH:
        row = source + axis * total
        store(halves, 0, _box_of(lists, row, at))
        store(halves, 1, _box_of(lists, row + at, n - at))
        left_may = cost_of(measure, load(halves, 0)) >= least_overlap
        right_may = cost_of(measure, load(halves, 1)) >= least_overlap
        if _overlap(measure, halves) >= least_overlap:
            tally[0] += 1
            plane_axis, plane = _plane_for(
                measure, corners, scale, lists, source, n, slack, cost, rules, halves, bins
            )
        if plane_axis == -2:
            left_may, right_may = False, False
        if plane_axis >= 0:
            cut_left, cut_right, added = cut_node(
                measure,
                corners,
                scale,
                lists,
                source,
                n,
                slack,
                first_id,
                plane_axis,
                plane,
                cost,
                side,
                parts,
                halves,
                bins,
            )
            if cut_left > 0:
                tally[1] += 1
                n_left, n_right = cut_left, cut_right
                left_may = cost_of(measure, load(halves, 0)) >= least_overlap
                right_may = cost_of(measure, load(halves, 1)) >= least_overlap
            else:
                plane_axis = -1
    room = slack - added
    left_room = room if left_may else 0
    if room > 0 and left_may == right_may:
        if plane_axis >= 0:
            row = source + plane_axis * total
            left, right = _needs_at_plane(lists, row, n, plane_axis, plane)
        else:
            row = source + axis * total
            left, right = _need(lists, row, at), _need(lists, row + at, n - at)
        left_room = np.int64(room * (left / (left + right))) if left + right > 0 else room // 2
    behind = n_left + left_room
    if plane_axis >= 0:
        part_at_plane(
            lists, source, target, target + behind, total, n, plane_axis, plane, added, side, parts
        )
    else:
        part(
            lists,
            np.uint64(source),
            np.uint64(target),
            np.uint64(target + behind),
            np.uint64(total),
            np.uint64(n),
            axis,
            np.uint64(at),
        )
    a = 0 if behind > n_right + room - left_room else 1
    b = 1 - a
    children[a, 0], children[b, 0] = begin, begin + behind
    children[a, 1], children[b, 1] = n_left, n_right
    children[a, 2], children[b, 2] = left_room, room - left_room
    # A cut takes two ids: both parts are new.
    children[a, 3], children[b, 3] = first_id + 2 * added, first_id + 2 * (added + left_room)
    # A node with room for R references owns 2 R - 1 places in the tree.
    children[a, 4], children[b, 4] = node + 1, node + 2 * behind
    children[a, 5], children[b, 5] = depth + 1, depth + 1
    children[a, 6], children[b, 6] = left_may, right_may
    children[a, 7], children[b, 7] = 1 - half, 1 - half
    return 2 * behind


class Links(NamedTuple):
    """The tree, (2 R - 1,) int32 each; a leaf's reference is a row of the lists."""

    left: Any
    right: Any
    reference: Any


@njit
def _run(measure, corners, scale, rules, lists, side, links, task, once, children, tally):
    """Build all below a node, or split it only once.

    Parameters
    ----------
    corners : (N, 3, 3) float32
        The mesh, in scene units.
    scale : float64
        From scene to builder units.
    rules : (int, float32, float, int)
        Number of bins, least overlap in builder units, cost of a triangle (that of an inner
        node being 1), and most triangles of a leaf.
    lists : (6 R, 8) float32
        Both sets of the three lists, with room for R references.
    side : (N + 2 (R - N),) uint8
        Scratch: where references across a plane go.
    links : Links
        Written at the node, and below it.
    task : (8,) int64
        The node: first place in the lists, number of references, how many may be added,
        first new id, place in the tree, depth, whether spatial splits are allowed, and in
        which set of lists it is.
    once : bool
        Whether to stop after one split; its results are in ``children``, (2, 8) int64.
    tally : (2,) int64
        Counts the nodes where a spatial split was looked for, and where one was made.
    """
    left, right, reference = links
    most = task[1] + task[2]
    bins = new_bins(rules[0], most, task[2])
    areas = np.empty(max(most, 3 * SMALL), np.float32)
    total = len(lists) // 6
    # The child with less room goes first, so that few wait.
    stack = np.empty((128, 8), np.int64)
    # Item by item: Numba takes two seconds to compile what it would say of slices.
    for k in range(8):
        stack[0, k] = task[k]
    top = 1
    while top > 0:
        top -= 1
        node = stack[top, 4]
        if stack[top, 1] == 1:
            reference[node] = stack[top, 0] + 3 * total * stack[top, 7]
            continue
        behind = _split_node(
            measure, corners, scale, rules, lists, side, areas, stack[top], children, tally, bins
        )
        left[node], right[node] = node + 1, node + behind
        if once:
            return
        for k in range(8):
            stack[top, k], stack[top + 1, k] = children[0, k], children[1, k]
        top += 2


@njit
def _compact(left, right, reference, lists):
    """Close the gaps that unused room left; number references as the leaves come."""
    number = np.empty(len(left), np.int32)
    nodes, leaves = 0, 0
    for i in range(len(left)):
        number[i] = nodes
        nodes += left[i] >= 0 or reference[i] >= 0
        leaves += reference[i] >= 0
    links = np.full((3, nodes), -1, np.int32)
    lower, upper = np.empty((leaves, 3), np.float32), np.empty((leaves, 3), np.float32)
    triangle = np.empty(leaves, np.int32)
    ids = lists.view(np.int32)
    leaf = 0
    for i in range(len(left)):
        if left[i] >= 0:
            links[0, number[i]] = number[left[i]]
            links[1, number[i]] = number[right[i]]
        elif reference[i] >= 0:
            row = reference[i]
            links[2, number[i]] = leaf
            for k in range(3):
                lower[leaf, k] = lists[row, k]
                upper[leaf, k] = -lists[row, k + 4]
            triangle[leaf] = ids[row, 7] - ID_ZERO
            leaf += 1
    return links, lower, upper, triangle


def _build(scene: tuple[Any, ...], root: npt.NDArray[np.int64], context: Context) -> list[int]:
    """Run tasks on all threads; return the tally."""
    tallies = []

    def work(task: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
        once = bool(task[1] > _TASK)
        children, tally = np.empty((2, 8), np.int64), np.zeros(2, np.int64)
        _run(*scene, task, once, children, tally)
        tallies.append(tally)
        return list(children) if once else []

    run_tasks(
        work,
        root,
        lambda task: int(task[1] + task[2]),
        thread_count(),
        functools.partial(context.progress, "split"),
    )
    return np.sum(tallies, axis=0).tolist()


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpatialOptions(Options):
    """Options of `sbvh`."""

    alpha: float = option(
        1e-5,
        "look for a spatial split where children overlap by this share of the root's area; "
        "more builds faster and splits less",
        0.0,
        1.0,
    )
    bins: int = option(
        128,
        "planes per axis to choose from, at most: nodes of few references have fewer; "
        "a lower limit builds faster",
        8,
        256,
    )
    budget: float = option(
        1.0,
        "references added at most, per triangle; memory is taken for all of them, and where "
        "they run out, object splits go on alone",
        0.0,
        8.0,
    )


@builder(
    "sbvh",
    summary="full sweep, and planes that cut triangles where children would overlap",
    source="Stich, Friedrich and Dietrich 2009",
    options=SpatialOptions,
    memory=620,
)
def sbvh(triangles: Triangles, options: SpatialOptions, context: Context) -> Draft:
    """Build the SBVH; O(n log n)."""
    refs = References.of(triangles)
    n, scale = len(refs), refs.scale
    slack = int(options.budget * n)
    room = n + slack
    lists = np.empty((6 * room, 8), np.float32)
    context.progress("sort", 0.0)
    sort_axes(refs.lower, refs.upper, lists)
    low, high = refs.lower.min(axis=0), refs.upper.max(axis=0)
    measure = context.compiled_measure(scale)
    x, y, z = (high - low).tolist()
    whole = x * y + y * z + z * x
    if measure is not None:
        whole = float(of_boxes(measure, np.concatenate([low, high])[None])[0])
    rules = (
        options.bins,
        np.float32(options.alpha * whole),
        options.c_tri / options.c_inner if options.c_inner > 0 else np.inf,
        options.max_leaf,
    )
    links = Links(*np.full((3, 2 * room - 1), -1, np.int32))
    side = np.empty(n + 2 * slack, np.uint8)
    root = np.array([0, n, slack, n, 0, 0, 1, 0], np.int64)
    scene = (measure, triangles.corners, scale, rules, lists, side, links)
    tried, made = _build(scene, root, context)
    joined, lower, upper, owner = _compact(*links, lists)
    return Draft(
        References(lower, upper, owner, scale),
        *joined,
        {"references": len(owner), "spatial_tried": tried, "spatial_made": made},
    )
