"""Tracing rays through a tree one at a time, with counters: hits for segments, costs for choices.

The same walk as the study's kernel (:mod:`mibvh.traversal.kernel`): the nearer child first, the
farther one pushed, popped nodes taken as they are. In float64, for builders that want a few
thousand rays traced without Mitsuba.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mibvh._jit import njit
from mibvh.measures.segments import Segments
from mibvh.parallel import run_blocks
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import F32, F64, I32, Triangles

_BLOCK = 1024
#: Segments that are not cut go this much farther than the scene's box, for a wall may be its side.
_BEYOND = 1.0 + 1e-5


class Nodes(NamedTuple):
    """A tree's arrays as the walk reads them."""

    lower: Any
    upper: Any
    left: Any
    first: Any
    count: Any
    references: Any


class Rays(NamedTuple):
    """Rays in float64; ``tmax`` in lengths of the direction."""

    o: Any
    d: Any
    tmax: Any


@njit(allocates=False)
def _begin(lower, upper, node, o, inverse, t):
    """Where a ray enters a box; inf if it does not, or only behind ``t``."""
    near, far = 0.0, t
    for k in range(3):
        a = (np.float64(lower[node, k]) - o[k]) * inverse[k]
        b = (np.float64(upper[node, k]) - o[k]) * inverse[k]
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near if near <= far else np.inf


@njit(allocates=False)
def _hit(corners, triangle, o, d, t):
    """Distance at which a ray hits a triangle, from either side; ``t`` if not before that."""
    ax, ay, az = (
        np.float64(corners[triangle, 0, 0]),
        np.float64(corners[triangle, 0, 1]),
        (np.float64(corners[triangle, 0, 2])),
    )
    ux, uy, uz = (
        corners[triangle, 1, 0] - ax,
        corners[triangle, 1, 1] - ay,
        (corners[triangle, 1, 2] - az),
    )
    vx, vy, vz = (
        corners[triangle, 2, 0] - ax,
        corners[triangle, 2, 1] - ay,
        (corners[triangle, 2, 2] - az),
    )
    px, py, pz = d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx
    determinant = ux * px + uy * py + uz * pz
    if determinant == 0.0:
        return t
    sx, sy, sz = o[0] - ax, o[1] - ay, o[2] - az
    u = (sx * px + sy * py + sz * pz) / determinant
    if not 0.0 <= u <= 1.0:
        return t
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    v = (d[0] * qx + d[1] * qy + d[2] * qz) / determinant
    if v < 0.0 or u + v > 1.0:
        return t
    at = (vx * qx + vy * qy + vz * qz) / determinant
    return at if 0.0 < at < t else t


@njit
def _walk(begin, end, nodes, corners, rays, any_hit, out, visits):
    """Trace rays; ``out`` gets distances (inf: none), ``visits`` inner nodes and triangles."""
    lower, upper, left, first, count, references = nodes
    o, d, tmax = rays
    stack = np.empty(MAX_DEPTH + 1, np.int32)
    inverse = np.empty(3, np.float64)
    for r in range(begin, end):
        for k in range(3):
            # A direction of zero never leaves its slab: infinities of the right signs.
            inverse[k] = 1.0 / (d[r, k] if abs(d[r, k]) > 1e-30 else 1e-30)
        t, inner, tests = tmax[r], 0, 0
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            while left[node] >= 0:
                inner += 1
                a = left[node]
                near_a = _begin(lower, upper, a, o[r], inverse, t)
                near_b = _begin(lower, upper, a + 1, o[r], inverse, t)
                if near_a == np.inf and near_b == np.inf:
                    node = -1
                    break
                if near_a < np.inf and near_b < np.inf:
                    stack[top] = a if near_b < near_a else a + 1
                    top += 1
                node = a + 1 if near_b < near_a else a
            if node < 0:
                continue
            for i in range(first[node], first[node] + count[node]):
                tests += 1
                t = _hit(corners, references[i], o[r], d[r], t)
                if any_hit and t < tmax[r]:
                    top = 0
                    break
        out[r] = t if t < tmax[r] else np.inf
        visits[r, 0], visits[r, 1] = inner, tests


