"""The best plane to cut a node at: chopped binning of the references, for spatial splits.

Stich, Friedrich, Dietrich: *Spatial Splits in Bounding Volume Hierarchies* (HPG 2009),
section 4.1. Every plane between the bins of each axis has the cost
``A_left N_left + A_right N_right``, N by counting where references begin and end, A by the
boxes of what lies on either side when every reference is chopped exactly at the plane.

Chopping is dear, and most nodes have no plane that pays. So the references are first entered
by their corners alone (:func:`_enter_all`): boxes of those are too small, and bound the cost
from below. Only where planes may pay even so, the references across those are chopped
(:func:`_chop_all`), on one axis after the other, the most promising first.

Planes that no reference is across are not tried: they are object splits, which the full
sweep has seen.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.builders import lanes
from mibvh.builders.measured import cost_of
from mibvh.builders.simd import (
    grid,
    lane,
    last_cells,
    load,
    load_last_vertex,
    load_point,
    load_vertex,
    nothing,
    store,
    union,
    widen,
)
from mibvh.builders.splitting import AHEAD, MAX_CORNERS, clip_to_box, expect
from mibvh.builders.sweep import ID_ZERO


class Bins(NamedTuple):
    """Scratch of one thread. B is the number of bins; planes bound them from below."""

    box: Any  #: (3 B, 8) float32: union of what lies inside one bin
    cut: Any  #: (3 B, 8) float32: union of the sections at each plane
    begins: Any  #: (3 B,) int32: references that begin in the bin
    ends: Any  #: (3 B,) int32
    area: Any  #: (B,) float32: at each plane, half the area of the right side
    frame: Any  #: (4, 8) float32: what takes boxes to bins
    polygon: Any  #: (MAX_CORNERS, 3) float64
    spare: Any  #: (MAX_CORNERS, 3) float64
    points: Any  #: (MAX_CORNERS, 8) float32: corners, as boxes
    rows: Any  #: (R,) uint32: references across planes
    bounds: Any  #: (3,) float32: least cost on each axis
    spans: Any  #: (3, 2) int64: first and last plane that may pay
    sections: Any  #: (6 (B + 8) + 8,) float32: least x, -x, y, -y, z, -z, and 0 to 7
    halves: Any  #: (3, 8) float32: boxes of a split's left and right side, and of both
    parts: Any  #: (2, A, 8) float32: left and right parts of cut references


def new_bins(most: int, references: int, added: int) -> Bins:
    """Scratch for so many bins, and for nodes of so many references, some of them added."""
    sections = np.empty(6 * (most + 8) + 8, np.float32)
    sections[-8:] = range(8)
    return Bins(
        np.empty((3 * most, 8), np.float32),
        np.empty((3 * most, 8), np.float32),
        np.empty(3 * most, np.int32),
        np.empty(3 * most, np.int32),
        np.empty(most, np.float32),
        np.empty((4, 8), np.float32),
        np.empty((MAX_CORNERS, 3), np.float64),
        np.empty((MAX_CORNERS, 3), np.float64),
        np.zeros((MAX_CORNERS, 8), np.float32),
        np.empty(references, np.uint32),
        np.empty(3, np.float32),
        np.empty((3, 2), np.int64),
        sections,
        np.empty((3, 8), np.float32),
        np.empty((2, added, 8), np.float32),
    )


@njit(allocates=False)
def _set_frame(origin, extent, count, frame):
    """Write what takes a box to its bins: origin, scale, and the least and greatest bins."""
    frame[:] = 0
    for k in range(3):
        # On an axis of no extent, all is in the first bin.
        inverse = np.float32(count) / extent[k] if extent[k] > 0 else np.float32(0)
        frame[0, k], frame[0, k + 4] = origin[k], -origin[k]
        frame[1, k], frame[1, k + 4] = -inverse, -inverse
        frame[2, k], frame[2, k + 4] = 1 - count, 1
        frame[3, k], frame[3, k + 4] = 0, count


@njit(allocates=False, forceinline=True)
def _clipped_triangle(corners, triangle, scale, lists, row, polygon, spare, points):
    """Write the corners of a triangle's part inside a box, as boxes; return their number."""
    size = clip_to_box(corners, triangle, scale, lists, row, polygon, spare)
    for i in range(size):
        store(points, i, load_point(polygon, i, 1.0))
    return size


