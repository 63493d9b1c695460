"""`sbvh`: top-down full-sweep SAH with spatial splits.

Stich, Friedrich, Dietrich: *Spatial Splits in Bounding Volume Hierarchies* (HPG 2009).
A large triangle drags a large box into every node it is in, and boxes overlap. A spatial
split cuts a node at a plane instead: triangles across it are entered on both sides, each
time under the box of only the part that is there.

Stages
------
1. Sort the references once per axis by box centre, as `bbvh` does.
2. At each node, find the best object split (:func:`_sweep`): the full sweep of `bbvh`, with
   its ties, over the *references'* boxes.
3. Where the children it would make overlap by ``alpha`` of the root's area, look for a
   spatial split as well (:func:`_sweep_planes`): every plane between the bins of each axis
   has the cost ``A_left N_left + A_right N_right``, N by counting where references begin and
   end. Corners alone (:func:`_enter_all`) bound that cost from below; where a plane may pay,
   references are chopped exactly at the planes (:func:`_chop_all`).
4. If a plane is cheaper, cut the references across it (:func:`_spatial_split`). Each of them
   may yet go whole to one side, if that is the cheapest of the three (*unsplitting*). If one
   side stays empty, or the cost after all is above that of the object split, the object
   split is taken.
5. Part the three sorted lists stably; the cut references, whose centres have moved, are
   sorted by themselves and merged in (:func:`_part_all`).
6. Where a leaf would be cheaper than any split (and not too large for one), spatial
   splits end. Object splits go on down to single references, and the common collapse
   (:mod:`mibvh.builders.finish`) makes the leaves, in which a triangle stands once.

Memory and threads: a node owns a range of the lists with room for the references that may
still be added below it, as many ids for them, and a range of the tree's nodes. Both halves
of a split get their share of that room: by their number of references, or all of it where
only one of them can use any. So nothing is allocated while building, subtrees are
independent, and the tree does not depend on the number of threads.
"""

from __future__ import annotations

import dataclasses
import heapq
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.builders.draft import Draft, References, centers_twice
from mibvh.builders.radix import argsort_keys, float_keys
from mibvh.builders.registry import Context, Options, builder, option
from mibvh.builders.simd import between, half_area, load, load_point, nothing, store, union, widen
from mibvh.builders.splitting import MAX_CORNERS, clip_to_box, pack_boxes, split_reference
from mibvh.triangles import Triangles

#: No spatial splits below this depth: they could go on for ever.
_SPATIAL_DEPTH = 48

#: Nodes of more references are split one at a time, so that threads can share the rest.
_TASK = 16384

#: A node of n references has ``_FEWEST_BINS + _BINS_PER_REFERENCE * n`` bins, up to the
#: number asked for: cutting three triangles at 127 planes finds nothing that 20 do not.
_FEWEST_BINS = 8
_BINS_PER_REFERENCE = 4

#: Fewer ids than this are sorted by insertion.
_FEW = 64


class _Work(NamedTuple):
    """All arrays of a build. R is the number of references that there is room for."""

    corners: Any  #: (N, 3, 3) float32
    scale: Any  #: float64, from scene to builder units
    box: Any  #: (R, 8) float32: each reference's box, as in simd
    triangle: Any  #: (R,) int32
    is_split: Any  #: (R,) bool: whether a box is less than its triangle's
    orders: Any  #: (3, R) int32: references by centre, per axis
    side: Any  #: (R,) uint8: where each reference goes: 1 left, 0 right, 2 both
    buffer: Any  #: (R,) int32, scratch
    across: Any  #: (R,) int32, scratch: references across the plane
    areas: Any  #: (R,) float32, scratch
    left: Any  #: (2 R - 1,) int32
    right: Any
    reference: Any


class _Rules(NamedTuple):
    """The options, as numbers."""

    bins: Any
    least_overlap: Any  #: area in builder units
    leaf_cost: Any  #: cost of a triangle, that of an inner node being 1
    max_leaf: Any


