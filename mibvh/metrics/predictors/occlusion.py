"""Predictors for rays that any hit ends: shadow rays and ambient occlusion (``docs/rays.md``).

They are not in the registry: studies by kinds of rays evaluate them beside those that are. Of rays
that end at the closest hit they are ``finite rays``, ``estimated`` and ``touched``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mibvh.metrics.occlusion import any_hit_ray_cost, estimate_alpha_any_hit
from mibvh.metrics.predictor import predict
from mibvh.metrics.predictors.registry import F64, Predictor, Sample, Values, Weights


def _saved(values: Values) -> F64:
    return np.asarray(values.get("saved", np.zeros_like(values["sah"])))


def _blocked(values: Values) -> float:
    """Share of the rays that are ended by any hit, and are."""
    return float(values["blocked"][0]) if "blocked" in values else 0.0


def _estimated(samples: Sequence[Sample], this: int) -> Weights:
    values = samples[this].values
    return {"alpha": estimate_alpha_any_hit(float(values["length_ratio"][0]), _blocked(values))}


PREDICTORS = (
    Predictor(
        name="estimated, any hit",
        formula="(1 − α) SAH + α EPO, α from the rays' mean length and the share that is blocked",
        free="0",
        needs=("sah", "epo", "length_ratio"),
        fit=_estimated,
        predict=lambda values, weights: predict(values["sah"], values["epo"], weights["alpha"]),
    ),
    Predictor(
        name="any-hit rays",
        formula="finite rays, less what ending at any hit saves",
        free="0",
        needs=("sah", "point_query", "length_ratio"),
        predict=lambda values, _: any_hit_ray_cost(
            values["sah"],
            values["point_query"],
            float(values["length_ratio"][0]),
            _saved(values),
        ),
    ),
    Predictor(
        name="touched, any hit",
        formula="all nodes that rays touch up to their closest hits, less what any hit saves",
        free="0",
        needs=("touched",),
        predict=lambda values, _: values["touched"] - _saved(values),
    ),
)
