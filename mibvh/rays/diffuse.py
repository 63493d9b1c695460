"""Diffuse rays, path-traced by Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mibvh.ranges import check
from mibvh.rays.kinds import KINDS, KindOptions
from mibvh.rays.make import Film, collect
from mibvh.rays.rayset import RaySet
from mibvh.scene import load


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
    viewpoints, width, height, samples, seed : int, optional
        As for :func:`mibvh.make_rays`.
    bounces : int
        Diffuse rays per path, at most.
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
    check(bounces=bounces)
    film = Film(
        viewpoints=viewpoints, width=width, height=height, samples=samples, seed=seed, sort=sort
    )
    rays = collect(load(scene), KINDS["diffuse"], 1, bounces, KindOptions(), film, progress)
    rays.meta.update({"bounces": bounces, "kind": "diffuse", "occlusion": False})
    return rays
