"""Rays in the directions that a diffuse surface scatters light to."""

from __future__ import annotations

from typing import Any

from mibvh.rays.paths import cosine_directions
from mibvh.variant import mitsuba


def leave(paths: Any, vertices: Any, options: Any) -> tuple[Any, Any]:
    """One cosine-distributed ray per vertex; see :meth:`mibvh.rays.kinds.Kind.leave`."""
    mi = mitsuba()
    return mi.Ray3f(vertices.origin, cosine_directions(vertices)), mi.Bool(True)
