"""The walk of the exact EPO: triangle by triangle through the nodes that are foreign to it.

A triangle's own nodes are the paths from the root to its references. They share a trunk, from
the root down to the *junction*, the last node that has all of its references below it; a triangle
with one reference has a trunk only, and its leaf is the junction. Foreign subtrees hang off both.

- Off the trunk: the siblings that touch a node's box are passed down from node to node, so that
  the trunk is gone once for all references below a node, and few of its siblings are left at the
  junction. The junction's box holds the whole triangle.
- Off the paths below the junction: these are walked for each triangle, which is clipped on its
  way down to what lies in its own node. What a triangle has in a foreign node there need not lie
  near any one of its leaves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.metrics.clip import Polygons, clip, measure, room, touches


class Nodes(NamedTuple):
    """A tree's arrays as the walk reads them: ``box`` is (M, 6), lower corners first."""

    box: Any
    left: Any
    first: Any
    count: Any


class Work(NamedTuple):
    """What one thread writes on.

    Attributes
    ----------
    polygons : Polygons
        Rows 0 and 1 are for the whole triangle, or the part of it in its leaf. Each level below
        the trunk has two more, ``2 * level + 2`` and the next: siblings share them, as a node
        is clipped when it is popped, after its sibling's subtree is done with.
    holder : (levels,) int64
        The row of the polygon inside the node that is at a level now; where it is all of its
        parent's, that is the parent's row.
    stack, stack_level : int32
        Foreign nodes to visit.
    own, own_level, own_begin, own_end : int32, int64
        Own nodes to visit, and which of the triangle's positions lie below each.
    alone : (1,) int32
        A list of one node.
    """

    polygons: Polygons
    holder: Any
    stack: Any
    stack_level: Any
    own: Any
    own_level: Any
    own_begin: Any
    own_end: Any
    alone: Any


@njit
def _work(depth):
    size = 2 * depth + 4
    return Work(
        room(2 * depth + 6),
        np.empty(depth + 2, np.int64),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty(1, np.int32),
    )


@njit(allocates=False)
def _foreign(nodes, subtrees, low, high, row, base, weight, work, sums):
    """Add the areas of the polygon in a row inside ``subtrees[low:high]`` and all below them.

    ``base`` is the level of these subtrees. Returns the pairs, boxes and clips it took.
    """
    polygons, holder, stack, stack_level = work.polygons, work.holder, work.stack, work.stack_level
    box, left = nodes.box, nodes.left
    pairs = visits = clips = 0
    for s in range(low, high):
        visits += 1
        if not touches(polygons.limits, row, box, subtrees[s]):
            continue
        stack[0], stack_level[0], top = subtrees[s], base, 1
        while top > 0:
            top -= 1
            node, level = stack[top], np.int64(stack_level[top])
            h = row if level == base else holder[level - 1]
            inside, n = clip(polygons, h, box, node, 2 * level + 2)
            if inside != h:
                clips += 1
                if n < 3 or measure(polygons, inside, n) == 0.0:
                    continue
            sums[node] += np.int64(polygons.area[inside] * weight + 0.5)
            pairs += 1
            if left[node] < 0:
                continue
            holder[level] = inside
            for child in range(left[node], left[node] + 2):
                visits += 1
                if touches(polygons.limits, inside, box, child):
                    stack[top], stack_level[top] = child, level + 1
                    top += 1
    return pairs, visits, clips


@njit(allocates=False)
def _below(nodes, junction, positions, begin, end, row, weight, work, sums):
    """Add the areas of a triangle's polygon in the foreign nodes below its junction.

    Its references are at ``positions[begin:end]``, ascending. Returns pairs, boxes and clips.
    """
    polygons, holder, alone = work.polygons, work.holder, work.alone
    own, own_level, own_begin, own_end = work.own, work.own_level, work.own_begin, work.own_end
    box, left, first = nodes.box, nodes.left, nodes.first
    pairs = visits = clips = 0
    own[0], own_level[0], own_begin[0], own_end[0], top = junction, 0, begin, end, 1
    while top > 0:
        top -= 1
        node, level = own[top], np.int64(own_level[top])
        low, high = own_begin[top], own_end[top]
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
                    own[top], own_level[top] = child, level + 1
                    own_begin[top], own_end[top] = some, end_of_some
                    top += 1
            elif touches(polygons.limits, h, box, child):
                alone[0] = child
                more = _foreign(nodes, alone, 0, 1, h, level + 1, weight, work, sums)
                pairs, visits, clips = pairs + more[0], visits + more[1], clips + more[2]
    return pairs, visits, clips


