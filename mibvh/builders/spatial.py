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

Memory and threads: a node owns a range of the lists with places for the references that may
still be added below it, ids for their parts, and a range of numbers in the tree. Both halves
of a split get their share of that room: by the sizes of their references, or all of it where
only one of them can use any. So subtrees are independent, and the tree does not depend on the
number of threads. Large nodes are split in common lists, which have few places to spare;
smaller ones, and those that need more places, are copied to lists of their own, whose memory
is used again by the next. Subtrees write their nodes and leaves from left to right, and are put
together in the end.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References
from mibvh.builders.measured import cost_of
from mibvh.builders.options import Options, option
from mibvh.builders.planes import Bins, best_plane, new_bins
from mibvh.builders.registry import Context, builder
from mibvh.builders.simd import half_area, load, nothing, store, union
from mibvh.builders.spatial_split import cut_node, part_at_plane
from mibvh.builders.sweep import ID_ZERO, SMALL, best_split, part, sort_axes
from mibvh.measures.boxes import of_boxes, of_corners
from mibvh.parallel import run_tasks, thread_count
from mibvh.triangles import F32, I32, Triangles

#: No spatial splits below this depth: they could go on for ever.
_SPATIAL_DEPTH = 48

#: Nodes of more references are split one at a time, so that threads can share the rest.
_TASK = 16384

#: While they are, there is room in the lists for one reference more per so many.
_FREE_SHARE = 4

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
def _overlap(measure, boxes, a, b):
    """Measure of the box in which the boxes of two rows overlap; -1 if they are apart."""
    x0, x1 = max(boxes[a, 0], boxes[b, 0]), -max(boxes[a, 4], boxes[b, 4])
    y0, y1 = max(boxes[a, 1], boxes[b, 1]), -max(boxes[a, 5], boxes[b, 5])
    z0, z1 = max(boxes[a, 2], boxes[b, 2]), -max(boxes[a, 6], boxes[b, 6])
    x, y, z = x1 - x0, y1 - y0, z1 - z0
    if x >= 0 and y >= 0 and z >= 0:
        if measure is None:
            return x * y + (x + y) * z
        return np.float32(of_corners(measure, x0, y0, z0, x1, y1, z1))
    return np.float32(-1)


@njit(allocates=False, inline="always")
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


@njit(allocates=False, inline="always")
def _split_node(measure, corners, scale, rules, lists, side, areas, task, children, tally, bins):
    """Split one node; write its children, the larger one first, as tasks.

    Returns
    -------
    bool
        False if there was no room in the lists, and nothing was written.
    """
    begin, n, slack, first_id, number = task[0], task[1], task[2], task[3], task[4]
    depth, may_cut, half, free = task[5], task[6], task[7], task[8]
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
        if _overlap(measure, halves, 0, 1) >= least_overlap:
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
    free -= added
    if free < 0:
        return False
    left_room = room if left_may else 0
    if room > 0 and left_may == right_may:
        if plane_axis >= 0:
            row = source + plane_axis * total
            left, right = _needs_at_plane(lists, row, n, plane_axis, plane)
        else:
            row = source + axis * total
            left, right = _need(lists, row, at), _need(lists, row + at, n - at)
        left_room = np.int64(room * (left / (left + right))) if left + right > 0 else room // 2
    left_free = left_room if free >= room else free * n_left // (n_left + n_right)
    behind = n_left + left_free
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
    children[0, 0], children[1, 0] = begin, begin + behind
    children[0, 1], children[1, 1] = n_left, n_right
    children[0, 2], children[1, 2] = left_room, room - left_room
    # A cut takes two ids: both parts are new.
    children[0, 3], children[1, 3] = first_id + 2 * added, first_id + 2 * (added + left_room)
    # A node with room for R references has 2 R - 1 numbers.
    children[0, 4], children[1, 4] = number + 1, number + 2 * (n_left + left_room)
    children[0, 5], children[1, 5] = depth + 1, depth + 1
    children[0, 6], children[1, 6] = left_may, right_may
    children[0, 7], children[1, 7] = 1 - half, 1 - half
    children[0, 8], children[1, 8] = left_free, free - left_free
    return True


