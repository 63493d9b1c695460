"""Where a picture is drawn, and what it is drawn of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes

from mibvh.errors import MibvhError
from mibvh.plot.marks import STYLE
from mibvh.tree import Tree


def axes(ax: Axes | None, width: float = 4.8, height: float = 3.2) -> Axes:
    """Return the Axes given, or those of a new figure of so many inches."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    with mpl.rc_context(STYLE):
        return plt.subplots(figsize=(width, height), layout="constrained")[1]


def named(trees: Any) -> dict[str, Tree]:
    """Trees by name: a mapping as it is, one tree or several by their builders' names.

    Raises
    ------
    MibvhError
        If there is no tree, or something else, or one that is not sound, or two trees have the
        same name.
    """
    if isinstance(trees, Mapping):
        found = dict(trees)
    else:
        several = [trees] if isinstance(trees, Tree) or not isinstance(trees, Iterable) else trees
        found = {}
        for tree in several:
            name = str(getattr(tree, "meta", {}).get("builder", "tree"))
            if name in found:
                raise MibvhError(
                    f"two of the trees are named {name}; give them as a dict of names to trees"
                )
            found[name] = tree
    if not found:
        raise MibvhError("there is no tree to draw")
    for name, tree in found.items():
        if not isinstance(tree, Tree):
            raise MibvhError(f"{name}: is no tree but a {type(tree).__name__}")
        tree.check()
    return found
