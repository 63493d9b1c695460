"""Cost of single rays in a tree."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.metrics.points import point_costs, triangle_positions
from mibvh.surface import on_surface
from mibvh.traversal.kernel import walk
from mibvh.traversal.records import Records, make_records
from mibvh.tree import Tree
from mibvh.triangles import F64, I32, Triangles
from mibvh.variant import mitsuba

#: What is counted for each ray, and its description.
QUANTITIES = {
    "inner": "inner nodes visited",
    "leaves": "leaves visited",
    "triangles": "triangles tested",
    "cost": "total cost",
    "leaf_depth": "depth of the leaf that is hit",
    "overlap": "overlap at the hit point",
}


class CostProbe:
    """Counts what each ray costs in a tree.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
        What the tree was built for.
    cull : bool
        Whether to re-test popped nodes against the current hit. The paper does not.
    records : Records, optional
        The tree's records, if they exist already.
    """

    def __init__(
        self,
        tree: Tree,
        triangles: Triangles,
        cull: bool = False,
        records: Records | None = None,
    ) -> None:
        self.tree, self.triangles, self.cull = tree, triangles, cull
        self._records = records or make_records(tree, triangles)

    def __call__(self, ray: Any, active: Any) -> dict[str, npt.NDArray[Any]]:
        """Trace rays and count their steps.

        Parameters
        ----------
        ray : mitsuba.Ray3f
        active : Bool

        Returns
        -------
        dict
            An array per name in :data:`QUANTITIES`, with a value per ray, and ``hit``: whether the
            ray hits anything. Leaf depth and overlap are 0 for rays that miss. Costs are in units
            of the constants that the tree was built with.
        """
        import drjit as dr

        mi = mitsuba()
        n = max(dr.width(ray), dr.width(active))
        o = np.broadcast_to(np.array(ray.o), (3, n)).T
        d = np.broadcast_to(np.array(ray.d), (3, n)).T
        scale = self._records.scale
        outputs = walk(
            self._records,
            mi.Point3f(np.ascontiguousarray(o.T * np.float32(scale))),
            mi.Vector3f(np.ascontiguousarray(d.T)),
            mi.Float(np.broadcast_to(np.array(ray.maxt * scale), n).copy()),
            mi.Bool(np.broadcast_to(np.array(active), n).copy()),
            cull=self.cull,
            count=True,
            any_hit=False,
        )
        dr.eval(outputs)
        t, triangle, inner, leaves, tests = (np.array(column) for column in outputs[:5])
        ids = triangle.view(np.int32)
        hit = np.flatnonzero(ids >= 0)
        at = o[hit].astype(np.float64) + d[hit].astype(np.float64) * (t[hit, None] / scale)
        found = on_surface(self.triangles, at, ids[hit])
        overlap, depth = np.zeros(n), np.zeros(n)
        overlap[hit] = point_costs(self.tree, self.triangles, found, ids[hit])[:, 0]
        depth[hit] = leaf_depths(self.tree, self.triangles, found, ids[hit])
        c_inner, c_tri = self.tree.meta["c_inner"], self.tree.meta["c_tri"]
        return {
            "inner": inner,
            "leaves": leaves,
            "triangles": tests,
            "cost": c_inner * inner + c_tri * tests,
            "leaf_depth": depth,
            "overlap": overlap,
            "hit": ids >= 0,
        }


def leaf_depths(tree: Tree, triangles: Triangles, points: F64, ids: I32) -> F64:
    """Depth of the leaf in which each point of a triangle is found.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
    points : (P, 3) float64
        On the triangles.
    ids : (P,) int32
        The triangle each point is on.

    Returns
    -------
    (P,) float64
        Edges from the root to the leaf that references the triangle and whose box contains the
        point. After spatial splits there may be several: the shallowest counts.
    """
    starts, positions = triangle_positions(tree, len(triangles))
    leaves = np.flatnonzero(tree.is_leaf)
    leaves = leaves[np.argsort(tree.first[leaves])]
    leaf_at = np.repeat(leaves, tree.count[leaves])
    count = starts[ids + 1] - starts[ids]
    begin = np.cumsum(count) - count
    point = np.repeat(np.arange(len(ids)), count)
    reference = positions[np.arange(len(point)) - begin[point] + starts[ids][point]]
    leaf = leaf_at[reference]
    inside = (points[point] >= tree.lower[leaf]) & (points[point] <= tree.upper[leaf])
    # If rounding puts a point outside all its leaves, the shallowest leaf counts.
    depth = tree.depths[leaf] + np.where(inside.all(axis=1), 0, 1000)
    return np.minimum.reduceat(depth, begin) % 1000.0 if len(ids) else np.zeros(0)
