"""From measurements to answers: how well each predictor explains each measurement."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import FIXED_ALPHAS, agreement, fit_alpha, predict

#: Measurements that predictors are held against: column, what it is.
MEASUREMENTS = {
    "counted_cost": "counted cost",
    "scalar_ns": "scalar ns/ray",
    "simd_ns": "SIMD ns/ray",
}


def column(record: dict[str, Any], name: str) -> np.ndarray:
    """One value per tree of a scene's record."""
    return np.array([tree[name] for tree in record["trees"]], dtype=np.float64)


def predictors(record: dict[str, Any], measured: np.ndarray) -> dict[str, tuple[float, np.ndarray]]:
    """Alpha and prediction of each predictor for the trees of a scene.

    Returns
    -------
    dict of str to (float, (K,) array)
        ``SAH``, ``fitted``, and one per fixed alpha.
    """
    sah, epo = column(record, "sah"), column(record, "epo")
    fitted = fit_alpha(sah, epo, measured)
    chosen = {"SAH": 0.0, "fitted": fitted, **{f"fixed {a}": a for a in FIXED_ALPHAS}}
    return {name: (alpha, predict(sah, epo, alpha)) for name, alpha in chosen.items()}


def correlations(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Agreement of each predictor with each measurement, per scene.

    Returns
    -------
    DataFrame
        Columns ``scene, measurement, predictor, alpha`` and those of
        :func:`mibvh.metrics.predictor.agreement`.
    """
    rows = []
    for record in records:
        for measurement in MEASUREMENTS:
            measured = column(record, measurement)
            for name, (alpha, values) in predictors(record, measured).items():
                rows.append({
                    "scene": record["scene"], "measurement": measurement, "predictor": name,
                    "alpha": alpha, **agreement(values, measured),
                })  # fmt: skip
    return pd.DataFrame(rows)


def overview(table: pd.DataFrame) -> pd.DataFrame:
    """Mean, minimum and maximum over the scenes of Pearson's r, as in the paper's tables.

    Returns
    -------
    DataFrame
        Index ``(measurement, predictor)``; columns ``mean, min, max, scenes``.
    """
    groups = table.groupby(["measurement", "predictor"], sort=False)["pearson"]
    return groups.agg(["mean", "min", "max", "count"]).rename(columns={"count": "scenes"})
