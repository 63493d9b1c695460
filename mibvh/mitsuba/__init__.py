"""Mitsuba plugins: ``import mibvh.mitsuba`` registers the integrators of ``plugins/``.

Scene XML and dicts can then use them like Mitsuba's own, in every variant that is set before or
after:

- ``bvh_path``: a path tracer that traces every ray through a tree
- ``bvh_cost``: heat maps of the cost of camera rays in one tree, or in two
- ``bvh_rays``: traces diffuse rays into a :class:`mibvh.RaySet`, and shows where they end

Examples
--------
>>> import mitsuba as mi
>>> import mibvh.mitsuba
>>> if mi.variant() is None:
...     _ = mi.set_variant("llvm_ad_rgb")
>>> scene = mi.load_dict(mi.cornell_box())
>>> path = mi.load_dict({"type": "bvh_path", "builder": "sbvh", "max_leaf": 4})
>>> mi.render(scene, integrator=path, spp=1).shape
(256, 256, 3)
"""

from __future__ import annotations

from mibvh.mitsuba.accelerator import Accelerator
from mibvh.mitsuba.coverage import coverage_figure
from mibvh.mitsuba.heatmap import channel_means, cost_figure, image_channels
from mibvh.registration import PLUGINS, register

__all__ = [
    "PLUGINS",
    "Accelerator",
    "channel_means",
    "cost_figure",
    "coverage_figure",
    "image_channels",
    "register",
]

register()
