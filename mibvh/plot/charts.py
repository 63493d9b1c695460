"""Charts of trees: by depth, by leaf size, metric against metric, predicted against measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mibvh.errors import MibvhError
from mibvh.metrics.epo import epo, epo_per_depth
from mibvh.metrics.predictor import pearson
from mibvh.metrics.sah import sah, sah_per_node
from mibvh.plot.canvas import axes, named
from mibvh.plot.marks import builder_colour, depth_curves, named_points
from mibvh.tree import Tree
from mibvh.triangles import F64, as_triangles
from mibvh.wide_tree import WideTree

DepthQuantity = Literal["nodes", "leaves", "leaf_size", "sah", "epo"]

#: What :func:`by_depth` draws: the title, and the label of the vertical axis.
_QUANTITIES: dict[str, tuple[str, str]] = {
    "nodes": ("Nodes by depth", "inner nodes and leaves"),
    "leaves": ("Leaves by depth", "leaves"),
    "leaf_size": ("Size of leaves by depth", "triangle references per leaf, mean"),
    "sah": ("SAH by depth", "share of the SAH (cost)"),
    "epo": ("EPO by depth", "share of the EPO (cost)"),
}


def by_depth(
    trees: Any, quantity: DepthQuantity = "nodes", triangles: Any = None, *, ax: Axes | None = None
) -> Axes:
    """Draw the distribution of a quantity over the depth of trees.

    Parameters
    ----------
    trees : Tree or WideTree, sequence of these, or mapping of name to them
    quantity : str
        ``nodes``, ``leaves``, ``leaf_size`` (mean number of references), ``sah`` or ``epo`` (each
        level's contribution). The legend gives the tree's total; for ``leaf_size`` the mean over
        all leaves.
    triangles : Triangles, Scene or (N, 3, 3) array
        What the trees were built for; required for ``epo``.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    MibvhError
        For another quantity, or ``epo`` without triangles.
    """
    if quantity not in _QUANTITIES:
        raise MibvhError(f"by_depth draws {', '.join(_QUANTITIES)}, not {quantity!r}")
    if quantity == "epo" and triangles is None:
        raise MibvhError("EPO by depth needs the triangles that the trees were built for")
    found = named(trees)
    curves = {name: _of_levels(tree, quantity, triangles) for name, tree in found.items()}
    labels = {f"{name}: {_total(found[name], quantity, v)}": v for name, v in curves.items()}
    axis = axes(ax)
    depth_curves(axis, labels)
    axis.set_xlabel("depth in the tree")
    title, unit = _QUANTITIES[quantity]
    axis.set_title(title)
    axis.set_ylabel(unit)
    axis.set_ylim(bottom=0)
    axis.legend(title="mean" if quantity == "leaf_size" else "total", fontsize=8)
    return axis


def _of_levels(tree: Tree | WideTree, quantity: str, triangles: Any) -> F64:
    """(depth + 1,) float64: the quantity on each level."""
    levels, leaf = tree.depth + 1, tree.is_leaf
    if quantity == "epo":
        return epo_per_depth(tree, triangles)
    if quantity == "sah":
        return np.bincount(tree.depths, sah_per_node(tree), levels).astype(np.float64)
    if quantity == "nodes":
        return np.bincount(tree.depths, minlength=levels).astype(np.float64)
    leaves = np.bincount(tree.depths[leaf], minlength=levels).astype(np.float64)
    if quantity == "leaves":
        return leaves
    references = np.bincount(tree.depths[leaf], tree.count[leaf], levels)
    return np.divide(references, leaves, out=np.full(levels, np.nan), where=leaves > 0)


def _total(tree: Tree | WideTree, quantity: str, values: F64) -> str:
    if quantity == "leaf_size":
        return f"{tree.stats()['mean_leaf_size']:.2f}"
    return f"{values.sum():.4g}" if quantity in ("sah", "epo") else f"{int(values.sum()):,}"


def leaf_sizes(trees: Any, *, ax: Axes | None = None) -> Axes:
    """Draw the share of leaves that have one triangle, two, and so on.

    Parameters
    ----------
    trees : Tree or WideTree, sequence of these, or mapping of name to them
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    found = named(trees)
    largest = max(int(tree.count[tree.is_leaf].max()) for tree in found.values())
    axis, width = axes(ax), 0.8 / len(found)
    for i, (name, tree) in enumerate(found.items()):
        sizes = tree.count[tree.is_leaf]
        share = np.bincount(sizes, minlength=largest + 1)[1:] / len(sizes)
        place = np.arange(1, largest + 1) + (i - (len(found) - 1) / 2) * width
        label = f"{name}: {len(sizes):,} leaves"
        axis.bar(place, 100 * share, width, color=builder_colour(i), label=label)
    axis.set_title("Size of leaves")
    axis.set_xlabel("triangle references in a leaf")
    axis.set_ylabel("share of the leaves (%)")
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.legend(fontsize=8)
    return axis


def sah_epo(trees: Any, triangles: Any, *, ax: Axes | None = None) -> Axes:
    """Draw the EPO of trees against their SAH, one point per tree.

    Parameters
    ----------
    trees : sequence of Tree or WideTree, or mapping of name to them
    triangles : Triangles, Scene or (N, 3, 3) array
        What they were built for.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    found, triangles = named(trees), as_triangles(triangles)
    axis = axes(ax)
    named_points(
        axis,
        list(found),
        [sah(tree) for tree in found.values()],
        [epo(tree, triangles) for tree in found.values()],
    )
    axis.annotate("↙ better", (0.02, 0.03), xycoords="axes fraction", color="#666666", fontsize=8)
    axis.set_title(f"{triangles.name}: EPO against SAH")
    axis.set_xlabel("SAH: cost of a long random ray")
    axis.set_ylabel("EPO: extra cost of a ray's end")
    return axis


def predicted_measured(
    predicted: Mapping[str, float],
    measured: Mapping[str, float],
    *,
    predictor: str = "predicted cost",
    measurement: str = "measured cost",
    ax: Axes | None = None,
) -> Axes:
    """Draw the measured cost of trees against a prediction, with the least-squares line.

    Parameters
    ----------
    predicted, measured : mapping of name to value
        A dict or a pandas Series each, over the same trees.
    predictor, measurement : str
        Labels of the axes, with units.
    ax : Axes, optional

    Returns
    -------
    Axes
        Its title gives Pearson's r, where there are three trees or more.

    Raises
    ------
    MibvhError
        If a tree is predicted but not measured, or the other way round.
    """
    x, y = dict(predicted), dict(measured)
    if odd := sorted(set(x) ^ set(y)):
        raise MibvhError(f"{odd[0]} is predicted or measured, but not both")
    axis, names = axes(ax), list(x)
    values = [x[name] for name in names], [y[name] for name in names]
    named_points(axis, names, *values, line=True)
    r = pearson(*values)
    axis.set_title(f"r = {r:.3f} over {len(x)} trees" if np.isfinite(r) else f"{len(x)} trees")
    axis.set_xlabel(predictor)
    axis.set_ylabel(measurement)
    return axis
