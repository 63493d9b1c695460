"""Hits by paths that share no code with the kernels: brute force in float64, and Mitsuba."""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh._jit import njit
from mibvh.audit.record import Check
from mibvh.rays import RaySet
from mibvh.traversal.trace import Hits
from mibvh.triangles import F32, I32, Triangles
from mibvh.variant import mitsuba

#: Tests of a ray against a triangle that brute force may take.
_BRUTE_FORCE = 1e7
#: Rays that brute force follows at most, and that Mitsuba intersects.
_BRUTE_FORCE_RAYS, _MITSUBA_RAYS = 256, 16_384
#: A hit this far inside a triangle, in barycentric coordinates, cannot be missed by rounding;
#: one this far outside cannot be a hit.
_INSIDE, _OUTSIDE = 1e-3, -1e-2
#: Rounding of a distance, relative to the distance and to the largest coordinate.
_FAR, _NEAR = 1e-4, 1e-5


def wrong_hits(triangles: Triangles, rays: RaySet, t: F32, triangle: I32) -> np.ndarray:
    """Judge hits by brute force over all triangles, in float64.

    A hit is wrong if it is no point of its triangle, or if the ray meets another triangle clearly
    before it. Where a ray grazes an edge or a surface, both outcomes are right.

    Parameters
    ----------
    triangles : Triangles
    rays : RaySet
    t : (R,) float32
        Distances; infinite for a miss.
    triangle : (R,) int32
        Triangles hit; -1 for a miss.

    Returns
    -------
    (R,) bool
    """
    return _wrong(
        triangles.corners,
        rays.o,
        rays.d,
        rays.tmax,
        t,
        triangle,
        float(np.abs(triangles.bounds).max()),
    )


@njit(inline="always")
def _meet(corners, i, o, d):
    """Where a ray meets a triangle's plane, how far inside, and by how much it grazes.

    Moeller and Trumbore's test in float64. Returns the distance, the smallest barycentric
    coordinate, and the cosine between ray and normal; an infinite distance for parallel ones.
    """
    ax, ay, az = (
        np.float64(corners[i, 0, 0]),
        np.float64(corners[i, 0, 1]),
        np.float64(corners[i, 0, 2]),
    )
    ux, uy, uz = corners[i, 1, 0] - ax, corners[i, 1, 1] - ay, corners[i, 1, 2] - az
    vx, vy, vz = corners[i, 2, 0] - ax, corners[i, 2, 1] - ay, corners[i, 2, 2] - az
    px, py, pz = d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx
    determinant = ux * px + uy * py + uz * pz
    if determinant == 0.0:
        return np.inf, -1.0, 0.0
    sx, sy, sz = o[0] - ax, o[1] - ay, o[2] - az
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    u = (sx * px + sy * py + sz * pz) / determinant
    v = (d[0] * qx + d[1] * qy + d[2] * qz) / determinant
    t = (vx * qx + vy * qy + vz * qz) / determinant
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(nx * nx + ny * ny + nz * nz) * np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return t, min(u, v, 1.0 - u - v), abs(determinant) / length if length > 0.0 else 0.0


@njit
def _wrong(corners, origins, directions, tmax, distance, triangle, scale):
    """(R,) bool: whether each ray's hit is wrong."""
    wrong = np.zeros(len(origins), np.bool_)
    o, d = np.empty(3), np.empty(3)
    for ray in range(len(origins)):
        speed = 0.0
        for k in range(3):
            o[k], d[k] = origins[ray, k], directions[ray, k]
            speed += d[k] * d[k]
        slack = _NEAR * scale / np.sqrt(speed)
        end = min(np.float64(distance[ray]), np.float64(tmax[ray]))
        if triangle[ray] >= 0:
            t, inside, cosine = _meet(corners, triangle[ray], o, d)
            near = (_FAR * abs(t) + slack) / max(cosine, 1e-6)
            # A triangle seen from its edge has no definite distance.
            if cosine > 1e-4 and (abs(t - distance[ray]) > near or inside < _OUTSIDE):
                wrong[ray] = True
        for i in range(len(corners)):
            t, inside, cosine = _meet(corners, i, o, d)
            if inside < _INSIDE or cosine < 1e-3 or i == triangle[ray]:
                continue
            near = (_FAR * abs(t) + slack) / cosine
            if near < t < end - near:
                wrong[ray] = True
                break
    return wrong


def some_rays(count: int, wanted: int, seed: int = 0) -> np.ndarray:
    """Draw indices of rays, in order, without repetition."""
    chosen = np.random.default_rng([seed, 21]).permutation(count)[:wanted]
    return np.sort(chosen)


def check_brute_force(triangles: Triangles, rays: RaySet, hits: Hits, seed: int = 0) -> Check:
    """Compare the hits of some randomly chosen rays with brute force over all triangles."""
    wanted = int(np.clip(_BRUTE_FORCE / len(triangles), 4, _BRUTE_FORCE_RAYS))
    chosen = some_rays(len(rays), wanted, seed)
    wrong = wrong_hits(triangles, rays.select(chosen), hits.t[chosen], hits.triangle[chosen])
    return Check.of(
        "hits",
        float(wrong.sum()),
        0.0,
        0.0,
        f"wrong hits of {len(chosen):,} rays, by brute force in float64",
    )


def check_mitsuba(scene: Any, rays: RaySet, hits: Hits, seed: int = 0) -> Check:
    """Compare the hits of some randomly chosen rays with Mitsuba's own intersection.

    Where the two differ, brute force decides which is right.
    """
    chosen = some_rays(len(rays), _MITSUBA_RAYS, seed)
    some = rays.select(chosen)
    mi = mitsuba()
    ray = mi.Ray3f(
        mi.Point3f(some.o.T), mi.Vector3f(some.d.T), mi.Float(some.tmax), mi.Float(0), []
    )
    theirs = np.array(scene.geometry.ray_intersect_preliminary(ray, coherent=False).t)
    ours = hits.t[chosen]
    differ = np.flatnonzero(~np.isclose(theirs, ours, rtol=1e-3, atol=0.0))
    differ = differ[: max(int(_BRUTE_FORCE / len(scene.triangles)), 4)]
    disputed = chosen[differ]
    wrong = wrong_hits(
        scene.triangles, rays.select(disputed), hits.t[disputed], hits.triangle[disputed]
    )
    return Check.of(
        "mitsuba",
        float(wrong.sum()),
        0.0,
        0.0,
        f"wrong hits, of {len(differ)} that differ from Mitsuba's (of {len(chosen):,} rays)",
    )


def check_same_hits(
    triangles: Triangles, rays: RaySet, hits: Hits, others: Hits, name: str
) -> Check:
    """Compare the hits of one tree, or of one way to trace it, with those of another.

    A ray that grazes an edge may hit either of its triangles. Of the hits that differ, only those
    count that are wrong by brute force.
    """
    differ = np.flatnonzero(hits.t != others.t)
    some = differ[: max(int(_BRUTE_FORCE / len(triangles)), 4)]
    wrong = wrong_hits(triangles, rays.select(some), hits.t[some], hits.triangle[some])
    wrong |= wrong_hits(triangles, rays.select(some), others.t[some], others.triangle[some])
    return Check.of(
        name,
        float(wrong.sum()),
        0.0,
        0.0,
        f"wrong hits among the {len(differ):,} of {len(rays):,} rays that differ",
    )
