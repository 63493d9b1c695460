"""Sensitivity: other leaf sizes, deeper bounces, fewer viewpoints, by counted cost."""

from __future__ import annotations

from collections.abc import Iterator

from mibvh.studies.measure.sensitivity import SensitivityResult, sensitivity_experiment
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.tables.sensitivity import sensitivity_sheets


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    found = record.result(SensitivityResult)
    if found is None:
        return
    for place, (tree, sizes, deeper) in enumerate(
        zip(record.trees, found.leaf_sizes, found.bounces, strict=True)
    ):
        for size in sizes:
            of = {"experiment": "leaf size", "max_leaf": size.max_leaf}
            yield TidyRow(place, size.values, of, {"all": size.rays})
        for entry in [*tree.costs_by_origin, *deeper]:
            origin = {
                "experiment": "origin",
                "bounce": entry.bounce,
                "viewpoint": entry.viewpoint,
            }
            yield TidyRow(place, {"counted_cost": entry.cost}, origin, {"all": entry.rays})


EXPERIMENT = Experiment(
    name="sensitivity",
    summary="other leaf sizes, deeper bounces, fewer viewpoints, by counted cost",
    measure=sensitivity_experiment,
    weight=0.4,
    drafts=True,
    rows=_rows,
    sheets=sensitivity_sheets,
)
