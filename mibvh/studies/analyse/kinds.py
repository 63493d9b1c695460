"""Results for kinds of rays, and for their mixture."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import Predictor, Sample, alpha_of, predictors
from mibvh.metrics.predictors.occlusion import PREDICTORS
from mibvh.studies.measure.kinds import KindResult, RayKind
from mibvh.studies.record.scene import Records
from mibvh.triangles import F64

_TARGET = "counted_cost"
#: What all kinds together are called.
MIXED = "mixed"
#: Quantities whose mean over the rays of all kinds is that of the kinds' means.
_MEANS = (
    "sah",
    "epo",
    "length_ratio",
    "point_query",
    "touched",
    "hit_share",
    "saved",
    "blocked",
    _TARGET,
)


def kind_predictors() -> tuple[Predictor, ...]:
    """Return all predictors, and those for rays that any hit ends."""
    return (*predictors(), *PREDICTORS)


def kind_results(records: Records) -> dict[str, KindResult]:
    """Return the results of the scenes that have this experiment, by the scene's name."""
    results = {record.scene: record.result(KindResult) for record in records}
    return {scene: found for scene, found in results.items() if found and found.sets}


def kind_samples(found: KindResult) -> dict[str, Sample]:
    """Return a scene's sample for each kind of rays, and for their mixture if there are several."""
    columns = {kind.name: _columns(kind) for kind in found.sets}
    if len(columns) > 1:
        columns[MIXED] = _mixture(found.sets, list(columns.values()))
    return {name: Sample(values, values[_TARGET]) for name, values in columns.items()}


def _columns(kind: RayKind) -> dict[str, F64]:
    names = set.intersection(*(set(values) for values in kind.values))
    columns = {n: np.array([v[n] for v in kind.values], np.float64) for n in sorted(names)}
    if kind.occlusion:
        columns["blocked"] = columns["hit_share"]
    return columns


def _mixture(kinds: list[RayKind], columns: list[dict[str, F64]]) -> dict[str, F64]:
    """Means over the rays of all kinds; kinds without a quantity of any-hit rays count as 0."""
    share = np.array([kind.weight for kind in kinds])
    share /= share.sum()
    zero = np.zeros_like(columns[0][_TARGET])
    return {
        name: np.sum([w * c.get(name, zero) for w, c in zip(share, columns, strict=True)], axis=0)
        for name in _MEANS
        if name in ("saved", "blocked") or all(name in c for c in columns)
    }


def kind_correlations(records: Records) -> pd.DataFrame:
    """Agreement of each predictor with counted cost, per scene and kind of rays.

    Returns
    -------
    DataFrame
        Columns ``scene, kind, predictor, alpha, pearson`` and ``level``: predicted over counted
        cost, mean over the trees. Empty where no kinds were made.
    """
    results = {scene: kind_samples(found) for scene, found in kind_results(records).items()}
    rows = []
    for kind in _kinds_of(records):
        scenes = [scene for scene in results if kind in results[scene]]
        known = [results[scene][kind] for scene in scenes]
        for place, scene in enumerate(scenes):
            for one in kind_predictors():
                if not one.knows(known[place].values):
                    continue
                weights, values = one(known, place)
                measured = known[place].measured
                rows.append(
                    {
                        "scene": scene,
                        "kind": kind,
                        "predictor": one.name,
                        "alpha": alpha_of(weights),
                        "pearson": pearson(values, measured),
                        "level": float(np.mean(values / measured)) if measured.all() else np.nan,
                    }
                )
    return pd.DataFrame(rows, columns=["scene", "kind", "predictor", "alpha", "pearson", "level"])


def _kinds_of(records: Records) -> list[str]:
    """Return the kinds of rays of all scenes in the requested order, then the mixture."""
    found = {k.name: None for of in kind_results(records).values() for k in of.sets}
    return [*found, MIXED] if len(found) > 1 else list(found)


def kind_facts(records: Records) -> pd.DataFrame:
    """Facts about the rays of each scene and kind.

    Returns
    -------
    DataFrame
        Columns ``scene, kind, rays, hit, s`` (mean length over the mean chord of the scene's box),
        ``weight`` (share in the mixture), ``radius``, ``cheapest`` (the builder of the tree in
        which they cost least) and ``spread`` (cost in the dearest tree over that).
    """
    rows = []
    for record in records:
        found = record.result(KindResult)
        if not (found and found.sets):
            continue
        total = sum(kind.weight for kind in found.sets)
        samples = kind_samples(found)
        facts = {k.name: (k.rays, k.weight / total, k.radius) for k in found.sets}
        for name, sample in samples.items():
            count, weight, radius = facts.get(name, (sum(k.rays for k in found.sets), 1.0, 0.0))
            cost, first = sample.measured, int(sample.measured.argmin())
            rows.append(
                {
                    "scene": record.scene,
                    "kind": name,
                    "rays": count,
                    "hit": float(sample.values["hit_share"][0]),
                    "s": float(sample.values["length_ratio"][0]),
                    "weight": weight,
                    "radius": radius or np.nan,
                    "cheapest": record.trees[first].builder,
                    "spread": float(cost.max() / cost[first]) if cost[first] > 0 else np.nan,
                }
            )
    return pd.DataFrame(rows)


def kind_ranks(records: Records) -> pd.DataFrame:
    """Mean rank of each builder's tree by counted cost, per kind of rays.

    Returns
    -------
    DataFrame
        Columns ``builder, kind, rank`` (1 is the cheapest; mean over the scenes).
    """
    rows = []
    for record in records:
        found = record.result(KindResult)
        if not (found and found.sets):
            continue
        for name, sample in kind_samples(found).items():
            for tree, cost in zip(record.trees, sample.measured, strict=True):
                rank = 1 + int((sample.measured < cost).sum())
                rows.append({"builder": tree.builder, "kind": name, "rank": rank})
    table = pd.DataFrame(rows, columns=["builder", "kind", "rank"])
    return table.groupby(["builder", "kind"], sort=False)["rank"].mean().reset_index()
