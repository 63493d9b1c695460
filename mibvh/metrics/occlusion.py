"""What rays cost that any hit ends: shadow rays and ambient occlusion. Derived in docs/rays.md."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mibvh.metrics.points import on_surface, point_costs, triangle_positions
from mibvh.metrics.predictor import finite_ray_cost
from mibvh.rays.rayset import RaySet
from mibvh.traversal.trace import Hits
from mibvh.tree import Tree
from mibvh.triangles import F64, Triangles


def saved_by_any_hit(tree: Tree, triangles: Triangles, rays: RaySet, hits: Hits) -> float:
    """What a traversal saves that ends at the first hit found, of the nodes that rays touch.

    Where two sibling boxes overlap and one holds the hit, the other is visited only if it comes
    first: half of the time. So half is saved of what foreign nodes cost that hold the start of an
    occluded ray, half of those that hold its end, and half of the triangles in the leaf that
    ends it.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
        What the tree was built for.
    rays : RaySet
    hits : Hits
        The closest ones, from any tree: of these, triangles and distances count.

    Returns
    -------
    float
        Mean over all rays, in units of the cost constants; rays that hit nothing save nothing.
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
    """(R,) float64: cost of the nodes that hold a ray's start, and not the triangle it leaves.

    0 for rays that leave no triangle.
    """
    found = np.zeros(len(rays))
    on = np.flatnonzero(rays.source >= 0)
    points = on_surface(triangles, rays.o[on], rays.source[on])
    found[on] = point_costs(tree, triangles, points, rays.source[on])[:, 0]
    return found


def leaf_sizes(tree: Tree, triangles: Triangles) -> F64:
    """(N,) float64: references in the leaf of each triangle; the mean over its leaves."""
    leaves = np.flatnonzero(tree.is_leaf)
    leaves = leaves[np.argsort(tree.first[leaves])]
    size = np.repeat(tree.count[leaves], tree.count[leaves]).astype(np.float64)
    starts, positions = triangle_positions(tree, len(triangles))
    return np.add.reduceat(size[positions], starts[:-1]) / np.diff(starts)


def any_hit_ray_cost(
    sah: npt.ArrayLike, point_query: npt.ArrayLike, length_ratio: float, saved: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Cost of rays that any hit ends, with nothing fitted: ``s SAH + Q - saved``.

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
    """Alpha of rays that any hit ends, without measuring any tree: ``(1 - p) / (1 - p + s)``.

    The overlap that occluded rays find at their ends is what they save: only the others pay it.

    Parameters
    ----------
    length_ratio : float
        ``s``.
    occluded : float
        ``p``, the share of the rays that hit something.
    """
    paying = 1.0 - occluded
    return paying / (paying + length_ratio) if paying + length_ratio > 0 else 0.0
