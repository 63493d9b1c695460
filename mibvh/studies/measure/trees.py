"""The pieces of a study of one scene: a tree and what it costs, kept as they are finished."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from mibvh.builders import build, get
from mibvh.metrics.epo import overlap
from mibvh.metrics.lines import RayLines, line_costs, ray_lines
from mibvh.metrics.points import RayEnds, point_costs, ray_hits, ray_starts
from mibvh.metrics.predictor import path_length_ratio
from mibvh.metrics.sah import node_costs, sah, sah_per_node
from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.options import StudyOptions
from mibvh.studies.measure.stopwatch import measure
from mibvh.studies.measure.store import Store, key_of
from mibvh.traversal.records import Records, make_records, unit_scale
from mibvh.traversal.trace import Hits, Tracer
from mibvh.tree import Tree
from mibvh.triangles import Triangles
from mibvh.variant import mitsuba

#: Groups of rays over which a tree's mean cost is kept, for the bootstrap.
_RAY_GROUPS = 64
#: Fewest rays of a portion that is timed: some hundredths of a second.
_PORTION = {"scalar": 8192, "simd": 32768}
#: Rays whose lines are followed through a tree: some microseconds each, for an error of 1%.
LINES = 10_000


def study_tree(
    name: str,
    scene: Scene,
    counter: RayCounter,
    rays_key: str,
    store: Store,
    report: Callable[[str, float], None],
) -> tuple[str, Tree, dict[str, Any]]:
    """Build, judge and count one tree. Returns its key, itself, and its row."""
    report("build", 0.0)
    key = key_of(digest=scene.triangles.digest, builder=name, code=get(name).fingerprint())
    tree = store.array(Tree, key, functools.partial(build, scene.triangles, name))
    report("metrics", 0.5)
    row = store.kept(f"metrics-{key}", functools.partial(tree_metrics, tree, scene))
    report("count", 0.8)
    counts_key = key_of(tree=key, rays=rays_key, cull=counter.cull, lines=LINES, format=3)
    counts = store.kept(f"counts-{counts_key}", functools.partial(counter, tree))
    return key, tree, {"builder": name, **row, **counts}


def report_part(
    report: Callable[[str, float], None],
    name: str,
    begin: float,
    share: float,
    stage: Any,
    done: float,
) -> None:
    """Pass the progress of a part on as that of the whole."""
    report(f"{stage} {name}", begin + share * done)


def cameras(scene: Scene) -> list[Any]:
    """What the rays depend on besides the triangles: where some camera rays start and go."""
    mi = mitsuba()
    x, y = mi.Float([0.1, 0.9, 0.5, 0.1, 0.9]), mi.Float([0.1, 0.1, 0.5, 0.9, 0.9])
    rays = [s.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(y, x))[0] for s in scene.sensors]
    return [[np.array(ray.o).tolist(), np.array(ray.d).tolist()] for ray in rays]


def tree_metrics(tree: Tree, scene: Scene) -> dict[str, Any]:
    """SAH and EPO of a tree, in total and by depth, and its statistics."""
    found = overlap(tree, scene.triangles)
    sah_share, epo_share = sah_per_node(tree), node_costs(tree) * found.fraction
    depth_count = tree.depth + 1
    inner, sizes = ~tree.is_leaf, tree.count * tree.is_leaf
    ratio = sah_per_node(tree, 1.0, 1.0) / np.where(tree.is_leaf, tree.count, 1)
    fragments = found.fraction
    if tree.splits_triangles:
        fragments = overlap(tree, scene.triangles, fragments=True).fraction
    return {
        **tree.stats(),
        # With the cost constants left out, so that others can be tried: C_inner times the first
        # plus C_tri times the second.
        "sah_parts": [float(ratio[inner].sum()), float((ratio * sizes).sum())],
        "epo_parts": [float(found.fraction[inner].sum()), float((found.fraction * sizes).sum())],
        "epo_fragments": float((node_costs(tree) * fragments).sum()),
        "build_seconds": tree.meta["build_seconds"],
        "sah": float(sah_share.sum()),
        "epo": float(epo_share.sum()),
        "epo_pairs": found.pairs,
        "sah_by_depth": np.bincount(tree.depths, sah_share, depth_count).tolist(),
        "epo_by_depth": np.bincount(tree.depths, epo_share, depth_count).tolist(),
        "c_inner": tree.meta["c_inner"],
        "c_tri": tree.meta["c_tri"],
        "options": tree.meta["options"],
        "build_report": tree.meta["report"],
    }


class RayCounter:
    """The rays of a scene, to be counted in any number of its trees.

    What does not depend on the tree is prepared when it is first needed, and kept: a study that
    goes on from what it has kept needs none of it.

    Parameters
    ----------
    scene : Scene
    rays : RaySet
    cull : bool
        Re-test popped nodes.
    """

    def __init__(self, scene: Scene, rays: RaySet, cull: bool) -> None:
        self.triangles, self.rays, self.cull = scene.triangles, rays, cull
        self._paths: RayPaths | None = None

    @functools.cached_property
    def tracer(self) -> Tracer:
        """The rays in Dr.Jit's memory."""
        return Tracer(self.rays, float(unit_scale(self.triangles)), cull=self.cull)

    @functools.cached_property
    def starts(self) -> RayEnds:
        """Where the rays begin."""
        return ray_starts(self.triangles, self.rays)

    def paths(self, hits: Hits) -> RayPaths:
        """Where the rays go, made anew only where a tree's hits are not those of the last.

        Trees agree on hits but for ties: rays that meet two triangles at one distance.
        """
        if self._paths is None or not self._paths.are_of(hits):
            self._paths = RayPaths.of(self.triangles, self.rays, hits)
        return self._paths

    def __call__(self, tree: Tree) -> dict[str, Any]:
        """Count the rays in a tree, its point queries at their ends, and their lines."""
        hits = self.tracer.hits(make_records(tree, self.triangles))
        c_inner, c_tri = tree.meta["c_inner"], tree.meta["c_tri"]
        costs = c_inner * hits.inner + c_tri * hits.tests
        group = np.arange(len(self.rays)) % _RAY_GROUPS
        sums = np.bincount(group, costs, _RAY_GROUPS)
        counted = np.maximum(np.bincount(group, minlength=_RAY_GROUPS), 1)
        paths, starts = self.paths(hits), self.starts
        at_starts = point_costs(tree, self.triangles, starts.points, starts.triangle)
        at_ends = point_costs(tree, self.triangles, paths.ends.points, paths.ends.triangle)
        # None in a flat scene: no ray has a part inside its box.
        inside = np.count_nonzero(paths.lines.share)
        of_lines = sah(tree, ray_lines=paths.lines) if inside > 1 else None
        return {
            **hits.counters(),
            "counted_cost": hits.counted_cost(c_inner, c_tri),
            "cost_groups": (sums / counted).tolist(),
            "costs_by_origin": costs_by_origin(self.rays, costs),
            "leaf_distribution": np.bincount(hits.leaves).tolist(),
            "epo_starts": float(at_starts[:, 0].mean()),
            "epo_starts_error": _standard_error(at_starts[:, 0]),
            "epo_ends": float(at_ends[:, 0].mean()) if len(paths.ends) else 0.0,
            "point_query": float(at_starts.sum(axis=1).mean()),
            "sah_lines": of_lines.value if of_lines else float("nan"),
            "sah_lines_error": of_lines.standard_error if of_lines else float("nan"),
            "line_share": float(paths.lines.share.mean()),
            "touched": float(line_costs(tree, paths.lines, whole=False).mean()),
            "hit_share": paths.ends.share,
            "length_ratio": paths.length_ratio,
        }


