"""Measures of the nodes of a finished tree."""

from __future__ import annotations

import numpy as np

from mibvh.measures.area import Measure
from mibvh.measures.boxes import of_boxes
from mibvh.tree import Tree
from mibvh.triangles import F64
from mibvh.wide_tree import WideTree


def node_measures(tree: Tree | WideTree, measure: Measure) -> F64:
    """Measure of each node's box.

    Parameters
    ----------
    tree : Tree or WideTree
    measure : Measure

    Returns
    -------
    (M,) float64
        In scene units, of half a surface area.
    """
    return of_boxes(measure.compiled(1.0), np.concatenate([tree.lower, tree.upper], axis=1))