@njit(allocates=False)
def _enter_all(
    corners,
    scale,
    lists,
    first,
    n,
    count,
    most,
    bin_box,
    bin_cut,
    begins,
    ends,
    frame,
    polygon,
    spare,
    points,
    rows,
):
    """Enter a node's references into ``count`` bins on each axis, those across planes by corners.

    All arrays by themselves: a tuple of arrays is dear to hand on for each reference.

    Returns
    -------
    int
        How many are across planes; ``rows`` has theirs.
    """
    for k in range(3):
        for e in range(k * most, k * most + count):
            store(bin_box, e, nothing())
            store(bin_cut, e, nothing())
            begins[e] = 0
            ends[e] = 0
    to_bins = load(frame, 0), load(frame, 1), load(frame, 2), load(frame, 3)
    ids = lists.view(np.int32)
    whole_triangles = np.int32(len(corners)) + ID_ZERO
    on_y, on_z = most, 2 * most
    across, end = 0, first + n - 1
    for row in range(first, first + n):
        expect(corners, np.int64(ids[min(row + AHEAD, end), 7] - ID_ZERO))
        box = load(lists, row)
        lower = grid(box, to_bins[0], to_bins[1], to_bins[2], to_bins[3])
        upper = last_cells(lower)
        x, y, z = -lane(lower, 0), on_y - lane(lower, 1), on_z - lane(lower, 2)
        x1, y1, z1 = -lane(upper, 0), on_y - lane(upper, 1), on_z - lane(upper, 2)
        begins[x] += 1
        begins[y] += 1
        begins[z] += 1
        ends[x1] += 1
        ends[y1] += 1
        ends[z1] += 1
        if x == x1 and y == y1 and z == z1:
            widen(bin_box, x, box)
            widen(bin_box, y, box)
            widen(bin_box, z, box)
            continue
        rows[across] = row
        across += 1
        triangle = np.int64(ids[row, 7] - ID_ZERO)
        if ids[row, 3] < whole_triangles:
            p = load_vertex(corners, 3 * triangle, scale)
            q = load_vertex(corners, 3 * triangle + 1, scale)
            r = load_last_vertex(corners, 3 * triangle + 2, scale)
            at_p = grid(p, to_bins[0], to_bins[1], upper, lower)
            at_q = grid(q, to_bins[0], to_bins[1], upper, lower)
            at_r = grid(r, to_bins[0], to_bins[1], upper, lower)
            if x == x1:
                widen(bin_box, x, box)
            else:
                widen(bin_box, -lane(at_p, 0), p)
                widen(bin_box, -lane(at_q, 0), q)
                widen(bin_box, -lane(at_r, 0), r)
            if y == y1:
                widen(bin_box, y, box)
            else:
                widen(bin_box, on_y - lane(at_p, 1), p)
                widen(bin_box, on_y - lane(at_q, 1), q)
                widen(bin_box, on_y - lane(at_r, 1), r)
            if z == z1:
                widen(bin_box, z, box)
            else:
                widen(bin_box, on_z - lane(at_p, 2), p)
                widen(bin_box, on_z - lane(at_q, 2), q)
                widen(bin_box, on_z - lane(at_r, 2), r)
            continue
        # Clipping rounds, so a bin that has all of a part is given its box.
        if x == x1:
            widen(bin_box, x, box)
        if y == y1:
            widen(bin_box, y, box)
        if z == z1:
            widen(bin_box, z, box)
        size = _clipped_triangle(corners, triangle, scale, lists, row, polygon, spare, points)
        for i in range(size):
            point = load(points, i)
            at = grid(point, to_bins[0], to_bins[1], upper, lower)
            if x < x1:
                widen(bin_box, -lane(at, 0), point)
            if y < y1:
                widen(bin_box, on_y - lane(at, 1), point)
            if z < z1:
                widen(bin_box, on_z - lane(at, 2), point)
    return across


@njit(allocates=False)
def _enter_crossing(points, p, q, axis, begin, end, origin, width, room, sections):
    """Enter where an edge crosses the planes from ``begin`` to ``end``, eight at a time.

    The edge goes from corner p to corner q, of which p is in a lower bin: triangles with a
    common edge are cut at one point.
    """
    first, per = points[p, axis], np.float32(1) / (points[q, axis] - points[p, axis])
    zero, full = lanes.fill(np.float32(0)), lanes.fill(np.float32(1))
    never = lanes.fill(np.float32(np.inf))
    number = lanes.add(lanes.fill(np.float32(begin)), lanes.load_run(sections, 6 * room))
    last = lanes.fill(np.float32(end))
    while begin <= end:
        plane = lanes.add(lanes.fill(origin), lanes.multiply(number, lanes.fill(width)))
        share = lanes.multiply(lanes.subtract(plane, lanes.fill(first)), lanes.fill(per))
        share = lanes.least(lanes.greatest(share, zero), full)
        at = begin
        for k in range(3):
            x = lanes.fill(points[p, k])
            step = lanes.fill(points[q, k] - points[p, k])
            x = lanes.add(x, lanes.multiply(share, step))
            # Planes beyond the last one stay as they are.
            low = lanes.where_at_most(number, last, x, never)
            high = lanes.where_at_most(number, last, lanes.subtract(zero, x), never)
            lanes.store_run(sections, at, lanes.least(low, lanes.load_run(sections, at)))
            at += room
            lanes.store_run(sections, at, lanes.least(high, lanes.load_run(sections, at)))
            at += room
        begin += 8
        number = lanes.add(number, lanes.fill(np.float32(8)))


