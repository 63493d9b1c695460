"""Viewpoints: the rays of cameras, and cameras for scenes without any."""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.triangles import F64, Triangles
from mibvh.variant import mitsuba

_PROBES = 1024
_DIRECTIONS = 64
_VIEWPOINTS = 4
_FIELD_OF_VIEW = 65.0


def camera_rays(sensor: Any, place: Any, aperture: Any) -> Any:
    """Rays of a sensor through positions on its film.

    Parameters
    ----------
    sensor : mitsuba.Sensor
    place : Point2f
        On the film, from 0 to 1.
    aperture : Point2f
        On the lens, from 0 to 1.

    Returns
    -------
    mitsuba.Ray3f

    Raises
    ------
    MibvhError
        If the sensor makes no rays.
    """
    mi = mitsuba()
    where = mi.Float(0), mi.Float(0.5), place, aperture
    try:
        ray, _ = sensor.sample_ray(*where)
    except RuntimeError:
        try:  # irradiance meters have only this one
            ray, _ = sensor.sample_ray_differential(*where)
        except RuntimeError as error:
            raise MibvhError(
                f"the sensor {sensor.class_name()} {sensor.id()!r} makes no rays "
                f"({' '.join(str(error).split())})"
            ) from None
    return mi.Ray3f(ray)


def automatic_viewpoints(triangles: Triangles, geometry: Any) -> list[Any]:
    """Choose viewpoints: in open space for interiors, on an orbit around objects.

    A scene is an interior if most points of its box see geometry in nearly every direction.

    Parameters
    ----------
    triangles : Triangles
    geometry : mitsuba.Scene
        The same triangles in Mitsuba.

    Returns
    -------
    list of mitsuba.Sensor
    """
    points, directions, distance = _probe(triangles, geometry)
    enclosed = np.isfinite(distance).mean(axis=1) > 0.95
    if enclosed.mean() > 0.6:
        places = _open_places(points[enclosed], distance[enclosed])
        views = [
            _longest_view(points[enclosed][i], directions, distance[enclosed][i]) for i in places
        ]
    else:
        views = _orbit(triangles)
    return [_camera(origin, target, triangles.diagonal) for origin, target in views]


def _probe(triangles: Triangles, geometry: Any) -> tuple[F64, F64, F64]:
    """Distances to geometry from random points of the scene's box, in uniform directions."""
    mi = mitsuba()
    rng = np.random.default_rng(0)
    lower, upper = triangles.bounds.astype(np.float64)
    points = lower + (upper - lower) * rng.uniform(0.02, 0.98, (_PROBES, 3))
    k = np.arange(_DIRECTIONS) + 0.5
    y, phi = 1 - 2 * k / _DIRECTIONS, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - y * y)
    directions = np.stack([r * np.cos(phi), y, r * np.sin(phi)], axis=1)
    o = np.repeat(points, _DIRECTIONS, axis=0).astype(np.float32)
    d = np.tile(directions, (_PROBES, 1)).astype(np.float32)
    hit = geometry.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T)))
    t = np.array(hit.t, dtype=np.float64).reshape(_PROBES, _DIRECTIONS)
    return points, directions, t


def _open_places(points: F64, distance: F64) -> list[int]:
    """Points far from any surface, and far from each other."""
    clearance = np.percentile(distance, 10, axis=1)
    good = np.flatnonzero(clearance >= np.quantile(clearance, 0.8))
    chosen = [int(good[clearance[good].argmax()])]
    while len(chosen) < _VIEWPOINTS and len(good) > len(chosen):
        gap = np.linalg.norm(points[good][:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(good[gap.argmax()]))
    return chosen


def _longest_view(point: F64, directions: F64, distance: F64) -> tuple[F64, F64]:
    """Look nearly horizontally to where the cone of view is deepest."""
    depth = np.where(np.isfinite(distance), distance, 0.0)
    inside = (directions @ directions.T) > np.cos(np.radians(35))
    score = (inside @ depth) / inside.sum(axis=1)
    score[np.abs(directions[:, 1]) > 0.4] = -1
    best = directions[score.argmax()]
    return point, point + best


def _orbit(triangles: Triangles) -> list[tuple[F64, F64]]:
    lower, upper = triangles.bounds.astype(np.float64)
    center, radius = (lower + upper) / 2, max(triangles.diagonal / 2, 1e-30)
    angle = np.radians(25 + 360 / _VIEWPOINTS * np.arange(_VIEWPOINTS))
    height = np.where(np.arange(_VIEWPOINTS) % 2, 0.7, 0.35)
    offset = np.stack([np.cos(angle), height, np.sin(angle)], axis=1)
    offset *= 2.0 * radius / np.linalg.norm(offset, axis=1, keepdims=True)
    return [(center + o, center) for o in offset]


def _camera(origin: F64, target: F64, diagonal: float) -> Any:
    mi = mitsuba()
    transform = mi.ScalarTransform4f().look_at(
        origin=origin.tolist(), target=target.tolist(), up=[0, 1, 0]
    )
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": _FIELD_OF_VIEW,
            "fov_axis": "x",
            "near_clip": max(1e-5 * diagonal, 1e-30),
            "far_clip": 100 * max(diagonal, 1e-25),
            "to_world": transform,
            "film": {"type": "hdrfilm", "width": 480, "height": 320},
        }
    )