class _Bins(NamedTuple):
    """Scratch of one thread. B is the number of bins; planes bound them from below."""

    box: Any  #: (3 B, 8) float32: union of what lies inside one bin
    cut: Any  #: (3 B, 8) float32: union of the sections at each plane
    begins: Any  #: (3 B,) int32: references that begin in the bin
    ends: Any  #: (3 B,) int32
    area: Any  #: (B,) float32: at each plane, half the area of the right side
    polygon: Any  #: (MAX_CORNERS, 3) float64
    spare: Any  #: (MAX_CORNERS, 3) float64
    points: Any  #: (MAX_CORNERS, 8) float32: corners, as boxes
    halves: Any  #: (3, 8) float32: boxes of the two sides, and of both


# ------------------------------------------------------------------ object split


@njit
def _sweep(order, begin, n, axis, box, areas, best_cost, best_even, best_axis, best_at):
    """Try every split of one axis; return the best (cost, unevenness, axis, left count) so far.

    A side's ``A N`` only grows with the side, so where one side alone costs more than the
    best split so far, the splits beyond are out.
    """
    side = nothing()
    out = 0
    for at in range(n - 1, 0, -1):
        side = union(side, load(box, order[begin + at]))
        area = half_area(side)
        areas[begin + at] = area
        if area * np.float32(n - at) > best_cost:
            out = at
            break
    side = nothing()
    for at in range(1, n):
        side = union(side, load(box, order[begin + at - 1]))
        if at <= out:
            continue
        cost = half_area(side) * np.float32(at)
        if cost > best_cost:
            break
        cost += areas[begin + at] * np.float32(n - at)
        if cost <= best_cost:
            even = abs(2 * at - n)
            if cost < best_cost or even < best_even:
                best_cost, best_even, best_axis, best_at = cost, even, axis, at
    return best_cost, best_even, best_axis, best_at


@njit
def _box_range(order, begin, end, box):
    """Box of a range of references."""
    result = nothing()
    for i in range(begin, end):
        result = union(result, load(box, order[i]))
    return result


@njit
def _overlap(halves):
    """Half the area of the box in which two boxes overlap; -1 if they are apart."""
    x = -max(halves[0, 4], halves[1, 4]) - max(halves[0, 0], halves[1, 0])
    y = -max(halves[0, 5], halves[1, 5]) - max(halves[0, 1], halves[1, 1])
    z = -max(halves[0, 6], halves[1, 6]) - max(halves[0, 2], halves[1, 2])
    if x >= 0 and y >= 0 and z >= 0:
        return x * y + (x + y) * z
    return np.float32(-1)


# ------------------------------------------------------------------ binning


@njit
def _bin_of(x, origin, inverse, first, last):
    """Bin of a coordinate, of those that a reference is in."""
    return min(max(np.int64((x - origin) * inverse), first), last)


@njit
def _enter_corners(points, size, axis, first, last, origin, inverse, base, bin_box):
    """Enter the corners of a polygon that lies in bins ``first`` to ``last`` of an axis."""
    for i in range(size):
        e = base + _bin_of(points[i, axis], origin, inverse, first, last)
        widen(bin_box, e, load(points, i))


@njit
def _enter_crossings(points, size, axis, first, last, origin, inverse, width, base, bin_cut):
    """Enter the points at which a polygon's edges cross the planes between its bins."""
    p = load(points, size - 1)
    x0 = points[size - 1, axis]
    a = _bin_of(x0, origin, inverse, first, last)
    for i in range(size):
        q = load(points, i)
        x1 = points[i, axis]
        b = _bin_of(x1, origin, inverse, first, last)
        if a != b:
            # From the lower end, so that triangles with a common edge are cut at one point.
            low, x, low_bin, high_bin = (p, x0, a, b) if a < b else (q, x1, b, a)
            high = q if a < b else p
            per = np.float32(1) / abs(x1 - x0)
            for e in range(base + low_bin + 1, base + high_bin + 1):
                share = (origin + np.float32(e - base) * width - x) * per
                share = min(max(share, np.float32(0)), np.float32(1))
                widen(bin_cut, e, between(low, high, share))
        p, x0, a = q, x1, b


