"""Point queries: what it costs to find a point on a surface, and how much of that is overlap.

Estimators of EPO that need no clipping: they use points drawn on the surfaces, or the points
where rays begin and end. They share no geometry with the exact walk of :mod:`mibvh.metrics.epo`.
"""

from __future__ import annotations

import dataclasses
import statistics
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.errors import MibvhError
from mibvh.metrics.sah import node_costs
from mibvh.parallel import run_blocks
from mibvh.surface import on_surface, points_on
from mibvh.tree import Tree
from mibvh.triangles import F64, I32, Triangles, as_triangles
from mibvh.wide_tree import BinaryView, WideTree, as_binary

_BLOCK = 4096


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A mean over points, with its standard error.

    Attributes
    ----------
    value, standard_error : float
        In units of the cost constants.
    points : int
        Number of points averaged.
    """

    value: float
    standard_error: float
    points: int

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a normally distributed mean."""
        reach = statistics.NormalDist().inv_cdf(0.5 + confidence / 2) * self.standard_error
        return self.value - reach, self.value + reach


class Nodes(NamedTuple):
    """A tree's arrays as a query reads them."""

    lower: Any
    upper: Any
    left: Any
    first: Any
    count: Any
    depth: int
    cost: Any  #: (M,) float64: what each node adds to the sums


class Held(NamedTuple):
    """Positions of each triangle's references, from :func:`triangle_positions`."""

    starts: Any
    positions: Any


@njit
def _query(begin, end, points, ids, held, nodes, out):
    """Cost of the nodes that hold each point: out[:, 0] foreign ones, out[:, 1] the point's own."""
    starts, positions = held
    lower, upper, left, first, count, depth, cost = nodes
    stack = np.empty(depth + 2, np.int32)
    for i in range(begin, end):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        t = ids[i]
        foreign = own = 0.0
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            if (
                x < lower[node, 0]
                or y < lower[node, 1]
                or z < lower[node, 2]
                or x > upper[node, 0]
                or y > upper[node, 1]
                or z > upper[node, 2]
            ):
                continue
            mine = False
            for k in range(starts[t], starts[t + 1]):
                if 0 <= positions[k] - first[node] < count[node]:
                    mine = True
            if mine:
                own += cost[node]
            else:
                foreign += cost[node]
            if left[node] >= 0:
                stack[top] = left[node]
                stack[top + 1] = left[node] + 1
                top += 2
        out[i, 0] = foreign
        out[i, 1] = own


def triangle_positions(tree: Tree | WideTree, triangles: int) -> tuple[Any, Any]:
    """Positions of each triangle's references in leaf order.

    Returns
    -------
    starts : (triangles + 1,) int64
    positions : (R,) int32
        Those of triangle ``t`` are ``positions[starts[t]:starts[t + 1]]``, ascending.
    """
    starts = np.zeros(triangles + 1, np.int64)
    np.cumsum(np.bincount(tree.references, minlength=triangles), out=starts[1:])
    return starts, _sorted_positions(tree.references, starts[:-1].copy())


@njit
def _sorted_positions(references, place):
    """Sort by counting: ``place`` tells where each triangle's next position goes."""
    positions = np.empty(len(references), np.int32)
    for i in range(len(references)):
        t = references[i]
        positions[place[t]] = i
        place[t] += 1
    return positions


