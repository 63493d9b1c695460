"""The walk of the exact EPO: triangle by triangle through the nodes that are foreign to it.

A triangle's own nodes form the paths from the root to its references. The paths share a *trunk*,
from the root down to the *junction*: the last node that has all of the triangle's references below
it. A triangle with one reference has a trunk only, and its leaf is the junction. Foreign subtrees
hang off the trunk and off the paths below it.

- Off the trunk: the foreign nodes that touch a node's box, siblings at first, are passed down from
  node to node. The trunk is thus walked once for all references below a node, and few foreign
  nodes are left at the junction. The junction's box contains the whole triangle: a foreign node
  around that of a node on the trunk holds all triangles whose junctions are below. It gets their
  areas in one sum, and its children are passed down in its place.
- Off the paths below the junction: these are walked for each triangle. On the way down the
  triangle is clipped to its own node. Its part in a foreign node there need not be near any one of
  its leaves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.metrics.clip import (
    Polygons,
    area_of,
    clip,
    lies_in,
    measure,
    meets,
    put_triangle,
    room,
    touches,
)

#: A node around others is replaced by its children only if fewer than this many would be passed on.
_PASSED_ON = 128


class Nodes(NamedTuple):
    """A tree's arrays as the walk reads them; ``box`` is (6 M,): lower and upper corners."""

    box: Any
    left: Any
    first: Any
    count: Any


class Work(NamedTuple):
    """Scratch memory of one thread.

    Attributes
    ----------
    polygons : Polygons
        Rows 0 and 1 hold the whole triangle, or its part in its leaf. Each level below the trunk
        has two more rows, ``2 * level + 2`` and the next. Siblings share them: a node is clipped
        when it is popped, and by then its sibling's subtree is finished.
    holder : (levels,) int64
        Row of the polygon inside the current node of each level. Where that is the parent's
        polygon, unclipped, it is the parent's row.
    stack, stack_level : int64
        Foreign nodes to visit.
    own : (., 4) int64
        Own nodes to visit: node, level, and the range of the triangle's positions below it.
    alone : (1,) int32
        A list of one node.
    path : (., 4) int32
        Nodes to visit on the way to the block's leaves: node, depth, and the range in
        ``passed`` of the foreign nodes that touch it.
    at : (., 3) int32
        The current node of each depth, and its range in ``passed``.
    passed : int32
        The lists of foreign nodes.
    """

    polygons: Polygons
    holder: Any
    stack: Any
    stack_level: Any
    own: Any
    alone: Any
    path: Any
    at: Any
    passed: Any


def workspace(depth: int) -> Work:
    """Allocate the scratch memory of one thread for a tree of the given depth."""
    size = 2 * depth + 4
    i32, i64 = np.int32, np.int64
    return Work(
        polygons=room(2 * depth + 6),
        holder=np.zeros(depth + 2, i64),
        stack=np.zeros(size, i64),
        stack_level=np.zeros(size, i64),
        own=np.zeros((size, 4), i64),
        alone=np.zeros(1, i32),
        path=np.zeros((size, 4), i32),
        at=np.zeros((depth + 2, 3), i32),
        passed=np.zeros(2 * (depth + 2) * (_PASSED_ON + depth + 2), i32),
    )


@njit(allocates=False, forceinline=True)
def _foreign(nodes, subtrees, low, high, row, base, weight, work, sums):
    """Add the areas of the polygon in a row inside ``subtrees[low:high]`` and all below them.

    ``base`` is the level of these subtrees. Returns how many pairs, boxes and clips there were.
    """
    polygons, holder, stack, stack_level = work.polygons, work.holder, work.stack, work.stack_level
    box, left = nodes.box, nodes.left
    pairs = visits = clips = 0
    for s in range(low, high):
        visits += 1
        if not meets(polygons.limits, row, box, subtrees[s]):
            continue
        stack[0], stack_level[0], top = subtrees[s], base, 1
        while top > 0:
            top -= 1
            node, level = stack[top], stack_level[top]
            h = row if level == base else holder[level - 1]
            inside, n = clip(polygons, h, box, node, 2 * level + 2)
            if inside != h:
                clips += 1
                if n < 3:
                    continue
                if left[node] < 0:  # nothing is clipped from it any more
                    area = area_of(polygons, inside, n)
                    sums[node] += np.int64(area * weight + 0.5)
                    pairs += area > 0.0
                    continue
                if measure(polygons, inside, n) == 0.0:
                    continue
            sums[node] += np.int64(polygons.area[inside] * weight + 0.5)
            pairs += 1
            if left[node] < 0:
                continue
            holder[level] = inside
            for child in range(left[node], left[node] + 2):
                visits += 1
                if meets(polygons.limits, inside, box, child):
                    stack[top], stack_level[top] = child, level + 1
                    top += 1
    return pairs, visits, clips


