"""Ray sets: diffuse rays that Mitsuba path-traces, stored so that every tree traces the same."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.files import checksum, read_arrays, write_arrays
from mibvh.scene import Scene, load
from mibvh.triangles import F32, F64, I32
from mibvh.variant import mitsuba

_ARRAYS = ("o", "d", "tmax", "viewpoint", "bounce", "source")
#: How far origins are backed off along the incoming ray, relative to the scene's diagonal.
BACK_OFF = 1e-5


@dataclasses.dataclass(frozen=True, eq=False)
class RaySet:
    """Rays to trace through trees.

    Attributes
    ----------
    o, d : (R, 3) float32
        Origins in scene units, and directions (of unit length).
    tmax : (R,) float32
        Farthest hit that counts; infinite for diffuse rays.
    viewpoint : (R,) int32
        The camera that the path began at.
    bounce : (R,) int32
        1 for the rays that leave what the camera sees, 2 for those that leave what they hit,
        and so on.
    source : (R,) int32
        The triangle that the ray leaves; -1 where that is not known.
    meta : dict
        JSON-able: scene, digest of the triangles, seed, film size, samples, order, and the
        numbers of primary rays and hits.
    """

    o: F32
    d: F32
    tmax: F32
    viewpoint: I32
    bounce: I32
    source: I32
    meta: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.tmax)

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the rays."""
        return checksum({name: getattr(self, name) for name in _ARRAYS}, {})

    def select(self, chosen: Any) -> RaySet:
        """Keep some of the rays.

        Parameters
        ----------
        chosen : index array, boolean mask or slice
        """
        arrays = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        return RaySet(**arrays, meta=self.meta)

    def rotated(self, rotation: F64) -> RaySet:
        """Turn about the origin, as :meth:`mibvh.Triangles.rotated` turns the scene."""
        turn = rotation.T
        return dataclasses.replace(
            self,
            o=(self.o.astype(np.float64) @ turn).astype(np.float32),
            d=(self.d.astype(np.float64) @ turn).astype(np.float32),
            meta={**self.meta, "digest": None, "rotated": True},
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an ``.npz`` file; see :func:`mibvh.files.write_arrays`."""
        write_arrays(path, {name: getattr(self, name) for name in _ARRAYS}, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RaySet:
        """Read a ray set back.

        Raises
        ------
        MibvhError
            If the file is missing, is no ray set, is damaged, or comes from a newer format.
        """
        arrays, meta = read_arrays(path, "ray set", _ARRAYS)
        return cls(**arrays, meta=meta)


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
    what that hits the next, up to ``bounces``. Origins are backed off along the incoming
    ray. Rays that miss end their path.

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
        If a number is out of range, or no camera sees anything.
    """
    scene = load(scene)
    sensors = scene.sensors[: viewpoints or len(scene.sensors)]
    for name, value in [("width", width), ("height", height), ("samples", samples),
                        ("bounces", bounces), ("viewpoints", len(sensors))]:  # fmt: skip
        if value < 1:
            raise MibvhError(f"{name} must be at least 1, not {value}")
    if viewpoints is not None and viewpoints > len(scene.sensors):
        raise MibvhError(
            f"{scene.name} has {len(scene.sensors)} viewpoints, fewer than the {viewpoints} asked "
            "for"
        )
    mi = mitsuba()
    # Zero-copy views of NumPy memory would keep gathers from being vectorised.
    corners = mi.Float(scene.triangles.corners.ravel())
    parts: list[tuple[F32, F32, I32, int, int]] = []
    primary = hits = 0
    for view, sensor in enumerate(sensors):
        rng = mi.PCG32(size=width * height * samples, initstate=seed, initseq=view)
        ray = _primary_rays(mi, sensor, width, height, samples, rng)
        primary += width * height * samples
        for bounce in range(1, bounces + 1):
            found = _bounce(mi, scene, corners, ray, rng)
            if found is None:
                break
            ray, rng, source = found
            o, d = (np.array(v, dtype=np.float32).T for v in (ray.o, ray.d))
            hits += len(o) if bounce == 1 else 0
            parts.append((o, d, np.array(source).astype(np.int32), view, bounce))
        if progress:
            progress((view + 1) / len(sensors))
    if hits == 0:
        raise MibvhError(f"{scene.name}: no viewpoint sees any geometry, so there are no rays")
    meta = {
        "scene": scene.name, "digest": scene.triangles.digest, "seed": seed, "width": width,
        "height": height, "samples": samples, "bounces": bounces, "viewpoints": len(sensors),
        "order": "morton" if sort else "path", "primary_rays": primary, "primary_hits": hits,
    }  # fmt: skip
    rays = RaySet(
        np.ascontiguousarray(np.concatenate([p[0] for p in parts])),
        np.ascontiguousarray(np.concatenate([p[1] for p in parts])),
        np.full(sum(len(p[0]) for p in parts), np.inf, np.float32),
        np.concatenate([np.full(len(p[0]), p[3], np.int32) for p in parts]),
        np.concatenate([np.full(len(p[0]), p[4], np.int32) for p in parts]),
        np.concatenate([p[2] for p in parts]),
        meta,
    )
    return rays.select(morton_order(rays, scene.triangles.bounds)) if sort else rays


def _primary_rays(mi: Any, sensor: Any, width: int, height: int, samples: int, rng: Any) -> Any:
    import drjit as dr

    index = dr.arange(mi.UInt32, width * height * samples) // samples
    column, row = index % width, index // width
    place = mi.Point2f(
        (mi.Float(column) + rng.next_float32()) / width,
        (mi.Float(row) + rng.next_float32()) / height,
    )
    aperture = mi.Point2f(rng.next_float32(), rng.next_float32())
    ray, _ = sensor.sample_ray(mi.Float(0), mi.Float(0.5), place, aperture)
    return mi.Ray3f(ray)


def _bounce(mi: Any, scene: Scene, corners: Any, ray: Any, rng: Any) -> tuple[Any, Any, Any] | None:
    """The diffuse rays that leave where rays hit, the paths' random numbers, and the triangles.

    None where there are no such rays: Dr.Jit does not compute with arrays of no entries.
    """
    import drjit as dr

    hit = scene.geometry.ray_intersect_preliminary(ray, coherent=False)
    went_on = dr.compress(hit.is_valid())
    if len(went_on) == 0:
        return None
    t, triangle = dr.gather(mi.Float, hit.t, went_on), dr.gather(mi.UInt32, hit.prim_index, went_on)
    o = dr.gather(mi.Point3f, ray.o, went_on)
    d = dr.gather(mi.Vector3f, ray.d, went_on)
    rng = dr.gather(mi.PCG32, rng, went_on)
    a, b, c = (dr.gather(mi.Point3f, corners, triangle * 3 + i) for i in range(3))
    normal = dr.cross(b - a, c - a)
    largest = dr.max(dr.abs(normal))  # scaled first, so that the norm does not underflow
    normal = normal * dr.rcp(dr.select(largest > 1e-38, largest, 1e-38))
    normal = dr.normalize(normal)
    normal = dr.select(dr.dot(normal, d) > 0, -normal, normal)
    back = dr.select(t * 0.5 < BACK_OFF * scene.triangles.diagonal, t * 0.5,
                     BACK_OFF * scene.triangles.diagonal)  # fmt: skip
    # Mitsuba's own warp has a maximum in it that LLVM 15 cannot compile on AVX-512 machines.
    u, phi = rng.next_float32(), dr.two_pi * rng.next_float32()
    local = mi.Vector3f(dr.sqrt(u) * dr.cos(phi), dr.sqrt(u) * dr.sin(phi), dr.sqrt(1 - u))
    out = mi.Frame3f(normal).to_world(local)
    sound = dr.compress(dr.all(dr.isfinite(out)))  # a zero-area triangle has no normal
    if len(sound) == 0:
        return None
    origin = mi.Point3f(o + d * (t - back))
    ray = mi.Ray3f(
        dr.gather(mi.Point3f, origin, sound), dr.gather(mi.Vector3f, mi.Vector3f(out), sound)
    )
    rng = dr.gather(mi.PCG32, rng, sound)
    source = dr.gather(mi.UInt32, triangle, sound)
    dr.eval(ray, rng, source)
    return ray, rng, source


def morton_order(rays: RaySet, bounds: F32) -> np.ndarray:
    """Order by bounce, then along a Morton curve of origin (10 bits an axis) and direction (5).

    Parameters
    ----------
    rays : RaySet
    bounds : (2, 3) array
        Lower and upper corner of the box that the curve fills: the scene's.
    """
    lower, upper = bounds.astype(np.float64)
    cell = (rays.o - lower) / np.maximum(upper - lower, 1e-30)
    origin = _interleave(np.clip(cell * 1024, 0, 1023).astype(np.uint64))
    direction = _interleave(np.clip((rays.d + 1.0) * 16, 0, 31).astype(np.uint64))
    key = (rays.bounce.astype(np.uint64) << np.uint64(45)) | (origin << np.uint64(15)) | direction
    return np.argsort(key, kind="stable")


def _interleave(cells: np.ndarray) -> np.ndarray:
    """(N,) uint64: interleave the low ten bits of three columns."""
    x = cells
    x = (x | (x << np.uint64(16))) & np.uint64(0x030000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x0300F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x030C30C3)
    x = (x | (x << np.uint64(2))) & np.uint64(0x09249249)
    return (x[:, 0] << np.uint64(2)) | (x[:, 1] << np.uint64(1)) | x[:, 2]
