"""Cost of any-hit rays: shadow rays and ambient occlusion. Derived in ``docs/rays.md``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from mibvh.metrics.points import point_costs, triangle_positions
from mibvh.metrics.predictor import finite_ray_cost
from mibvh.surface import on_surface
from mibvh.tree import Tree
from mibvh.triangles import F64, Triangles

if TYPE_CHECKING:
    from mibvh.rays.rayset import RaySet
    from mibvh.traversal.trace import Hits


def saved_by_any_hit(tree: Tree, triangles: Triangles, rays: RaySet, hits: Hits) -> float:
    """What a traversal saves by ending at the first hit found, among the nodes that rays touch.

    Where two sibling boxes overlap and one contains the hit, the other is visited only if it comes
    first, half of the time. So an occluded ray saves half the cost of the foreign nodes that
    contain its start, half of those that contain its end, and half of the triangles in the leaf
    where it ends.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
        What the tree was built for.
    rays : RaySet
    hits : Hits
        The closest hits, from any tree. Their triangles and distances are used.

    Returns
    -------
    float
        Mean over all rays, in units of the cost constants. Rays that hit nothing save nothing.
    """
    hit = np.flatnonzero(hits.triangle >= 0)
    if not len(hit):
        return 0.0
    ids = hits.triangle[hit]
    ends = rays.o[hit].astype(np.float64) + rays.d[hit].astype(np.float64) * hits.t[hit, None]
    foreign = point_costs(tree, triangles, on_surface(triangles, ends, ids), ids)[:, 0]
    rest = float(tree.meta.get("c_tri", 1.0)) * (leaf_sizes(tree, triangles)[ids] - 1)
    starts = foreign_at_starts(tree, triangles, rays.select(hit))
    return float(0.5 * (foreign + rest + starts).sum() / len(rays))


def foreign_at_starts(tree: Tree, triangles: Triangles, rays: RaySet) -> F64:
    """(R,) float64: cost of the nodes that contain a ray's start, but not the triangle it leaves.

    0 for rays that leave no triangle.
    """
    found = np.zeros(len(rays))
    on = np.flatnonzero(rays.source >= 0)
    points = on_surface(triangles, rays.o[on], rays.source[on])
    found[on] = point_costs(tree, triangles, points, rays.source[on])[:, 0]
    return found


def leaf_sizes(tree: Tree, triangles: Triangles) -> F64:
    """(N,) float64: number of references in the leaf of each triangle, averaged over its leaves."""
    leaves = np.flatnonzero(tree.is_leaf)
    leaves = leaves[np.argsort(tree.first[leaves])]
    size = np.repeat(tree.count[leaves], tree.count[leaves]).astype(np.float64)
    starts, positions = triangle_positions(tree, len(triangles))
    return np.add.reduceat(size[positions], starts[:-1]) / np.diff(starts)


def any_hit_ray_cost(
    sah: npt.ArrayLike, point_query: npt.ArrayLike, length_ratio: float, saved: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Cost of any-hit rays, with nothing fitted: ``s SAH + Q - saved``.

    Parameters
    ----------
    sah, point_query : (K,) array
        Per tree, as for :func:`mibvh.metrics.predictor.finite_ray_cost`.
    length_ratio : float
        From :func:`mibvh.metrics.predictor.path_length_ratio`, with the closest hits.
    saved : (K,) array
        From :func:`saved_by_any_hit`.
    """
    return finite_ray_cost(sah, point_query, length_ratio) - np.asarray(saved, np.float64)


def estimate_alpha_any_hit(length_ratio: float, occluded: float) -> float:
    """Alpha of any-hit rays, without measuring any tree: ``(1 - p) / (1 - p + s)``.

    Occluded rays save the overlap at their ends; only the others pay for it.

    Parameters
    ----------
    length_ratio : float
        ``s``.
    occluded : float
        ``p``, the share of the rays that hit something.
    """
    paying = 1.0 - occluded
    return paying / (paying + length_ratio) if paying + length_ratio > 0 else 0.0
