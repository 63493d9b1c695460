"""Tables of the rotation experiment."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.analyse.rotation import average_weights, headings, rotation_factors
from mibvh.studies.measure.rotation import DEGREES, RotationResult
from mibvh.studies.paper.published import published
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

SECTION = f"Scenes rotated by {DEGREES:g}° about (1, 1, 1)"


def rotation_sheets(records: Records) -> list[Sheet]:
    """Return the factors per scene and per builder; none where the experiment was not run."""
    factors = rotation_factors(records)
    if factors.empty:
        return []
    columns = [Column(key, heading, ".2f") for key, heading in headings().items()]
    keys = [column.key for column in columns]
    by_scene = factors.groupby("scene", sort=False)[keys].mean()
    mean = by_scene.mean().rename("mean of the scenes")
    paper = pd.Series(published().rotation, name="paper").reindex(keys)
    by_scene = pd.concat([by_scene, mean.to_frame().T, paper.to_frame().T])
    results = {record.scene: record.result(RotationResult) for record in records}
    by_scene["same_hits"] = pd.Series({s: r.same_hits for s, r in results.items() if r})
    same_hits = Column("same_hits", "rays that hit the same", ".3%")
    by_builder = factors.groupby("builder", sort=False)[keys].mean()
    note = _note(records)
    return [
        _sheet("scene", "trees of a scene", by_scene, [*columns, same_hits], note),
        _sheet("builder", "scenes", by_builder, columns, note),
    ]


def _sheet(what: str, others: str, table: pd.DataFrame, columns: list[Column], note: str) -> Sheet:
    return Sheet(
        name=f"rotation-{what}s",
        section=SECTION,
        title=f"What rotating costs, per {what}",
        note="Cost in the rotated frame over that in the given one, mean over the "
        f"{others}; {note}",
        frame=table.rename_axis(what).reset_index(),
        columns=[Column(what), *columns],
    )


def _note(records: Records) -> str:
    weights = average_weights(records)
    both, lines = (weights[name]["alpha"] for name in ("fitted", "ray lines"))
    return (
        "the trees are rebuilt, the rays are the same. Average α: the mean over the scenes of "
        f"those fitted to counted cost, {both:.2f} with EPO, {lines:.2f} with the rays' own ends "
        "and lines."
    )