@njit
def _whole_triangle(corners, t, scale, points):
    """Write a triangle's corners, in builder units, as boxes."""
    # Stored whole: a vector load of what was just stored in pieces has to wait.
    store(points, 0, load_point(corners, 3 * t, scale))
    store(points, 1, load_point(corners, 3 * t + 1, scale))
    store(points, 2, load_point(corners, 3 * t + 2, scale))


@njit
def _clipped_triangle(corners, t, scale, box, r, polygon, spare, points):
    """Write the corners of a triangle's part inside a box, as boxes; return their number."""
    size = clip_to_box(corners, t, scale, box, r, polygon, spare)
    for i in range(size):
        store(points, i, load_point(polygon, i, 1.0))
    return size


@njit
def _bins_of_box(box, r, axis, origin, inverse, last):
    """First and last bin that a box reaches into, of those up to ``last``."""
    start = np.int64((box[r, axis] - origin) * inverse)
    end = (-box[r, axis + 4] - origin) * inverse
    stop = np.int64(end)
    stop -= np.float32(stop) == end  # a box that ends at a plane is not in the bin behind
    start = min(max(start, 0), last)
    return start, min(max(stop, start), last)


@njit
def _enter_all(
    corners, scale, box, triangle, is_split, order, begin, n, count, origin, extent,
    bin_box, bin_cut, begins, ends, most, polygon, spare, points,
):  # fmt: skip
    """Enter a node's references into ``count`` bins on each axis, those across planes by corners.

    All arrays by themselves: a tuple of arrays is dear to hand on for each reference.
    """
    for k in range(3):
        for e in range(k * most, k * most + count):
            store(bin_box, e, nothing())
            store(bin_cut, e, nothing())
            begins[e] = 0
            ends[e] = 0
    bins, end = np.float32(count), count - 1
    x, y, z = origin
    # On an axis of no extent, all is in the first bin.
    px = bins / extent[0] if extent[0] > 0 else np.float32(0)
    py = bins / extent[1] if extent[1] > 0 else np.float32(0)
    pz = bins / extent[2] if extent[2] > 0 else np.float32(0)
    on_y, on_z = most, 2 * most
    for i in range(begin, begin + n):
        r = order[i]
        x0, x1 = _bins_of_box(box, r, 0, x, px, end)
        y0, y1 = _bins_of_box(box, r, 1, y, py, end)
        z0, z1 = _bins_of_box(box, r, 2, z, pz, end)
        begins[x0] += 1
        ends[x1] += 1
        begins[on_y + y0] += 1
        ends[on_y + y1] += 1
        begins[on_z + z0] += 1
        ends[on_z + z1] += 1
        whole = load(box, r)
        if x0 == x1:
            widen(bin_box, x0, whole)
        if y0 == y1:
            widen(bin_box, on_y + y0, whole)
        if z0 == z1:
            widen(bin_box, on_z + z0, whole)
        if x0 == x1 and y0 == y1 and z0 == z1:
            continue
        t, size = triangle[r], 3
        if is_split[r]:
            size = _clipped_triangle(corners, t, scale, box, r, polygon, spare, points)
        else:
            _whole_triangle(corners, t, scale, points)
        if x0 != x1:
            _enter_corners(points, size, 0, x0, x1, x, px, 0, bin_box)
        if y0 != y1:
            _enter_corners(points, size, 1, y0, y1, y, py, on_y, bin_box)
        if z0 != z1:
            _enter_corners(points, size, 2, z0, z1, z, pz, on_z, bin_box)


