"""Rays of any kind, made by Mitsuba from a scene's viewpoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.memory import BYTES, require_memory
from mibvh.ranges import check
from mibvh.rays.kinds import Kind, KindOptions, kind_named
from mibvh.rays.order import morton_order
from mibvh.rays.origins import check_resolution
from mibvh.rays.paths import Paths, Vertices, cosine_directions
from mibvh.rays.rayset import RaySet
from mibvh.scene import NO_OPTIX, Scene, load
from mibvh.variant import mitsuba

#: A set with a greater share of rays that hit the triangle they leave is refused: what it costs
#: would be wrong in the third digit.
MOST_SELF_HITS = 1e-3
#: Mitsuba hits a cube that is 2e-12 across; of 2e-13 it misses parts, by the number of threads.
SMALLEST = 1e-12


@dataclasses.dataclass(frozen=True, kw_only=True)
class Film:
    """Where paths begin, and how their rays are put in order; see :func:`make_rays`."""

    viewpoints: int | None
    width: int
    height: int
    samples: int
    seed: int
    sort: bool


def make_rays(
    scene: Any,
    kind: str,
    *,
    viewpoints: int | None = None,
    width: int = 320,
    height: int = 240,
    samples: int = 4,
    seed: int = 0,
    sort: bool = True,
    radius: float | None = None,
    radius_share: float = 0.1,
    progress: Callable[[float], None] | None = None,
) -> RaySet:
    """Make rays of one kind, from paths that are the same for all kinds.

    From every viewpoint, ``samples`` primary rays through random points of each pixel; from each
    hit, on the side it was seen from, a path goes on in cosine-distributed directions. The rays
    of a kind leave one vertex of the paths, the first by default.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    kind : str
        ``primary``; ``diffuse``, in a cosine-distributed direction; ``shadow``, towards the
        scene's lights by light sampling, or a white sky where it has none; ``ao``, cosine-
        distributed and of limited length. A number names the vertex that they leave:
        ``bounce2`` (for ``diffuse2``), ``shadow2``. :data:`mibvh.rays.kinds.KINDS` has them all.
    viewpoints : int, optional
        How many of the scene's cameras to use; all by default.
    width, height : int
        Pixels per viewpoint.
    samples : int
        Paths per pixel.
    seed : int
        Of the random numbers.
    sort : bool
        Whether to put the rays in Morton order of origin and direction.
    radius : float, optional
        How far ``ao`` rays reach, in scene units.
    radius_share : float
        How far they reach as a share of the diagonal, where no radius is given.
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    RaySet
        ``occlusion`` says whether any hit ends a ray (``shadow``, ``ao``).

    Raises
    ------
    MibvhError
        If there is no such kind, a number is out of range, there are no such rays, or more than a
        thousandth of them hit the triangle that they leave.
    """
    of, vertex = kind_named(kind)
    film = Film(
        viewpoints=viewpoints, width=width, height=height, samples=samples, seed=seed, sort=sort
    )
    options = KindOptions(radius, radius_share)
    rays = collect(load(scene), of, vertex, vertex, options, film, progress)
    meta = {"kind": kind, "occlusion": of.occlusion}
    if of.name == "ao":
        meta["radius"] = float(rays.tmax[0])
    rays.meta.update(meta)
    return rays


def collect(
    scene: Scene,
    kind: Kind,
    first: int,
    last: int,
    options: KindOptions,
    film: Film,
    progress: Callable[[float], None] | None,
) -> RaySet:
    """Rays of a kind that leave the vertices ``first`` to ``last``; see :func:`make_rays`."""
    width, height, samples, seed = film.width, film.height, film.samples, film.seed
    check(seed=seed)
    views = _checked(scene, film.viewpoints, width=width, height=height, samples=samples)
    primary = views * width * height * samples
    needed = ray_memory(primary, max(0, last - max(first, 1)))
    require_memory(needed, f"{scene.name}: rays of {primary:,} camera rays")
    paths = Paths(scene)
    parts: list[RaySet] = []
    hits = self_hits = 0
    for view in range(views):
        start = paths.camera(view, width, height, samples, seed)
        for vertex, met in enumerate(_vertices(paths, start, last)):
            hits += len(met) if vertex == 1 else 0
            if vertex >= first:
                part, hit_self = _part(paths, kind, met, options, view, vertex)
                parts += part
                self_hits += hit_self
        if progress:
            progress((view + 1) / views)
    if hits == 0 and last > 0:
        raise MibvhError(
            f"{scene.name}: no viewpoint sees any geometry, so there are no rays"
            f"{_why_unseen(scene.triangles.diagonal)}"
        )
    if not parts:
        raise MibvhError(f"{scene.name}: there are no {kind.name} rays that leave vertex {first}")
    meta = {
        "scene": scene.name,
        "digest": scene.triangles.digest,
        "seed": seed,
        "width": width,
        "height": height,
        "samples": samples,
        "viewpoints": views,
        "order": "morton" if film.sort else "path",
        "primary_rays": primary,
        "primary_hits": hits,
        "self_hits": self_hits,
    }
    rays = joined(parts, meta)
    if self_hits > MOST_SELF_HITS * len(rays):
        raise MibvhError(
            f"{scene.name}: {self_hits} of {len(rays)} {kind.name} rays hit the triangle that they "
            f"leave, more than {MOST_SELF_HITS:.1%}: float32 is too coarse for this geometry"
        )
    return rays.select(morton_order(rays, scene.triangles.bounds)) if film.sort else rays


def _why_unseen(diagonal: float) -> str:
    """What hides a scene of such a size from cameras, if its size may be why."""
    if diagonal < SMALLEST:
        return " (below 1e-12 across, Mitsuba misses hits; scale it up)"
    if 0.1 < diagonal < 1e3:
        return ""
    return " (a camera sees from its near_clip to its far_clip: by default, from 0.01 to 10,000)"


def ray_memory(primary: int, bounces: int = 0) -> float:
    """Bytes that making rays takes at most.

    Parameters
    ----------
    primary : int
        Rays from cameras that they are made of.
    bounces : int
        Vertices of the paths, beyond one, that rays leave.
    """
    return primary * (BYTES["rays"] + BYTES["bounce"] * bounces)


def _checked(scene: Scene, viewpoints: int | None, **sizes: int) -> int:
    """How many viewpoints to use, if they and the sizes can be."""
    if not scene.sensors:  # never but on a GPU without OptiX
        raise MibvhError(f"{scene.name}: no rays can be made. {NO_OPTIX}")
    views = len(scene.sensors) if viewpoints is None else viewpoints
    check(**sizes, viewpoints=views)
    if views > len(scene.sensors):
        raise MibvhError(
            f"{scene.name} has {len(scene.sensors)} viewpoints, fewer than the {views} asked for"
        )
    check_resolution(scene.triangles)
    return views


def _vertices(paths: Paths, start: Vertices, last: int) -> Iterator[Vertices]:
    """Vertices of the paths, from the camera's to the ``last``, as far as paths get."""
    mi = mitsuba()
    yield start
    if last < 1:
        return
    met = paths.meet(start.incoming, start.random)
    for vertex in range(1, last + 1):
        if met is None:
            return
        # The kind that leaves here draws the same numbers as the path: it has a copy.
        random = mi.PCG32(met.random)
        yield met
        if vertex < last:
            going = Vertices(met.origin, met.normal, met.triangle, random, met.incoming)
            met = paths.meet(mi.Ray3f(met.origin, cosine_directions(going)), random)


