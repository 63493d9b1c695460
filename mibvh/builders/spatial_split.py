"""A spatial split: a node cut at a plane, and its sorted lists parted there.

Stich, Friedrich, Dietrich: *Spatial Splits in Bounding Volume Hierarchies* (HPG 2009), section 4.
References across the plane are cut in two; each of them may yet go whole to one side where that
is cheaper (*unsplitting*). The lists are those of :mod:`mibvh.builders.sweep`.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.builders.measured import cost_of
from mibvh.builders.radix import argsort_keys, float_keys
from mibvh.builders.simd import load, nothing, store, union, widen
from mibvh.builders.splitting import AHEAD, expect, split_reference
from mibvh.builders.sweep import ID_ZERO

#: Fewer parts than this are sorted by insertion.
_FEW = 64


@njit(allocates=False)
def _classify(lists, first, n, axis, plane, rows, halves):
    """Tell on which side of a plane references lie; the rows of those across go to ``rows``.

    Returns
    -------
    (left, right, across)
        How many there are; ``halves`` are the boxes of those on one side only.
    """
    left, right = nothing(), nothing()
    n_left, across = 0, 0
    for row in range(first, first + n):
        if -lists[row, axis + 4] <= plane:
            n_left += 1
            left = union(left, load(lists, row))
        elif lists[row, axis] >= plane:
            right = union(right, load(lists, row))
        else:
            rows[across] = row
            across += 1
    store(halves, 0, left)
    store(halves, 1, right)
    return n_left, n - n_left - across, across


@njit(allocates=False)
def _cut_all(corners, scale, lists, across, axis, plane, rows, side, parts, halves, bins):
    """Cut the references across the plane: left parts to ``parts[0]``, right ones to ``parts[1]``.

    What turns out to be on one side only stays whole.

    Returns
    -------
    (left, right, both)
        How many are on the left only, on the right only, and still across.
    """
    ids = lists.view(np.int32)
    polygon, spare = bins.polygon, bins.spare
    left, both = 0, 0
    for i in range(across):
        row = np.int64(rows[i])
        ahead = np.int64(rows[min(i + AHEAD, across - 1)])
        expect(corners, np.int64(ids[ahead, 7] - ID_ZERO))
        found = split_reference(
            corners,
            ids[row, 7] - ID_ZERO,
            scale,
            lists,
            row,
            axis,
            plane,
            parts[0, both],
            parts[1, both],
            polygon,
            spare,
        )
        if found == 3:
            widen(halves, 0, load(parts[0], both))
            widen(halves, 1, load(parts[1], both))
            rows[both] = row
            both += 1
            continue
        half = found - 1
        side[ids[row, 3] - ID_ZERO] = half
        widen(halves, half, load(lists, row))
        left += 1 - half
    return left, across - left - both, both


@njit(allocates=False)
def _unsplit(measure, lists, both, n_left, n_right, rows, side, parts, halves):
    """Give each cut reference whole to one side where that is cheaper.

    Counts and boxes are those with all references cut, less what was unsplit before: the
    sides of the plane as the paper has them.

    Returns
    -------
    (left count, right count, still cut, cost)
    """
    ids = lists.view(np.int32)
    left, right = load(halves, 0), load(halves, 1)
    area_left, area_right = cost_of(measure, left), cost_of(measure, right)
    kept = 0
    for i in range(both):
        row = np.int64(rows[i])
        r = ids[row, 3] - ID_ZERO
        wide_left, wide_right = union(left, load(lists, row)), union(right, load(lists, row))
        less_left, less_right = np.float32(n_left - 1), np.float32(n_right - 1)
        split = area_left * np.float32(n_left) + area_right * np.float32(n_right)
        on_left = cost_of(measure, wide_left) * np.float32(n_left) + area_right * less_right
        on_right = area_left * less_left + cost_of(measure, wide_right) * np.float32(n_right)
        if on_left <= split and on_left <= on_right:
            side[r] = 0
            left, area_left = wide_left, cost_of(measure, wide_left)
            n_right -= 1
        elif on_right <= split:
            side[r] = 1
            right, area_right = wide_right, cost_of(measure, wide_right)
            n_left -= 1
        else:
            side[r] = 2
            rows[kept] = row
            store(parts[0], kept, load(parts[0], i))
            store(parts[1], kept, load(parts[1], i))
            kept += 1
    store(halves, 0, left)
    store(halves, 1, right)
    cost = area_left * np.float32(n_left) + area_right * np.float32(n_right)
    return n_left, n_right, kept, cost


@njit(allocates=False)
def cut_node(
    measure,
    corners,
    scale,
    lists,
    first,
    n,
    slack,
    first_id,
    axis,
    plane,
    limit,
    side,
    parts,
    halves,
    bins,
):
    """Split a node at a plane, if that is possible and costs less than ``limit``.

    Returns
    -------
    (left count, right count, references added)
        All 0 if the node was not split. Otherwise the parts are in ``parts``, and ``side``
        of the references across says where they go: 0 left, 1 right, 2 both.
    """
    rows = bins.rows
    n_left, n_right, across = _classify(lists, first, n, axis, plane, rows, halves)
    if across > slack:
        return 0, 0, 0
    only_left, only_right, both = _cut_all(
        corners, scale, lists, across, axis, plane, rows, side, parts, halves, bins
    )
    n_left += only_left + both
    n_right += only_right + both
    n_left, n_right, added, cost = _unsplit(
        measure, lists, both, n_left, n_right, rows, side, parts, halves
    )
    if n_left == 0 or n_right == 0 or not cost < limit:
        return 0, 0, 0
    ids, part_ids = lists.view(np.int32), parts.view(np.int32)
    for i in range(added):
        for half in range(2):
            part_ids[half, i, 3] = first_id + 2 * i + half + ID_ZERO
            part_ids[half, i, 7] = ids[np.int64(rows[i]), 7]
    return n_left, n_right, added


@njit
def _center_order(boxes, n, axis):
    """Order of boxes by centre, stable."""
    keys = np.empty(n, np.float32)
    for i in range(n):
        keys[i] = boxes[i, axis] - boxes[i, axis + 4]
    if n > _FEW:
        return argsort_keys(float_keys(keys), 32)
    order = np.arange(n).astype(np.int32)
    for i in range(1, n):
        index, key, j = order[i], keys[i], i
        while j > 0 and keys[j - 1] > key:
            order[j], keys[j] = order[j - 1], keys[j - 1]
            j -= 1
        order[j], keys[j] = index, key
    return order


@njit
def _merge(lists, first, end, boxes, n, axis):
    """Merge boxes into the sorted rows from ``first`` to ``end``, from the back.

    Their ids are above all others, so they go behind equal centres.
    """
    order = _center_order(boxes, n, axis)
    out = end + n - 1
    row = end - 1
    for i in range(n - 1, -1, -1):
        j = np.int64(order[i])
        key = boxes[j, axis] - boxes[j, axis + 4]
        while row >= first and lists[row, axis] - lists[row, axis + 4] > key:
            store(lists, out, load(lists, row))
            row -= 1
            out -= 1
        store(lists, out, load(boxes, j))
        out -= 1


@njit(allocates=False)
def part_at_plane(lists, source, left, right, total, n, axis, plane, added, side, parts):
    """Write the lists of a node to the other set, parted at a plane, with the parts merged in."""
    ids = lists.view(np.int32)
    for k in range(3):
        on_left, on_right = left + k * total, right + k * total
        for row in range(source + k * total, source + k * total + n):
            box = load(lists, row)
            goes_left = -lists[row, axis + 4] <= plane
            goes_right = lists[row, axis] >= plane
            if not goes_left and not goes_right:
                where = side[ids[row, 3] - ID_ZERO]
                goes_left, goes_right = where == 0, where == 1
            if goes_left:
                store(lists, on_left, box)
                on_left += 1
            elif goes_right:
                store(lists, on_right, box)
                on_right += 1
        if added > 0:
            _merge(lists, left + k * total, on_left, parts[0], added, k)
            _merge(lists, right + k * total, on_right, parts[1], added, k)
