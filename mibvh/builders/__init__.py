"""Builders: one file per algorithm family, and a registry that users can add to."""

from mibvh.builders.draft import Draft, References
from mibvh.builders.registry import Builder, Context, Options, build, builder, get, names, option

__all__ = [
    "Builder",
    "Context",
    "Draft",
    "Options",
    "References",
    "build",
    "builder",
    "get",
    "names",
    "option",
]
