"""Width: the same trees with four and eight children per node."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mibvh.audit.record import Check
from mibvh.metrics.registry import Quantity
from mibvh.studies.measure.widths import WidthResult, width_experiment
from mibvh.studies.paper.claims.widths import width_claims
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.tables.widths import width_sheets


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    if found := record.result(WidthResult):
        for place, rows in enumerate(found.trees):
            for width, row in zip(found.widths, rows, strict=True):
                yield TidyRow(place, row.values, {"experiment": "width", "width": width})


def _audits(record: SceneRecord) -> Iterator[tuple[str, list[Check]]]:
    if found := record.result(WidthResult):
        for tree, rows in zip(record.trees, found.trees, strict=True):
            for width, row in zip(found.widths, rows, strict=True):
                yield f"{tree.builder} ({width} children)", row.audit


def _figures(record: SceneRecord) -> Iterator[tuple[str, str, Any]]:
    if found := record.result(WidthResult):
        from mibvh.studies.report.side_plots import at_widths

        said = "Counted cost by children per node against the prediction, each width by its own."
        yield "width", said, at_widths(record, found)


EXPERIMENT = Experiment(
    name="width",
    summary="the same trees with 4 and 8 children per node, all figures, by counted cost",
    measure=width_experiment,
    weight=0.5,
    quantities=(
        Quantity(name="boxes_per_ray", unit="boxes/ray", rays="all", per_tree=False),
        Quantity(name="mean_children", unit="children", per_tree=False),
    ),
    rows=_rows,
    sheets=width_sheets,
    claims=width_claims,
    figures=_figures,
    audits=_audits,
)
