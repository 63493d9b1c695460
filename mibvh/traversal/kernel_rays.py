"""Rays in the units that the kernels compute in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mibvh.rays.rayset import RaySet
from mibvh.triangles import F32, F64


class KernelRays(NamedTuple):
    """A ray set, scaled such that no product of the kernels overflows or underflows.

    Attributes
    ----------
    o : (R, 3) float32
        Origins in the records' units; zero where the ray is no number.
    d : (R, 3) float32
        Directions, brought to a length near 1 by a power of two.
    tmax : (R,) float32
        Farthest hit that counts, in the kernels' unit of distance; -1 for a ray that hits
        nothing, because it is no number or has no direction.
    unit : (R,) float64
        From distances in units of the ray set's direction to the kernels'; powers of two.
    """

    o: F32
    d: F32
    tmax: F32
    unit: F64


def kernel_rays(rays: RaySet, scale: float) -> KernelRays:
    """Bring rays into the units of a scene's records.

    Parameters
    ----------
    rays : RaySet
    scale : float
        From scene units to those of the records (:attr:`mibvh.traversal.records.Records.scale`).
    """
    # Rays that are no numbers hit nothing, and must not upset their neighbours.
    sound = np.isfinite(rays.o).all(1) & np.isfinite(rays.d).all(1) & ~np.isnan(rays.tmax)
    o = np.where(sound[:, None], rays.o * np.float32(scale), np.float32(0))
    d = np.where(sound[:, None], rays.d, 0)
    stretch = np.ldexp(1.0, np.frexp(np.abs(d).max(1))[1].clip(-100, 100))
    unit = stretch * scale
    d = (d / stretch[:, None]).astype(np.float32)
    with np.errstate(over="ignore"):
        tmax = np.where(sound & (d != 0).any(1), rays.tmax * unit, -1).astype(np.float32)
    return KernelRays(o, d, tmax, unit)