def point_costs(tree: Tree | WideTree, triangles: Any, points: F64, ids: I32) -> F64:
    """Cost of a point query at each point.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
        What the tree was built for.
    points : (P, 3) float64
        On the triangles.
    ids : (P,) int32
        The triangle each point is on.

    Returns
    -------
    (P, 2) float64
        Cost of the foreign nodes that contain the point (the overlap), and of the point's own
        nodes, which have a reference to its triangle below them. In units of the cost constants.

    Raises
    ------
    MibvhError
        If the tree was built for another geometry, or points and ids do not match each other
        or the triangles.
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    points, ids = np.asarray(points, np.float64), np.asarray(ids)
    if points.ndim != 2 or points.shape[1] != 3 or ids.shape != points.shape[:1]:
        raise MibvhError(
            f"point costs take (P, 3) points and (P,) ids, not {points.shape} and {ids.shape}"
        )
    if ids.dtype.kind not in "iu" or (
        len(ids) and not 0 <= ids.min() <= ids.max() < len(triangles)
    ):
        raise MibvhError(f"ids of points must be integers from 0 to {len(triangles) - 1}")
    ids = ids.astype(np.int32)
    starts, positions = triangle_positions(tree, len(triangles))
    tree = as_binary(tree)
    return _sums(tree, points, ids, starts, positions, node_costs(tree))


def weight_at(tree: Tree | WideTree, points: F64, weights: F64) -> F64:
    """Sum of the weights of the nodes whose closed box contains a point, anywhere in space.

    Parameters
    ----------
    tree : Tree or WideTree
    points : (P, 3) float64
    weights : (M,) float64
        One per node. Ones count the nodes; :func:`mibvh.metrics.sah.node_costs` gives the cost
        of a point query.

    Returns
    -------
    (P,) float64
    """
    tree.check()
    tree = as_binary(tree)
    if isinstance(tree, BinaryView):
        weights = tree.spread(weights)
    # A point that belongs to a triangle without references has foreign nodes only.
    nobody, starts = np.zeros(len(points), np.int32), np.zeros(2, np.int64)
    return _sums(tree, points, nobody, starts, np.zeros(0, np.int32), weights)[:, 0]


def _sums(
    tree: Tree, points: F64, ids: I32, starts: npt.NDArray[np.int64], positions: I32, weights: F64
) -> F64:
    """(P, 2) float64: weights of the foreign nodes around each point, and of the point's own."""
    out = np.zeros((len(points), 2))
    held = Held(starts, positions)
    nodes = Nodes(tree.lower, tree.upper, tree.left, tree.first, tree.count, tree.depth, weights)

    def work(_worker: int, begin: int, end: int) -> None:
        _query(begin, end, points, ids, held, nodes, out)

    run_blocks(work, len(points), _BLOCK)
    return out


def estimate_epo(tree: Tree | WideTree, triangles: Any, samples: int, seed: int = 0) -> Estimate:
    """Estimate EPO from points on the surfaces, stratified by area.

    The surfaces are ordered like the tree's references and cut into ``samples / 2`` strata of
    equal area. Each stratum gets two points, whose differences give the standard error.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
    samples : int
        Number of points, at least 4; an odd number is rounded down.
    seed : int

    Returns
    -------
    Estimate

    Raises
    ------
    MibvhError
        For fewer than four points, or if the tree was built for another geometry.
    """
    if samples < 4:
        raise MibvhError(f"an estimate of EPO needs at least 4 points, not {samples}")
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    rng = np.random.default_rng(seed)
    _, first = np.unique(tree.references, return_index=True)
    order = tree.references[np.sort(first)]
    reach = np.cumsum(triangles.areas[order])
    if not reach[-1] > 0:
        return Estimate(0.0, 0.0, samples)
    strata = samples // 2
    at = (np.repeat(np.arange(strata), 2) + rng.random(2 * strata)) / strata * reach[-1]
    place = np.minimum(np.searchsorted(reach, at, side="right"), len(order) - 1)
    ids = order[place].astype(np.int32)
    points = points_on(triangles, ids, seed + 1)
    foreign = point_costs(tree, triangles, points, ids)[:, 0].reshape(strata, 2)
    within = 0.5 * (foreign[:, 0] - foreign[:, 1]) ** 2  # variance of one point of the stratum
    error = float(np.sqrt(within.sum() / 2) / strata)
    return Estimate(float(foreign.mean()), error, 2 * strata)


