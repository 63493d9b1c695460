"""The unexplained variance of times: the share of the stopwatch's noise, and that of LCV.

Of the variance of a scene's measured times, the mean square of their standard errors is noise. What
is left over the whole is their reliability; the correlation with anything is lower by its square
root than with times known exactly (Spearman's correction for attenuation).
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import predictors
from mibvh.studies.analyse.correlations import LANES, SCALAR, SIMD
from mibvh.studies.analyse.warps import deviation
from mibvh.studies.record.scene import Records
from mibvh.triangles import F64


def headline_predictors() -> list[str]:
    """Return the predictors in the table of noise."""
    return [one.name for one in predictors() if one.headline]


def reliability(values: F64, errors: F64) -> float:
    """Reliability: the share of the variance of measured values that is not measurement noise.

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
    """Share of the unexplained variance ``1 - r^2`` that is measurement noise.

    With times known exactly, ``r`` would be ``r / sqrt(reliable)``, at most 1.
    """
    if not (np.isfinite(r) and reliable > 0):
        return float("nan")
    explained = min(1.0, r * r / reliable)
    return (explained - r * r) / (1 - r * r) if r * r < 1 else 0.0


def noise_table(records: Records, correlations: pd.DataFrame) -> pd.DataFrame:
    """Tabulate how much of the variance that predictors do not explain is the stopwatch's noise.

    Parameters
    ----------
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.

    Returns
    -------
    DataFrame
        Per scene and lane mode ``scene, lanes``, ``r_at_most`` (the greatest that r can be
        expected to be with this noise, the square root of the reliability), and the share of the
        unexplained variance that is noise for each of :func:`headline_predictors`.
    """
    r = correlations.set_index(["scene", "measurement", "predictor"])["pearson"]
    rows = []
    for record in records:
        for lanes in LANES:
            ns = record.column(lanes.ns)
            reliable = reliability(ns, ns * record.column(lanes.error))
            shares = {
                name: noise_share(r[record.scene, lanes.ns, name], reliable)
                for name in headline_predictors()
            }
            rows.append(
                {
                    "scene": record.scene,
                    "lanes": lanes.key,
                    "r_at_most": float(np.sqrt(reliable)),
                    **shares,
                }
            )
    return pd.DataFrame(rows)


def simd_deviation(records: Records) -> pd.DataFrame:
    """Deviation of SIMD from scalar time per ray, and the share of it that LCV explains.

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
        departs = deviation(record.column(SIMD.ns), record.column(SCALAR.ns))
        r = pearson(record.column("lcv"), departs)
        error = np.hypot(record.column(SIMD.error), record.column(SCALAR.error))
        rows.append(
            {
                "scene": record.scene,
                "deviation": float(np.abs(departs).mean()),
                "r": r,
                "explained": r * abs(r),
                "noise": 1 - reliability(departs, error),
            }
        )
    return pd.DataFrame(rows)
