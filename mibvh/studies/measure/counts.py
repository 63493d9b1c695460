"""The counted cost of rays in a tree, which is free of noise."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from mibvh.errors import MibvhError
from mibvh.metrics.lines import RayLines, line_costs, ray_lines, sah_of_lines
from mibvh.metrics.occlusion import saved_by_any_hit
from mibvh.metrics.points import RayEnds, point_costs, ray_hits, ray_starts, weight_at
from mibvh.metrics.predictor import path_length_ratio
from mibvh.metrics.sah import node_costs
from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.warps import WarpCounter, WarpRules
from mibvh.studies.record.scene import OriginCost
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.styles import find_style
from mibvh.traversal.trace import Hits, Tracer
from mibvh.tree import Tree
from mibvh.triangles import F32, F64, I32, Triangles
from mibvh.wide_tree import WideTree

#: Groups of rays over which a tree's mean cost is kept, for the bootstrap.
_RAY_GROUPS = 64
#: Rays whose lines are followed through a tree: some microseconds each, for an error of 1%.
LINES = 10_000
#: Of the cost of a ray, where a tree's ``meta`` has them.
_CONSTANTS = ("c_inner", "c_tri", "c_box")
#: What a traversal counts, as it is.
_COUNTERS = (
    "inner_per_ray",
    "leaves_per_ray",
    "triangles_per_ray",
    "lcv",
    "inner_deviation",
    "steps_deviation",
    "lane_utilisation",
)


def lines_of(rays: int) -> int:
    """Return of how many rays the lines are followed: of every k-th."""
    return -(-rays // max(1, -(-rays // LINES)))


@dataclasses.dataclass(frozen=True)
class Counts:
    """Counts of a scene's rays in one tree; see :class:`TreeRow`."""

    values: dict[str, float]
    cost_groups: list[float]
    costs_by_origin: list[OriginCost]
    leaf_distribution: list[int]


class RayCounter:
    """Counts the rays of a scene in its trees.

    What does not depend on the tree is prepared when it is first needed and cached: a study that
    goes on from its store needs none of it. Occlusion rays are traced by the any-hit kernel, and
    their ends and lines are those of the closest hits in the first tree.

    Parameters
    ----------
    scene : Scene
    rays : RaySet
    cull : bool
        Re-test popped nodes.
    rules : WarpRules
        Of the warps that are simulated.
    """

    def __init__(
        self, scene: Scene, rays: RaySet, cull: bool, rules: WarpRules | None = None
    ) -> None:
        self.scene, self.triangles, self.rays, self.cull = scene, scene.triangles, rays, cull
        self.warps = WarpCounter(scene.triangles, rays, rules or WarpRules())
        self._paths: RayPaths | None = None
        self._closest: Hits | None = None

    @functools.cached_property
    def tracer(self) -> Tracer:
        """The rays in Dr.Jit's memory."""
        return self._tracer("single", any_hit=self.rays.occlusion)

    @functools.cached_property
    def wide_tracer(self) -> Tracer:
        """The same for wide trees, whose kernel does not re-test popped nodes."""
        return self._tracer("wide", any_hit=self.rays.occlusion)

    def _tracer(self, style: str, *, any_hit: bool) -> Tracer:
        cull = self.cull and style == "single"
        scale = float(unit_scale(self.triangles))
        return Tracer(self.rays, scale, style=style, cull=cull, any_hit=any_hit)

    @functools.cached_property
    def starts(self) -> RayEnds:
        """Start points of the rays."""
        return ray_starts(self.triangles, self.rays)

    def hits(self, tree: Tree | WideTree) -> Hits:
        """Trace the rays once, with counters."""
        tracer = self.wide_tracer if isinstance(tree, WideTree) else self.tracer
        return tracer.hits(make_records(tree, self.triangles, tracer.layout))

    def closest_hits(self, tree: Tree) -> Hits:
        """The closest hits of occlusion rays, in the first tree that is asked for."""
        if self._closest is None:
            tracer = self._tracer("single", any_hit=False)
            self._closest = tracer.hits(make_records(tree, self.triangles))
        return self._closest

    def paths(self, hits: Hits) -> RayPaths:
        """Ends and lines of the rays, recomputed only where hits differ from the last tree's.

        Trees agree on hits but for ties: rays that meet two triangles at one distance.
        """
        if self._paths is None:
            self._paths = RayPaths.of(self.triangles, self.rays, hits)
        else:
            self._paths = self._paths.with_hits(self.triangles, self.rays, hits)
        return self._paths

    def __call__(self, tree: Tree | WideTree) -> Counts:
        """Count the rays in a tree, with point queries at their ends and with their lines."""
        hits = self.hits(tree)
        constants = {name: tree.meta[name] for name in _CONSTANTS if name in tree.meta}
        costs = hits.costs(**constants)
        group = np.arange(len(self.rays)) % _RAY_GROUPS
        sums = np.bincount(group, costs, _RAY_GROUPS)
        size = np.maximum(np.bincount(group, minlength=_RAY_GROUPS), 1)
        values = _counters(hits)
        values["boxes_per_ray"] = float(hits.boxes.mean())
        values["counted_cost"] = hits.counted_cost(**constants)
        values["cost_deviation"] = float(costs.std())
        closest = hits
        if self.rays.occlusion:
            if isinstance(tree, WideTree):
                raise MibvhError("a study counts occlusion rays in binary trees alone")
            closest = self.closest_hits(tree)
            values["saved"] = saved_by_any_hit(tree, self.triangles, self.rays, closest)
        paths = self.paths(closest)
        return Counts(
            values={**values, **self._ends(tree, paths), **self._lines(tree, paths)},
            cost_groups=(sums / size).tolist(),
            costs_by_origin=costs_by_origin(self.rays, costs),
            leaf_distribution=np.bincount(hits.leaves).tolist(),
        )

    def _ends(self, tree: Tree | WideTree, paths: RayPaths) -> dict[str, float]:
        """Costs of point queries at the rays' starts and ends."""
        starts, ends = self.starts, paths.ends
        at_starts = point_costs(tree, self.triangles, starts.points, starts.triangle)
        at_ends = point_costs(tree, self.triangles, ends.points, ends.triangle)
        query = float(at_starts.sum(axis=1).mean()) if len(starts) else self._away(tree)
        return {
            # Given rays need not tell where they start.
            "epo_starts": float(at_starts[:, 0].mean()) if len(starts) else float("nan"),
            "epo_starts_error": _standard_error(at_starts[:, 0]),
            "epo_ends": float(at_ends[:, 0].mean()) if len(ends) else 0.0,
            "point_query": query,
            "hit_share": ends.share,
        }

    def _away(self, tree: Tree | WideTree) -> float:
        """Point query at the cameras; NaN of rays that do not tell where they start."""
        if self.rays.kind != "primary":
            return float("nan")
        at = weight_at(tree, self.rays.o.astype(np.float64), node_costs(tree))
        return float(at.mean())

    def _lines(self, tree: Tree | WideTree, paths: RayPaths) -> dict[str, float]:
        """SAH on the rays' own lines, and how long the rays are."""
        # None in a flat scene: no ray has a part inside its box.
        inside = np.count_nonzero(paths.lines.share)
        of_lines = sah_of_lines(tree, paths.lines) if inside > 1 else None
        return {
            "sah_lines": of_lines.value if of_lines else float("nan"),
            "sah_lines_error": of_lines.standard_error if of_lines else float("nan"),
            "line_share": float(paths.lines.share.mean()),
            "touched": float(line_costs(tree, paths.lines, whole=False).mean()),
            "length_ratio": paths.length_ratio,
        }


