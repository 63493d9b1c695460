"""Convex polygons clipped to boxes: what the exact EPO cuts triangles with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit

#: Numbers in a row: a triangle cut by six planes has at most nine corners of three coordinates.
_ROW = 36


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
    begin = place = _ROW * target
    last = _ROW * source + 3 * n - 3
    px, py, pz = corners[last], corners[last + 1], corners[last + 2]
    p = sign * (corners[last + axis] - limit)
    for i in range(_ROW * source, last + 3, 3):
        qx, qy, qz = corners[i], corners[i + 1], corners[i + 2]
        q = sign * (corners[i + axis] - limit)
        s = p / (p - q)
        corners[place] = px + s * (qx - px)
        corners[place + 1] = py + s * (qy - py)
        corners[place + 2] = pz + s * (qz - pz)
        corners[place + axis] = limit
        place += 3 * ((p >= 0.0) != (q >= 0.0))
        corners[place] = qx
        corners[place + 1] = qy
        corners[place + 2] = qz
        place += 3 * (q >= 0.0)
        px, py, pz, p = qx, qy, qz, q
    return (place - begin) // 3


@njit(inline="always")
def measure(polygons, row, n):
    """Write the corner count, the box and the area of the polygon in a row; return the area."""
    corners, limits = polygons.corners, polygons.limits
    begin = _ROW * row
    x = y = z = 0.0
    ax, ay, az = corners[begin], corners[begin + 1], corners[begin + 2]
    x0, y0, z0, x1, y1, z1 = ax, ay, az, ax, ay, az
    ux = uy = uz = 0.0
    for i in range(begin + 3, begin + 3 * n, 3):
        bx, by, bz = corners[i], corners[i + 1], corners[i + 2]
        x0, y0, z0 = min(x0, bx), min(y0, by), min(z0, bz)
        x1, y1, z1 = max(x1, bx), max(y1, by), max(z1, bz)
        vx, vy, vz = bx - ax, by - ay, bz - az
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
        ux, uy, uz = vx, vy, vz
    place = 6 * row
    limits[place], limits[place + 1], limits[place + 2] = x0, y0, z0
    limits[place + 3], limits[place + 4], limits[place + 5] = x1, y1, z1
    area = 0.5 * np.sqrt(x * x + y * y + z * z)
    polygons.count[row] = n
    polygons.area[row] = area
    return area


@njit(inline="always")
def clip(polygons, row, box, node, spare):
    """Clip the polygon in a row by the planes of a node's box that cut the polygon's own box.

    The rows ``spare`` and ``spare + 1`` are written in turn. Returns the row of the result and its
    corner count, which is below three if nothing is left. The result is not measured, unless it
    is the given row.
    """
    # What is left may no longer cross the next planes. The box of the given polygon is used all the
    # same: a clip without effect costs less than measuring the box again.
    limits, given = polygons.limits, 6 * row
    n = polygons.count[row]
    for plane in range(6):
        bound = np.float64(box[6 * node + plane])
        if plane < 3:
            if limits[given + plane] >= bound:
                continue
        elif limits[given + plane] <= bound:
            continue
        target = spare + 1 if row == spare else spare
        sign = 1.0 if plane < 3 else -1.0
        n = _cut(polygons.corners, row, n, target, plane % 3, bound, sign)
        row = target
        if n < 3:
            break
    return row, n


@njit(inline="always")
def touches(limits, row, box, node):
    """Whether the closed box in a row of ``limits`` and that of a node have a point in common."""
    a, b = 6 * row, 6 * node
    return (
        limits[a] <= box[b + 3]
        and limits[a + 3] >= box[b]
        and limits[a + 1] <= box[b + 4]
        and limits[a + 4] >= box[b + 1]
        and limits[a + 2] <= box[b + 5]
        and limits[a + 5] >= box[b + 2]
    )
