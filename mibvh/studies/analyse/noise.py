"""What is left unexplained: how much is the stopwatch's noise, and how much LCV explains.

Of the variance of a scene's measured times, the mean square of their standard errors is noise. What
is left over the whole is their reliability; the correlation with anything is lower by its square
root than with times known exactly (Spearman's correction for attenuation).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.studies.analyse.correlations import LANES, column
from mibvh.triangles import F64

#: Predictors of which it is said how much of what they miss is noise.
OF = ("SAH", "fitted", "finite rays")


def reliability(values: F64, errors: F64) -> float:
    """Share of the variance of measured values that is not their own noise.

    Parameters
    ----------
    values : (K,) float64
        One per tree.
    errors : (K,) float64
        Their standard errors.

    Returns
    -------
    float
        From 0 to 1; NaN for values that are all the same.
    """
    variance = float(values.var(ddof=1)) if len(values) > 1 else 0.0
    if not variance > 0:
        return float("nan")
    return max(0.0, 1.0 - float(np.mean(errors**2)) / variance)


def noise_share(r: float, reliable: float) -> float:
    """Share of the unexplained variance ``1 - r^2`` that is the noise of what was measured.

    With times known exactly, ``r`` would be ``r / sqrt(reliable)``, at most 1.
    """
    if not (np.isfinite(r) and reliable > 0):
        return float("nan")
    explained = min(1.0, r * r / reliable)
    return (explained - r * r) / (1 - r * r) if r * r < 1 else 0.0


def noise_table(records: list[dict[str, Any]], found: pd.DataFrame) -> pd.DataFrame:
    """How much of what predictors miss of times is the stopwatch's noise.

    Parameters
    ----------
    records : list of dict
        A study's scenes.
    found : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.

    Returns
    -------
    DataFrame
        Per scene and lane mode ``scene, lanes``, ``r_at_most`` (the greatest that r can be
        expected to be with this noise, the square root of the reliability), and the share of the
        unexplained variance that is noise for each predictor of :data:`OF`.
    """
    r = found.set_index(["scene", "measurement", "predictor"])["pearson"]
    rows = []
    for record in records:
        for lanes in LANES:
            ns = column(record, f"{lanes}_ns")
            reliable = reliability(ns, ns * column(record, f"{lanes}_error"))
            rows.append({
                "scene": record["scene"], "lanes": lanes, "r_at_most": float(np.sqrt(reliable)),
                **{n: noise_share(r[record["scene"], f"{lanes}_ns", n], reliable) for n in OF},
            })  # fmt: skip
    return pd.DataFrame(rows)


def simd_deviation(records: list[dict[str, Any]]) -> pd.DataFrame:
    """How SIMD time per ray departs from scalar time, and how much of that LCV explains.

    A tree's deviation is the logarithm of SIMD over scalar time, less the mean over the scene's
    trees.

    Returns
    -------
    DataFrame
        Per scene ``scene``, ``deviation`` (mean size over the trees), ``r`` (Pearson's, of LCV
        with the deviation), ``explained`` (share of the deviation's variance: the square of r,
        with its sign), and ``noise`` (share of that variance that is the stopwatch's).
    """
    rows = []
    for record in records:
        ratio = np.log(column(record, "simd_ns") / column(record, "scalar_ns"))
        deviation = ratio - ratio.mean()
        r = pearson(column(record, "lcv"), deviation)
        error = np.hypot(column(record, "simd_error"), column(record, "scalar_error"))
        rows.append({
            "scene": record["scene"], "deviation": float(np.abs(deviation).mean()), "r": r,
            "explained": r * abs(r), "noise": 1 - reliability(deviation, error),
        })  # fmt: skip
    return pd.DataFrame(rows)
