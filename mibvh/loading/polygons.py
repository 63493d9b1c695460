"""Polygons of any number of corners, concave ones too, as triangles."""

from __future__ import annotations

import numpy as np

from mibvh.loading.mesh import I64, Refused, check_indices
from mibvh.triangles import F64

#: A fan's triangle may be turned over by this share of the polygon's area: rounding.
_ROUNDING = 1e-6


def triangulate(
    vertices: F64, indices: I64, sizes: I64, first_is: int = 0
) -> tuple[I64, list[str]]:
    """Cut polygons into triangles of the same surface.

    Polygons whose fan from the first corner nowhere turns over are cut so, as most programs do;
    the others are cut in the plane they are closest to, by earcut.

    Parameters
    ----------
    vertices : (V, 3) float64
    indices : (K,) int64
        The polygons' corners, one polygon after the other.
    sizes : (F,) int64
        Corners of each polygon.
    first_is : int
        What the file calls its first vertex, for messages.

    Returns
    -------
    faces : (N, 3) int64
        In the order of the polygons.
    notes : list of str
        About polygons that no triangles can be right for.

    Raises
    ------
    Refused
        If an index names no vertex.
    """
    if int(sizes.sum()) != len(indices) or (sizes < 0).any():
        raise Refused("the faces have another number of corners than they say")
    check_indices(indices, len(vertices), first_is)
    notes = []
    lines = int((sizes < 3).sum())
    if lines:
        notes.append(f"{lines:,} faces of fewer than three corners were left out")
    start = np.cumsum(sizes) - sizes
    room = np.maximum(sizes - 2, 0)
    place = np.cumsum(room) - room
    faces = np.full((int(room.sum()), 3), -1, dtype=np.int64)
    crossing = 0
    for size in np.unique(sizes[sizes >= 3]):
        which = np.flatnonzero(sizes == size)
        polygons = indices[start[which][:, None] + np.arange(size)]
        steps = np.arange(size - 2)
        fans = np.stack(
            [np.repeat(polygons[:, :1], size - 2, axis=1), polygons[:, 1:-1], polygons[:, 2:]],
            axis=2,
        )
        faces[place[which][:, None] + steps] = fans
        for row in np.flatnonzero(~_fan_is_right(vertices, fans)):
            cut = _earcut(vertices[polygons[row]])
            if cut is None:
                crossing += 1
                continue
            at = place[which[row]]
            faces[at : at + size - 2] = -1
            faces[at : at + len(cut)] = polygons[row][cut]
    if crossing:
        notes.append(f"{crossing:,} polygons cross themselves; they were cut from a corner")
    return faces[faces[:, 0] >= 0], notes


def _fan_is_right(vertices: F64, fans: I64) -> np.ndarray:
    """(M,) bool: whether no triangle of a polygon's fan is turned over."""
    if fans.shape[1] == 1:
        return np.ones(len(fans), dtype=bool)
    a, b, c = (vertices[fans[:, :, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    whole = normals.sum(axis=1)
    along = np.einsum("mij,mj->mi", normals, whole)
    forward = (along >= -_ROUNDING * (whole**2).sum(axis=1)[:, None]).all(axis=1)
    # Lobes of a polygon that crosses itself may cancel: then nothing is forward.
    most = np.abs(normals).sum(axis=(1, 2))
    return np.asarray(forward & (np.abs(whole).max(axis=1) >= _ROUNDING * most))


def _earcut(polygon: F64) -> I64 | None:
    """(T, 3) int64: triangles of one polygon; None where no triangles have its area."""
    from mapbox_earcut import triangulate_float64

    around = polygon - polygon[0]
    turns = np.cross(around, np.roll(around, -1, axis=0))
    normal = turns.sum(axis=0)
    if not np.abs(normal).max() > _ROUNDING * np.abs(turns).max():  # true for NaN
        return None
    flat = np.ascontiguousarray(np.delete(around, int(np.abs(normal).argmax()), axis=1))
    flat /= np.abs(flat).max()
    cut = triangulate_float64(flat, np.array([len(flat)], np.uint32)).astype(np.int64)
    cut = cut.reshape(-1, 3)
    u, v = flat[cut[:, 1]] - flat[cut[:, 0]], flat[cut[:, 2]] - flat[cut[:, 0]]
    area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    x, y = flat[:, 0], flat[:, 1]
    whole = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    return cut if abs(area - whole) <= _ROUNDING * whole else None