@njit
def _chop_all(
    corners, scale, box, triangle, is_split, order, begin, n, count, axis, origin, extent,
    bin_cut, base, polygon, spare, points,
):  # fmt: skip
    """Enter the sections of a node's references at the planes of one axis."""
    bins, end = np.float32(count), count - 1
    width, inverse = extent / bins, bins / extent
    for i in range(begin, begin + n):
        r = order[i]
        first, last = _bins_of_box(box, r, axis, origin, inverse, end)
        if first == last:
            continue
        t, size = triangle[r], 3
        if is_split[r]:
            size = _clipped_triangle(corners, t, scale, box, r, polygon, spare, points)
        else:
            _whole_triangle(corners, t, scale, points)
        if size > 0:
            _enter_crossings(points, size, axis, first, last, origin, inverse, width, base, bin_cut)


@njit
def _reach_planes(n, count, axis, origin, width, base, bin_cut, begins, ends):
    """Let both sides of each plane that references are across reach to the plane."""
    n_left, n_right = 0, n
    for e in range(1, count):
        n_left += begins[base + e - 1]
        n_right -= ends[base + e - 1]
        if n_left + n_right > n:
            plane = origin + np.float32(e) * width
            bin_cut[base + e, axis] = plane
            bin_cut[base + e, axis + 4] = -plane


@njit
def _sweep_planes(n, slack, count, axis, best_cost, best_axis, best_at, bins):
    """Try every plane of one axis; return the best (cost, axis, plane) so far.

    Planes that would add more references than there is room for are left out.
    """
    bin_box, bin_cut, begins, ends = bins.box, bins.cut, bins.begins, bins.ends
    areas = bins.area
    base = axis * len(areas)
    side = nothing()
    for e in range(count - 1, 0, -1):
        side = union(side, load(bin_box, base + e))
        areas[e] = half_area(union(side, load(bin_cut, base + e)))
    side = nothing()
    n_left, n_right = 0, n
    for e in range(1, count):
        side = union(side, load(bin_box, base + e - 1))
        n_left += begins[base + e - 1]
        n_right -= ends[base + e - 1]
        if n_left == 0 or n_right == 0 or n_left + n_right - n > slack:
            continue
        area = half_area(union(side, load(bin_cut, base + e)))
        cost = area * np.float32(n_left) + areas[e] * np.float32(n_right)
        if cost < best_cost:
            best_cost, best_axis, best_at = cost, axis, e
    return best_cost, best_axis, best_at


# ------------------------------------------------------------------ spatial split


@njit
def _classify(work, begin, n, axis, plane, halves):
    """Find out on which side of a plane each reference is, and box the sides.

    Returns the number on the left, on the right, and across.
    """
    box, side, order, waiting = work.box, work.side, work.orders[0], work.across
    left, right = nothing(), nothing()
    n_left, n_right, across = 0, 0, 0
    for i in range(begin, begin + n):
        r = order[i]
        if -box[r, axis + 4] <= plane:
            side[r] = 1
            n_left += 1
            left = union(left, load(box, r))
        elif box[r, axis] >= plane:
            side[r] = 0
            n_right += 1
            right = union(right, load(box, r))
        else:
            side[r] = 2
            waiting[begin + across] = r
            across += 1
    store(halves, 0, left)
    store(halves, 1, right)
    return n_left, n_right, across


@njit
def _cut_all(work, begin, across, first_id, axis, plane, cut, bins):
    """Cut the references across the plane.

    Left boxes go to ``cut``, right ones to the boxes from ``first_id`` on. What turns out to
    be on one side only stays whole.

    Returns
    -------
    (left, right, both)
        How many are on the left only, on the right only, and still across.
    """
    box, halves = work.box, bins.halves
    left, right, both = 0, 0, 0
    for i in range(across):
        r = work.across[begin + i]
        a, b = cut[both], box[first_id + both]
        found = split_reference(
            work.corners, work.triangle[r], work.scale, box, r, axis, plane, a, b,
            bins.polygon, bins.spare,
        )  # fmt: skip
        if found == 3:
            widen(halves, 0, load(cut, both))
            widen(halves, 1, load(box, first_id + both))
            work.across[begin + both] = r
            both += 1
        elif found == 1:
            work.side[r] = 1
            widen(halves, 0, load(box, r))
            left += 1
        else:
            work.side[r] = 0
            widen(halves, 1, load(box, r))
            right += 1
    return left, right, both


