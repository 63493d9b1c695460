"""Styles: each timed in both lane modes, beside the simulated cost of the same packets."""

from __future__ import annotations

from collections.abc import Iterator

from mibvh.metrics.registry import Quantity
from mibvh.studies.measure.styles import StylesResult, styles_experiment
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.tables.styles import style_sheets

#: Fields of a tree in a style, and what they are in ``results.parquet``.
_FIELDS = {
    "scalar_ns": ("ns/ray", "scalar"),
    "scalar_error": ("share", "scalar"),
    "simd_ns": ("ns/ray", "simd"),
    "simd_error": ("share", "simd"),
    "scalar_cost": ("cost", "warp"),
    "cost": ("cost", "warp"),
}
#: Styles of :data:`mibvh.traversal.styles.STYLES`.
_STYLES = ("single", "while-while", "speculative", "wide")


def _name(style: str, field: str) -> str:
    """Name of a measurement, such as ``while_while_packet_cost``."""
    kind = {"cost": "packet_cost", "scalar_cost": "packet_scalar_cost"}.get(field, field)
    return f"{style.replace('-', '_')}_{kind}"


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    found = record.result(StylesResult)
    for run in found.runs if found else ():
        rays = {lanes: timing.rays for lanes, timing in run.timing.items()} | {"warp": run.rays}
        for place, tree in enumerate(run.trees):
            values = {_name(run.style, field): getattr(tree, field) for field in _FIELDS}
            yield TidyRow(place, values, {"experiment": "styles"}, rays)


def _quantity(style: str, field: str) -> Quantity:
    unit, rays = _FIELDS[field]
    if style == "wide" and unit == "cost":
        unit = "steps/ray"
    return Quantity(name=_name(style, field), unit=unit, rays=rays, per_tree=False)  # type: ignore[arg-type]


EXPERIMENT = Experiment(
    name="styles",
    summary="styles of traversal, timed and simulated: does simulation tell which tree gains?",
    measure=styles_experiment,
    weight=0.5,
    quantities=tuple(_quantity(style, field) for style in _STYLES for field in _FIELDS),
    rows=_rows,
    sheets=style_sheets,
)
