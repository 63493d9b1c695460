"""Triangles for Mitsuba's analytic shapes: sphere, disk, cylinder."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from mibvh.triangles import F32, F64

#: Segments around; a sphere has half as many rings.
_SEGMENTS = 48


def tessellate(kind: str, shape: Any) -> F32 | None:
    """Tessellate an analytic shape.

    Parameters
    ----------
    kind : str
        Mitsuba's name of the class.
    shape : mitsuba.Shape

    Returns
    -------
    (N, 3, 3) float32 or None
        None for a kind that has no tessellation here.
    """
    import mitsuba as mi

    make = {"Sphere": _sphere, "Disk": _disk, "Cylinder": _cylinder}.get(kind)
    if make is None:
        return None
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    points = make()
    return (points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)


def _circle() -> F64:
    angle = np.linspace(0, 2 * np.pi, _SEGMENTS, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(_SEGMENTS)], axis=1)


def _strip(a: F64, b: F64) -> F64:
    """Triangles between two closed rings of equal length."""
    a1, b1 = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    return np.concatenate([np.stack([a, a1, b1], axis=1), np.stack([a, b1, b], axis=1)])


def _disk() -> F64:
    ring = _circle()
    return np.stack([np.zeros_like(ring), ring, np.roll(ring, -1, axis=0)], axis=1)


def _cylinder() -> F64:
    ring = _circle()
    return _strip(ring, ring + [0, 0, 1])


def _sphere() -> F64:
    polar = np.linspace(0, np.pi, _SEGMENTS // 2 + 1)
    rings = [np.sin(p) * _circle() + [0, 0, np.cos(p)] for p in polar]
    strips = [_strip(a, b) for a, b in itertools.pairwise(rings)]
    corners = np.concatenate(strips)
    edges = corners - np.roll(corners, 1, axis=1)
    return corners[(np.linalg.norm(edges, axis=2) > 1e-9).all(axis=1)]  # none at the poles
