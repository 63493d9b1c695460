"""A fingerprint of a scene's cameras, for cache keys of its rays."""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.scene import Scene
from mibvh.variant import mitsuba


def cameras(scene: Scene) -> list[Any]:
    """Return origins and directions of five camera rays of each viewpoint, as JSON-able values."""
    mi = mitsuba()
    x, y = mi.Float([0.1, 0.9, 0.5, 0.1, 0.9]), mi.Float([0.1, 0.1, 0.5, 0.9, 0.9])
    rays = [s.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(y, x))[0] for s in scene.sensors]
    return [[np.array(ray.o).tolist(), np.array(ray.d).tolist()] for ray in rays]
