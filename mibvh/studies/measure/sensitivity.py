"""The experiment ``sensitivity``: other leaf sizes, deeper bounces, fewer viewpoints.

Everything here is by counted cost, which has no noise, so that small changes of r can be seen.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

from mibvh.builders import Context, get
from mibvh.builders.building import draft_or_tree, leaf_measure
from mibvh.builders.finish import finish
from mibvh.builders.sharing import shared_drafts
from mibvh.collapsing import nodes_in_finer
from mibvh.errors import TreeFailed, of_one_tree
from mibvh.metrics.epo import overlap
from mibvh.metrics.sah import node_costs, sah
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import Scene
from mibvh.studies.measure.cameras import cameras
from mibvh.studies.measure.counts import costs_by_origin, counted_costs
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import key_of
from mibvh.studies.measure.trees import TreeSource, with_paper_costs
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import OriginCost, Result
from mibvh.traversal.records import unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.tree import Tree
from mibvh.triangles import Triangles

#: Largest leaves that are tried, in ascending order.
LEAF_SIZES = (1, 2, 4, 8, 16)
#: Bounces that are tried, each a set of its own.
BOUNCES = 3
#: Rays that trees of other leaf sizes are counted on, at most.
_LEAF_RAYS = 262_144


@dataclasses.dataclass(frozen=True)
class LeafSize:
    """A tree whose leaves were collapsed with another largest size.

    The builder itself ran with its own: some use that while they build.

    Attributes
    ----------
    max_leaf : int
    rays : int
        How many it was counted on.
    values : dict of str to float
        ``sah, epo, counted_cost, mean_leaf_size``.
    """

    max_leaf: int
    rays: int
    values: dict[str, float]


@dataclasses.dataclass(frozen=True)
class SensitivityResult(Result, experiment="sensitivity"):
    """Costs of the trees under other choices.

    Attributes
    ----------
    leaf_sizes : list of list of LeafSize
        Of each tree one per size; none of trees that were not made by a builder's draft, or could
        not be made again.
    bounces : list of list of OriginCost
        Of each tree the costs of the rays that are deeper than the scene's ray set.
    """

    leaf_sizes: list[list[LeafSize]]
    bounces: list[list[OriginCost]]


@dataclasses.dataclass(frozen=True)
class _Sizes:
    sizes: list[LeafSize]


@dataclasses.dataclass(frozen=True)
class _Costs:
    costs: list[OriginCost]


def sensitivity_experiment(setting: Setting, report: Reporter) -> SensitivityResult:
    """Count what other leaf sizes and deeper bounces cost."""
    options, trees = setting.options, setting.trees
    share = 0.7 / len(trees)
    leaf_sizes = []
    waiting = [setting.sources[name].starts() for name in trees]
    with shared_drafts(setting.scene.triangles.digest, setting.store.folder) as drafts:
        for i, name in enumerate(trees):
            report.part(share * i, share, name)("leaf sizes", 0.0)
            drafts.want(frozenset().union(*waiting[i:]))
            piece = key_of(
                __name__,
                "mibvh.builders.building",
                builder=name,
                tree=trees.digest(name),
                rays=setting.rays.digest,
                cull=options.cull,
                sizes=LEAF_SIZES,
                most=_LEAF_RAYS,
            )
            make = functools.partial(
                _leaf_sizes, setting.sources[name], setting.scene, setting.rays, options.cull
            )
            try:
                leaf_sizes.append(setting.store.record(f"leaves-{piece}", _Sizes, make).sizes)
            except TreeFailed as error:  # of a user's builder, when it ran a second time
                report.missing(f"tree {name}", error)
                leaf_sizes.append([])
    return SensitivityResult(leaf_sizes, _bounces(setting, report.part(0.7, 0.3)))


def _leaf_sizes(source: TreeSource, scene: Scene, rays: RaySet, cull: bool) -> _Sizes:
    """Finish one builder's draft with each leaf size; return metrics and counts of the trees.

    It is the draft of the builder's tree in the base study, if that was built in this run.
    """
    triangles = scene.triangles
    if source.chosen is None:
        return _Sizes([])
    entry = get(source.chosen.builder)
    options = entry.options(**dict(source.chosen.options))
    context = Context(source=scene)
    with of_one_tree():
        draft = draft_or_tree(entry, triangles, options, context)
    if isinstance(draft, Tree):
        return _Sizes([])
    costs = {"c_inner": options.c_inner, "c_tri": options.c_tri}
    meta = {"triangles": len(triangles), "digest": triangles.digest, **costs}
    measure = leaf_measure(draft, context)

    def at_size(size: int) -> Tree:
        tree = finish(draft, **costs, max_leaf=size, meta=meta, measure=measure)
        return with_paper_costs(tree)

    # Trees are made twice, which takes no time, so that one is in memory while rays are counted.
    metrics = _metrics_of_sizes(at_size, triangles)
    some = rays.select(slice(None, None, -(-len(rays) // _LEAF_RAYS)))
    counted = _costs_of_sizes(at_size, triangles, some, cull)
    return _Sizes(
        [
            LeafSize(
                size,
                len(some),
                {
                    "sah": of_size.sah,
                    "epo": of_size.epo,
                    "counted_cost": cost,
                    "mean_leaf_size": of_size.mean_leaf_size,
                },
            )
            for size, of_size, cost in zip(LEAF_SIZES, metrics, counted, strict=True)
        ]
    )


class _Metrics(NamedTuple):
    """Metrics of a tree that need no rays."""

    sah: float
    epo: float
    mean_leaf_size: float


def _metrics_of_sizes(at_size: Callable[[int], Tree], triangles: Triangles) -> list[_Metrics]:
    """Metrics with each size.

    The nodes of a tree are some of those of the tree with the smallest leaves. How much of the
    surfaces overlaps a node does not depend on what is below it, so that is computed once.
    """
    finest = at_size(LEAF_SIZES[0])
    fraction = overlap(finest, triangles).fraction
    found = []
    for size in LEAF_SIZES:
        tree = at_size(size)
        nodes = nodes_in_finer(tree, finest)
        # A tree that was too deep had part of it rebuilt.
        of_nodes = overlap(tree, triangles).fraction if nodes is None else fraction[nodes]
        overlaps = float((node_costs(tree) * of_nodes).sum())
        found.append(_Metrics(sah(tree), overlaps, tree.stats()["mean_leaf_size"]))
    return found


def _costs_of_sizes(
    at_size: Callable[[int], Tree], triangles: Triangles, rays: RaySet, cull: bool
) -> list[float]:
    """Counted cost with each size. Large sizes often make the same tree, which is counted once."""
    tracer = Tracer(rays, float(unit_scale(triangles)), cull=cull)
    of_tree: dict[str, float] = {}
    found = []
    for size in LEAF_SIZES:
        tree = at_size(size)
        if tree.digest not in of_tree:
            of_tree[tree.digest] = float(counted_costs(tracer, tree, triangles).mean())
        found.append(of_tree[tree.digest])
    return found


def _bounces(setting: Setting, report: Reporter) -> list[list[OriginCost]]:
    """Costs of the rays of deeper bounces than those of the scene's ray set."""
    scene, trees, options = setting.scene, setting.trees, setting.options
    if setting.rays_given:
        return [[] for _ in trees]  # those of the cameras would be of another population
    choices = {**options.rays(), "bounces": max(BOUNCES, options.bounces)}
    key = key_of(
        "mibvh.rays.diffuse",
        digest=scene.triangles.digest,
        cameras=cameras(scene),
        deeper=True,
        **choices,
    )

    def deeper() -> RaySet:
        rays = diffuse_rays(scene, **choices)
        return rays.select(rays.bounce > options.bounces)

    report("rays", 0.0)
    rays = setting.store.array(RaySet, key, deeper)
    if len(rays) == 0:
        return [[] for _ in trees]
    counter = _LazyTracer(scene, rays, options.cull)
    costs = []
    for i, name in enumerate(trees):
        report.part(0.2 + 0.8 * i / len(trees), 0.8 / len(trees), name)("count", 0.0)
        code = "mibvh.studies.measure.counts"
        key = key_of(code, tree=trees.digest(name), rays=rays.digest, cull=options.cull)
        make = functools.partial(counter.count, trees, name)
        costs.append(setting.store.record(f"deeper-{key}", _Costs, make).costs)
    return costs


class _LazyTracer:
    """Rays that are copied to Dr.Jit's memory when a tree is first counted."""

    def __init__(self, scene: Scene, rays: RaySet, cull: bool) -> None:
        self._scene, self._rays, self._cull = scene, rays, cull

    @functools.cached_property
    def _tracer(self) -> Tracer:
        return Tracer(self._rays, float(unit_scale(self._scene.triangles)), cull=self._cull)

    def count(self, trees: Mapping[str, Tree], name: str) -> _Costs:
        costs = counted_costs(self._tracer, trees[name], self._scene.triangles)
        return _Costs(costs_by_origin(self._rays, costs))