def _part(
    paths: Paths, kind: Kind, met: Vertices, options: KindOptions, view: int, vertex: int
) -> tuple[list[RaySet], int]:
    """Rays that leave vertices, if any does, and how many hit the triangle they leave."""
    import drjit as dr

    mi = mitsuba()
    rays, valid = kind.leave(paths, met, options)
    index = dr.compress(mi.Bool(valid) & (dr.arange(mi.UInt32, len(met)) < len(met)))
    n = len(index)
    if n == 0:
        return [], 0
    rays = dr.gather(mi.Ray3f, rays, index)
    triangle = None if met.triangle is None else dr.gather(mi.UInt32, met.triangle, index)
    source = np.full(n, -1) if triangle is None else np.array(triangle)
    hit_self = 0 if triangle is None else paths.self_hits(rays, triangle)
    tmax = np.broadcast_to(np.array(rays.maxt, dtype=np.float32), n)
    tmax = np.where(tmax < np.finfo(np.float32).max, tmax, np.inf)
    part = RaySet(
        np.array(rays.o, dtype=np.float32).T,
        np.array(rays.d, dtype=np.float32).T,
        tmax,
        np.full(n, view),
        np.full(n, vertex),
        source,
    )
    return [part], hit_self


def joined(parts: Sequence[RaySet], meta: dict[str, Any]) -> RaySet:
    """Ray sets one after the other, with the ``meta`` of the whole."""
    names = ("o", "d", "tmax", "viewpoint", "bounce", "source")
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return RaySet(**arrays, meta=meta)
