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
would take 256 (:mod:`mibvh.measures.lookup`).

Between planes, each coordinate is interpolated linearly. The result is the mean, over the boxes
that come of moving each face to the plane below or above it, of exact counts, and so lies
between the counts of the box inside and the box outside whose faces are on planes.
"""

from __future__ import annotations

import numpy as np

from mibvh._jit import njit
from mibvh.measures.lookup import CELLS
from mibvh.triangles import F32, F64, I32

#: What rounding moves a coordinate by at most, in cells: three times half a step of float32, of
#: CELLS, is a third of it.
_ROUNDED = 2e-3


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


@njit(allocates=False)
def _walked(planes, value, at):
    """Find what :func:`_not_below` does, from a place nearby."""
    while at < len(planes) and planes[at] < value:
        at += 1
    while at > 0 and not planes[at - 1] < value:
        at -= 1
    return at


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
    place = np.zeros(3, np.int64)
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
            place[b] = _walked(planes[b], y + along * slope_y, place[b])
            place[c] = _walked(planes[c], z + along * slope_z, place[c])
            counts[side, place[0], place[1], place[2]] += 1


@njit
def _add(lower, upper, signs, table):
    """Add counts to the corners: of one table at lower sides of an axis, another at upper ones."""
    size = len(lower)
    for i in range(size):
        for j in range(size):
            for k in range(size):
                for corner in range(8):
                    count = lower[i, j, k] if signs[corner, 0] < 0 else upper[i, j, k]
                    table[i, j, k, corner, 0] += np.float32(signs[corner, 1] * count)


@njit
def _pair(table):
    """Put the number at the next plane on z beside each."""
    size = len(table)
    for i in range(size):
        for j in range(size):
            for k in range(size):
                above = min(k + 1, size - 1)
                for corner in range(8):
                    table[i, j, k, corner, 1] = table[i, j, above, corner, 0]


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
    (P * P * P * 16,) float32
        Whole numbers: for each corner of a box the one at this crossing of planes, and that at
        the next plane on z. A start on a plane counts as below it.
    """
    size = planes.shape[1]
    table = np.zeros((size, size, size, 8, 2), np.float32)
    signs = 2 * ((np.arange(8)[:, None] >> np.array([2, 1, 0])) & 1) - 1  # (corner, axis)
    starts = np.zeros((size, size, size), np.int32)
    _count_starts(planes, start, starts)
    for axis in range(3):
        np.cumsum(starts, axis=axis, out=starts)
    product = signs.prod(axis=1)
    _add(starts, starts, np.stack([product, product], axis=1), table)
    for axis in range(3):
        crossings = np.zeros((2, size, size, size), np.int32)
        _count_crossings(planes, start, end, axis, crossings)
        for k in range(3):
            if k != axis:
                np.cumsum(crossings, axis=k + 1, out=crossings)
        # The lower face is entered towards the positive side.
        side = signs[:, axis]
        _add(crossings[0], crossings[1], np.stack([side, side * product], axis=1), table)
    _pair(table)
    return table.reshape(-1)


def lookup_of(planes: F32) -> tuple[I32, F32, F32]:
    """Make the lookup from coordinates to planes: ``cells``, ``lookup`` and ``above``."""
    count = planes.shape[1]
    origin = planes[:, 0].astype(np.float64)
    width = np.maximum(planes[:, -1].astype(np.float64) - origin, 1e-30)
    lookup = np.concatenate([origin, CELLS / width]).astype(np.float32)
    cells = np.empty((3, CELLS), np.int32)
    for axis in range(3):
        # From a little before each cell: a rounding may have put a coordinate into the next one.
        begins = origin[axis] + (np.arange(CELLS) - _ROUNDED) * (width[axis] / CELLS)
        below = np.searchsorted(planes[axis].astype(np.float64), begins, side="right") - 1
        cells[axis] = np.clip(below, 0, count - 2) + axis * count
    above = np.full_like(planes, np.nan)
    above[:, : count - 2] = planes[:, 1 : count - 1]
    return cells.reshape(-1), lookup, above.reshape(-1)


def box_area(bounds: F64) -> float:
    """Half the surface area of the box between two corners: (2, 3) float64."""
    x, y, z = (bounds[1] - bounds[0]).tolist()
    return float(x * y + y * z + z * x)
