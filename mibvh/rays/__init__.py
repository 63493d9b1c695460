"""Ray sets, and how Mitsuba makes them in a scene.

:class:`RaySet` and :func:`read_rays` know of no scene; what makes rays is loaded when first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mibvh.rays.rayset import RaySet

if TYPE_CHECKING:
    from mibvh.rays.diffuse import diffuse_rays
    from mibvh.rays.make import make_rays
    from mibvh.rays.mixture import Mixture
    from mibvh.rays.read import read_rays

__all__ = ["Mixture", "RaySet", "diffuse_rays", "make_rays", "read_rays"]

_LATER = {
    "Mixture": "mibvh.rays.mixture",
    "diffuse_rays": "mibvh.rays.diffuse",
    "make_rays": "mibvh.rays.make",
    "read_rays": "mibvh.rays.read",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'mibvh.rays' has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)
