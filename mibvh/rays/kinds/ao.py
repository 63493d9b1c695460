"""Ambient occlusion rays: is anything near, in a cosine-distributed direction."""

from __future__ import annotations

from typing import Any

from mibvh.rays.paths import cosine_directions
from mibvh.variant import mitsuba


def leave(paths: Any, vertices: Any, options: Any) -> tuple[Any, Any]:
    """One ray of limited length per vertex; see :meth:`mibvh.rays.kinds.Kind.leave`."""
    mi = mitsuba()
    rays = mi.Ray3f(vertices.origin, cosine_directions(vertices))
    share = options.radius_share * paths.scene.triangles.diagonal
    rays.maxt = mi.Float(share if options.radius is None else options.radius)
    return rays, mi.Bool(True)
