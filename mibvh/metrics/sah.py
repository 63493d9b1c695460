"""The surface area heuristic (Aila, Karras and Laine 2013, equation 1)."""

from __future__ import annotations

import typing

import numpy as np

from mibvh.errors import MibvhError
from mibvh.tree import Tree
from mibvh.triangles import F64

if typing.TYPE_CHECKING:
    from mibvh.metrics.lines import RayLines
    from mibvh.metrics.points import Estimate


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


@typing.overload
def sah(tree: Tree, c_inner: float | None = None, c_tri: float | None = None) -> float: ...
@typing.overload
def sah(tree: Tree, *, ray_lines: RayLines) -> Estimate: ...
def sah(
    tree: Tree,
    c_inner: float | None = None,
    c_tri: float | None = None,
    *,
    ray_lines: RayLines | None = None,
) -> float | Estimate:
    """Expected cost of a long random ray, by the surface area heuristic.

    Parameters
    ----------
    tree : Tree
    c_inner, c_tri : float, optional
        By default what the tree was built with, or the paper's 1.2 and 1.0.
    ray_lines : RayLines, optional
        The lines that rays lie on (:func:`mibvh.ray_lines`): average over these instead of
        lines of even place and direction.

    Returns
    -------
    float or Estimate
        In units of the cost constants; with ``ray_lines`` (and the tree's own constants), an
        estimate with its standard error.

    Raises
    ------
    MibvhError
        If cost constants are given together with ``ray_lines``.
    """
    if ray_lines is not None:
        if c_inner is not None or c_tri is not None:
            raise MibvhError("with ray_lines, the cost constants are those the tree was built with")
        from mibvh.metrics.lines import sah_of_lines  # needs the node costs of this file

        return sah_of_lines(tree, ray_lines)
    return float(sah_per_node(tree, c_inner, c_tri).sum())
