"""Predictors of what warps in lockstep cost, from rays that were counted one by one.

The more rays differ in cost, the longer lanes wait for each other; ``docs/simd.md`` has how much of
SIMD's deviation from scalar cost that explains, against LCV.
"""

from __future__ import annotations

import numpy as np

from mibvh.metrics.predictors.registry import F64, Predictor, Values, Weights

_NEEDS = ("counted_cost", "cost_deviation")


def _spread(values: Values, _: Weights) -> F64:
    mean, deviation = (values[name] for name in _NEEDS)
    return np.asarray(np.sqrt(mean * deviation))


def _spread_and_lcv(values: Values, weights: Weights) -> F64:
    return np.asarray(_spread(values, weights) * values["lcv"] ** 0.25)


PREDICTORS = (
    Predictor(
        name="spread",
        formula="√(counted cost × its standard deviation over the rays): lanes that fetch rays",
        free="0",
        needs=_NEEDS,
        predict=_spread,
    ),
    Predictor(
        name="spread and LCV",
        formula="the same × LCV^¼: lanes that wait for a warp's last ray",
        free="0",
        needs=(*_NEEDS, "lcv"),
        predict=_spread_and_lcv,
    ),
)
