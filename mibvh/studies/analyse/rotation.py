"""Factors by which rotation changes measured and predicted cost."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from mibvh.metrics.predictors import Predictor, Weights, predictors
from mibvh.studies.measure.rotation import RotationResult
from mibvh.studies.record.quantities import quantities
from mibvh.studies.record.scene import Records, TreeRow, samples

#: Quantities whose factors are shown, before those of the predictors.
_MEASURED = ("counted_cost", "scalar_ns", "sah", "epo")


def rotated_predictors() -> list[Predictor]:
    """Return the predictors that have a column in the tables of factors."""
    return [one for one in predictors() if one.rotated]


def headings() -> dict[str, str]:
    """Return the columns of :func:`rotation_factors` that are factors, with their headings."""
    known = quantities()
    measured = {name: known[name].heading for name in _MEASURED}
    return measured | {one.key: one.rotated for one in rotated_predictors()}


def average_weights(records: Records) -> dict[str, Weights]:
    """Weights fitted to counted cost, mean over the scenes; NaN if there are none.

    Counted cost has no noise; the paper fits to scalar time.
    """
    known = samples(records, "counted_cost")
    found: dict[str, Weights] = {}
    for one in rotated_predictors():
        fitted = pd.DataFrame([dict(one.fit(known, i)) for i in range(len(known))])
        found[one.name] = {str(name): float(value) for name, value in fitted.mean().items()}
    return found


def rotation_factors(records: Records) -> pd.DataFrame:
    """Costs of the rotated scenes over those of the unrotated ones.

    Predictors with fitted weights have the mean of the weights fitted to each scene's counted
    cost; see :func:`average_weights`.

    Returns
    -------
    DataFrame
        One row per scene and builder: ``scene, builder``, and a column per key of
        :func:`headings`; empty where no scene was rotated. NaN where the cost before is zero.
    """
    names = ["scene", "builder", *headings()]
    if not any(record.result(RotationResult) for record in records):
        return pd.DataFrame(columns=names)
    weights = average_weights(records)
    rows = []
    for record in records:
        found = record.result(RotationResult)
        if found is None:
            continue
        given = {tree.builder: tree for tree in record.trees}
        for after in found.trees:
            before = given[after.builder]
            there, here = (_costs(tree, weights) for tree in (after, before))
            rows.append(
                {
                    "scene": record.scene,
                    "builder": before.builder,
                    **{name: _ratio(there[name], here[name]) for name in there},
                    # Of the same rounds of the stopwatch, so that drift cancels.
                    "scalar_ns": _ratio(after["scalar_ns"], after["scalar_ns_before"]),
                }
            )
    return pd.DataFrame(rows, columns=names)


def _costs(tree: TreeRow, weights: Mapping[str, Weights]) -> dict[str, float]:
    """Measured and predicted costs of a tree."""
    values = {name: np.array([value], np.float64) for name, value in tree.values.items()}
    return {name: tree[name] for name in _MEASURED} | {
        one.key: float(one.predict(values, weights[one.name])[0]) for one in rotated_predictors()
    }


def _ratio(after: float, before: float) -> float:
    return after / before if before > 0 else float("nan")