@dataclasses.dataclass(frozen=True, eq=False)
class RayPaths:
    """Ends and lines of the rays, computed from the hits in some tree.

    Attributes
    ----------
    hits : Hits
    ends : RayEnds
        Of those that hit something.
    lines : RayLines
        Of some of the rays.
    length_ratio : float
        See :func:`mibvh.metrics.predictor.path_length_ratio`.
    """

    hits: Hits
    ends: RayEnds
    lines: RayLines
    length_ratio: float

    @classmethod
    def of(cls, triangles: Triangles, rays: RaySet, hits: Hits) -> RayPaths:
        """Compute them from the hits."""
        return cls(
            hits,
            ray_hits(triangles, rays, hits),
            ray_lines(triangles, rays, hits, LINES),
            path_length_ratio(triangles, rays, hits),
        )

    def with_hits(self, triangles: Triangles, rays: RaySet, hits: Hits) -> RayPaths:
        """Return the paths of other hits of the rays: the same as :meth:`of` would.

        At the same distances, only rays that hit another triangle end elsewhere: in its plane.
        """
        hit = hits.triangle >= 0
        if not np.array_equal(self.hits.t, hits.t) or not np.array_equal(
            self.hits.triangle >= 0, hit
        ):
            return RayPaths.of(triangles, rays, hits)
        changed = np.flatnonzero(self.hits.triangle != hits.triangle)
        if len(changed) == 0:
            return self
        some = _SomeHits(hits.t[changed], hits.triangle[changed])
        moved = ray_hits(triangles, rays.select(changed), some)
        place = np.searchsorted(np.flatnonzero(hit), changed)
        points, triangle = self.ends.points.copy(), self.ends.triangle.copy()
        points[place], triangle[place] = moved.points, moved.triangle
        ends = RayEnds(points, triangle, self.ends.rays)
        return dataclasses.replace(self, hits=hits, ends=ends)


class _SomeHits(NamedTuple):
    """Where some rays end."""

    t: F32
    triangle: I32


def _counters(hits: Hits) -> dict[str, float]:
    """Return the counters of a traversal by the names of the study's quantities."""
    counters, prefix = hits.counters(), find_style(hits.style).prefix
    of_tree = {name.removeprefix(prefix): value for name, value in counters.items()}
    return {name: float(of_tree[name]) for name in _COUNTERS}


def costs_by_origin(rays: RaySet, costs: F64) -> list[OriginCost]:
    """Mean cost of the rays of each bounce and viewpoint.

    Parameters
    ----------
    rays : RaySet
    costs : (R,) float64

    Returns
    -------
    list of OriginCost
        One for each pair of bounce and viewpoint that has rays.
    """
    bounce, viewpoint = rays.bounce.astype(np.int64), rays.viewpoint.astype(np.int64)
    group = bounce * (viewpoint.max(initial=0) + 1) + viewpoint
    count, sums = np.bincount(group), np.bincount(group, costs)
    _, first = np.unique(group, return_index=True)
    return [
        OriginCost(
            bounce=int(bounce[i]),
            viewpoint=int(viewpoint[i]),
            rays=int(count[group[i]]),
            cost=float(sums[group[i]] / count[group[i]]),
        )
        for i in first
    ]


def counted_costs(tracer: Tracer, tree: Tree, triangles: Triangles) -> F64:
    """Return (R,) float64: the counted cost of each ray; nothing is timed."""
    outputs, _ = tracer.run(make_records(tree, triangles), count=True)
    counted = (outputs.inner, outputs.tests)
    inner, tests = (tracer.fetch(column).astype(np.float64) for column in counted)
    return np.asarray(tree.meta["c_inner"] * inner + tree.meta["c_tri"] * tests)


def _standard_error(values: F64) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")
