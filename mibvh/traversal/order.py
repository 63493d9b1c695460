"""Orders in which rays are dealt to lanes: rays side by side share a warp."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from mibvh.errors import MibvhError
from mibvh.rays.order import morton_order
from mibvh.rays.rayset import RaySet
from mibvh.triangles import F32, I32

Order = Literal["stored", "path", "morton", "random"]


def ray_order(rays: RaySet, bounds: F32, order: Order = "stored", seed: int = 0) -> I32:
    """Places of a ray set's rays in an order.

    Parameters
    ----------
    rays : RaySet
    bounds : (2, 3) array
        The scene's box.
    order : "stored", "path", "morton" or "random"
        As they stand; as their paths were made, pixel by pixel; along a Morton curve of origin
        and direction, bounce by bounce; or at random.
    seed : int
        Of the random order.

    Returns
    -------
    (R,) int32

    Raises
    ------
    MibvhError
        For an unknown order, and for ``path`` where the set has been sorted: it does not know
        how it was made. ``diffuse_rays(..., sort=False)`` leaves it unsorted.
    """
    if order not in get_args(Order):
        raise MibvhError(f"the order must be one of {', '.join(get_args(Order))}, not {order!r}")
    if order == "path" and rays.meta.get("order") != "path":
        raise MibvhError("the rays are not in the order of their paths: make them with sort=False")
    if order == "random":
        return np.random.default_rng(seed).permutation(len(rays)).astype(np.int32)
    if order == "morton":
        return morton_order(rays, bounds)
    return np.arange(len(rays), dtype=np.int32)