@njit
def _unsplit(work, begin, both, first_id, n_left, n_right, cut, halves):
    """Give each cut reference whole to one side where that is cheaper.

    Counts and boxes are those with all references cut, less what was unsplit before: the
    sides of the plane as the paper has them.

    Returns
    -------
    (left count, right count, still cut, cost)
    """
    box = work.box
    left, right = load(halves, 0), load(halves, 1)
    area_left, area_right = half_area(left), half_area(right)
    kept = 0
    for i in range(both):
        r = work.across[begin + i]
        wide_left, wide_right = union(left, load(box, r)), union(right, load(box, r))
        less_left, less_right = np.float32(n_left - 1), np.float32(n_right - 1)
        split = area_left * np.float32(n_left) + area_right * np.float32(n_right)
        on_left = half_area(wide_left) * np.float32(n_left) + area_right * less_right
        on_right = area_left * less_left + half_area(wide_right) * np.float32(n_right)
        if on_left <= split and on_left <= on_right:
            work.side[r] = 1
            left, area_left = wide_left, half_area(wide_left)
            n_right -= 1
        elif on_right <= split:
            work.side[r] = 0
            right, area_right = wide_right, half_area(wide_right)
            n_left -= 1
        else:
            work.across[begin + kept] = r
            store(cut, kept, load(cut, i))
            store(box, first_id + kept, load(box, first_id + i))
            kept += 1
    store(halves, 0, left)
    store(halves, 1, right)
    cost = area_left * np.float32(n_left) + area_right * np.float32(n_right)
    return n_left, n_right, kept, cost


@njit
def _spatial_split(work, begin, n, slack, first_id, axis, plane, limit, bins):
    """Split a node at a plane, if that is possible and costs less than ``limit``.

    Returns
    -------
    (left count, right count, references added)
        All 0 if the node was not split; ``work.side`` is undefined then.
    """
    box = work.box
    n_left, n_right, across = _classify(work, begin, n, axis, plane, bins.halves)
    if across > slack:
        return 0, 0, 0
    cut = np.empty((across, 8), np.float32)
    only_left, only_right, both = _cut_all(work, begin, across, first_id, axis, plane, cut, bins)
    n_left, n_right, added, cost = _unsplit(
        work,
        begin,
        both,
        first_id,
        n_left + only_left + both,
        n_right + only_right + both,
        cut,
        bins.halves,
    )
    if n_left == 0 or n_right == 0 or not cost < limit:
        return 0, 0, 0
    for i in range(added):
        r, new = work.across[begin + i], first_id + i
        store(box, r, load(cut, i))
        work.triangle[new] = work.triangle[r]
        work.is_split[r] = True
        work.is_split[new] = True
    return n_left, n_right, added