@njit(allocates=False)
def _run(
    measure,
    corners,
    scale,
    rules,
    side,
    lists,
    right,
    leaves,
    areas,
    stack,
    bins,
    task,
    once,
    children,
    tally,
):
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
    side : (N + 2 (R - N),) uint8
        Scratch: where references across a plane go.
    lists : (6 R, 8) float32
        Both sets of the three lists, with room for R references.
    right : (2 R - 1,) int32
        Written: the nodes, each left subtree behind its parent, by their right children; -1 for
        a leaf.
    leaves : (R, 8) float32
        Written: the leaves' references.
    areas : (max(R, 3 SMALL),) float32; stack : (R + 1, 10) int64; bins : Bins
        Scratch; a row of the stack is enough for one split.
    task : (9,) int64
        The node: first place in the lists, number of references, how many may be added,
        first new id, number in the tree, depth, whether spatial splits are allowed, in
        which set of lists it is, and how many places there are free for it.
    once : bool
        Whether to stop after one split; its results are in ``children``, (2, 9) int64.
    tally : (2,) int64
        Counts the nodes where a spatial split was looked for, and where one was made.

    Returns
    -------
    int
        How many nodes were written, or split; 0 if there was no room in the lists.
    """
    half = len(lists) // 2
    # Item by item: Numba takes two seconds to compile what it would say of slices.
    for k in range(9):
        stack[0, k] = task[k]
    stack[0, 9] = -1
    # Left children go first, so that nodes are written in order; right ones wait, with their
    # parents.
    top, node, leaf = 1, 0, 0
    while top > 0:
        top -= 1
        begin, n, parent = stack[top, 0], stack[top, 1], stack[top, 9]
        if parent >= 0:
            right[parent] = node
        row = begin + half * stack[top, 7]
        if n == 1:
            store(leaves, leaf, load(lists, row))
            right[node] = -1
            node, leaf = node + 1, leaf + 1
            continue
        if n == 2 and not once:
            # Half of all nodes. Of object splits, that on the first axis is taken.
            may_cut = stack[top, 6] and stack[top, 2] > 0 and stack[top, 5] < _SPATIAL_DEPTH
            if not may_cut or _overlap(measure, lists, row, row + 1) < rules[1]:
                store(leaves, leaf, load(lists, row))
                store(leaves, leaf + 1, load(lists, row + 1))
                right[node], right[node + 1], right[node + 2] = node + 2, -1, -1
                node, leaf = node + 3, leaf + 2
                continue
        if not _split_node(
            measure, corners, scale, rules, lists, side, areas, stack[top], children, tally, bins
        ):
            return 0
        if once:
            return 1
        for k in range(9):
            stack[top, k], stack[top + 1, k] = children[1, k], children[0, k]
        stack[top, 9], stack[top + 1, 9] = node, -1
        node += 1
        top += 2
    return node


@njit(allocates=False)
def _place(right, leaves, node, leaf, links, lower, upper, triangle):
    """Put the nodes of a subtree and their references where they belong in the draft."""
    ids = leaves.view(np.int32)
    at = leaf
    for i in range(len(right)):
        inner = right[i] >= 0
        links[0, node + i] = node + i + 1 if inner else -1
        links[1, node + i] = node + right[i] if inner else -1
        links[2, node + i] = -1 if inner else at
        at += 0 if inner else 1
    for i in range(len(leaves)):
        for k in range(3):
            lower[leaf + i, k] = leaves[i, k]
            upper[leaf + i, k] = -leaves[i, k + 4]
        triangle[leaf + i] = ids[i, 7] - ID_ZERO


class _Scratch(NamedTuple):
    """What nodes are split in, with room for R references; arguments of :func:`_run`.

    Pages of it that are not written cost nothing.
    """

    lists: Any  #: (6 R, 8) float32
    right: Any  #: (2 R,) int32
    leaves: Any  #: (R, 8) float32
    areas: Any  #: (max(R, 3 SMALL),) float32
    stack: Any  #: (R + 1, 10) int64
    bins: Bins

    @classmethod
    def of(cls, count: int, n: int, slack: int) -> _Scratch:
        """Make it for a subtree of n references and so many more, with so many bins."""
        room = n + slack
        return cls(
            np.empty((6 * room, 8), np.float32),
            np.empty(2 * room, np.int32),
            np.empty((room, 8), np.float32),
            np.empty(max(room, 3 * SMALL), np.float32),
            # Only a chain has as many nodes waiting.
            np.empty((room + 1, 10), np.int64),
            new_bins(count, room, slack),
        )

    @classmethod
    def around(cls, lists: F32, count: int, n: int, slack: int) -> _Scratch:
        """Make it for one split of a node that is in lists already."""
        return cls(
            lists,
            np.empty(0, np.int32),
            np.empty((0, 8), np.float32),
            np.empty(max(n, 3 * SMALL), np.float32),
            np.empty((1, 10), np.int64),
            new_bins(count, n, slack),
        )

    def holds(self, references: int, added: int) -> bool:
        """Whether nodes of so many references, some of them added, can be split in it."""
        return references <= len(self.bins.rows) and added <= self.bins.parts.shape[1]

    def copy(self, lists: F32, task: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Take over a node's lists; return its task here."""
        begin, n, slack, half = task[0], task[1], task[2], task[7]
        total, room = len(lists) // 6, len(self.lists) // 6
        for k in range(3):
            first = begin + (3 * half + k) * total
            self.lists[k * room : k * room + n] = lists[first : first + n]
        here = task.copy()
        here[0], here[7], here[8] = 0, 0, slack
        return here