@njit(allocates=False)
def _below(nodes, junction, positions, begin, end, row, weight, work, sums):
    """Add the areas of a triangle's polygon in the foreign nodes below its junction.

    Its references are at ``positions[begin:end]``, ascending. Returns pairs, boxes and clips.
    """
    polygons, holder, own, alone = work.polygons, work.holder, work.own, work.alone
    box, left, first = nodes.box, nodes.left, nodes.first
    pairs = visits = clips = 0
    own[0, 0], own[0, 1], own[0, 2], own[0, 3], top = junction, 0, begin, end, 1
    while top > 0:
        top -= 1
        node, level, low, high = own[top, 0], own[top, 1], own[top, 2], own[top, 3]
        h = row
        if level > 0:
            h = holder[level - 1]
            inside, n = clip(polygons, h, box, node, 2 * level + 2)
            if inside != h:
                clips += 1
                if n < 3 or measure(polygons, inside, n) == 0.0:
                    continue
            h = inside
        holder[level] = h
        middle = low
        while middle < high and positions[middle] < first[left[node] + 1]:
            middle += 1
        for c in range(2):
            child = left[node] + c
            some, end_of_some = (low, middle) if c == 0 else (middle, high)
            visits += 1
            if some < end_of_some:
                if left[child] >= 0:
                    own[top, 0], own[top, 1] = child, level + 1
                    own[top, 2], own[top, 3] = some, end_of_some
                    top += 1
            elif meets(polygons.limits, h, box, child):
                alone[0] = child
                more = _foreign(nodes, alone, 0, 1, h, level + 1, weight, work, sums)
                pairs, visits, clips = pairs + more[0], visits + more[1], clips + more[2]
    return pairs, visits, clips


@njit(allocates=False)
def walk(
    begin,
    end,
    walked,
    cut_to_leaf,
    corners,
    weights,
    starts,
    positions,
    references,
    nodes,
    unit,
    below,
    work,
    sums,
):
    """Add the foreign areas of the references ``begin`` to ``end`` to ``sums`` (M,) int64.

    Fourteen arguments: with those beside ``nodes`` and ``work`` in tuples too, EPO took 8 % longer.
    ``walked`` marks the references that stand for their triangle: the first of each. With
    ``cut_to_leaf`` every reference stands for the part of its triangle in its leaf's box.
    ``below`` is from :func:`add_up`; the block with a node's first reference adds the node's sum.
    """
    polygons, limits = work.polygons, work.polygons.limits
    box, left, first, count = nodes.box, nodes.left, nodes.first, nodes.count
    path, at, passed = work.path, work.at, work.passed
    stack = work.stack
    pairs = visits = clips = 0
    path[0, 0], path[0, 1], path[0, 2], path[0, 3], top = 0, 0, 0, 0, 1
    while top > 0:
        top -= 1
        node, level, low, high = path[top, 0], path[top, 1], path[top, 2], path[top, 3]
        if first[node] >= end or first[node] + count[node] <= begin:
            continue
        at[level, 0], at[level, 1], at[level, 2] = node, low, high
        if left[node] >= 0:
            # -- pass on the foreign nodes that touch each child, the other child among them. Both
            # lists are written now, one behind the other, and last until both children are finished
            for c in range(2):
                child, other = left[node] + c, left[node] + 1 - c
                place = high if c == 0 else path[top - 1, 3]
                path[top, 0], path[top, 1], path[top, 2] = child, level + 1, place
                for k in range(6):
                    limits[k] = box[6 * child + k]
                mine = not cut_to_leaf and begin <= first[child] and first[child] < end
                for i in range(low, high + 1):
                    stack[0], waiting = passed[i] if i < high else other, 1
                    while waiting > 0:
                        waiting -= 1
                        foreign = stack[waiting]
                        visits += 1
                        if not touches(limits, 0, box, foreign):
                            continue
                        others = place - path[top, 2] + waiting + high - i
                        if (
                            cut_to_leaf
                            or others >= _PASSED_ON
                            or not lies_in(limits, 0, box, foreign)
                        ):
                            passed[place] = foreign
                            place += 1
                            continue
                        if mine:
                            sums[foreign] += below[child, 0]
                            pairs += below[child, 1]
                        if left[foreign] >= 0:
                            stack[waiting], stack[waiting + 1] = left[foreign], left[foreign] + 1
                            waiting += 2
                path[top, 3] = place
                top += 1
            continue
        for position in range(max(begin, first[node]), min(end, first[node] + count[node])):
            t = references[position]
            if not walked[position] or weights[t] == 0.0:
                continue
            row = np.int64(0)
            if put_triangle(polygons, 0, corners, t) == 0.0:
                continue
            if cut_to_leaf:
                row, n = clip(polygons, 0, box, node, 0)
                if n < 3 or measure(polygons, row, n) == 0.0:
                    continue
            item = position if cut_to_leaf else t
            start, stop = starts[item], starts[item + 1]
            up = level
            while first[at[up, 0]] > positions[start] or (
                positions[stop - 1] >= first[at[up, 0]] + count[at[up, 0]]
            ):
                up -= 1
            weight = weights[t] * unit
            found = _foreign(nodes, passed, at[up, 1], at[up, 2], row, 0, weight, work, sums)
            pairs, visits, clips = pairs + found[0], visits + found[1], clips + found[2]
            if up < level:
                found = _below(nodes, at[up, 0], positions, start, stop, row, weight, work, sums)
                pairs, visits, clips = pairs + found[0], visits + found[1], clips + found[2]
    return pairs, visits, clips


@njit
def add_up(nodes, parents, walked, starts, positions, references, areas, weights, unit):
    """Sum up the triangles whose junction is a node or below it.

    Returns (M, 2) int64: their areas in the walk's units, and how many have one.
    """
    left, first, count = nodes.left, nodes.first, nodes.count
    below = np.zeros((len(left), 2), np.int64)
    for node in range(len(left) - 1, -1, -1):  # children before parents
        if left[node] >= 0:
            for k in range(2):
                below[node, k] += below[left[node], k] + below[left[node] + 1, k]
            continue
        for position in range(first[node], first[node] + count[node]):
            t = references[position]
            amount = areas[t] * (weights[t] * unit)
            if not walked[position] or amount == 0.0:
                continue
            junction, last = node, positions[starts[t + 1] - 1]
            while last >= first[junction] + count[junction]:
                junction = parents[junction]
            below[junction, 0] += np.int64(amount + 0.5)
            below[junction, 1] += 1
    return below
