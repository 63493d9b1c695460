"""Predictors over all scenes at once, and on scenes and builders outside the fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd

from mibvh.metrics.predictor import pearson, rank_correlations
from mibvh.metrics.predictors import Predictor, Sample, Weights
from mibvh.metrics.registry import Quantity
from mibvh.studies.analyse.left_out import predicted_from_others
from mibvh.studies.record.scene import Records, samples
from mibvh.triangles import F64

#: Builders that make alike trees: one of them says much of the others.
FAMILIES = (
    ("bbvh", "sbvh", "binned", "plain"),
    ("agglo", "ploc"),
    ("lbvh",),
    ("hill", "anneal"),
    ("bittner", "bittner_sbvh", "bittner_streelet", "reinsertion"),
    ("treelet", "streelet", "treelet_sbvh"),
)
_NONE = float("nan")


def family(builder: str) -> str:
    """Return the first name of a builder's family, or its own if it has no family."""
    name = builder.partition("(")[0]
    return next((members[0] for members in FAMILIES if name in members), name)


def pooled(records: Records, target: Quantity, shown: Sequence[Predictor]) -> pd.DataFrame:
    """How well predictors explain a measurement over the trees of all scenes.

    Costs are relative to their scene's mean, predicted and measured alike: scenes of another level
    do not make an r.

    Returns
    -------
    DataFrame
        Per predictor ``predictor``; ``mean``: the mean of the scenes' r; ``pooled`` and
        ``spearman``: r and rank correlation over all trees of all scenes; ``by_scene``: the pooled
        r where each scene has the mean of the weights fitted to the others; ``by_family``: where
        the trees of a family of builders are predicted from weights and a line fitted to the
        scene's other trees; ``family_error``: the mean error of these.
    """
    records = [record for record in records if record.knows(target.name)]
    known = samples(records, target.name)
    families = [np.array([family(tree.builder) for tree in r.trees]) for r in records]
    rows = [_row(one, known, families) for one in shown if all(one.knows(s.values) for s in known)]
    return pd.DataFrame(rows)


def _row(
    one: Predictor, known: list[Sample], families: Sequence[npt.NDArray[np.str_]]
) -> dict[str, float | str]:
    own = [one(known, i)[1] for i in range(len(known))]
    others = [one.predict(s.values, _of_others(one, known, i)) for i, s in enumerate(known)]
    measured = np.concatenate([_relative(s.measured) for s in known] or [np.zeros(0)])
    together = np.concatenate([_relative(values) for values in own] or [np.zeros(0)])
    left = [
        predicted_from_others(one, known, i, families[i]) / s.measured.mean()
        for i, s in enumerate(known)
    ]
    predicted = np.concatenate(left or [np.zeros(0)])
    sound = np.isfinite(predicted)
    error = np.abs(predicted[sound] / measured[sound] - 1)
    return {
        "predictor": one.name,
        "mean": _mean([pearson(v, s.measured) for v, s in zip(own, known, strict=True)]),
        "pooled": pearson(together, measured),
        "spearman": _spearman(together, measured),
        "by_scene": pearson(
            np.concatenate([_relative(values) for values in others] or [np.zeros(0)]), measured
        ),
        "by_family": pearson(predicted[sound], measured[sound]),
        "family_error": float(error.mean()) if sound.any() else _NONE,
    }


def _relative(values: F64) -> F64:
    return np.asarray(values / values.mean())


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else _NONE


def _spearman(x: F64, y: F64) -> float:
    if len(x) < 3 or not np.isfinite([x, y]).all():
        return _NONE
    return rank_correlations(x, y)[0]


def _of_others(one: Predictor, known: list[Sample], this: int) -> Weights:
    """Mean of the weights fitted to the other scenes; the scene's own if nothing is fitted."""
    if one.free == "0":
        return one.fit(known, this)
    # Without the scene itself: it has a part in weights that scenes share.
    others = [*known[:this], *known[this + 1 :]]
    fitted = pd.DataFrame([dict(one.fit(others, i)) for i in range(len(others))])
    return {str(name): float(value) for name, value in fitted.mean().items()} or dict.fromkeys(
        one.fit(known, this), _NONE
    )