def walk(
    tree: Tree,
    triangles: Triangles,
    o: F32,
    d: F32 | F64,
    tmax: F32 | F64,
    any_hit: bool = False,
) -> tuple[F64, I32]:
    """Trace rays through a tree.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
    o, d : (R, 3) float
        Origins and directions in scene units.
    tmax : (R,) float64
        In lengths of the direction.
    any_hit : bool
        Whether the first hit found ends a ray, and not the closest.

    Returns
    -------
    t : (R,) float64
        Distance of the hit in lengths of the direction; inf for none.
    visits : (R, 2) int32
        Inner nodes visited, and triangles tested.
    """
    t, visits = np.empty(len(o), np.float64), np.zeros((len(o), 2), np.int32)
    nodes = Nodes(tree.lower, tree.upper, tree.left, tree.first, tree.count, tree.references)
    rays = Rays(*(np.ascontiguousarray(a, np.float64) for a in (o, d, tmax)))

    def work(_worker: int, begin: int, end: int) -> None:
        _walk(begin, end, nodes, triangles.corners, rays, any_hit, t, visits)

    run_blocks(work, len(o), _BLOCK)
    return t, visits


def cut_at_hits(
    tree: Tree,
    triangles: Triangles,
    o: F32,
    d: F32,
    tmax: F32,
    viewpoint: I32,
    any_hit: bool = False,
) -> Segments:
    """Cut rays where they hit; those that miss end where they leave the scene's box.

    Rays that any hit ends are not cut: which hit that is depends on the tree.

    Parameters
    ----------
    tree : Tree
        Any, of these triangles.
    triangles : Triangles
    o, d : (R, 3) float32
    tmax : (R,) float32
    viewpoint : (R,) int32
    any_hit : bool

    Returns
    -------
    Segments
        Rays that are no numbers are left out.
    """
    sound = np.isfinite(o).all(1) & np.isfinite(d).all(1) & (tmax >= 0) & (d != 0).any(1)
    o, viewpoint = o[sound], viewpoint[sound]
    along = d[sound].astype(np.float64)
    limit = tmax[sound].astype(np.float64)
    low, high = triangles.bounds.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(
            along > 0, (high - o) / along, np.where(along < 0, (low - o) / along, np.inf)
        )
    t = np.minimum(np.maximum(far.min(axis=1), 0.0), limit)
    if any_hit:
        t = np.minimum(t * _BEYOND, limit)
    else:
        hit, _ = walk(tree, triangles, o, along, limit)
        t = np.where(np.isfinite(hit), hit, t)
    end = (o + along * t[:, None]).astype(np.float32)
    reach = t if any_hit else limit if np.isfinite(limit).any() else None
    return Segments(o, end, viewpoint, any_hit, reach, d[sound])


def counted_cost(
    tree: Tree, triangles: Triangles, segments: Segments, c_inner: float, c_tri: float
) -> float:
    """Mean cost of segments in a tree: ``c_inner`` per inner node, ``c_tri`` per triangle.

    Segments go on beyond their ends up to their reach, as the traversal does not know the hit
    beforehand; those that any hit ends do not, where no reach is given.
    """
    d: F32 | F64 | None = segments.direction
    if d is None:
        d = segments.end.astype(np.float64) - segments.start
        d[(d == 0).all(axis=1), 0] = 1e-30
    tmax = segments.reach
    if tmax is None:
        tmax = np.full(len(d), 1.0 if segments.any_hit else np.inf)
    _, visits = walk(tree, triangles, segments.start, d, tmax, segments.any_hit)
    return float((visits * np.array([c_inner, c_tri])).sum(axis=1).mean())
