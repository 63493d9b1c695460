"""`reinsertion`: parallel reinsertion, in a schedule of passes.

Meister and Bittner: *Parallel Reinsertion for Bounding Volume Hierarchy Optimization* (Computer
Graphics Forum 37(2), 2018), with the schedule of the Rust library obvhs: sixteen passes, over all
nodes, the larger third, the larger fifth, ... of them; then the leaf collapse; then two more passes
over what is left of the tree.

A pass
------
1. For each node in question, in parallel, find where it would be best inserted, with the tree as
   it is: the gain is the measure of its parent, which goes, plus what the nodes above shrink by,
   minus what those at the new place grow by and the new parent's measure. From each ancestor up
   to the root, the other child's subtree is searched, with branch and bound, and beside the
   ancestor itself is tried.
2. In the order of gain, do the moves; one is skipped where a node that it touches has been
   touched in this pass, and where its new place has come to be below it.

The widely copied code of this (madmann91/bvh v2) ends the climb before the other child of the root
is searched, so that only the root's own children can move across it, tries no ancestors, and lacks
the second check.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.builders.draft import Draft
from mibvh.builders.options import Options, option
from mibvh.builders.registry import Context, builder
from mibvh.builders.rotations import box_area, depth_first, fit_box, judged, union_area
from mibvh.builders.subtrees import subtree_costs
from mibvh.measures.boxes import of_corners
from mibvh.parallel import run_blocks
from mibvh.triangles import Triangles

#: Nodes that one thread searches for, one after the other.
_BLOCK = 256
#: A move must gain this share of the root's measure, or it is rounding.
_LEAST = 1e-9


@njit
def _costs(measure, box):
    """(M,) float64: measures of all nodes."""
    out = np.empty(len(box), np.float64)
    for node in range(len(box)):
        out[node] = box_area(measure, box, node)
    return out


@njit
def _parents_and_depth(left, right):
    """Parents, which nodes belong to the tree, and edges on the longest path."""
    parent = np.full(len(left), -1, np.int32)
    depth = np.full(len(left), -1, np.int32)
    stack = np.empty(len(left) + 1, np.int32)
    stack[0], depth[0], top, deepest = 0, 0, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        deepest = max(deepest, depth[node])
        if left[node] >= 0:
            for child in (left[node], right[node]):
                parent[child], depth[child] = node, depth[node] + 1
                stack[top] = child
                top += 1
    return parent, depth >= 0, deepest


@njit
def _other(left, right, node, child):
    return right[node] if left[node] == child else left[node]


@njit
def _find(measure, node, left, right, parent, box, cost, stack, gains, rest):
    """Find the best place of a node: the node it becomes the sibling of, and the gain."""
    best, to = 0.0, np.int32(-1)
    pivot, below = parent[node], node
    gain = cost[pivot]
    beside = _other(left, right, pivot, node)
    for k in range(6):
        rest[k] = box[beside, k]
    while True:
        stack[0], gains[0], top = beside, gain, 1
        while top > 0:
            top -= 1
            at, had = stack[top], gains[top]
            if had - cost[node] <= best:
                continue
            left_over = had - union_area(measure, box, at, node)
            if left_over > best:
                best, to = left_over, at
            if left[at] >= 0:
                stack[top], gains[top] = left[at], left_over + cost[at]
                stack[top + 1], gains[top + 1] = right[at], left_over + cost[at]
                top += 2
        if pivot == 0:
            return to, best
        if pivot != parent[node]:
            for k in range(3):
                rest[k] = min(rest[k], box[beside, k])
                rest[k + 3] = max(rest[k + 3], box[beside, k + 3])
            shrunk = of_corners(measure, rest[0], rest[1], rest[2], rest[3], rest[4], rest[5])
            # Beside the shrunk ancestor itself: their common box is the ancestor's of now.
            if gain - shrunk > best:
                best, to = gain - shrunk, pivot
            gain += cost[pivot] - shrunk
        below, pivot = pivot, parent[pivot]
        beside = _other(left, right, pivot, below)


@njit
def _find_some(begin, end, nodes, places, gains, measure, left, right, parent, box, cost, depth):
    """Find the best places of the nodes ``begin`` to ``end``, and what they gain."""
    stack, had = np.empty(depth + 3, np.int32), np.empty(depth + 3, np.float64)
    rest = np.empty(6, np.float32)
    for i in range(begin, end):
        places[i], gains[i] = _find(
            measure, nodes[i], left, right, parent, box, cost, stack, had, rest
        )


@njit
def _refit_up(measure, node, left, right, parent, box, cost):
    while node >= 0:
        fit_box(left, right, box, node)
        cost[node] = box_area(measure, box, node)
        node = parent[node]


@njit
def _replace(left, right, parent, above, old, new):
    if left[above] == old:
        left[above] = new
    else:
        right[above] = new
    parent[new] = above


@njit
def _move_all(measure, nodes, places, left, right, parent, box, cost, touched):
    """Do the moves in the order given, but for those that are in each other's way."""
    done = 0
    for i in range(len(nodes)):
        node, to = nodes[i], places[i]
        above = parent[node]
        beside = _other(left, right, above, node)
        if touched[to] or touched[node] or touched[beside] or touched[above]:
            continue
        if touched[parent[to]] or to in (beside, above):
            continue
        up = to
        while up > 0 and up != node:
            up = parent[up]
        if up == node:
            continue
        free = above
        if above == 0:
            # The sibling becomes the root, which keeps its number.
            free = beside
            left[0], right[0] = left[beside], right[beside]
            parent[left[0]], parent[right[0]] = 0, 0
            _refit_up(measure, 0, left, right, parent, box, cost)
        else:
            _replace(left, right, parent, parent[above], above, beside)
            _refit_up(measure, parent[beside], left, right, parent, box, cost)
        beyond = parent[to]
        _replace(left, right, parent, beyond, to, free)
        left[free], right[free] = to, node
        parent[to], parent[node] = free, free
        _refit_up(measure, free, left, right, parent, box, cost)
        touched[to] = touched[node] = touched[beside] = touched[above] = touched[beyond] = True
        done += 1
    return done


