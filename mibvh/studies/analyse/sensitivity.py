"""Pearson's r under other leaf sizes, bounces and viewpoints."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import Predictor, Sample, alpha_of, predictors
from mibvh.studies.measure.sensitivity import LEAF_SIZES, SensitivityResult
from mibvh.studies.record.scene import OriginCost, Records, SceneRecord
from mibvh.triangles import F64

#: Predictor whose alpha is shown.
_ALPHA_OF = "fitted"


def varied_predictors() -> list[Predictor]:
    """Return the predictors that have columns in the tables of sensitivity."""
    return [one for one in predictors() if one.varied]


@dataclasses.dataclass(frozen=True)
class _Case:
    """The trees of a scene under one choice of leaf size, bounce or viewpoints.

    Attributes
    ----------
    experiment : str
        ``leaf size``, ``bounce`` or ``viewpoints``.
    choice : int
        The largest leaf, the bounce, or how many viewpoints.
    which : str
        The viewpoints.
    sample : Sample
    """

    experiment: str
    choice: int
    which: str
    sample: Sample


def sensitivity_table(records: Records) -> pd.DataFrame:
    """Pearson's r with counted cost under each choice.

    Returns
    -------
    DataFrame
        Columns ``scene, experiment`` (``leaf size``, ``bounce`` or ``viewpoints``), ``choice``
        (the largest leaf, the bounce, or how many viewpoints), ``which`` (the viewpoints; there
        is a row for each run of so many neighbours), a column of r for the key of each of
        :func:`varied_predictors`, and ``alpha`` (of SAH + EPO, fitted). Empty where the
        experiment was not run.
    """
    rows = []
    for record in records:
        found = record.result(SensitivityResult)
        for case in _cases(record, found) if found else ():
            r, alpha = {}, float("nan")
            for one in varied_predictors():
                r[one.key] = float("nan")
                if one.knows(case.sample.values):
                    weights, values = one([case.sample])
                    r[one.key] = pearson(values, case.sample.measured)
                    alpha = alpha_of(weights) if one.name == _ALPHA_OF else alpha
            rows.append(
                {
                    "scene": record.scene,
                    "experiment": case.experiment,
                    "choice": case.choice,
                    "which": case.which,
                    **r,
                    "alpha": alpha,
                }
            )
    keys = [one.key for one in varied_predictors()]
    names = ["scene", "experiment", "choice", "which", *keys, "alpha"]
    return pd.DataFrame(rows, columns=names)


def _cases(record: SceneRecord, found: SensitivityResult) -> Iterator[_Case]:
    own = record.sample("counted_cost").values
    with_sizes = [sizes for sizes in found.leaf_sizes if sizes]
    for i, size in enumerate(LEAF_SIZES if with_sizes else ()):
        trees = [sizes[i].values for sizes in with_sizes]
        values = {name: np.array([t[name] for t in trees], np.float64) for name in trees[0]}
        yield _Case("leaf size", size, "", Sample(values, values["counted_cost"]))
    origins = [
        [*tree.costs_by_origin, *deeper]
        for tree, deeper in zip(record.trees, found.bounces, strict=True)
    ]
    for bounce in sorted({entry.bounce for entry in origins[0]}):
        chosen = [[e for e in tree if e.bounce == bounce] for tree in origins]
        yield _Case("bounce", bounce, "", _of_origins(own, chosen))
    by_view = [tree.costs_by_origin for tree in record.trees]
    views = sorted({entry.viewpoint for entry in by_view[0]})
    for run in _runs(views):
        chosen = [[e for e in tree if e.viewpoint in run] for tree in by_view]
        which = " ".join(map(str, run))
        yield _Case("viewpoints", len(run), which, _of_origins(own, chosen))


def _runs(views: list[int]) -> Iterator[list[int]]:
    """Yield every contiguous range of viewpoints, shortest first; viewpoints form a ring."""
    for many in range(1, len(views) + 1):
        for first in range(len(views) if many < len(views) else 1):
            yield [views[(first + i) % len(views)] for i in range(many)]


def _of_origins(own: Mapping[str, F64], chosen: list[list[OriginCost]]) -> Sample:
    """Return the trees with the cost of some of the rays; their metrics stay the same."""
    costs = np.array([_mean_cost(entries) for entries in chosen], np.float64)
    return Sample({**own, "counted_cost": costs}, costs)


def _mean_cost(entries: list[OriginCost]) -> float:
    """Mean over all rays of some origins."""
    return sum(e.cost * e.rays for e in entries) / sum(e.rays for e in entries)


def sensitivity_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and minimum of r over the scenes (and sets of viewpoints) for each choice.

    Parameters
    ----------
    table : DataFrame
        From :func:`sensitivity_table`.

    Returns
    -------
    DataFrame
        Columns ``experiment, choice, cases``, for each predictor its key and its key with
        ``_min``, and ``alpha``.
    """
    keys = [one.key for one in varied_predictors()]
    names = ["experiment", "choice", "cases", *(n for k in keys for n in (k, f"{k}_min")), "alpha"]
    rows = []
    for (experiment, choice), group in table.groupby(["experiment", "choice"], sort=False):
        row: dict[str, object] = {
            "experiment": experiment,
            "choice": choice,
            "cases": len(group),
            "alpha": group["alpha"].mean(),
        }
        for key in keys:
            row[key], row[f"{key}_min"] = group[key].mean(), group[key].min()
        rows.append(row)
    return pd.DataFrame(rows, columns=names)