@dataclasses.dataclass(frozen=True, eq=False)
class RayEnds:
    """Where rays begin or end: points on triangles.

    Attributes
    ----------
    points : (P, 3) float64
    triangle : (P,) int32
    rays : int
        Number of rays they belong to. There are fewer points where some rays have no such end.
    """

    points: F64
    triangle: I32
    rays: int

    def __len__(self) -> int:
        return len(self.triangle)

    @property
    def share(self) -> float:
        """Share of the rays that have such an end."""
        return len(self) / self.rays

    def joined(self, other: RayEnds) -> RayEnds:
        """Join two sets of ends of the same rays."""
        return RayEnds(
            np.concatenate([self.points, other.points]),
            np.concatenate([self.triangle, other.triangle]),
            max(self.rays, other.rays),
        )

    def density(self, triangles: Triangles, pseudo: float = 1.0, group: int = 32) -> F64:
        """Ends per area on each triangle, smoothed where few rays reach.

        The density is the posterior mean under a gamma prior that is worth ``pseudo`` ends at
        the density of the triangle's neighbourhood: ``(n + pseudo) / (area + pseudo /
        neighbourhood)``. Triangles with many ends keep their own density; triangles without
        any take that of their neighbours. A neighbourhood is a run of triangles along a Morton
        curve with at least ``group`` ends.

        Parameters
        ----------
        triangles : Triangles
        pseudo : float
            Weight of the neighbourhood, in ends.
        group : int
            Least number of ends per neighbourhood.

        Returns
        -------
        (N,) float64
            Ends per unit of area; 0 for triangles without area.
        """
        from mibvh.morton import morton_codes

        hits = np.bincount(self.triangle, minlength=len(triangles)).astype(np.float64)
        order = np.argsort(morton_codes(triangles.lower, triangles.upper), kind="stable")
        run = ((np.cumsum(hits[order]) - hits[order]) // group).astype(np.int64)
        run = np.unique(run, return_inverse=True)[1]
        area = triangles.areas[order]
        run_area = np.bincount(run, area)
        around = np.bincount(run, hits[order]) / np.maximum(run_area, 1e-300)
        overall = len(self) / max(float(triangles.areas.sum()), 1e-300)
        prior = np.maximum(around[run], 1e-6 * overall)
        density = np.zeros(len(triangles))
        density[order] = (hits[order] + pseudo) / (area + pseudo / prior)
        density[triangles.areas == 0] = 0.0
        return density


def ray_ends(triangles: Any, rays: Any, hits: Any) -> tuple[RayEnds, RayEnds]:
    """Where the rays of a set begin, and where they end.

    Parameters
    ----------
    triangles : Triangles or (N, 3, 3) array
    rays : RaySet
        With the triangle that each ray leaves (``source``).
    hits : Hits
        Of these rays, from any tree.

    Returns
    -------
    starts, ends : RayEnds
        Starts of the rays that leave a triangle, and ends of those that hit one.

    Raises
    ------
    MibvhError
        If the hits are not as many as the rays, or a triangle is none of the scene's.
    """
    return ray_starts(triangles, rays), ray_hits(triangles, rays, hits)


def ray_starts(triangles: Any, rays: Any) -> RayEnds:
    """Where those rays of a set begin that leave triangles; see :func:`ray_ends`."""
    left_from = np.flatnonzero(rays.source >= 0)
    return _ray_ends(triangles, rays.o[left_from], rays.source[left_from], len(rays))


def ray_hits(triangles: Any, rays: Any, hits: Any) -> RayEnds:
    """Where those rays of a set end that hit something; see :func:`ray_ends`."""
    if len(hits.t) != len(rays):
        raise MibvhError(f"there are {len(rays)} rays, and hits of {len(hits.t)}")
    hit = np.flatnonzero(hits.triangle >= 0)
    at = rays.o[hit].astype(np.float64) + rays.d[hit].astype(np.float64) * hits.t[hit, None]
    return _ray_ends(triangles, at, hits.triangle[hit], len(rays))


def _ray_ends(triangles: Any, near: Any, ids: I32, rays: int) -> RayEnds:
    triangles = as_triangles(triangles)
    if len(ids) and int(ids.max()) >= len(triangles):
        raise MibvhError(
            f"a ray begins or ends on triangle {int(ids.max())}, and {triangles.name} has "
            f"{len(triangles)}: the rays or hits are of another geometry"
        )
    points = on_surface(triangles, near, ids)
    return RayEnds(points, np.ascontiguousarray(ids, np.int32), rays)


def epo_at_ends(tree: Tree | WideTree, triangles: Any, ends: RayEnds) -> Estimate:
    """Extra cost of a point query where rays really end, instead of evenly over all surfaces.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles or (N, 3, 3) array
    ends : RayEnds
        From :func:`ray_ends`.

    Returns
    -------
    Estimate
        Mean over the ends. Multiply by ``ends.share`` for the cost per ray.

    Raises
    ------
    MibvhError
        If there are fewer than two ends, or the tree was built for another geometry.
    """
    if len(ends) < 2:
        raise MibvhError(f"there are {len(ends)} ray ends, too few to average over")
    foreign = point_costs(tree, triangles, ends.points, ends.triangle)[:, 0]
    error = float(foreign.std(ddof=1) / np.sqrt(len(foreign)))
    return Estimate(float(foreign.mean()), error, len(foreign))