def _pass(measure: Any, share: float, left: Any, right: Any, box: Any) -> int:
    """One pass over the largest nodes; returns the moves."""
    parent, belongs, depth = _parents_and_depth(left, right)
    cost = _costs(measure, box)
    nodes = np.flatnonzero(belongs)[1:]
    largest = np.argsort(-cost[nodes], kind="stable")[: max(1, round(share * len(nodes)))]
    nodes = nodes[largest].astype(np.int32)
    if len(nodes) == 0:
        return 0
    places, gains = np.empty(len(nodes), np.int32), np.empty(len(nodes), np.float64)
    arrays = (nodes, places, gains, measure, left, right, parent, box, cost, depth)
    run_blocks(lambda _, begin, end: _find_some(begin, end, *arrays), len(nodes), _BLOCK)
    worth = np.flatnonzero((places >= 0) & (gains > _LEAST * cost[0]))
    worth = worth[np.argsort(-gains[worth], kind="stable")]
    touched = np.zeros(len(left), np.bool_)
    return int(
        _move_all(measure, nodes[worth], places[worth], left, right, parent, box, cost, touched)
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReinsertionOptions(Options):
    """Options of `reinsertion`."""

    start: str = option("ploc", "builder of the tree to improve")
    passes: int = option(16, "passes; the n-th goes over one (2 n - 1)-th of the nodes", 0, 1000)
    share: float = option(1.0, "share of the nodes that the first pass goes over", 1e-6, 1.0)


@builder(
    "reinsertion",
    summary="parallel reinsertion: sixteen passes that shrink to the top, the collapse, two more",
    source="Meister and Bittner 2018; the schedule of obvhs",
    options=ReinsertionOptions,
)
def reinsertion(triangles: Triangles, options: ReinsertionOptions, context: Context) -> Draft:
    """Improve a tree by parallel reinsertion; the better one of start and end."""
    start = context.start(triangles, options.start, options)
    measure = context.compiled_measure(start.references.scale)
    left, right, reference, count, box = depth_first(start)
    moves, last = 0, (options.share, options.share / 2) if options.passes else ()
    for n in range(options.passes):
        moves += _pass(measure, options.share / (2 * n + 1), left, right, box)
        context.progress("reinserting", (n + 1) / (options.passes + 2))
    # What will be one leaf is one from here on.
    improved = Draft(start.references, left, right, reference)
    left, right, reference, count, box = depth_first(improved)
    costs = options.c_inner, options.c_tri, options.max_leaf, measure
    least = subtree_costs(left, right, box, count, *costs)
    as_leaf = options.c_tri * count * _costs(measure, box)
    closed = (left >= 0) & (count <= options.max_leaf) & (least >= as_leaf)
    open_left, open_right = np.where(closed, -1, left), np.where(closed, -1, right)
    for share in last:
        moves += _pass(measure, share, open_left, open_right, box)
    end = Draft(
        start.references,
        np.where(closed, left, open_left),
        np.where(closed, right, open_right),
        reference,
    )
    report = {"start": options.start, "iterations": options.passes + len(last), "moves": moves}
    return judged(measure, start, end, options, report)