@dataclasses.dataclass(frozen=True, eq=False)
class RayPaths:
    """Where the rays of a set go, by the hits in some tree.

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
        """Find them from the hits."""
        return cls(
            hits,
            ray_hits(triangles, rays, hits),
            ray_lines(triangles, rays, hits, LINES),
            path_length_ratio(triangles, rays, hits),
        )

    def are_of(self, hits: Hits) -> bool:
        """Whether other hits lead to the same paths."""
        return np.array_equal(self.hits.t, hits.t) and np.array_equal(
            self.hits.triangle, hits.triangle
        )


def costs_by_origin(rays: RaySet, costs: np.ndarray) -> list[dict[str, Any]]:
    """Mean cost of the rays of each bounce and viewpoint.

    Parameters
    ----------
    rays : RaySet
    costs : (R,) array

    Returns
    -------
    list of dict
        ``bounce, viewpoint, rays, cost``, for each pair that has rays.
    """
    bounce, viewpoint = rays.bounce.astype(np.int64), rays.viewpoint.astype(np.int64)
    group = bounce * (viewpoint.max(initial=0) + 1) + viewpoint
    count, sums = np.bincount(group), np.bincount(group, costs)
    _, first = np.unique(group, return_index=True)
    return [
        {
            "bounce": int(bounce[i]),
            "viewpoint": int(viewpoint[i]),
            "rays": int(count[group[i]]),
            "cost": float(sums[group[i]] / count[group[i]]),
        }
        for i in first
    ]


def counted_costs(tracer: Tracer, tree: Tree, triangles: Triangles) -> np.ndarray:
    """(R,) float64: what each ray costs by the counters; nothing is timed."""
    outputs, _ = tracer.run(make_records(tree, triangles), count=True)
    inner, tests = (tracer.fetch(outputs[i]).astype(np.float64) for i in (2, 4))
    return tree.meta["c_inner"] * inner + tree.meta["c_tri"] * tests


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def times(
    trees: list[Tree],
    scene: Scene,
    rays: RaySet,
    lanes: Any,
    options: StudyOptions,
    report: Callable[[str, float], None],
) -> dict[str, Any]:
    """Time all trees of a scene, and the first one a second time under another name."""
    rays = timed_rays(rays, lanes, options)
    tracers = portions(rays, scene, lanes, options)
    records = [make_records(tree, scene.triangles) for tree in trees]
    again = make_records(trees[0], scene.triangles)
    launches = [functools.partial(launch, tracers, r) for r in [*records, again]]
    timings = measure(
        launches,
        portions=len(tracers),
        seconds=options.seconds,
        standard_error=options.standard_error,
        progress=functools.partial(report, "time"),
    )
    ns = timings.estimate / len(rays) * 1e9
    return {
        "ns": ns[:-1].tolist(),
        "error": timings.relative_error[:-1].tolist(),
        "rounds": len(timings.seconds),
        "complete": timings.complete,
        "rays": len(rays),
        "portions": len(tracers),
        "repeat_difference": float(ns[-1] / ns[0] - 1),
    }


def timed_rays(rays: RaySet, lanes: Any, options: StudyOptions) -> RaySet:
    """The rays that are timed: all, or with one lane per packet every so-many-eth."""
    step = -(-len(rays) // options.scalar_rays) if lanes == "scalar" else 1
    return rays.select(slice(None, None, step))


def portions(rays: RaySet, scene: Scene, lanes: Any, options: StudyOptions) -> list[Tracer]:
    """Split rays into runs of neighbours that are long enough to be timed; at most eight."""
    count = min(max(len(rays) // _PORTION[lanes], 1), 8)
    ends = np.linspace(0, len(rays), count + 1).astype(int)
    scale = float(unit_scale(scene.triangles))
    return [
        Tracer(rays.select(slice(begin, end)), scale, lanes, cull=options.cull)
        for begin, end in itertools.pairwise(ends)
    ]


def launch(tracers: list[Tracer], records: Records, portion: int) -> float:
    """Trace a portion of the rays; return the kernel time in seconds."""
    return tracers[portion].run(records)[1]
