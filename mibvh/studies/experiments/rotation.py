"""Rotation: the scene and its rays rotated, all trees built anew."""

from __future__ import annotations

from collections.abc import Iterator

from mibvh.metrics.registry import Quantity
from mibvh.studies.measure.rotation import RotationResult, rotation_experiment
from mibvh.studies.paper.claims.rotation import rotation_claims
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.tables.rotation import rotation_sheets


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    if found := record.result(RotationResult):
        of = {"experiment": "rotation", "rotation": found.degrees, "digest": found.digest}
        rays = {"scalar": found.timing.rays}
        places = {tree.builder: place for place, tree in enumerate(record.trees)}
        for tree in found.trees:
            yield TidyRow(places[tree.builder], tree.values, of, rays)
        yield TidyRow(0, {"same_hits": found.same_hits}, of, rays)


EXPERIMENT = Experiment(
    name="rotation",
    summary="the scene and its rays rotated 45 degrees about (1, 1, 1), all trees rebuilt",
    measure=rotation_experiment,
    weight=1.0,
    quantities=(
        Quantity(name="same_hits", unit="share", rays="all", per_tree=False),
        Quantity(name="scalar_ns_before", unit="ns/ray", rays="scalar", per_tree=False),
    ),
    rows=_rows,
    sheets=rotation_sheets,
    claims=rotation_claims,
)
