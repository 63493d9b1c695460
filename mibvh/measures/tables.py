"""Summed tables: how many of a set of segments touch a box, in constant time.

A segment touches a closed box either because it starts in it or because it enters it, and a
convex box is entered once at most, through one of its six faces. So the share of segments that
touch a box is a sum of seven counts: of starts in a box, and of crossings of a rectangle, for
each face. With P planes per axis, seven tables summed along their axes give any such count for
a box between planes from its eight corners, like a summed-area table.

The seven come to one number for each of the eight corners: with the signs of inclusion and
exclusion, corner c of a box adds::

    T_c = s_x s_y s_z S + s_y s_z E_x(c_x) + s_x s_z E_y(c_y) + s_x s_y E_z(c_z)

where ``s`` is -1 at the lower and +1 at the upper side of an axis, ``S`` counts the starts below
the corner on all axes, and ``E_x(lower)`` (``E_x(upper)``) the segments that cross the plane at
the corner towards positive (negative) x with the other two coordinates below it. Eight tables of
one number each, side by side: a query reads eight times eight of them, where the seven tables
would take 256.

Between planes, each coordinate is interpolated linearly. The result is the mean, over the boxes
that come of moving each face to the plane below or above it, of exact counts, and so lies
between the counts of the box inside and the box outside whose faces are on planes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.triangles import F32, F64

#: Cells per axis of the lookup from a coordinate to the plane below it.
CELLS = 4096


class FluxTables(NamedTuple):
    """What the compiled measure reads.

    Attributes
    ----------
    table : (P * P * P * 8,) float32
        ``T_c`` at each crossing of three planes; whole numbers.
    planes : (3 * P,) float32
        In builder units, rising along each axis.
    inverse : (3 * P,) float32
        One over the distance to the next plane.
    cells : (3 * CELLS,) int32
        The last plane at or below the beginning of each cell of equal size; 0 for the first.
    lookup : (6,) float32
        Origin of the cells of each axis, and cells per unit.
    per_axis : int
        P.
    area_weight, share_weight : float
        The measure is the first times half the area plus the second times the number of
        segments that touch the box.
    """

    table: F32
    planes: F32
    inverse: F32
    cells: Any
    lookup: F32
    per_axis: int
    area_weight: float
    share_weight: float


@njit(allocates=False)
def _plane_below(tables, axis, value):
    """Last plane at or below a coordinate, but the last of all, and how far it is to the next."""
    count = tables.per_axis
    at = (value - tables.lookup[axis]) * tables.lookup[axis + 3]
    cell = np.int64(min(max(at, np.float32(0)), np.float32(CELLS - 1)))
    plane = np.int64(tables.cells[axis * CELLS + cell])
    first = axis * count
    while plane < count - 2 and tables.planes[first + plane + 1] <= value:
        plane += 1
    # A rounding may have put the coordinate into the next cell.
    while plane > 0 and tables.planes[first + plane] > value:
        plane -= 1
    beyond = np.float64(value) - np.float64(tables.planes[first + plane])
    share = beyond * tables.inverse[first + plane]
    return plane, min(max(share, 0.0), 1.0)


@njit(allocates=False)
def _along_z(table, row, w):
    low = np.float64(table[row])
    return low + w * (np.float64(table[row + np.uint64(8)]) - low)


@njit(allocates=False)
def _at_corner(table, row, step_x, step_y, u, v, w):
    """Interpolate one table between eight crossings."""
    a = _along_z(table, row, w)
    b = _along_z(table, row + step_y, w)
    c = _along_z(table, row + step_x, w)
    d = _along_z(table, row + step_x + step_y, w)
    low = a + v * (b - a)
    return low + u * (c + v * (d - c) - low)


@njit(allocates=False)
def touched(tables, x0, y0, z0, x1, y1, z1):
    """Count the segments that touch a box; float64, interpolated between planes."""
    i0, u0 = _plane_below(tables, 0, x0)
    i1, u1 = _plane_below(tables, 0, x1)
    j0, v0 = _plane_below(tables, 1, y0)
    j1, v1 = _plane_below(tables, 1, y1)
    k0, w0 = _plane_below(tables, 2, z0)
    k1, w1 = _plane_below(tables, 2, z1)
    table = tables.table
    step_y = np.uint64(8 * tables.per_axis)
    step_x = step_y * np.uint64(tables.per_axis)
    x_low, x_high = np.uint64(i0) * step_x, np.uint64(i1) * step_x
    y_low, y_high = np.uint64(j0) * step_y, np.uint64(j1) * step_y
    z_low, z_high = np.uint64(8 * k0), np.uint64(8 * k1)
    total = _at_corner(table, x_low + y_low + z_low, step_x, step_y, u0, v0, w0)
    total += _at_corner(table, x_low + y_low + z_high + np.uint64(1), step_x, step_y, u0, v0, w1)
    total += _at_corner(table, x_low + y_high + z_low + np.uint64(2), step_x, step_y, u0, v1, w0)
    total += _at_corner(table, x_low + y_high + z_high + np.uint64(3), step_x, step_y, u0, v1, w1)
    total += _at_corner(table, x_high + y_low + z_low + np.uint64(4), step_x, step_y, u1, v0, w0)
    total += _at_corner(table, x_high + y_low + z_high + np.uint64(5), step_x, step_y, u1, v0, w1)
    total += _at_corner(table, x_high + y_high + z_low + np.uint64(6), step_x, step_y, u1, v1, w0)
    total += _at_corner(table, x_high + y_high + z_high + np.uint64(7), step_x, step_y, u1, v1, w1)
    return max(total, 0.0)


@njit(allocates=False)
def touched_share(tables, x0, y0, z0, x1, y1, z1):
    """Measure of a box: weighted half area plus weighted count of segments that touch it."""
    x = np.float64(x1) - np.float64(x0)
    y = np.float64(y1) - np.float64(y0)
    z = np.float64(z1) - np.float64(z0)
    area = x * y + (x + y) * z
    return tables.area_weight * area + tables.share_weight * touched(tables, x0, y0, z0, x1, y1, z1)


# ------------------------------------------------------------------ making them


@njit(allocates=False)
def _not_below(planes, value):
    """Index of the first plane that is not below a value."""
    low, high = 0, len(planes)
    while low < high:
        middle = (low + high) >> 1
        if planes[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@njit
def _count_starts(planes, start, counts):
    """Count starts by the first plane not below them, on each axis: (P, P, P) int32."""
    for r in range(len(start)):
        i = _not_below(planes[0], start[r, 0])
        j = _not_below(planes[1], start[r, 1])
        k = _not_below(planes[2], start[r, 2])
        counts[i, j, k] += 1


@njit
def _count_crossings(planes, start, end, axis, counts):
    """Count crossings of the planes of one axis.

    Fills (2, P, P, P) int32: towards the positive and towards the negative side, by the planes on
    x, y and z: the crossed one, and the first not below the crossing on the other two axes.
    """
    b, c = (axis + 1) % 3, (axis + 2) % 3
    place = np.empty(3, np.int64)
    for r in range(len(start)):
        first = _not_below(planes[axis], start[r, axis])
        last = _not_below(planes[axis], end[r, axis])
        side = 0 if first <= last else 1
        x, y, z = np.float64(start[r, axis]), np.float64(start[r, b]), np.float64(start[r, c])
        length = np.float64(end[r, axis]) - x
        slope_y = (np.float64(end[r, b]) - y) / length
        slope_z = (np.float64(end[r, c]) - z) / length
        for p in range(min(first, last), max(first, last)):
            along = np.float64(planes[axis, p]) - x
            place[axis] = p
            place[b] = _not_below(planes[b], y + along * slope_y)
            place[c] = _not_below(planes[c], z + along * slope_z)
            counts[side, place[0], place[1], place[2]] += 1


def summed_tables(planes: F32, start: F32, end: F32) -> F32:
    """Make the table of the eight corners.

    Parameters
    ----------
    planes : (3, P) float32
        Rising along each axis; the first and last must leave no start, nor end, outside.
    start, end : (R, 3) float32
        The segments; R up to four millions, so that every count is exact in float32.

    Returns
    -------
    (P * P * P * 8,) float32
        Whole numbers. A start on a plane counts as below it.
    """
    size = planes.shape[1]
    table = np.zeros((size, size, size, 8), np.float32)
    signs = 2 * ((np.arange(8)[:, None] >> np.array([2, 1, 0])) & 1) - 1  # (corner, axis)
    counts = np.zeros((size, size, size), np.int32)
    _count_starts(planes, start, counts)
    for axis in range(3):
        np.cumsum(counts, axis=axis, out=counts)
    for corner in range(8):
        table[..., corner] = int(signs[corner].prod()) * counts
    for axis in range(3):
        crossings = np.zeros((2, size, size, size), np.int32)
        _count_crossings(planes, start, end, axis, crossings)
        others = [k for k in range(3) if k != axis]
        for k in others:
            np.cumsum(crossings, axis=k + 1, out=crossings)
        for corner in range(8):
            # The lower face is entered towards the positive side.
            side = 0 if signs[corner, axis] < 0 else 1
            table[..., corner] += int(signs[corner, others].prod()) * crossings[side]
    return table.reshape(-1)


def lookup_of(planes: F32) -> tuple[np.ndarray, F32]:
    """Make the lookup from coordinates to planes: ``cells`` and ``lookup`` of the tables."""
    origin = planes[:, 0].astype(np.float64)
    width = np.maximum(planes[:, -1].astype(np.float64) - origin, 1e-30)
    lookup = np.concatenate([origin, CELLS / width]).astype(np.float32)
    cells = np.empty((3, CELLS), np.int32)
    for axis in range(3):
        begins = origin[axis] + np.arange(CELLS) * (width[axis] / CELLS)
        below = np.searchsorted(planes[axis].astype(np.float64), begins, side="right") - 1
        cells[axis] = np.clip(below, 0, planes.shape[1] - 2)
    return cells.reshape(-1), lookup


def box_area(bounds: F64) -> float:
    """Half the surface area of the box between two corners: (2, 3) float64."""
    x, y, z = (bounds[1] - bounds[0]).tolist()
    return float(x * y + y * z + z * x)
