"""Origins of rays that leave a triangle: clear of it, and no farther than they must be.

A ray hits the triangle that it leaves where rounding puts its origin on the wrong side of the
plane, or leaves it so near that a kernel cannot tell. Both are bounded, as for ``spawn_ray`` in
pbrt-v4 (section 6.8, "Managing Rounding Error"), by what is rounded:

- *Position.* The point of the triangle is computed in float64, from the triangle's corners. How
  far the camera was does not count: it can only move the point within the triangle. Storing the
  origin in float32 moves it by at most half a step of each coordinate.
- *Triangle.* The kernels see the corners from the origin. Seen from so near, these are no longer
  than the triangle, and the subtractions exact but for their own rounding: what the distance from
  the plane is off by goes with the size of the triangle, not with its coordinates. Some kernels
  take the normal from the float32 edges; its error goes with the products of the edges, which for
  a sliver are much larger than its area.

The origin is moved along the normal of the plane by the bound of the triangle, and, where
storing it would take it nearer again, by that of the position too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.surface import on_surface
from mibvh.traversal.geometry import larger
from mibvh.triangles import F32, I32, Triangles
from mibvh.variant import mitsuba

#: Half a step of float32 at 1: the largest relative error of one rounding.
_HALF_STEP = 2.0**-24
#: Roundings on the way to the distance from the plane: of corner, normal, product, and two sums
#: (3 more where the normal comes from the edges, each of whose products counts twice), and a
#: third on top for their products.
_ROUNDINGS = 8
#: Where all of that is exact, as on axis-aligned planes, a step of the triangle's size remains:
#: an origin in the plane is hit at distance 0.
_LEAST = 1.0
#: Fewer steps of float32 than this along the scene's diagonal, and there is no use in tracing
#: rays: an origin next to a surface is as far from it as the scene is fine.
FEWEST_STEPS = 1024


def check_resolution(triangles: Triangles) -> None:
    """Refuse scenes so far from the origin that float32 cannot tell their places apart.

    Raises
    ------
    MibvhError
        If the diagonal has less than :data:`FEWEST_STEPS` steps of float32.
    """
    reach = np.abs(triangles.bounds).max()
    step = float(np.spacing(reach))
    if triangles.diagonal < FEWEST_STEPS * step:
        raise MibvhError(
            f"{triangles.name}: float32 has steps of {step:.3g} where its coordinates are "
            f"({float(reach):.3g}), too coarse for a scene of size {triangles.diagonal:.3g}: move "
            "it towards the origin"
        )


def corners_of(corners: Any, triangle: Any, active: Any = True) -> tuple[Any, Any, Any]:
    """Three corners of a triangle per lane, in float64.

    Parameters
    ----------
    corners : Float
        Coordinates of all triangles, nine each.
    triangle : UInt32
    active : Bool

    Returns
    -------
    a, b, c : Point3d
    """
    import drjit as dr

    mi = mitsuba()
    a, b, c = (
        mi.Point3d(dr.gather(mi.Point3f, corners, triangle * 3 + i, active)) for i in range(3)
    )
    return a, b, c


def point_at(a: Any, b: Any, c: Any, u: Any, v: Any) -> Any:
    """Point of a triangle, from the barycentric coordinates of a hit, drawn into it."""
    import drjit as dr

    mi = mitsuba()
    u, v = (dr.select(x > 0, mi.Float64(x), 0) for x in (u, v))  # 0 for NaN too
    over = dr.select(u + v > 1, u + v, 1)
    u, v = u / over, v / over
    return a + (b - a) * u + (c - a) * v


def onto_plane(a: Any, b: Any, c: Any, point: Any) -> Any:
    """Point3d: a point that lies near a triangle, moved into its plane."""
    import drjit as dr

    normal = dr.cross(b - a, c - a)
    squared = dr.squared_norm(normal)
    off = dr.select(squared > 0, dr.dot(normal, point - a) / squared, 0)
    return point - normal * off


def clear_origin(a: Any, b: Any, c: Any, point: Any, towards: Any) -> tuple[Any, Any]:
    """Move points of triangles off them, to the side that a direction points to.

    Parameters
    ----------
    a, b, c : Point3d
        Corners, float32 numbers.
    point : Point3d
        On the triangle, up to float64 roundings.
    towards : Vector3d
        Of any length.

    Returns
    -------
    origin : Point3f
        In float32, and as such clear of the triangle: see the module's text.
    normal : Vector3d
        The triangle's, of unit length, on that side; 0 for a triangle without area.
    """
    import drjit as dr

    mi = mitsuba()
    edges = _largest(dr.abs(b - a), dr.abs(c - a), dr.abs(c - b))
    normal = dr.cross(b - a, c - a)
    length = dr.norm(normal)
    unit = normal * dr.select(length > 0, 1 / length, 0)
    unit = dr.select(dr.dot(unit, towards) < 0, -unit, unit)
    reach = _largest(dr.abs(point - a), dr.abs(point - b), dr.abs(point - c))
    of_edges = mi.Vector3d(edges.y * edges.z, edges.z * edges.x, edges.x * edges.y)
    bound = _ROUNDINGS * (
        dr.dot(dr.abs(unit), reach) + dr.select(length > 0, dr.dot(of_edges, reach) / length, 0)
    )
    distance = _HALF_STEP * (bound + _LEAST * _largest(edges.x, edges.y, edges.z))
    near = mi.Point3f(point + unit * distance)
    # Rounded to float32, it may be nearer than that.
    position = _HALF_STEP * dr.dot(dr.abs(unit), dr.abs(point) + distance)
    far = mi.Point3f(point + unit * (distance + 1.01 * position))
    is_clear = dr.dot(unit, mi.Point3d(near) - point) >= distance
    return dr.select(is_clear, near, far), unit


def _largest(a: Any, b: Any, c: Any) -> Any:
    """Greatest of three, component by component."""
    return larger(larger(a, b), c)


def clear_origins(triangles: Triangles, ids: I32, points: Any, directions: F32) -> F32:
    """Put origins of rays, that lie on triangles up to roundings, clear of these.

    Parameters
    ----------
    triangles : Triangles
    ids : (R,) int32
        The triangle that each ray leaves.
    points : (R, 3) float
        On the triangles, up to roundings.
    directions : (R, 3) float32

    Returns
    -------
    (R, 3) float32
        On the side of the triangle that the ray leaves to; see :func:`clear_origin`.
    """
    if not len(ids):
        return np.zeros((0, 3), np.float32)
    mi = mitsuba()
    corners = mi.Float(triangles.corners.ravel())
    at = mi.Point3d(np.ascontiguousarray(on_surface(triangles, points, ids).T))
    towards = mi.Vector3d(np.ascontiguousarray(directions.T.astype(np.float64)))
    abc = corners_of(corners, mi.UInt32(ids.astype(np.uint32)))
    return np.array(clear_origin(*abc, at, towards)[0], dtype=np.float32).T.copy()
