"""Builders: one file per algorithm family, and a registry that users can add to."""

from mibvh.builders.building import build, next_to_nothing, warm_up
from mibvh.builders.draft import Draft, References
from mibvh.builders.options import Options, option
from mibvh.builders.registry import (
    Builder,
    Context,
    all_names,
    builder,
    get,
    later_names,
    names,
)

__all__ = [
    "Builder",
    "Context",
    "Draft",
    "Options",
    "References",
    "all_names",
    "build",
    "builder",
    "get",
    "later_names",
    "names",
    "next_to_nothing",
    "option",
    "warm_up",
]
