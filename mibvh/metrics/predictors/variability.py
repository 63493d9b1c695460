"""Predictors with leaf count variability (LCV), the paper's explanation of SIMD times."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from mibvh.metrics.predictor import combination_weights, fit_alpha, pearson, predict
from mibvh.metrics.predictors.paper import best_choice
from mibvh.metrics.predictors.registry import F64, Predictor, Sample, Values, Weights

_NEEDS = ("sah", "epo", "lcv")
#: Weights of LCV that are tried, in cost per leaf.
_BETAS = np.concatenate([[0.0], np.geomspace(0.1, 100, 31)])
_NONE = float("nan")


def _columns(values: Values) -> F64:
    return np.stack([values[name] for name in _NEEDS], axis=1)


def _fit_all(samples: Sequence[Sample], this: int) -> Weights:
    x, y = _columns(samples[this].values), samples[this].measured
    if len(y) <= x.shape[1] + 1:
        return dict.fromkeys((*_NEEDS, "level"), _NONE)
    found = combination_weights(x, y)
    return {**dict(zip(_NEEDS, found.tolist(), strict=True)), "level": float(y.mean())}


def _combine(values: Values, weights: Weights) -> F64:
    """Weighted sum of the trees' deviations from their mean, plus the mean measurement."""
    x = _columns(values)
    of = np.array([weights[name] for name in _NEEDS])
    return (x - x.mean(axis=0)) @ of + weights["level"]


def _with_beta(sample: Sample, beta: float) -> Weights:
    """The best alpha for a given weight of LCV."""
    sah, epo, lcv = (sample.values[name] for name in _NEEDS)
    return {"alpha": fit_alpha(sah, epo, sample.measured, beta * lcv), "beta": beta}


def _mix(values: Values, weights: Weights) -> F64:
    both = predict(values["sah"], values["epo"], weights["alpha"])
    return both + weights["beta"] * values["lcv"]


@functools.lru_cache(maxsize=1024)
def _r_by_beta(sample: Sample) -> F64:
    return np.array(
        [pearson(_mix(sample.values, _with_beta(sample, b)), sample.measured) for b in _BETAS]
    )


def _shared(samples: Sequence[Sample], this: int) -> Weights:
    r = np.array([_r_by_beta(sample) for sample in samples])
    return _with_beta(samples[this], best_choice(_BETAS, r))


def _from_others(samples: Sequence[Sample], this: int) -> Weights:
    r = np.array([_r_by_beta(sample) for sample in samples])
    return _with_beta(samples[this], best_choice(_BETAS, np.delete(r, this, axis=0)))


PREDICTORS = (
    Predictor(
        name="with LCV",
        formula="(1 − α) SAH + α EPO + β LCV, α and β fitted to the scene's trees",
        free="2 per scene",
        needs=_NEEDS,
        fit=_fit_all,
        predict=_combine,
        linear=_NEEDS,
    ),
    Predictor(
        name="LCV fixed",
        formula="the same, α fitted, the β of greatest mean r over these scenes",
        free="1 per scene, 1 in all",
        needs=_NEEDS,
        fit=_shared,
        predict=_mix,
    ),
    Predictor(
        name="LCV from others",
        formula="the same, α fitted, the β of greatest mean r over the other scenes",
        free="1 per scene",
        needs=_NEEDS,
        fit=_from_others,
        predict=_mix,
    ),
)