@njit
def _try_spatial(work, rules, begin, n, slack, first_id, limit, bins):
    """Look for a spatial split cheaper than ``limit``, and carry it out.

    Returns
    -------
    (left count, right count, references added)
        Counts of -1 if a leaf is cheaper than all splits; 0 if the object split is best.
    """
    count = min(rules.bins, _FEWEST_BINS + _BINS_PER_REFERENCE * n)
    whole = union(load(bins.halves, 0), load(bins.halves, 1))
    store(bins.halves, 2, whole)
    row = bins.halves[2]
    origin = (row[0], row[1], row[2])
    extent = (-row[4] - row[0], -row[5] - row[1], -row[6] - row[2])
    _enter_all(
        work.corners, work.scale, work.box, work.triangle, work.is_split, work.orders[0],
        begin, n, count, origin, extent,
        bins.box, bins.cut, bins.begins, bins.ends, rules.bins,
        bins.polygon, bins.spare, bins.points,
    )  # fmt: skip
    # Boxes of the corners alone are too small, but most nodes are done with them: where no
    # plane pays even so, nothing is chopped.
    none = np.int64(-1)
    best_cost, axis, at = limit, none, np.int64(0)
    for k in range(3):
        _reach_planes(
            n, count, k, origin[k], extent[k] / np.float32(count), k * rules.bins,
            bins.cut, bins.begins, bins.ends,
        )  # fmt: skip
        bound, pays, _ = _sweep_planes(n, slack, count, k, limit, none, at, bins)
        if pays >= 0 and bound < best_cost:
            _chop_all(
                work.corners, work.scale, work.box, work.triangle, work.is_split, work.orders[0],
                begin, n, count, k, origin[k], extent[k],
                bins.cut, k * rules.bins, bins.polygon, bins.spare, bins.points,
            )  # fmt: skip
            best_cost, axis, at = _sweep_planes(n, slack, count, k, best_cost, axis, at, bins)
    area = half_area(whole)
    if n <= rules.max_leaf and rules.leaf_cost * (n * area - best_cost) <= area:
        return -1, -1, 0
    if axis < 0:
        return 0, 0, 0
    plane = origin[axis] + np.float32(at) * (extent[axis] / np.float32(count))
    return _spatial_split(work, begin, n, slack, first_id, axis, plane, limit, bins)


# ------------------------------------------------------------------ parting the lists


@njit
def _sort_by_center(ids, box, axis):
    """Sort reference ids by box centre, stably."""
    n = len(ids)
    keys = np.empty(n, np.float32)
    for i in range(n):
        keys[i] = box[ids[i], axis] - box[ids[i], axis + 4]
    if n > _FEW:
        order = argsort_keys(float_keys(keys), 32)
        before = ids.copy()
        for i in range(n):
            ids[i] = before[order[i]]
        return
    for i in range(1, n):
        r, key, j = ids[i], keys[i], i
        while j > 0 and keys[j - 1] > key:
            ids[j], keys[j] = ids[j - 1], keys[j - 1]
            j -= 1
        ids[j], keys[j] = r, key


@njit
def _merge(order, first, end, ids, box, axis):
    """Merge sorted ids into the sorted ``order[first:end]``, from the back."""
    i, j = end - 1, len(ids) - 1
    out = i + len(ids)
    while j >= 0:
        r = ids[j]
        key = box[r, axis] - box[r, axis + 4]
        while i >= first and box[order[i], axis] - box[order[i], axis + 4] > key:
            order[out] = order[i]
            i -= 1
            out -= 1
        order[out] = r
        j -= 1
        out -= 1


@njit
def _part(order, begin, n, target, side, buffer):
    """Move those on the left to ``begin``, on the right to ``target``; return where they end."""
    a, b = begin, begin
    for i in range(begin, begin + n):
        r = order[i]
        s = side[r]
        # Written where it may not belong, and then overwritten: cheaper than a jump.
        order[a] = r
        buffer[b] = r
        a += s == 1
        b += s == 0
    for i in range(b - begin):
        order[target + i] = buffer[begin + i]
    return a, target + b - begin


@njit
def _part_all(work, begin, n, target, first_id, added):
    """Part the three lists, and merge the cut references in on both sides."""
    ids = np.empty(added, np.int32)
    for k in range(3):
        order = work.orders[k]
        left_end, right_end = _part(order, begin, n, target, work.side, work.buffer)
        if added > 0:
            for i in range(added):
                ids[i] = work.across[begin + i]
            _sort_by_center(ids, work.box, k)
            _merge(order, begin, left_end, ids, work.box, k)
            for i in range(added):
                ids[i] = first_id + i
            _sort_by_center(ids, work.box, k)
            _merge(order, target, right_end, ids, work.box, k)


# ------------------------------------------------------------------ the build


