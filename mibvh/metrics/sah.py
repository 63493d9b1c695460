"""The surface area heuristic (Aila, Karras and Laine 2013, equation 1)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from mibvh.errors import MibvhError, expect
from mibvh.nodes import C_INNER, C_TRI
from mibvh.tree import Tree
from mibvh.triangles import F64
from mibvh.wide_tree import C_BOX, BinaryView, WideTree


def node_costs(
    tree: Tree | WideTree,
    c_inner: float | None = None,
    c_tri: float | None = None,
    *,
    c_box: float | None = None,
) -> F64:
    """Cost of visiting each node: ``c_inner``, or ``c_tri`` times a leaf's references.

    A wide tree's inner node costs ``c_box`` more for each child box beyond two.

    Parameters
    ----------
    tree : Tree or WideTree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.
    c_box : float, optional
        By default what the tree was collapsed with, or :data:`mibvh.wide_tree.C_BOX`.

    Returns
    -------
    (M,) float64
    """
    expect((Tree, WideTree), tree=tree)
    tree.check()
    inner = tree.meta.get("c_inner", C_INNER) if c_inner is None else c_inner
    tri = tree.meta.get("c_tri", C_TRI) if c_tri is None else c_tri
    if isinstance(tree, BinaryView):
        return tree.spread(node_costs(tree.wide, inner, tri, c_box=c_box))
    if isinstance(tree, WideTree):
        box = tree.meta.get("c_box", C_BOX) if c_box is None else c_box
        inner = inner + box * (tree.children - 2)
    return np.where(tree.is_leaf, tri * tree.count, inner).astype(np.float64)


def sah_per_node(
    tree: Tree | WideTree, c_inner: float | None = None, c_tri: float | None = None
) -> F64:
    """Each node's share of the SAH: ``C_n A_n / A_root``, root included.

    Parameters
    ----------
    tree : Tree or WideTree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.

    Returns
    -------
    (M,) float64
        In units of the cost constants. Where the root has no area at all, every ratio of areas
        is taken as 1.

    Raises
    ------
    MibvhError
        If it is no tree, or an invalid one.
    """
    expect((Tree, WideTree), tree=tree)
    areas = tree.half_areas
    ratio = areas / areas[0] if areas[0] > 0 else np.ones_like(areas)
    return node_costs(tree, c_inner, c_tri) * ratio


def sah(
    tree: Tree | WideTree,
    c_inner: float | None = None,
    c_tri: float | None = None,
    **deprecated: Any,
) -> float:
    """Expected cost of a long random ray, by the surface area heuristic.

    ``1 / A_root`` times the sum of ``C_n A_n`` over all nodes, root included (Goldsmith and Salmon
    1987; MacDonald and Booth 1990). The ray is taken from uniformly distributed lines.
    :func:`mibvh.sah_of_lines` uses the lines that given rays lie on.

    Parameters
    ----------
    tree : Tree or WideTree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.
    **deprecated
        ``ray_lines``: an argument of the function named above.

    Returns
    -------
    float
        In units of the cost constants.

    Raises
    ------
    MibvhError
        If it is no tree, or an invalid one.
    """
    if deprecated:
        return _of_lines(tree, c_inner, c_tri, deprecated)
    return float(sah_per_node(tree, c_inner, c_tri).sum())


def _of_lines(
    tree: Tree | WideTree, c_inner: float | None, c_tri: float | None, asked: dict[str, Any]
) -> Any:
    """Return what ``sah(ray_lines=...)`` was before 0.2, an Estimate."""
    for name in asked:
        if name != "ray_lines":
            raise TypeError(f"sah() got an unexpected keyword argument {name!r}")
    if c_inner is not None or c_tri is not None:
        raise MibvhError("with ray_lines, the cost constants are those the tree was built with")
    warnings.warn("sah(ray_lines=) is now sah_of_lines()", DeprecationWarning, stacklevel=3)
    return asked["ray_lines"].sah(tree)
