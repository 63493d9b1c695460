"""The order that rays are stored in: neighbours start near each other, and go the same way."""

from __future__ import annotations

import numpy as np

from mibvh.morton import ray_codes
from mibvh.rays.rayset import RaySet
from mibvh.triangles import F32, I32


def morton_order(rays: RaySet, bounds: F32) -> I32:
    """Order by bounce, then along a Morton curve of origin and direction.

    Parameters
    ----------
    rays : RaySet
    bounds : (2, 3) array
        Lower and upper corner of the box that the curve fills: the scene's.

    Returns
    -------
    (R,) int32
        Places of the rays in the given order.
    """
    codes = ray_codes(rays.o, rays.d, bounds)
    key = (rays.bounce.astype(np.uint64) << np.uint64(45)) | codes
    return np.argsort(key, kind="stable").astype(np.int32)
