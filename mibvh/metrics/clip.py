"""Convex polygons clipped to boxes: what the exact EPO cuts triangles with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit

#: A triangle cut by six planes has at most nine corners.
_CORNERS = 10


class Polygons(NamedTuple):
    """Room for polygons, a row each.

    Attributes
    ----------
    corners : (rows, 10, 3) float64
    limits : (rows, 6) float64
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
    """Return room for so many polygons."""
    return Polygons(
        corners=np.zeros((rows, _CORNERS, 3)),
        limits=np.zeros((rows, 6)),
        count=np.zeros(rows, np.int64),
        area=np.zeros(rows),
    )


@njit(inline="always")
def _cut(corners, source, n, target, axis, limit, sign):
    """Clip a convex polygon by an axis plane, keeping ``sign * (x - limit) >= 0``.

    From one row of ``corners`` to another; returns the corner count.
    """
    m = 0
    px, py, pz = corners[source, n - 1, 0], corners[source, n - 1, 1], corners[source, n - 1, 2]
    p = sign * (corners[source, n - 1, axis] - limit)
    for i in range(n):
        qx, qy, qz = corners[source, i, 0], corners[source, i, 1], corners[source, i, 2]
        q = sign * (corners[source, i, axis] - limit)
        if (p >= 0.0) != (q >= 0.0):
            s = p / (p - q)
            corners[target, m, 0] = px + s * (qx - px)
            corners[target, m, 1] = py + s * (qy - py)
            corners[target, m, 2] = pz + s * (qz - pz)
            corners[target, m, axis] = limit
            m += 1
        if q >= 0.0:
            corners[target, m, 0] = qx
            corners[target, m, 1] = qy
            corners[target, m, 2] = qz
            m += 1
        px, py, pz, p = qx, qy, qz, q
    return m


@njit(inline="always")
def measure(polygons, row, n):
    """Write the corner count, the box and the area of the polygon in a row; return the area."""
    corners, limits = polygons.corners, polygons.limits
    x = y = z = 0.0
    ax, ay, az = corners[row, 0, 0], corners[row, 0, 1], corners[row, 0, 2]
    x0, y0, z0, x1, y1, z1 = ax, ay, az, ax, ay, az
    ux = uy = uz = 0.0
    for i in range(1, n):
        bx, by, bz = corners[row, i, 0], corners[row, i, 1], corners[row, i, 2]
        x0, y0, z0 = min(x0, bx), min(y0, by), min(z0, bz)
        x1, y1, z1 = max(x1, bx), max(y1, by), max(z1, bz)
        vx, vy, vz = bx - ax, by - ay, bz - az
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
        ux, uy, uz = vx, vy, vz
    limits[row, 0], limits[row, 1], limits[row, 2] = x0, y0, z0
    limits[row, 3], limits[row, 4], limits[row, 5] = x1, y1, z1
    area = 0.5 * np.sqrt(x * x + y * y + z * z)
    polygons.count[row] = n
    polygons.area[row] = area
    return area


@njit(inline="always")
def clip(polygons, row, box, node, spare):
    """Clip the polygon in a row by the planes of a node's box that cut the polygon's own box.

    The rows ``spare`` and ``spare + 1`` are written in turn. Returns the row that holds the
    result, unmeasured unless it is the one given, and its corner count, below three for nothing
    left.
    """
    corners, limits = polygons.corners, polygons.limits
    n = polygons.count[row]
    for plane in range(6):
        k = plane % 3
        if plane < 3:
            if limits[row, k] >= box[node, k]:
                continue
        elif limits[row, k + 3] <= box[node, k + 3]:
            continue
        target = spare + 1 if row == spare else spare
        sign = 1.0 if plane < 3 else -1.0
        n = _cut(corners, row, n, target, k, np.float64(box[node, plane]), sign)
        if n < 3:
            return target, n
        # The box of what is left may no longer cross the next planes; the old one is kept, as
        # cutting in vain costs less than measuring.
        for i in range(6):
            limits[target, i] = limits[row, i]
        row = target
    return row, n


@njit(inline="always")
def touches(limits, row, box, node):
    """Whether the closed box in a row of ``limits`` and that of a node have a point in common."""
    return (
        limits[row, 0] <= box[node, 3]
        and limits[row, 3] >= box[node, 0]
        and limits[row, 1] <= box[node, 4]
        and limits[row, 4] >= box[node, 1]
        and limits[row, 2] <= box[node, 5]
        and limits[row, 5] >= box[node, 2]
    )
