"""Parameters that the plugins read from a scene file: a builder and its options, or a tree file."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

from mibvh.builders.registry import get
from mibvh.errors import MibvhError
from mibvh.mitsuba.trees import Builder, TreeFile
from mibvh.variant import mitsuba


def read_tree_source(props: Any, key: str, default: str, prefix: str = "") -> Builder | TreeFile:
    """Read a tree file's name, or else a builder and its given options.

    Parameters
    ----------
    props : mitsuba.Properties
    key : str
        The parameter that names the builder.
    default : str
        The builder if neither is given.
    prefix : str
        Prefix of the options' names, and of ``tree``, the file.

    Raises
    ------
    MibvhError
        If both are given, for an unknown builder, or an option out of range.
    """
    if prefix + "tree" in props.keys():  # noqa: SIM118 - keys only
        if key in props.keys():  # noqa: SIM118
            raise MibvhError(f"{prefix}tree is a finished tree: leave {key} out")
        # Files that a scene names are beside it.
        return TreeFile(str(mitsuba().file_resolver().resolve(str(props[prefix + "tree"]))))
    return _read_builder(props, key, default, prefix)


def _read_builder(props: Any, key: str, default: str, prefix: str) -> Builder:
    name = props.get(key, default)
    entry = get(name)
    given = {}
    for field in dataclasses.fields(entry.options):
        if prefix + field.name in props.keys():  # noqa: SIM118 - keys only
            value = props[prefix + field.name]
            given[field.name] = value
    entry.options(**given)
    return Builder(name, tuple(sorted(given.items())))


def refuse_unknown(props: Any, plugin: str) -> None:
    """Refuse parameters that were not read, as Mitsuba does for its own plugins.

    Raises
    ------
    MibvhError
        Naming the first of them.
    """
    unknown = list(props.unqueried())
    if unknown:
        # bvh_rays builds no tree.
        also = "" if plugin == "bvh_rays" else ", and neither has the builder it names"
        raise MibvhError(f"{plugin} has no parameter {unknown[0]!r}{also}")


def positive(props: Any, key: str, default: int) -> int:
    """Read a positive integer.

    Raises
    ------
    MibvhError
        If it is smaller.
    """
    value = int(props.get(key, default))
    if value < 1:
        raise MibvhError(f"{key} must be at least 1, not {value}")
    return value


@functools.cache
def plain_variant(plugin: str, variant: str) -> None:
    """Refuse variants whose spectra are Mueller matrices.

    Raises
    ------
    MibvhError
        In a polarized variant.
    """
    if "polarized" in variant:
        raise MibvhError(f"{plugin} does not support polarization (variant {variant})")
