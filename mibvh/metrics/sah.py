"""The surface area heuristic (Aila, Karras and Laine 2013, equation 1)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.tree import Tree
from mibvh.triangles import F64


def node_costs(tree: Tree, c_inner: float | None = None, c_tri: float | None = None) -> F64:
    """Cost of visiting each node: ``c_inner``, or ``c_tri`` times a leaf's references.

    Parameters
    ----------
    tree : Tree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.

    Returns
    -------
    (M,) float64
    """
    tree.check()
    inner = tree.meta.get("c_inner", 1.2) if c_inner is None else c_inner
    tri = tree.meta.get("c_tri", 1.0) if c_tri is None else c_tri
    return np.where(tree.is_leaf, tri * tree.count, inner).astype(np.float64)


def sah_per_node(tree: Tree, c_inner: float | None = None, c_tri: float | None = None) -> F64:
    """Each node's share of the SAH: ``C_n A_n / A_root``, root included.

    Parameters
    ----------
    tree : Tree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.

    Returns
    -------
    (M,) float64
        Where the root has no area at all, every ratio of areas is taken as 1.
    """
    areas = tree.half_areas
    ratio = areas / areas[0] if areas[0] > 0 else np.ones_like(areas)
    return node_costs(tree, c_inner, c_tri) * ratio


def sah(
    tree: Tree, c_inner: float | None = None, c_tri: float | None = None, **deprecated: Any
) -> float:
    """Expected cost of a long random ray, by the surface area heuristic.

    :func:`mibvh.sah_of_lines` takes the lines that rays lie on, instead of lines of even place
    and direction.

    Parameters
    ----------
    tree : Tree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.
    **deprecated
        ``ray_lines``: what the function named above takes.

    Returns
    -------
    float
        In units of the cost constants.
    """
    if deprecated:
        return _of_lines(tree, c_inner, c_tri, deprecated)
    return float(sah_per_node(tree, c_inner, c_tri).sum())


def _of_lines(tree: Tree, c_inner: float | None, c_tri: float | None, asked: dict[str, Any]) -> Any:
    """Return what ``sah(ray_lines=...)`` was before 0.2, an Estimate."""
    for name in asked:
        if name != "ray_lines":
            raise TypeError(f"sah() got an unexpected keyword argument {name!r}")
    if c_inner is not None or c_tri is not None:
        raise MibvhError("with ray_lines, the cost constants are those the tree was built with")
    from mibvh.metrics.lines import sah_of_lines  # needs the node costs of this file

    warnings.warn("sah(ray_lines=) is now sah_of_lines()", DeprecationWarning, stacklevel=3)
    return sah_of_lines(tree, asked["ray_lines"])
