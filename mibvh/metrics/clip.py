"""Convex polygons clipped to boxes: what the exact EPO cuts triangles with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit

#: Numbers in a row: a triangle cut by six planes has at most nine corners of three coordinates.
_ROW = 36
#: Without a sign, as indices that Numba takes as they are: those below zero count from the end.
_ONE, _TWO, _THREE, _SIX, _WIDE = (np.uint64(n) for n in (1, 2, 3, 6, _ROW))


class Polygons(NamedTuple):
    """Memory for polygons, one row each. Rows lie end to end: constant strides are faster.

    Attributes
    ----------
    corners : (rows * 36,) float64
        Up to twelve corners.
    limits : (rows * 6,) float64
        Each polygon's box, lower corner first; it may be larger than the polygon.
    count : (rows,) int64
        Corners in use.
    area : (rows,) float64
    """

    corners: Any
    limits: Any
    count: Any
    area: Any


def room(rows: int) -> Polygons:
    """Allocate memory for a number of polygons."""
    return Polygons(
        corners=np.zeros(rows * _ROW),
        limits=np.zeros(rows * 6),
        count=np.zeros(rows, np.int64),
        area=np.zeros(rows),
    )


@njit(allocates=False)
def put_triangle(polygons, row, corners, t):
    """Write a triangle, ``corners[t]``, to a row; return its area."""
    for i in range(3):
        for k in range(3):
            polygons.corners[_ROW * row + 3 * i + k] = corners[t, i, k]
    return measure(polygons, row, 3)


@njit(allocates=False)
def _cut(corners, source, n, target, axis, limit, sign):
    """Clip a convex polygon by an axis plane, keeping ``sign * (x - limit) >= 0``.

    From one row of ``corners`` to another; returns the corner count.
    """
    begin = place = _WIDE * np.uint64(target)
    first = _WIDE * np.uint64(source)
    end = first + _THREE * np.uint64(n)
    last, along = end - _THREE, np.uint64(axis)
    px, py, pz = corners[last], corners[last + _ONE], corners[last + _TWO]
    p = sign * (corners[last + along] - limit)
    for i in range(first, end, _THREE):
        qx, qy, qz = corners[i], corners[i + _ONE], corners[i + _TWO]
        q = sign * (corners[i + along] - limit)
        s = p / (p - q)
        corners[place] = px + s * (qx - px)
        corners[place + _ONE] = py + s * (qy - py)
        corners[place + _TWO] = pz + s * (qz - pz)
        corners[place + along] = limit
        place += _THREE * np.uint64((p >= 0.0) != (q >= 0.0))
        corners[place] = qx
        corners[place + _ONE] = qy
        corners[place + _TWO] = qz
        place += _THREE * np.uint64(q >= 0.0)
        px, py, pz, p = qx, qy, qz, q
    return np.int64((place - begin) // _THREE)


@njit(allocates=False, forceinline=True)
def measure(polygons, row, n):
    """Write the corner count, the box and the area of the polygon in a row; return the area."""
    corners, limits = polygons.corners, polygons.limits
    begin = _WIDE * np.uint64(row)
    x = y = z = 0.0
    ax, ay, az = corners[begin], corners[begin + _ONE], corners[begin + _TWO]
    x0, y0, z0, x1, y1, z1 = ax, ay, az, ax, ay, az
    ux = uy = uz = 0.0
    for i in range(begin + _THREE, begin + _THREE * np.uint64(n), _THREE):
        bx, by, bz = corners[i], corners[i + _ONE], corners[i + _TWO]
        x0, y0, z0 = min(x0, bx), min(y0, by), min(z0, bz)
        x1, y1, z1 = max(x1, bx), max(y1, by), max(z1, bz)
        vx, vy, vz = bx - ax, by - ay, bz - az
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
        ux, uy, uz = vx, vy, vz
    place = _SIX * np.uint64(row)
    limits[place], limits[place + _ONE], limits[place + _TWO] = x0, y0, z0
    place += _THREE
    limits[place], limits[place + _ONE], limits[place + _TWO] = x1, y1, z1
    area = 0.5 * np.sqrt(x * x + y * y + z * z)
    polygons.count[row] = n
    polygons.area[row] = area
    return area


@njit(allocates=False, forceinline=True)
def area_of(polygons, row, n):
    """Return the area of the polygon of ``n`` corners in a row, which is not measured: its bits."""
    corners = polygons.corners
    begin = _WIDE * np.uint64(row)
    x = y = z = 0.0
    ax, ay, az = corners[begin], corners[begin + _ONE], corners[begin + _TWO]
    ux = uy = uz = 0.0
    for i in range(begin + _THREE, begin + _THREE * np.uint64(n), _THREE):
        vx, vy, vz = corners[i] - ax, corners[i + _ONE] - ay, corners[i + _TWO] - az
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
        ux, uy, uz = vx, vy, vz
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@njit(allocates=False, forceinline=True)
def clip(polygons, row, box, node, spare):
    """Clip the polygon in a row by the planes of a node's box that cut the polygon's own box.

    The rows ``spare`` and ``spare + 1`` are written in turn. Returns the row of the result and its
    corner count, which is below three if nothing is left. The result is not measured, unless it
    is the given row.
    """
    # What is left may no longer cross the next planes. The box of the given polygon is used all the
    # same: a clip without effect costs less than measuring the box again.
    limits, given, of_node = polygons.limits, _SIX * np.uint64(row), _SIX * np.uint64(node)
    n = polygons.count[np.uint64(row)]
    for plane in range(6):
        bound = np.float64(box[of_node + np.uint64(plane)])
        if plane < 3:
            if limits[given + np.uint64(plane)] >= bound:
                continue
        elif limits[given + np.uint64(plane)] <= bound:
            continue
        target = spare + 1 if row == spare else spare
        sign = 1.0 if plane < 3 else -1.0
        n = _cut(polygons.corners, row, n, target, plane % 3, bound, sign)
        row = target
        if n < 3:
            break
    return row, n


@njit(allocates=False, forceinline=True)
def touches(limits, row, box, node):
    """Whether the closed box in a row of ``limits`` and that of a node have a point in common."""
    a, b = _SIX * np.uint64(row), _SIX * np.uint64(node)
    c, d = a + _THREE, b + _THREE
    return (
        limits[a] <= box[d]
        and limits[c] >= box[b]
        and limits[a + _ONE] <= box[d + _ONE]
        and limits[c + _ONE] >= box[b + _ONE]
        and limits[a + _TWO] <= box[d + _TWO]
        and limits[c + _TWO] >= box[b + _TWO]
    )


@njit(inline="always")
def lies_in(limits, row, box, node):
    """Whether the closed box in a row of ``limits`` lies in that of a node."""
    a, b = _SIX * np.uint64(row), _SIX * np.uint64(node)
    c, d = a + _THREE, b + _THREE
    return (
        limits[a] >= box[b]
        and limits[c] <= box[d]
        and limits[a + _ONE] >= box[b + _ONE]
        and limits[c + _ONE] <= box[d + _ONE]
        and limits[a + _TWO] >= box[b + _TWO]
        and limits[c + _TWO] <= box[d + _TWO]
    )


@njit(inline="always")
def meets(limits, row, box, node):
    """Whether the polygon with the box in a row of ``limits`` may have an area in a node's box.

    A polygon that ends at a face of the node has an edge or a corner there, but no area: neighbours
    in a mesh do so all the time. One that lies in the face has its whole area there.
    """
    a, b = _SIX * np.uint64(row), _SIX * np.uint64(node)
    c, d = a + _THREE, b + _THREE
    return not (
        _apart(limits[a], limits[c], box[b], box[d])
        or _apart(limits[a + _ONE], limits[c + _ONE], box[b + _ONE], box[d + _ONE])
        or _apart(limits[a + _TWO], limits[c + _TWO], box[b + _TWO], box[d + _TWO])
    )


@njit(inline="always")
def _apart(low, high, least, most):
    """Whether an interval has no length in another; for a point, whether it lies outside."""
    return not (low < most and high > least) and (low != high or low > most or high < least)
