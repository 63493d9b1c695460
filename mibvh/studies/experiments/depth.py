"""Depth: where in the trees cost and overlap sit, and the worst case that remains."""

from __future__ import annotations

from collections.abc import Iterator

from mibvh.metrics.registry import Quantity
from mibvh.studies.measure.depth import SPLITS, Cuts, DepthResult, depth_experiment
from mibvh.studies.paper.claims.builders import depth_claims
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import SceneRecord, TreeRow
from mibvh.studies.report.tables.depth import depth_sheets


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    if found := record.result(DepthResult):
        for place, (tree, cuts) in enumerate(zip(record.trees, found.trees, strict=True)):
            yield from _cut_at_depths(place, tree, cuts)
            yield from _cut_after_splits(place, cuts)


def _cut_at_depths(place: int, tree: TreeRow, cuts: Cuts) -> Iterator[TidyRow]:
    by_depth = {
        "nodes_at_depth": cuts.nodes_by_depth,
        "sah_at_depth": tree.sah_by_depth,
        "epo_at_depth": tree.epo_by_depth,
        "spent_above_cut": cuts.spent_by_depth,
        "worst_case_below_cut": cuts.remaining_by_depth,
    }
    for depth, values in enumerate(zip(*by_depth.values(), strict=True)):
        of = {"experiment": "depth", "cut_depth": depth}
        yield TidyRow(place, dict(zip(by_depth, values, strict=True)), of)


def _cut_after_splits(place: int, cuts: Cuts) -> Iterator[TidyRow]:
    for splits, value in zip(SPLITS, cuts.remaining_after_splits, strict=True):
        if value is not None:
            of = {"experiment": "splits", "splits": splits}
            yield TidyRow(place, {"worst_case_below_cut": value}, of)


EXPERIMENT = Experiment(
    name="depth",
    summary="where in the trees cost and overlap sit, and the worst case that remains",
    measure=depth_experiment,
    weight=0.02,
    quantities=(
        Quantity(name="sah_at_depth", unit="cost", per_tree=False),
        Quantity(name="epo_at_depth", unit="cost", per_tree=False),
        Quantity(name="nodes_at_depth", unit="count", per_tree=False),
        Quantity(name="spent_above_cut", unit="cost", per_tree=False),
        Quantity(name="worst_case_below_cut", unit="cost", per_tree=False),
    ),
    rows=_rows,
    sheets=depth_sheets,
    claims=depth_claims,
)
