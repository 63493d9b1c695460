"""Predictors of Aila, Karras and Laine: SAH, and SAH with EPO, by several choices of alpha."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from mibvh.metrics.predictor import FIXED_ALPHAS, estimate_alpha, fit_alpha, pearson, predict
from mibvh.metrics.predictors.registry import F64, Predictor, Sample, Values, Weights

#: Alphas that are tried where scenes share one.
_ALPHAS = np.linspace(0, 1, 101)
_NEEDS = ("sah", "epo")


def _mix(values: Values, weights: Weights) -> F64:
    return predict(values["sah"], values["epo"], weights["alpha"])


def _fitted(samples: Sequence[Sample], this: int) -> Weights:
    values = samples[this].values
    return {"alpha": fit_alpha(values["sah"], values["epo"], samples[this].measured)}


def _fixed(alpha: float, samples: Sequence[Sample], this: int) -> Weights:
    return {"alpha": alpha}


def _estimated(samples: Sequence[Sample], this: int) -> Weights:
    return {"alpha": estimate_alpha(float(samples[this].values["length_ratio"][0]))}


def _shared(samples: Sequence[Sample], this: int) -> Weights:
    return {"alpha": best_choice(_ALPHAS, np.array([_r_by_alpha(s) for s in samples]))}


@functools.lru_cache(maxsize=1024)
def _r_by_alpha(sample: Sample) -> F64:
    sah, epo = sample.values["sah"], sample.values["epo"]
    return np.array([pearson(predict(sah, epo, a), sample.measured) for a in _ALPHAS])


def best_choice(choices: F64, r: F64) -> float:
    """The choice with the largest mean r over the scenes.

    Parameters
    ----------
    choices : (C,) float64
    r : (S, C) float64
        One row per scene. Scenes without any r are left out.

    Returns
    -------
    float
        NaN where no scene has an r.
    """
    r = r[np.isfinite(r).any(axis=1)]
    if not len(r):
        return float("nan")
    return float(choices[int(np.nan_to_num(r).mean(axis=0).argmax())])


PREDICTORS = (
    Predictor(
        name="SAH",
        formula="the surface area heuristic alone",
        free="0",
        needs=("sah",),
        fit=functools.partial(_fixed, 0.0),
        predict=lambda values, _: values["sah"],
        headline="SAH alone",
        varied="SAH",
    ),
    Predictor(
        name="fitted",
        formula="(1 − α) SAH + α EPO, α fitted to the scene's trees",
        free="1 per scene",
        needs=_NEEDS,
        fit=_fitted,
        predict=_mix,
        linear=_NEEDS,
        headline="SAH + EPO, α fitted per scene",
        rotated="SAH + EPO, average α",
        varied="fitted",
    ),
    *(
        Predictor(
            name=f"fixed {alpha}",
            formula=f"(1 − α) SAH + α EPO, α = {alpha}",
            free="0",
            needs=_NEEDS,
            fit=functools.partial(_fixed, alpha),
            predict=_mix,
            # Of the fixed alphas the paper's own stands for both.
            rotated=f"SAH + EPO, α = {alpha}" if alpha == FIXED_ALPHAS[0] else "",
            varied=f"fixed {alpha}" if alpha == FIXED_ALPHAS[0] else "",
        )
        for alpha in FIXED_ALPHAS
    ),
    Predictor(
        name="fixed best",
        formula="(1 − α) SAH + α EPO, the α of greatest mean r over these scenes",
        free="1 in all",
        needs=_NEEDS,
        fit=_shared,
        predict=_mix,
    ),
    Predictor(
        name="estimated",
        formula="(1 − α) SAH + α EPO, α from the rays' mean length; no tree is measured",
        free="0",
        needs=(*_NEEDS, "length_ratio"),
        fit=_estimated,
        predict=_mix,
    ),
)
