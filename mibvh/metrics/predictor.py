"""Predictors of cost, and how well they explain measurements.

The paper's predictor is ``(1 - alpha) SAH + alpha EPO``; alpha is what part of a ray's cost
comes from its ends rather than from its length.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

#: The best fixed alpha on the paper's slides, and the default of other codes that cite it.
FIXED_ALPHAS = (0.79, 0.71)


def predict(sah: npt.ArrayLike, epo: npt.ArrayLike, alpha: float) -> npt.NDArray[np.float64]:
    """``(1 - alpha) SAH + alpha EPO`` for each tree.

    Parameters
    ----------
    sah, epo : (K,) array
    alpha : float
        From 0 to 1.
    """
    return (1 - alpha) * np.asarray(sah, np.float64) + alpha * np.asarray(epo, np.float64)


def pearson(predicted: npt.ArrayLike, measured: npt.ArrayLike) -> float:
    """Pearson's correlation coefficient.

    NaN for constant values, and for fewer than three trees: over two it is 1 or -1 whatever the
    predictor.
    """
    x, y = np.asarray(predicted, np.float64), np.asarray(measured, np.float64)
    if len(x) < 3 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return float("nan")
    return float(stats.pearsonr(x, y).statistic)


def fit_alpha(sah: npt.ArrayLike, epo: npt.ArrayLike, measured: npt.ArrayLike) -> float:
    """Alpha of the greatest Pearson r with the measurement, in closed form.

    Of all linear combinations, that of least squares correlates best; where its weights are
    not both positive, the best one allowed is SAH alone or EPO alone.

    Parameters
    ----------
    sah, epo, measured : (K,) array
        One value per tree.

    Returns
    -------
    float
        From 0 to 1; NaN for fewer than three trees.
    """
    s, e, y = (np.asarray(v, np.float64) for v in (sah, epo, measured))
    if len(y) < 3:
        return float("nan")
    columns = np.stack([s - s.mean(), e - e.mean()], axis=1)
    weights = np.linalg.lstsq(columns, y - y.mean(), rcond=None)[0]
    if (weights >= 0).all() and weights.sum() > 0:
        return float(weights[1] / weights.sum())
    alone = np.nan_to_num([pearson(s, y), pearson(e, y)], nan=-1.0)
    return float(alone.argmax())


def agreement(predicted: npt.ArrayLike, measured: npt.ArrayLike) -> dict[str, Any]:
    """How well a predictor explains a measurement over the trees of a scene.

    Returns
    -------
    dict
        ``trees`` (how many), ``pearson``, ``spearman``, ``kendall``, ``without_worst`` (the
        Pearson r without the tree that changes it most: one absurd tree lifts every r), and
        ``worst_error`` (largest relative error of the least-squares line, as a share).
    """
    x, y = np.asarray(predicted, np.float64), np.asarray(measured, np.float64)
    result: dict[str, Any] = {"trees": len(x), "pearson": pearson(x, y)}
    for name in ("spearman", "kendall", "without_worst", "worst_error"):
        result[name] = float("nan")
    if np.isnan(result["pearson"]):
        return result
    result["spearman"] = float(stats.spearmanr(x, y).statistic)
    result["kendall"] = float(stats.kendalltau(x, y).statistic)
    if len(x) > 3:
        others = [pearson(np.delete(x, i), np.delete(y, i)) for i in range(len(x))]
        change = np.abs(np.nan_to_num(others, nan=result["pearson"]) - result["pearson"])
        result["without_worst"] = others[int(change.argmax())]
    line = stats.linregress(x, y)
    result["worst_error"] = float(np.abs((line.intercept + line.slope * x) / y - 1).max())
    return result
