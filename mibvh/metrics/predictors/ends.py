"""Predictors that use the rays: their ends, their lines, their lengths."""

from __future__ import annotations

from collections.abc import Sequence

from mibvh.metrics.predictor import finite_ray_cost, fit_alpha, predict
from mibvh.metrics.predictors.registry import F64, Predictor, Sample, Values, Weights

_ENDS = ("epo_starts", "epo_ends", "hit_share")


def _at_ends(values: Values) -> F64:
    """EPO at the rays' starts, and at their ends where they hit something."""
    return values["epo_starts"] + float(values["hit_share"][0]) * values["epo_ends"]


def _fit_ends(samples: Sequence[Sample], this: int) -> Weights:
    values = samples[this].values
    return {"alpha": fit_alpha(values["sah"], _at_ends(values), samples[this].measured)}


def _fit_lines(samples: Sequence[Sample], this: int) -> Weights:
    values = samples[this].values
    return {"alpha": fit_alpha(values["sah_lines"], _at_ends(values), samples[this].measured)}


PREDICTORS = (
    Predictor(
        name="ray ends",
        formula="(1 − α) SAH + α EPO at the rays' starts and ends, α fitted",
        free="1 per scene",
        needs=("sah", *_ENDS),
        fit=_fit_ends,
        predict=lambda values, weights: predict(values["sah"], _at_ends(values), weights["alpha"]),
    ),
    Predictor(
        name="ray lines",
        formula="(1 − α) SAH of the rays' lines + α EPO at their starts and ends, α fitted",
        free="1 per scene",
        needs=("sah_lines", *_ENDS),
        fit=_fit_lines,
        predict=lambda values, weights: predict(
            values["sah_lines"], _at_ends(values), weights["alpha"]
        ),
        rotated="ray lines, average α",
    ),
    Predictor(
        name="finite rays",
        formula="s SAH + point query at the rays' starts",
        free="0",
        needs=("sah", "point_query", "length_ratio"),
        predict=lambda values, _: finite_ray_cost(
            values["sah"], values["point_query"], float(values["length_ratio"][0])
        ),
        headline="finite rays, nothing fitted",
        rotated="finite rays",
    ),
    Predictor(
        name="finite by lines",
        formula="the same with the SAH of the rays' lines",
        free="0",
        needs=("sah_lines", "point_query", "line_share"),
        predict=lambda values, _: finite_ray_cost(
            values["sah_lines"], values["point_query"], float(values["line_share"][0])
        ),
        rotated="finite by lines",
    ),
    Predictor(
        name="touched",
        formula="all nodes that rays touch up to their hits: the least that a traversal visits",
        free="0",
        needs=("touched",),
        predict=lambda values, _: values["touched"],
        rotated="touched",
    ),
)