@njit(allocates=False)
def _bin_of(x, origin, inverse, first, last):
    """Bin of a coordinate, of those that a reference is in."""
    return min(max(np.int64((x - origin) * inverse), first), last)


@njit(allocates=False)
def _chop_all(
    corners,
    scale,
    lists,
    across,
    count,
    most,
    axis,
    begin,
    end,
    origin,
    extent,
    bin_cut,
    frame,
    polygon,
    spare,
    points,
    rows,
    sections,
):
    """Enter the sections of a node's references at the planes ``begin`` to ``end`` of an axis."""
    ids = lists.view(np.int32)
    whole_triangles = np.int32(len(corners)) + ID_ZERO
    to_bins = load(frame, 0), load(frame, 1), load(frame, 2), load(frame, 3)
    width, inverse = extent / np.float32(count), np.float32(count) / extent
    base, room = axis * most, len(sections) // 6 - 1
    for k in range(6):
        for e in range(begin, end + 1):
            sections[k * room + e] = np.inf
    for i in range(across):
        row = np.int64(rows[i])
        ahead = np.int64(rows[min(i + AHEAD, across - 1)])
        expect(corners, np.int64(ids[ahead, 7] - ID_ZERO))
        lower = grid(load(lists, row), to_bins[0], to_bins[1], to_bins[2], to_bins[3])
        first, last = -lane(lower, axis), -lane(last_cells(lower), axis)
        if max(first + 1, begin) > min(last, end):
            continue
        triangle, size = np.int64(ids[row, 7] - ID_ZERO), 3
        if ids[row, 3] < whole_triangles:
            # Stored whole: a vector load of what was just stored in pieces has to wait.
            for j in range(3):
                store(points, j, load_point(corners, 3 * triangle + j, scale))
        else:
            size = _clipped_triangle(corners, triangle, scale, lists, row, polygon, spare, points)
        if size == 0:
            continue
        p = size - 1
        a = _bin_of(points[p, axis], origin, inverse, first, last)
        for q in range(size):
            b = _bin_of(points[q, axis], origin, inverse, first, last)
            low, high = (p, q) if a < b else (q, p)
            from_plane, to_plane = max(min(a, b) + 1, begin), min(max(a, b), end)
            if from_plane <= to_plane:
                _enter_crossing(
                    points, low, high, axis, from_plane, to_plane, origin, width, room, sections
                )
            p, a = q, b
    for e in range(begin, end + 1):
        for k in range(3):
            x, y = sections[2 * k * room + e], sections[(2 * k + 1) * room + e]
            bin_cut[base + e, k] = min(bin_cut[base + e, k], x)
            bin_cut[base + e, k + 4] = min(bin_cut[base + e, k + 4], y)


@njit(allocates=False)
def _reach_planes(n, count, axis, origin, width, base, bin_cut, begins, ends):
    """Let both sides of each plane that references are across reach to the plane.

    Returns
    -------
    (first, last)
        Planes that references are across; the first above the last if there is none.
    """
    n_left, n_right = 0, n
    first, last = count, 0
    for e in range(1, count):
        n_left += begins[base + e - 1]
        n_right -= ends[base + e - 1]
        if n_left + n_right > n:
            plane = origin + np.float32(e) * width
            bin_cut[base + e, axis] = plane
            bin_cut[base + e, axis + 4] = -plane
            first, last = min(first, e), e
    return first, last


