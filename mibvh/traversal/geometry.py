"""What every traversal kernel computes with a ray: box distances and triangle hits."""

from __future__ import annotations

from typing import Any

import drjit as dr

from mibvh.variant import mitsuba

#: Directions nearer to zero than this are moved to it, so that no slab distance is 0 * inf.
_TINY = 2.0**-80
#: Rounding of the slab distances, at most three half ulps, must not lose a box that is just
#: touched (Ize: Robust BVH Ray Traversal, JCGT 2013).
_OUTWARD = 1.0 + 2.0**-21


def inverse(d: Any) -> Any:
    """Component-wise 1 / d, finite where a component is zero."""
    mi = mitsuba()
    tiny = mi.Float(_TINY)
    return mi.Vector3f(
        [1 / dr.select(dr.abs(c) < tiny, dr.copysign(tiny, c), c) for c in (d.x, d.y, d.z)]
    )


def slabs(row: Any, at: int, o: Any, inv: Any) -> tuple[Any, Any]:
    """Where a ray enters and leaves the closed box whose corners stand at ``row[at:at + 6]``."""
    corners = [row[at + i] for i in range(6)]
    return slabs_of(corners[:3], corners[3:], o, inv)


def slabs_of(lower: Any, upper: Any, o: Any, inv: Any) -> tuple[Any, Any]:
    """Where a ray enters and leaves the closed box of these corners."""
    ax, bx = (lower[0] - o.x) * inv.x, (upper[0] - o.x) * inv.x
    ay, by = (lower[1] - o.y) * inv.y, (upper[1] - o.y) * inv.y
    az, bz = (lower[2] - o.z) * inv.z, (upper[2] - o.z) * inv.z
    near = larger(larger(smaller(ax, bx), smaller(ay, by)), larger(smaller(az, bz), 0.0))
    far = smaller(smaller(larger(ax, bx), larger(ay, by)), larger(az, bz))
    return near, far * _OUTWARD


def triangle_hit(row: Any, o: Any, d: Any, t: Any) -> tuple[Any, Any]:
    """Whether a ray hits the triangle in ``row`` before ``t``, and where.

    Three edges are seen along the ray. An edge's value in the one triangle is exactly minus
    that in its neighbour, so that no ray slips between them. The plane's normal is the
    triangle's own, so that its size cancels.
    """
    ax, ay, az = row[0] - o.x, row[1] - o.y, row[2] - o.z
    bx, by, bz = row[3] - o.x, row[4] - o.y, row[5] - o.z
    cx, cy, cz = row[6] - o.x, row[7] - o.y, row[8] - o.z
    u = _triple(d, cx, cy, cz, bx, by, bz)
    v = _triple(d, ax, ay, az, cx, cy, cz)
    w = _triple(d, bx, by, bz, ax, ay, az)
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    at = (row[9] * ax + row[10] * ay + row[11] * az) / (
        row[9] * d.x + row[10] * d.y + row[11] * d.z
    )
    return inside & (at >= 0) & (at < t), at


def _triple(d: Any, ax: Any, ay: Any, az: Any, bx: Any, by: Any, bz: Any) -> Any:
    """Twice ``d . (a x b)``, rounded such that exchanging a and b changes the sign alone.

    Computed as ``d . ((a + b) x (b - a))``: a x b itself is the small difference of large
    products where the edge is short and far away.
    """
    sx, sy, sz = ax + bx, ay + by, az + bz
    ex, ey, ez = bx - ax, by - ay, bz - az
    return d.x * (sy * ez - sz * ey) + (d.y * (sz * ex - sx * ez) + d.z * (sx * ey - sy * ex))


def smaller(a: Any, b: Any) -> Any:
    """Minimum by comparison.

    ``dr.minimum`` propagates NaN, which LLVM 15 cannot select on AVX-512 machines and others do
    slowly.
    """
    return dr.select(a < b, a, b)


def larger(a: Any, b: Any) -> Any:
    """Maximum by comparison."""
    return dr.select(a > b, a, b)
