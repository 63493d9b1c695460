"""Points on triangles."""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.triangles import F64, I32, Triangles


def points_on(triangles: Triangles, ids: I32, seed: int = 0) -> F64:
    """Draw a uniformly distributed random point on each of the given triangles.

    Parameters
    ----------
    triangles : Triangles
    ids : (P,) int32
    seed : int

    Returns
    -------
    (P, 3) float64
    """
    u, v = np.random.default_rng(seed).random((2, len(ids)))
    over = u + v > 1
    return barycentric(triangles, ids, np.where(over, 1 - u, u), np.where(over, 1 - v, v))


def barycentric(triangles: Triangles, ids: I32, u: F64, v: F64) -> F64:
    """Points of triangles by barycentric coordinates; exact in axis-aligned planes.

    Parameters
    ----------
    triangles : Triangles
    ids : (P,) int32
    u, v : (P,) float64
        Weights of the second and third corner.

    Returns
    -------
    (P, 3) float64
    """
    a, b, c = np.moveaxis(triangles.corners[ids].astype(np.float64), 1, 0)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)


def on_surface(triangles: Triangles, near: Any, ids: I32) -> F64:
    """Move points into the planes of their triangles.

    Ray hits lie on their triangles only up to rounding. Flat boxes are common, so a point that is
    off its wall by one rounding would miss every box that has the wall for a face.

    Parameters
    ----------
    triangles : Triangles
    near : (P, 3) float
    ids : (P,) int32
        The triangle that each point lies on.

    Returns
    -------
    (P, 3) float64
    """
    a, b, c = np.moveaxis(triangles.corners[ids].astype(np.float64), 1, 0)
    e1, e2, p = b - a, c - a, near - a
    d11, d12, d22 = (np.einsum("ij,ij->i", x, y) for x, y in ((e1, e1), (e1, e2), (e2, e2)))
    p1, p2 = np.einsum("ij,ij->i", p, e1), np.einsum("ij,ij->i", p, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = d11 * d22 - d12 * d12
        u = np.clip(np.nan_to_num((d22 * p1 - d12 * p2) / determinant), 0, 1)
        v = np.clip(np.nan_to_num((d11 * p2 - d12 * p1) / determinant), 0, 1)
    over = np.maximum(u + v, 1)
    return barycentric(triangles, ids, u / over, v / over)
