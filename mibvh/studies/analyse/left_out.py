"""Predictions of trees from a fit to other trees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from mibvh.metrics.predictors import Predictor, Sample
from mibvh.triangles import F64


def predicted_from_others(
    one: Predictor, known: Sequence[Sample], this: int, groups: npt.ArrayLike
) -> F64:
    """Cost of each tree, from the weights and the line that fit the scene's trees of other groups.

    Parameters
    ----------
    one : Predictor
    known : sequence of Sample
        Of all scenes: some weights are shared.
    this : int
        Which scene.
    groups : (K,) array
        Of each tree; a number of its own where each tree is to be predicted from all others.

    Returns
    -------
    (K,) float64
        In the units of the measurement; NaN where fewer than three trees are left, or they are
        predicted alike.
    """
    sample, groups = known[this], np.asarray(groups)
    found = np.full(len(groups), np.nan)
    for group in dict.fromkeys(groups.tolist()):
        kept = groups != group
        if kept.sum() < 3:  # no line through so few
            continue
        part = Sample({name: v[kept] for name, v in sample.values.items()}, sample.measured[kept])
        weights = one.fit([*known[:this], part, *known[this + 1 :]], this)
        values = one.predict(sample.values, weights)
        if np.isfinite(values).all() and np.ptp(values[kept]) > 0:
            slope, base = np.polyfit(values[kept], part.measured, 1)
            found[~kept] = base + slope * values[~kept]
    return found