@njit
def walk(
    begin, end, walked, cut_to_leaf, corners, weights, starts, positions, references, nodes,
    depth, unit, sums,
):  # fmt: skip
    """Add the foreign areas of the references ``begin`` to ``end`` to ``sums`` (M,) int64.

    ``walked`` says which references stand for their triangle, the first of each; with
    ``cut_to_leaf`` every one stands for the part of its triangle in its leaf's box.
    """
    work = _work(depth)
    polygons, limits = work.polygons, work.polygons.limits
    box, left, first, count = nodes.box, nodes.left, nodes.first, nodes.count
    path = np.empty(2 * depth + 4, np.int32)
    path_level = np.empty(2 * depth + 4, np.int32)
    path_low = np.empty(2 * depth + 4, np.int32)
    path_high = np.empty(2 * depth + 4, np.int32)
    # The node that is at a level now, and where its siblings are listed.
    at = np.empty(depth + 2, np.int32)
    at_low = np.empty(depth + 2, np.int32)
    at_high = np.empty(depth + 2, np.int32)
    siblings = np.empty((depth + 2) * (depth + 2), np.int32)
    pairs = visits = clips = 0
    path[0], path_level[0], path_low[0], path_high[0], top = 0, 0, 0, 0, 1
    while top > 0:
        top -= 1
        node, level, low, high = path[top], path_level[top], path_low[top], path_high[top]
        if first[node] >= end or first[node] + count[node] <= begin:
            continue
        at[level], at_low[level], at_high[level] = node, low, high
        if left[node] >= 0:
            # -- pass on the siblings that touch each child, and the other child; the lists of both
            # are written now, one behind the other, and stay until the children are done with
            for c in range(2):
                child, other = left[node] + c, left[node] + 1 - c
                place = high if c == 0 else path_high[top - 1]
                path[top], path_level[top], path_low[top] = child, level + 1, place
                for k in range(6):
                    limits[0, k] = box[child, k]
                for i in range(low, high + 1):
                    sibling = siblings[i] if i < high else other
                    visits += 1
                    if touches(limits, 0, box, sibling):
                        siblings[place] = sibling
                        place += 1
                path_high[top] = place
                top += 1
            continue
        for position in range(max(begin, first[node]), min(end, first[node] + count[node])):
            t = references[position]
            if not walked[position] or weights[t] == 0.0:
                continue
            for i in range(3):
                for k in range(3):
                    polygons.corners[0, i, k] = corners[t, i, k]
            row, n = np.int64(0), np.int64(3)
            if measure(polygons, 0, 3) == 0.0:
                continue
            if cut_to_leaf:
                row, n = clip(polygons, 0, box, node, 0)
                if n < 3 or (row != 0 and measure(polygons, row, n) == 0.0):
                    continue
            item = position if cut_to_leaf else t
            start, stop = starts[item], starts[item + 1]
            up = level
            while first[at[up]] > positions[start] or (
                positions[stop - 1] >= first[at[up]] + count[at[up]]
            ):
                up -= 1
            weight = weights[t] * unit
            found = _foreign(
                nodes, siblings, at_low[up], at_high[up], row, 0, weight, work, sums
            )
            pairs, visits, clips = pairs + found[0], visits + found[1], clips + found[2]
            if up < level:
                found = _below(nodes, at[up], positions, start, stop, row, weight, work, sums)
                pairs, visits, clips = pairs + found[0], visits + found[1], clips + found[2]
    return pairs, visits, clips
