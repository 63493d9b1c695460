"""How well each predictor explains each measurement."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import (
    agreement,
    bootstrap_interval,
    fisher_interval,
    pearson,
)
from mibvh.metrics.predictors import Predictor, Sample, alpha_of, predictor, predictors
from mibvh.metrics.registry import Quantity
from mibvh.studies.analyse.left_out import predicted_from_others
from mibvh.studies.record.quantities import targets
from mibvh.studies.record.scene import Records, samples
from mibvh.triangles import F64

_NONE = float("nan")
_NO_AGREEMENT: dict[str, float] = dict.fromkeys(
    (
        "alpha",
        "pearson",
        "spearman",
        "kendall",
        "without_worst",
        "worst_error",
        "held_out",
        "low",
        "high",
        "trees_low",
        "trees_high",
    ),
    _NONE,
) | {"trees": 0}


class LaneMode(NamedTuple):
    """A lane mode: its key and its title."""

    key: str
    title: str

    @property
    def ns(self) -> str:
        """Quantity of its time."""
        return f"{self.key}_ns"

    @property
    def error(self) -> str:
        """Quantity of its time's relative standard error."""
        return f"{self.key}_error"


SCALAR, SIMD = LaneMode("scalar", "scalar"), LaneMode("simd", "SIMD")
LANES = (SCALAR, SIMD)


def worst_error(records: Records, quantity: str) -> float:
    """Largest relative standard error of a time, such as ``scalar_error``."""
    known = (float(record.column(quantity).max()) for record in records if record.knows(quantity))
    return max(known, default=_NONE)


def correlations(records: Records) -> pd.DataFrame:
    """Agreement of each predictor with each measurement, per scene.

    Returns
    -------
    DataFrame
        Columns ``scene, measurement, predictor, alpha``, those of
        :func:`mibvh.metrics.predictor.agreement`, ``held_out`` (Pearson r of trees predicted from
        a fit to the other trees, for predictors with free weights), ``low, high`` (95%
        bootstrap interval of r over the rays, for counted cost), and ``trees_low, trees_high``
        (95% interval of r over the trees; :func:`mibvh.metrics.predictor.fisher_interval`). Trees
        that nothing is predicted of have no part in it: ``trees`` counts the others.
    """
    rows = [row for target in targets() for row in _of_target(records, target)]
    return pd.DataFrame(rows)


def _of_target(records: Records, target: Quantity) -> Iterator[dict[str, float | str]]:
    timed = [record for record in records if record.knows(target.name)]
    known = samples(timed, target.name)
    place = 0
    for record in records:
        name = {"scene": record.scene, "measurement": target.name}
        # Where the rays are too few to be timed there is nothing to agree with.
        if not record.knows(target.name):
            for one in predictors():
                yield {**name, "predictor": one.name, **_NO_AGREEMENT}
            continue
        sample = known[place]
        groups = np.array([tree.cost_groups for tree in record.trees])
        for one in predictors():
            if not one.knows(sample.values):
                continue
            weights, values = one(known, place)
            sound = np.isfinite(values)  # a user's metric may be missing of a tree
            agrees = agreement(values[sound], sample.measured[sound])
            trees = fisher_interval(agrees["pearson"], agrees["trees"])
            low = high = _NONE
            if target.name == "counted_cost":
                low, high = bootstrap_interval(values[sound], groups[sound])
            yield {
                **name,
                "predictor": one.name,
                "alpha": alpha_of(weights),
                **agrees,
                "held_out": _held_out(one, known, place),
                "low": low,
                "high": high,
                "trees_low": trees[0],
                "trees_high": trees[1],
            }
        place += 1


def _held_out(one: Predictor, known: list[Sample], place: int) -> float:
    """Pearson r of trees predicted from a fit to the others."""
    if not one.linear:
        return _NONE
    measured = known[place].measured
    predicted = predicted_from_others(one, known, place, np.arange(len(measured)))
    return pearson(predicted, measured) if np.isfinite(predicted).all() else _NONE


def predicted(name: str, sample: Sample) -> tuple[float, F64]:
    """Return alpha (NaN if there is none) and the predicted values of one scene's trees."""
    weights, values = predictor(name)([sample])
    return alpha_of(weights), values


def overview(table: pd.DataFrame) -> pd.DataFrame:
    """Mean, minimum and maximum over the scenes of Pearson's r, as in the paper's tables.

    Returns
    -------
    DataFrame
        Index ``(measurement, predictor)``; columns ``mean, min, max, scenes``, and
        ``worst_error``: the largest misprediction of any tree, as a share.
    """
    groups = table.groupby(["measurement", "predictor"], sort=False)
    found = groups["pearson"].agg(["mean", "min", "max", "count"])
    found["worst_error"] = groups["worst_error"].max()
    return found.rename(columns={"count": "scenes"})


def shared_weights(records: Records) -> pd.DataFrame:
    """Weights that are fitted to several scenes at once.

    Returns
    -------
    DataFrame
        Per measurement ``measurement, alpha`` (of greatest mean r), ``beta`` (weight of LCV of
        greatest mean r, alpha being fitted to each scene), ``beta_low`` and ``beta_high`` (its
        range where one scene is left out).
    """
    rows = []
    for target in targets():
        known = samples(records, target.name)
        others = predictor("LCV from others")
        without = pd.Series([others.fit(known, i)["beta"] for i in range(len(known))])
        rows.append(
            {
                "measurement": target.heading,
                "alpha": predictor("fixed best").fit(known, 0)["alpha"],
                "beta": predictor("LCV fixed").fit(known, 0)["beta"],
                "beta_low": without.min(),
                "beta_high": without.max(),
            }
        )
    return pd.DataFrame(rows)
