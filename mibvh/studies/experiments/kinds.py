"""Kinds: shadow, ambient occlusion, primary and deeper rays beside the diffuse ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mibvh.audit.record import Check
from mibvh.metrics.registry import Quantity
from mibvh.studies.analyse.kinds import kind_samples
from mibvh.studies.measure.counts import lines_of
from mibvh.studies.measure.kinds import KindResult, kind_experiment
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.tables.kinds import kind_sheets


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    if found := record.result(KindResult):
        for kind in found.sets:
            of = {"experiment": "kinds", "kind": kind.name}
            rays = {"all": kind.rays, "lines": lines_of(kind.rays)}
            for place, values in enumerate(kind.values):
                yield TidyRow(place, values, of, rays)


def _audits(record: SceneRecord) -> Iterator[tuple[str, list[Check]]]:
    if found := record.result(KindResult):
        for kind in found.sets:
            for tree, audit in zip(record.trees, kind.audit, strict=True):
                yield f"{tree.builder} ({kind.name} rays)", audit.checks


def _figures(record: SceneRecord) -> Iterator[tuple[str, str, Any]]:
    found = record.result(KindResult)
    if found and found.sets:
        from mibvh.studies.report.side_plots import side_by_side

        said = "Counted cost of each kind of rays against the prediction."
        yield "kinds", said, side_by_side(record, kind_samples(found))


EXPERIMENT = Experiment(
    name="kinds",
    summary="shadow, ambient occlusion, primary and deeper rays, by counted cost",
    measure=kind_experiment,
    weight=0.8,
    quantities=(Quantity(name="saved", unit="cost", rays="all", per_tree=False),),
    rows=_rows,
    sheets=kind_sheets,
    figures=_figures,
    audits=_audits,
)
