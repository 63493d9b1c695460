"""Diffuse rays, path-traced by Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.morton import ray_codes
from mibvh.rays.origins import check_resolution
from mibvh.rays.paths import Paths, cosine_directions
from mibvh.rays.rayset import RaySet
from mibvh.scene import load
from mibvh.variant import mitsuba

#: A set with a greater share of rays that hit the triangle they leave is refused: what it costs
#: would be wrong in the third digit.
MOST_SELF_HITS = 1e-3


def diffuse_rays(
    scene: Any,
    *,
    viewpoints: int | None = None,
    width: int = 320,
    height: int = 240,
    samples: int = 4,
    bounces: int = 1,
    seed: int = 0,
    sort: bool = True,
    progress: Callable[[float], None] | None = None,
) -> RaySet:
    """Path-trace diffuse rays with Mitsuba.

    From every viewpoint, ``samples`` primary rays through random points of each pixel; from
    each hit, on the side it was seen from, one ray in a cosine-distributed direction; from
    what that hits the next, up to ``bounces``. Rays that miss end their path. Origins are
    clear of the triangle that is left by a bound on what is rounded
    (:mod:`mibvh.rays.origins`); the set's ``meta`` counts the rays that hit it nevertheless,
    as ``self_hits``.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    viewpoints : int, optional
        How many of the scene's cameras to use; all by default.
    width, height : int
        Pixels per viewpoint.
    samples : int
        Paths per pixel.
    bounces : int
        Diffuse rays per path, at most.
    seed : int
        Of the random numbers.
    sort : bool
        Whether to put the rays of each bounce in Morton order of origin and direction.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    RaySet

    Raises
    ------
    MibvhError
        If a number is out of range, no camera sees anything, the scene is so far from the
        origin that float32 cannot tell its places apart, or more than a thousandth of the rays
        hit the triangle that they leave.
    """
    scene = load(scene)
    for name, value in [
        ("width", width), ("height", height), ("samples", samples), ("bounces", bounces),
        ("viewpoints", len(scene.sensors) if viewpoints is None else viewpoints),
    ]:  # fmt: skip
        if value < 1:
            raise MibvhError(f"{name} must be at least 1, not {value}")
    views = len(scene.sensors) if viewpoints is None else viewpoints
    if views > len(scene.sensors):
        raise MibvhError(
            f"{scene.name} has {len(scene.sensors)} viewpoints, fewer than the {views} asked for"
        )
    check_resolution(scene.triangles)
    mi = mitsuba()
    paths = Paths(scene)
    parts: list[RaySet] = []
    hits = self_hits = 0
    for view in range(views):
        ray, random = paths.primary(view, width, height, samples, seed)
        for bounce in range(1, bounces + 1):
            met = paths.meet(ray, random)
            if met is None:
                break
            ray, random = mi.Ray3f(met.origin, cosine_directions(met)), met.random
            hits += len(met) if bounce == 1 else 0
            self_hits += paths.self_hits(ray, met.triangle)
            parts.append(_stored(ray, met.triangle, view, bounce))
        if progress:
            progress((view + 1) / views)
    if hits == 0:
        raise MibvhError(f"{scene.name}: no viewpoint sees any geometry, so there are no rays")
    meta = {
        "scene": scene.name, "digest": scene.triangles.digest, "seed": seed, "width": width,
        "height": height, "samples": samples, "bounces": bounces, "viewpoints": views,
        "order": "morton" if sort else "path", "primary_rays": views * width * height * samples,
        "primary_hits": hits, "self_hits": self_hits,
    }  # fmt: skip
    rays = joined(parts, meta)
    if self_hits > MOST_SELF_HITS * len(rays):
        raise MibvhError(
            f"{scene.name}: {self_hits} of {len(rays)} diffuse rays hit the triangle that they "
            f"leave, more than {MOST_SELF_HITS:.1%}: float32 is too coarse for this geometry"
        )
    return rays.select(_order(rays, scene.triangles.bounds)) if sort else rays


def _stored(ray: Any, triangle: Any, view: int, bounce: int) -> RaySet:
    """Rays of Mitsuba's as a ray set."""
    o, d = (np.array(v, dtype=np.float32).T for v in (ray.o, ray.d))
    n = len(o)
    return RaySet(
        o, d, viewpoint=np.full(n, view), bounce=np.full(n, bounce), source=np.array(triangle)
    )


def joined(parts: list[RaySet], meta: dict[str, Any]) -> RaySet:
    """Ray sets one after the other, with the ``meta`` of the whole."""
    names = ("o", "d", "tmax", "viewpoint", "bounce", "source")
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return RaySet(**arrays, meta=meta)


def _order(rays: RaySet, bounds: Any) -> np.ndarray:
    """Order by bounce, then along a Morton curve of origin and direction."""
    codes = ray_codes(rays.o, rays.d, bounds)
    return np.argsort((rays.bounce.astype(np.uint64) << np.uint64(45)) | codes, kind="stable")