@njit
def _split_node(work, rules, task, children, tally, bins):
    """Split one node; write its children, the larger one first, as tasks.

    A task is (begin, number, slack, first new id, node, depth, whether spatial splits are
    allowed); the slack is the number of references that may be added.
    """
    begin, n, slack, first_id, node, depth = task[0], task[1], task[2], task[3], task[4], task[5]
    box, orders, halves = work.box, work.orders, bins.halves
    cost, even, axis, at = np.float32(np.inf), n + 1, np.int64(0), np.int64(1)
    for k in range(3):
        cost, even, axis, at = _sweep(orders[k], begin, n, k, box, work.areas, cost, even, axis, at)
    n_left, n_right, added = 0, 0, 0
    left_may, right_may = False, False
    if task[6] and slack > 0 and depth < _SPATIAL_DEPTH:
        store(halves, 0, _box_range(orders[axis], begin, begin + at, box))
        store(halves, 1, _box_range(orders[axis], begin + at, begin + n, box))
        left_may = half_area(load(halves, 0)) >= rules.least_overlap
        right_may = half_area(load(halves, 1)) >= rules.least_overlap
        if _overlap(halves) >= rules.least_overlap:
            tally[0] += 1
            n_left, n_right, added = _try_spatial(
                work, rules, begin, n, slack, first_id, cost, bins
            )
            if n_left > 0:
                tally[1] += 1
                left_may = half_area(load(halves, 0)) >= rules.least_overlap
                right_may = half_area(load(halves, 1)) >= rules.least_overlap
            elif n_left < 0:
                left_may, right_may = False, False
    if n_left <= 0:
        n_left, n_right = at, n - at
        side, order = work.side, orders[axis]
        for i in range(begin, begin + n):
            side[order[i]] = i < begin + at
    room = slack - added
    left_room = room * n_left // (n_left + n_right)
    if left_may != right_may:
        left_room = room if left_may else 0
    target = begin + n_left + left_room
    _part_all(work, begin, n, target, first_id, added)
    # A node with room for R references owns 2 R - 1 places in the tree.
    left, right = node + 1, node + 2 * (n_left + left_room)
    work.left[node], work.right[node] = left, right
    a = 0 if n_left + left_room > n_right + room - left_room else 1
    b = 1 - a
    children[a, 0], children[b, 0] = begin, target
    children[a, 1], children[b, 1] = n_left, n_right
    children[a, 2], children[b, 2] = left_room, room - left_room
    children[a, 3], children[b, 3] = first_id + added, first_id + added + left_room
    children[a, 4], children[b, 4] = left, right
    children[a, 5], children[b, 5] = depth + 1, depth + 1
    children[a, 6], children[b, 6] = left_may, right_may


@njit
def _run(work, rules, task, once, children, tally):
    """Build all below a node, or split it only once.

    Parameters
    ----------
    work : _Work
    rules : _Rules
    task : (7,) int64
    once : bool
        Whether to stop after one split; its results are in ``children``, (2, 7) int64.
    tally : (2,) int64
        Counts the nodes where a spatial split was looked for, and where one was made.
    """
    most = rules.bins
    bins = _Bins(
        np.empty((3 * most, 8), np.float32),
        np.empty((3 * most, 8), np.float32),
        np.empty(3 * most, np.int32),
        np.empty(3 * most, np.int32),
        np.empty(most, np.float32),
        np.empty((MAX_CORNERS, 3), np.float64),
        np.empty((MAX_CORNERS, 3), np.float64),
        np.zeros((MAX_CORNERS, 8), np.float32),
        np.empty((3, 8), np.float32),
    )
    # The child with less room goes first, so that few wait.
    stack = np.empty((128, 7), np.int64)
    for c in range(7):
        stack[0, c] = task[c]
    top = 1
    while top > 0:
        top -= 1
        if stack[top, 1] == 1:
            work.reference[stack[top, 4]] = work.orders[0, stack[top, 0]]
            continue
        _split_node(work, rules, stack[top], children, tally, bins)
        if once:
            return
        for c in range(7):
            stack[top, c] = children[0, c]
            stack[top + 1, c] = children[1, c]
        top += 2


