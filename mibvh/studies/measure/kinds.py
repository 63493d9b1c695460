"""The experiment ``kinds``: primary, shadow and other rays from the same viewpoints.

Everything here is by counted cost. Occlusion rays are traced by the any-hit kernel, and cost what
that visits; their lengths and ends are those of the closest hits.
"""

from __future__ import annotations

import dataclasses
import functools

from mibvh.audit.record import Check
from mibvh.audit.run import check_any_hit, check_brute_force, check_mitsuba, check_self_hits
from mibvh.errors import MibvhError
from mibvh.rays import RaySet, make_rays
from mibvh.studies.measure.cameras import cameras
from mibvh.studies.measure.counts import RayCounter
from mibvh.studies.measure.scene_digest import scene_digest
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import Store, key_of
from mibvh.studies.measure.trees import kept_counts, kept_metrics
from mibvh.studies.record.options import KINDS, weights
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Result
from mibvh.traversal.trace import release_records
from mibvh.tree import Tree
from mibvh.variant import backend, mitsuba_traces

#: Rays of a kind that are traced and counted, at most.
MOST_RAYS = 131_072


@dataclasses.dataclass(frozen=True)
class RayKind:
    """One kind of rays in one scene.

    Attributes
    ----------
    name : str
        As :func:`mibvh.make_rays` takes it.
    rays : int
        How many were counted.
    made : int
        How many there are; every k-th is counted.
    weight : float
        Its share in the mixture, up to a factor: what was asked for, or ``made``.
    occlusion : bool
        Whether any hit ends them.
    radius : float
        How far they reach, in scene units; 0 where no radius ends them.
    values : list of dict of str to float
        Of each tree, quantities by name; of occlusion rays also ``saved``, what ending at any hit
        saves by :func:`mibvh.metrics.occlusion.saved_by_any_hit`.
    audit : list of Checks
        Of each tree.
    """

    name: str
    rays: int
    made: int
    weight: float
    occlusion: bool
    radius: float
    values: list[dict[str, float]]
    audit: list[Checks]


@dataclasses.dataclass(frozen=True)
class Checks:
    """The checks of one kind of rays in one tree."""

    checks: list[Check]


@dataclasses.dataclass(frozen=True)
class KindResult(Result, experiment="kinds"):
    """Kinds of rays in a scene.

    Attributes
    ----------
    sets : list of RayKind
    left_out : dict of str to str
        Kinds of which the scene has no rays, and why.
    """

    sets: list[RayKind]
    left_out: dict[str, str]


def kind_experiment(setting: Setting, report: Reporter) -> KindResult:
    """Make the rays of each kind, and count them in all trees of a scene."""
    asked = weights(setting.options.kinds or KINDS)
    kinds: list[RayKind] = []
    left_out: dict[str, str] = {}
    for i, (name, weight) in enumerate(asked.items()):
        part = report.part(i / len(asked), 1 / len(asked))
        part("rays", 0.0)
        try:
            rays = _rays(setting, name)
        except MibvhError as error:  # of a scene without a second vertex, say
            left_out[name] = str(error)
            continue
        kinds.append(_count(setting, name, weight, rays, part))
    return KindResult(kinds, left_out)


def _rays(setting: Setting, name: str) -> RaySet:
    """Make all rays of a kind."""
    options = setting.options.rays()
    options.pop("bounces")
    key = key_of(
        "mibvh.rays.make",
        scene=scene_digest(setting.scene),
        cameras=cameras(setting.scene),
        kind=name,
        **options,
    )
    make = functools.partial(make_rays, setting.scene, name, **options)
    return setting.store.array(RaySet, key, make)


def _count(
    setting: Setting, name: str, weight: float | None, rays: RaySet, report: Reporter
) -> RayKind:
    some = rays.select(slice(None, None, -(-len(rays) // MOST_RAYS)))
    counter = RayCounter(setting.scene, some, setting.options.cull)
    share = 1 / len(setting.trees)
    values, audits = [], []
    for i, builder in enumerate(setting.trees):
        report.part(share * i, share, builder)("count", 0.0)
        of_tree, checks = _in_tree(setting.trees[builder], counter, setting.store)
        values.append(of_tree)
        audits.append(checks)
    return RayKind(
        name=name,
        rays=len(some),
        made=len(rays),
        weight=float(len(rays)) if weight is None else weight,
        occlusion=rays.occlusion,
        radius=float(rays.meta.get("radius", 0.0)),
        values=values,
        audit=audits,
    )


def _in_tree(tree: Tree, counter: RayCounter, store: Store) -> tuple[dict[str, float], Checks]:
    """Count and audit the rays in one tree."""
    metrics = kept_metrics(tree, counter.triangles, store).values
    counts = kept_counts(tree, counter, store).values
    checks = _audited(tree, counter, counts["counted_cost"], store)
    return {**{n: metrics[n] for n in ("sah", "epo")}, **counts}, checks


def _audited(tree: Tree, counter: RayCounter, cost: float, store: Store) -> Checks:
    key = key_of(
        __name__,
        "mibvh.audit.run",
        tree=tree.digest,
        digest=counter.triangles.digest,
        rays=counter.rays.digest,
        cull=counter.cull,
        backend=backend(),
        cost=cost,
    )
    return store.record(f"audit-{key}", Checks, lambda: _audit(tree, counter, cost))


def _audit(tree: Tree, counter: RayCounter, cost: float) -> Checks:
    """Check hits and counts of one kind of rays in one tree, which itself was audited before."""
    rays, hits = counter.rays, counter.hits(tree)
    closest = counter.closest_hits(tree) if rays.occlusion else hits
    again = hits.counted_cost(tree.meta["c_inner"], tree.meta["c_tri"])
    checks = [
        check_self_hits(rays, closest),
        check_brute_force(counter.triangles, rays, closest),
        *([check_mitsuba(counter.scene, rays, closest)] if mitsuba_traces() else []),
        Check.of("counts", cost, again, 1e-9 * abs(again), "counted again"),
    ]
    if rays.occlusion and not counter.cull:
        checks += check_any_hit(tree, counter.triangles, rays, hits, closest)
    release_records()
    return Checks(checks)
