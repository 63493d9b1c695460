"""Wide trees from a builder: its own, where it makes such, or its binary tree collapsed."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

from mibvh.builders.building import build, next_to_nothing, origin_of
from mibvh.builders.registry import Builder, Context, get
from mibvh.collapsing import collapse
from mibvh.errors import MibvhError
from mibvh.triangles import as_triangles
from mibvh.wide_tree import C_BOX, WIDTHS, WideTree


def build_wide(
    triangles: Any,
    builder: str = "bbvh",
    width: int = 8,
    *,
    progress: Callable[[str, float], None] | None = None,
    **options: Any,
) -> WideTree:
    """Build a tree of up to ``width`` children per node.

    `embree` makes nodes and leaves itself. Any other builder's binary tree of single references
    is collapsed (:func:`mibvh.collapse`), which puts up to ``max_leaf`` of them into a leaf.

    Parameters
    ----------
    triangles : Triangles, Scene, (N, 3, 3) array, or a name or file that `load` takes
        The geometry.
    builder : str
        A name from ``mibvh builders``.
    width : int
        2, 4 or 8.
    progress : callable, optional
        Called as ``progress(stage, done)`` with ``done`` from 0 to 1.
    **options
        The builder's.

    Returns
    -------
    WideTree

    Raises
    ------
    MibvhError
        As of :func:`mibvh.build`, or for another width.
    """
    if width not in WIDTHS:
        raise MibvhError(f"a wide tree's width is one of 2, 4, 8, not {width!r}")
    source, triangles = triangles, as_triangles(triangles)
    entry = get(builder)
    chosen = entry.options_of(options)
    if entry.wide is None or width == 2:
        binary = build(source, builder, progress=progress, **{**options, "max_leaf": 1})
        tree = collapse(binary, width, max_leaf=chosen.max_leaf)
        return tree.replace(meta={**tree.meta, "options": dataclasses.asdict(chosen)})
    entry.check_room(triangles, chosen)
    report = progress or Context.progress
    report("compiling", 0.0)
    _warm_up(entry, width)
    report("building", 0.0)
    started = time.perf_counter()
    with entry.guard(entry.wide):
        tree = entry.wide(triangles, chosen, width)
    seconds = time.perf_counter() - started
    if not isinstance(tree, WideTree):
        raise MibvhError(f"builder {builder} made a {type(tree).__name__} for a wide tree")
    origin = origin_of(builder, chosen, triangles, {"references": len(tree.references)})
    meta = {**origin, "c_box": C_BOX, "build_seconds": seconds}
    tree = tree.replace(width=width, meta=meta)
    if violations := tree.validate(triangles):
        raise MibvhError(f"builder {builder} made an invalid wide tree: {violations[0]}")
    return tree


@functools.cache
def _warm_up(entry: Builder, width: int) -> None:
    """Run a builder once, so that the seconds of a tree hold no compilation."""
    if entry.wide is not None:
        with entry.guard(entry.wide):
            entry.wide(next_to_nothing(), entry.options(), width)
