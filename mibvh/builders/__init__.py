"""Builders: one file per algorithm family, and a registry that users can add to."""

from mibvh.builders.draft import Draft, References
from mibvh.builders.registry import (
    Builder,
    Context,
    Options,
    all_names,
    build,
    builder,
    get,
    later_names,
    names,
    next_to_nothing,
    option,
    warm_up,
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
