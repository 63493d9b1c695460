"""The axes of a picture, and the trees it shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes

from mibvh.errors import MibvhError
from mibvh.plot.marks import STYLE
from mibvh.tree import Tree
from mibvh.wide_tree import WideTree


def axes(ax: Axes | None, width: float = 4.8, height: float = 3.2) -> Axes:
    """Return the given Axes, or those of a new figure of this size in inches."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    with mpl.rc_context(STYLE):
        return plt.subplots(figsize=(width, height), layout="constrained")[1]


def named(trees: Any) -> dict[str, Tree | WideTree]:
    """Trees by name: a mapping is taken as it is; other trees get their builders' names.

    Raises
    ------
    MibvhError
        If there is no tree, or something else, or an invalid tree, or two trees have the
        same name.
    """
    if isinstance(trees, Mapping):
        found = dict(trees)
    else:
        alone = isinstance(trees, Tree | WideTree) or not isinstance(trees, Iterable)
        several = [trees] if alone else trees
        found = {}
        for tree in several:
            name = str(getattr(tree, "meta", {}).get("builder", "tree"))
            if isinstance(tree, WideTree):
                name = f"{name}, {tree.width} wide"
            if name in found:
                raise MibvhError(
                    f"two of the trees are named {name}; pass a dict of names to trees"
                )
            found[name] = tree
    if not found:
        raise MibvhError("there is no tree to draw")
    for name, tree in found.items():
        if not isinstance(tree, Tree | WideTree):
            raise MibvhError(f"{name}: is of type {type(tree).__name__}, not a Tree")
        tree.check()
    return found
