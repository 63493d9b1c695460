"""Triangles of Mitsuba's shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.loading.mesh import Refused, check_indices
from mibvh.tessellate import tessellate
from mibvh.triangles import F32, F64, Triangles


def shape_key(shape: Any, name: str | None = None) -> tuple[Any, ...]:
    """Sort key of a Mitsuba shape, the same in every load; ``name`` in place of its id."""
    box = shape.bbox()
    return (
        shape.id() if name is None else name,
        shape.primitive_count(),
        *np.array(box.min),
        *np.array(box.max),
    )


def shape_kind(shape: Any) -> str:
    """Mitsuba's name of a shape's class, such as ``Sphere``."""
    return str(shape).split("[")[0].strip()


def mesh_corners(mesh: Any) -> F32:
    """(N, 3, 3) float32: the triangles of a Mitsuba mesh, in the order of its faces.

    Raises
    ------
    MibvhError
        If a face names a vertex that the mesh does not have: Mitsuba does not look.
    """
    vertices = np.array(mesh.vertex_positions_buffer(), dtype=np.float32).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), dtype=np.int64).reshape(-1, 3)
    try:
        check_indices(faces, len(vertices))
    except Refused as error:
        raise MibvhError(f"{shape_kind(mesh)} {mesh.id()!r}: {error}") from None
    return vertices[faces]


def see_through(shapes: Sequence[Any]) -> str:
    """Return a note on shapes whose material lets rays pass that here meet a wall; or nothing."""
    kinds = [bsdf.class_name() for shape in shapes if (bsdf := shape.bsdf()) is not None]
    count = sum(kind.startswith(("Mask", "Null")) for kind in kinds)
    if not count:
        return ""
    many = f"{count} shapes have" if count > 1 else "1 shape has"
    return f"{many} a mask or null material, which is ignored: rays hit all of its triangles"


def shape_triangles(shape: Any) -> tuple[F32 | None, str]:
    """Triangles of a shape, and a note where it is no mesh."""
    kind = shape_kind(shape)
    if shape.is_mesh():
        if shape.face_count() == 0:
            return None, f"{kind} {shape.id()!r} has no faces"
        return mesh_corners(shape), ""
    try:
        corners, note = tessellate(kind, shape)
    except MibvhError as error:
        raise MibvhError(f"{kind} {shape.id()!r}: {error}") from None
    if corners is None:
        return None, f"{kind} {shape.id()!r} is not made of triangles and was left out"
    Triangles(corners, f"{kind} {shape.id()!r}")  # refuses NaN, which no message could place later
    return corners, f"{kind} {shape.id()!r} was tessellated into {len(corners)} triangles{note}"


def transformed(corners: F32, matrix: F64) -> F32:
    """Place triangles by a (4, 4) matrix."""
    with np.errstate(over="ignore", invalid="ignore"):  # Triangles refuses what comes out
        points = corners.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        return points.astype(np.float32).reshape(-1, 3, 3)
