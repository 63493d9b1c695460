"""An overview of a tree on one sheet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl

from mibvh.plot.charts import by_depth, leaf_sizes
from mibvh.plot.marks import STYLE
from mibvh.plot.slices import overlap_slice
from mibvh.plot.wireframe import wireframe
from mibvh.scene import Scene
from mibvh.tree import Tree
from mibvh.wide_tree import WideTree

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def overview(tree: Tree | WideTree, scene: Scene, *, depth: int = 6, viewpoint: int = 0) -> Figure:
    """Draw a tree on one sheet: its boxes, where they overlap, where its cost is.

    Parameters
    ----------
    tree : Tree or WideTree
    scene : Scene
        What it was built for.
    depth : int
        Depth of the boxes in the wireframe.
    viewpoint : int
        Index of ``scene.sensors``.

    Returns
    -------
    Figure
        With the wireframe, a slice through all boxes, the overlap on the surfaces of that
        slice, and SAH, EPO and leaf sizes.
    """
    from matplotlib import pyplot as plt

    with mpl.rc_context(STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(13, 7), layout="constrained")
        wireframe(tree, scene, depth, viewpoint=viewpoint, ax=axes[0, 0])
        overlap_slice(tree, scene, "nodes", ax=axes[0, 1])
        overlap_slice(tree, scene, "foreign", ax=axes[0, 2])
        leaf_sizes(tree, ax=axes[1, 0])
        by_depth(tree, "sah", ax=axes[1, 1])
        by_depth(tree, "epo", scene, ax=axes[1, 2])
    stats = tree.stats()
    figure.suptitle(
        f"{tree.meta.get('builder', 'tree')} over {scene.name}: {stats['triangles']:,} triangles, "
        f"{stats['nodes']:,} nodes, {stats['depth']} levels"
    )
    return figure
