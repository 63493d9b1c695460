"""Triangles for Mitsuba's analytic shapes: sphere, disk, cylinder."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.triangles import F32, F64

#: Segments around; a sphere has half as many rings.
_SEGMENTS = 48
#: Scales that differ by less than this are one scale: Mitsuba's own bound.
_EVEN = 1e-6
#: Mitsuba inverts as it composes: a rotation about an axis that is no unit vector comes out wrong.
_INVERSE = 1e-3


def tessellate(kind: str, shape: Any) -> tuple[F32 | None, str]:
    """Tessellate an analytic shape as Mitsuba traces it.

    Disks and cylinders are traced under any transform. A sphere stays one: of a transform with
    shear or uneven scales Mitsuba, with a warning, takes the place and one scale.

    Parameters
    ----------
    kind : str
        Mitsuba's name of the class.
    shape : mitsuba.Shape

    Returns
    -------
    corners : (N, 3, 3) float32 or None
        None for a kind that has no tessellation here.
    note : str
        What its transform was not taken for, to go on with in a sentence; mostly empty.

    Raises
    ------
    MibvhError
        If Mitsuba traces the shape elsewhere than it has it.
    """
    import mitsuba as mi

    make = {"Sphere": _sphere, "Disk": _disk, "Cylinder": _cylinder}.get(kind)
    if make is None:
        return None, ""
    transform = mi.traverse(shape)["to_world"]
    matrix = np.array(transform.matrix, dtype=np.float64).reshape(4, 4)
    inverse = np.array(transform.inverse_transpose, dtype=np.float64).reshape(4, 4).T
    note = ""
    if kind == "Sphere" and not _is_even(matrix[:3, :3]):
        box = shape.bbox()
        lower, upper = np.array(box.min, np.float64), np.array(box.max, np.float64)
        matrix = np.diag([*(upper - lower) / 2, 1.0])
        matrix[:3, 3] = (lower + upper) / 2
        note = "; as in Mitsuba, it stays a sphere under its uneven transform"
    elif np.abs(matrix[:3, :3] @ inverse[:3, :3] - np.eye(3)).max() > _INVERSE:
        raise MibvhError(
            "its transform and Mitsuba's inverse of it do not belong together, so that Mitsuba "
            "traces it elsewhere than it stands; give axes of rotation unit length"
        )
    points = make()
    return (points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32), note


def _is_even(matrix: F64) -> bool:
    """Whether a transform turns, mirrors and scales evenly, but does no more."""
    product = matrix @ matrix.T
    scale = float(np.trace(product)) / 3
    return bool(np.abs(product - scale * np.eye(3)).max() <= _EVEN * scale)


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