@njit
def _compact(left, right, reference, box, triangle):
    """Close the gaps that unused room left; number references as the leaves come."""
    number = np.empty(len(left), np.int32)
    nodes, leaves = 0, 0
    for i in range(len(left)):
        number[i] = nodes
        nodes += left[i] >= 0 or reference[i] >= 0
        leaves += reference[i] >= 0
    links = np.full((3, nodes), -1, np.int32)
    lower, upper = np.empty((leaves, 3), np.float32), np.empty((leaves, 3), np.float32)
    owner = np.empty(leaves, np.int32)
    leaf = 0
    for i in range(len(left)):
        if left[i] >= 0:
            links[0, number[i]] = number[left[i]]
            links[1, number[i]] = number[right[i]]
        elif reference[i] >= 0:
            r = reference[i]
            links[2, number[i]] = leaf
            for k in range(3):
                lower[leaf, k] = box[r, k]
                upper[leaf, k] = -box[r, k + 4]
            owner[leaf] = triangle[r]
            leaf += 1
    return links, lower, upper, owner


def _build(work: _Work, rules: _Rules, root: npt.NDArray[np.int64], context: Context) -> list[int]:
    """Run tasks on all threads, the largest first; return the tally."""
    threads = numba.get_num_threads()
    waiting = [(-int(root[1]), int(root[4]), root)]
    running: dict[Future[None], tuple[Any, bool, Any, Any]] = {}
    total, done = int(root[1] + root[2]), 0
    tally = np.zeros(2, np.int64)
    with ThreadPoolExecutor(threads) as pool:
        while waiting or running:
            while waiting and len(running) < threads:
                _, _, task = heapq.heappop(waiting)
                once = bool(task[1] > _TASK)
                out, counts = np.empty((2, 7), np.int64), np.zeros(2, np.int64)
                future = pool.submit(_run, work, rules, task, once, out, counts)
                running[future] = (task, once, out, counts)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task, once, out, counts = running.pop(future)
                future.result()
                tally += counts
                if once:
                    for child in out:
                        heapq.heappush(waiting, (-int(child[1]), int(child[4]), child))
                else:
                    done += int(task[1] + task[2])
                    context.progress("split", done / total)
    return tally.tolist()


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
)
def sbvh(triangles: Triangles, options: SpatialOptions, context: Context) -> Draft:
    """Build the SBVH; O(n log n)."""
    refs = References.of(triangles)
    n = len(refs)
    slack = int(options.budget * n)
    room = n + slack
    centers = centers_twice(refs)
    orders = np.empty((3, room), np.int32)
    context.progress("sort", 0.0)
    for k in range(3):
        orders[k, :n] = argsort_keys(float_keys(centers[:, k]), 32)
    links = np.full((3, 2 * room - 1), -1, np.int32)
    work = _Work(
        triangles.corners,
        refs.scale,
        pack_boxes(refs, slack),
        np.concatenate([refs.triangle, np.empty(slack, np.int32)]),
        np.zeros(room, np.bool_),
        orders,
        np.empty(room, np.uint8),
        np.empty(room, np.int32),
        np.empty(room, np.int32),
        np.empty(room, np.float32),
        *links,
    )
    x, y, z = (refs.upper.max(axis=0) - refs.lower.min(axis=0)).tolist()
    rules = _Rules(
        options.bins,
        np.float32(options.alpha * (x * y + y * z + z * x)),
        options.c_tri / options.c_inner if options.c_inner > 0 else np.inf,
        options.max_leaf,
    )
    root = np.array([0, n, slack, n, 0, 0, 1], np.int64)
    tried, made = _build(work, rules, root, context)
    joined, lower, upper, owner = _compact(*links, work.box, work.triangle)
    return Draft(
        References(lower, upper, owner, refs.scale),
        *joined,
        {"references": len(owner), "spatial_tried": tried, "spatial_made": made},
    )