@njit(allocates=False)
def _sweep_planes(
    measure, n, slack, count, base, first, last, limit, bin_box, bin_cut, begins, ends, areas
):
    """Try the planes of one axis from the first to the last.

    Planes that would add more references than there is room for are left out. A side's
    ``A N`` only grows with the side, so where one side alone costs more than the limit, so
    do the planes beyond.

    Returns
    -------
    (cost, plane, first, last)
        The best plane, and the first and last of those that cost less than the limit.
    """
    side = nothing()
    n_right = 0
    for e in range(count - 1, last, -1):
        side = union(side, load(bin_box, base + e))
        n_right += ends[base + e]
    out = first - 1
    for e in range(last, first - 1, -1):
        side = union(side, load(bin_box, base + e))
        n_right += ends[base + e]
        areas[e] = cost_of(measure, union(side, load(bin_cut, base + e)))
        if areas[e] * np.float32(n_right) > limit:
            out = e
            break
    best, at, begin, end = limit, 0, count, 0
    side = nothing()
    n_left, n_right = 0, n
    for e in range(1, last + 1):
        side = union(side, load(bin_box, base + e - 1))
        n_left += begins[base + e - 1]
        n_right -= ends[base + e - 1]
        if e <= out or n_left + n_right == n or n_left + n_right - n > slack:
            continue
        cost = cost_of(measure, union(side, load(bin_cut, base + e))) * np.float32(n_left)
        if cost > limit:
            break
        cost += areas[e] * np.float32(n_right)
        if cost < limit:
            begin, end = min(begin, e), e
        if cost < best:
            best, at = cost, e
    return best, at, begin, end


@njit(allocates=False)
def best_plane(measure, corners, scale, lists, first, n, slack, count, whole, limit, bins):
    """Find the best plane to cut a node at.

    Parameters
    ----------
    measure : None or tuple
        Of boxes; None is the area.
    corners : (N, 3, 3) float32
        The mesh, in scene units.
    scale : float64
        From scene to builder units.
    lists : (6 R, 8) float32
        References, as in :mod:`mibvh.builders.sweep`; ids from N on are parts of triangles.
    first, n : int
        Rows of the node's references, in any order.
    slack : int
        How many references may be added.
    count : int
        Number of bins on each axis.
    whole : (8,) float32
        The node's box.
    limit : float32
        What the plane must cost less than.
    bins : Bins
        Scratch.

    Returns
    -------
    (axis, plane)
        Axis -1: no plane is good enough.
    """
    bin_box, bin_cut, begins, ends, areas = bins.box, bins.cut, bins.begins, bins.ends, bins.area
    most = len(areas)
    origin = (whole[0], whole[1], whole[2])
    extent = (-whole[4] - whole[0], -whole[5] - whole[1], -whole[6] - whole[2])
    _set_frame(origin, extent, count, bins.frame)
    across = _enter_all(
        corners,
        scale,
        lists,
        first,
        n,
        count,
        most,
        bin_box,
        bin_cut,
        begins,
        ends,
        bins.frame,
        bins.polygon,
        bins.spare,
        bins.points,
        bins.rows,
    )
    best, best_axis, best_at = limit, -1, 0
    if across == 0:
        return best_axis, np.float32(0)
    # Bounds of the three axes by corners alone.
    bounds, spans = bins.bounds, bins.spans
    for k in range(3):
        width = extent[k] / np.float32(count)
        low, high = _reach_planes(n, count, k, origin[k], width, k * most, bin_cut, begins, ends)
        bounds[k] = limit
        if low <= high:
            bounds[k], _, spans[k, 0], spans[k, 1] = _sweep_planes(
                measure,
                n,
                slack,
                count,
                k * most,
                low,
                high,
                limit,
                bin_box,
                bin_cut,
                begins,
                ends,
                areas,
            )
    while True:
        k = 0 if bounds[0] <= bounds[1] else 1
        k = k if bounds[k] <= bounds[2] else 2
        if not bounds[k] < best:
            break
        bounds[k] = np.inf
        _chop_all(
            corners,
            scale,
            lists,
            across,
            count,
            most,
            k,
            spans[k, 0],
            spans[k, 1],
            origin[k],
            extent[k],
            bin_cut,
            bins.frame,
            bins.polygon,
            bins.spare,
            bins.points,
            bins.rows,
            bins.sections,
        )
        cost, at, _, _ = _sweep_planes(
            measure,
            n,
            slack,
            count,
            k * most,
            spans[k, 0],
            spans[k, 1],
            best,
            bin_box,
            bin_cut,
            begins,
            ends,
            areas,
        )
        if at > 0:
            best, best_axis, best_at = cost, k, at
    if best_axis < 0:
        return best_axis, np.float32(0)
    width = extent[best_axis] / np.float32(count)
    return best_axis, origin[best_axis] + np.float32(best_at) * width
