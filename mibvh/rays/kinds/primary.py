"""Rays of the camera."""

from __future__ import annotations

from typing import Any

from mibvh.variant import mitsuba


def leave(paths: Any, vertices: Any, options: Any) -> tuple[Any, Any]:
    """What the camera sends; see :meth:`mibvh.rays.kinds.Kind.leave`."""
    return vertices.incoming, mitsuba().Bool(True)
