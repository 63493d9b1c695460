"""mibvh: measures and predicts how fast a bounding volume hierarchy really is.

Everything below is loaded when first used, so that ``import mibvh`` is quick and touches
neither Mitsuba's variant nor a compiler.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mibvh.version import __version__

if TYPE_CHECKING:
    from mibvh import plot
    from mibvh.builders import Context, Draft, Options, References, build, builder, option
    from mibvh.builders.wide import build_wide
    from mibvh.collapsing import collapse, unfold
    from mibvh.comparison import Comparison, compare
    from mibvh.errors import MibvhError
    from mibvh.layouts import read_tree, write_tree
    from mibvh.measures import Area, Flux, Segments
    from mibvh.metrics.epo import epo, epo_per_depth, epo_per_node
    from mibvh.metrics.lines import RayLines, ray_lines, sah_of_lines
    from mibvh.metrics.points import (
        Estimate,
        RayEnds,
        epo_at_ends,
        estimate_epo,
        point_costs,
        ray_ends,
    )
    from mibvh.metrics.predictor import (
        estimate_alpha,
        finite_ray_cost,
        fit_alpha,
        path_length_ratio,
    )
    from mibvh.metrics.sah import sah, sah_per_node
    from mibvh.optimised import optimize
    from mibvh.quantise import quantised
    from mibvh.rays import Mixture, RaySet, diffuse_rays, make_rays, read_rays
    from mibvh.scene import Scene, load
    from mibvh.studies import Study, StudyOptions, study
    from mibvh.traversal.trace import Hits, trace
    from mibvh.tree import Tree
    from mibvh.triangles import Triangles, rotation_about
    from mibvh.wide_tree import WideTree

_PUBLIC = {
    "Area": "mibvh.measures",
    "Comparison": "mibvh.comparison",
    "Context": "mibvh.builders",
    "Draft": "mibvh.builders",
    "Estimate": "mibvh.metrics.points",
    "Flux": "mibvh.measures",
    "Hits": "mibvh.traversal.trace",
    "MibvhError": "mibvh.errors",
    "Mixture": "mibvh.rays",
    "Options": "mibvh.builders",
    "RayEnds": "mibvh.metrics.points",
    "RayLines": "mibvh.metrics.lines",
    "RaySet": "mibvh.rays",
    "References": "mibvh.builders",
    "Scene": "mibvh.scene",
    "Segments": "mibvh.measures",
    "Study": "mibvh.studies",
    "StudyOptions": "mibvh.studies",
    "Tree": "mibvh.tree",
    "Triangles": "mibvh.triangles",
    "WideTree": "mibvh.wide_tree",
    "build": "mibvh.builders",
    "build_wide": "mibvh.builders.wide",
    "builder": "mibvh.builders",
    "collapse": "mibvh.collapsing",
    "compare": "mibvh.comparison",
    "diffuse_rays": "mibvh.rays",
    "epo": "mibvh.metrics.epo",
    "epo_at_ends": "mibvh.metrics.points",
    "epo_per_depth": "mibvh.metrics.epo",
    "epo_per_node": "mibvh.metrics.epo",
    "estimate_alpha": "mibvh.metrics.predictor",
    "estimate_epo": "mibvh.metrics.points",
    "finite_ray_cost": "mibvh.metrics.predictor",
    "fit_alpha": "mibvh.metrics.predictor",
    "load": "mibvh.scene",
    "make_rays": "mibvh.rays",
    "optimize": "mibvh.optimised",
    "option": "mibvh.builders",
    "path_length_ratio": "mibvh.metrics.predictor",
    "plot": "mibvh",
    "point_costs": "mibvh.metrics.points",
    "quantised": "mibvh.quantise",
    "ray_ends": "mibvh.metrics.points",
    "ray_lines": "mibvh.metrics.lines",
    "read_tree": "mibvh.layouts",
    "read_rays": "mibvh.rays",
    "rotation_about": "mibvh.triangles",
    "sah": "mibvh.metrics.sah",
    "sah_of_lines": "mibvh.metrics.lines",
    "sah_per_node": "mibvh.metrics.sah",
    "study": "mibvh.studies",
    "trace": "mibvh.traversal.trace",
    "unfold": "mibvh.collapsing",
    "write_tree": "mibvh.layouts",
}

__all__ = [
    "Area",
    "Comparison",
    "Context",
    "Draft",
    "Estimate",
    "Flux",
    "Hits",
    "MibvhError",
    "Mixture",
    "Options",
    "RayEnds",
    "RayLines",
    "RaySet",
    "References",
    "Scene",
    "Segments",
    "Study",
    "StudyOptions",
    "Tree",
    "Triangles",
    "WideTree",
    "__version__",
    "build",
    "build_wide",
    "builder",
    "collapse",
    "compare",
    "diffuse_rays",
    "epo",
    "epo_at_ends",
    "epo_per_depth",
    "epo_per_node",
    "estimate_alpha",
    "estimate_epo",
    "finite_ray_cost",
    "fit_alpha",
    "load",
    "make_rays",
    "optimize",
    "option",
    "path_length_ratio",
    "plot",
    "point_costs",
    "quantised",
    "ray_ends",
    "ray_lines",
    "read_rays",
    "read_tree",
    "rotation_about",
    "sah",
    "sah_of_lines",
    "sah_per_node",
    "study",
    "trace",
    "unfold",
    "write_tree",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'mibvh' has no attribute {name!r}")
    home = _PUBLIC[name]
    value = (
        importlib.import_module(f"mibvh.{name}")
        if home == "mibvh"
        else getattr(importlib.import_module(home), name)
    )
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