class _Pieces:
    """What the tree is put together from: nodes that were split, and finished subtrees."""

    def __init__(self) -> None:
        self.right_of: dict[int, int] = {}  #: by number, that of the right child
        self.subtrees: dict[int, tuple[I32, F32]] = {}  #: by number, nodes and leaves
        self.tally = np.zeros(2, np.int64)

    def joined(self) -> tuple[I32, F32, F32, I32]:
        """Links, bounds and triangles of the draft: nodes and leaves from left to right."""
        order = sorted([*self.right_of, *self.subtrees])
        place, nodes, leaves = {}, 0, 0
        for number in order:
            place[number] = nodes, leaves
            right, below = self.subtrees.get(number, (range(1), ()))
            nodes, leaves = nodes + len(right), leaves + len(below)
        links = np.empty((3, nodes), np.int32)
        lower, upper = np.empty((leaves, 3), np.float32), np.empty((leaves, 3), np.float32)
        triangle = np.empty(leaves, np.int32)
        for number, (node, leaf) in place.items():
            if number in self.right_of:
                links[:, node] = node + 1, place[self.right_of[number]][0], -1
            else:
                _place(*self.subtrees.pop(number), node, leaf, links, lower, upper, triangle)
        return links, lower, upper, triangle


def _build(
    scene: tuple[Any, ...],
    lists: F32,
    side: npt.NDArray[np.uint8],
    root: npt.NDArray[np.int64],
    context: Context,
) -> _Pieces:
    """Run tasks on all threads: large nodes are split in ``lists``, the others by subtrees.

    Subtrees are built in memory that is used again: of the lists, where each part of the tree has
    room of its own, most would be written once, and the system would have to clear all of it.
    """
    pieces, lock = _Pieces(), threading.Lock()
    *_, rules = scene
    # What is idle, for subtrees and for large nodes.
    idle: tuple[list[_Scratch], list[_Scratch]] = [], []

    def run(
        task: npt.NDArray[np.int64], once: bool, references: int, make: Callable[..., _Scratch]
    ) -> tuple[npt.NDArray[np.int64], tuple[I32, F32]]:
        slack = int(task[2])
        with lock:
            scratch = idle[once].pop() if idle[once] else None
        if scratch is None or not scratch.holds(references, slack):
            scratch = make(rules[0], int(task[1]), slack)
        children, tally = np.empty((2, 9), np.int64), np.zeros(2, np.int64)
        here = task if once else scratch.copy(lists, task)
        used = _run(*scene, side, *scratch, here, once, children, tally)
        piece = scratch.right[:used].copy(), scratch.leaves[: (used + 1) // 2].copy()
        with lock:
            pieces.tally += tally if used else 0
            idle[once].append(scratch)
        return children[: 2 * used], piece

    def work(task: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
        n, slack, number = task[[1, 2, 4]].tolist()
        if n > _TASK:
            children, _ = run(task, True, n, functools.partial(_Scratch.around, lists))
            if len(children):
                pieces.right_of[number] = int(children[1, 4])
                return list(children)
        _, pieces.subtrees[number] = run(task, False, n + slack, _Scratch.of)
        return []

    run_tasks(
        work,
        root,
        lambda task: int(task[1] + task[2]),
        thread_count(),
        functools.partial(context.progress, "split"),
    )
    return pieces


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
    memory=520,
)
def sbvh(triangles: Triangles, options: SpatialOptions, context: Context) -> Draft:
    """Build the SBVH; O(n log n)."""
    refs = References.of(triangles)
    n, scale = len(refs), refs.scale
    slack = int(options.budget * n)
    # Few references are added in nodes so large that they are split in these lists.
    free = min(slack, n // _FREE_SHARE)
    lists = np.empty((6 * (n + free), 8), np.float32)
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
    side = np.empty(n + 2 * slack, np.uint8)
    root = np.array([0, n, slack, n, 0, 0, 1, 0, free], np.int64)
    pieces = _build((measure, triangles.corners, scale, rules), lists, side, root, context)
    del lists
    tried, made = pieces.tally.tolist()
    joined, lower, upper, owner = pieces.joined()
    return Draft(
        References(lower, upper, owner, scale),
        *joined,
        {"references": len(owner), "spatial_tried": tried, "spatial_made": made},
    )
