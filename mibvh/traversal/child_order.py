"""Orders of a wide tree's children for any-hit rays: which child is to be looked into first.

A ray that is to find any hit need not go near first: it may go where it is most likely blocked, or
soonest for the cost of looking (Ize and Hansen, *RTSAH Traversal Order for Occlusion Rays*,
Eurographics 2011). :meth:`mibvh.WideTree.ordered` takes the priorities given here.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.metrics.sah import node_costs
from mibvh.triangles import F64, as_triangles
from mibvh.wide_tree import WideTree

ChildOrder = Literal["larger", "blocking", "worth"]


def child_priority(tree: WideTree, triangles: Any, by: ChildOrder) -> F64:
    """What children are to be ordered by, greatest first.

    Parameters
    ----------
    tree : WideTree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    by : "larger", "blocking" or "worth"
        The surface area of the box; the chance that a ray through the box is blocked by what is
        below the node, :func:`blocked_share`; or that chance over the cost of finding out, the
        SAH of what is below the node for a ray through its box.

    Returns
    -------
    (M,) float64

    Raises
    ------
    MibvhError
        For another order, or if the tree was built for another geometry.
    """
    if by not in get_args(ChildOrder):
        raise MibvhError(f"children are ordered by {', '.join(get_args(ChildOrder))}, not {by!r}")
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    if by == "larger":
        return tree.half_areas
    blocked = blocked_share(tree, triangles)
    if by == "blocking":
        return blocked
    areas = tree.half_areas
    below = _sum_below(tree.child, tree.children, node_costs(tree) * areas)
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = np.where(areas > 0, below / areas, node_costs(tree))
    return blocked / cost


def blocked_share(tree: WideTree, triangles: Any) -> F64:
    """Share of the rays through each node's box that what is below it blocks.

    A line through a convex body of surface A meets surfaces of area S in it 2 S / A times in the
    mean; if they are met independently, ``1 - exp(-2 S / A)`` of the lines meet one. The area of a
    split triangle is shared evenly among its references.

    Parameters
    ----------
    tree : WideTree
    triangles : Triangles or (N, 3, 3) array

    Returns
    -------
    (M,) float64
        1 for boxes without area.
    """
    triangles = as_triangles(triangles)
    times = np.bincount(tree.references, minlength=len(triangles))
    share = (triangles.areas / np.maximum(times, 1))[tree.references]
    total = np.r_[0.0, np.cumsum(share)]
    surfaces = total[tree.first + tree.count] - total[tree.first]
    areas = 2 * tree.half_areas
    met = np.divide(2 * surfaces, areas, out=np.full(len(tree), np.inf), where=areas > 0)
    return -np.expm1(-met)


@njit
def _sum_below(child, children, values):
    """Sum of a value over each node and all below it."""
    total = values.copy()
    for n in range(len(child) - 1, -1, -1):
        for c in range(child[n], child[n] + children[n]):
            total[n] += total[c]
    return total
