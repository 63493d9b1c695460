"""Tables of the traversal styles: timed and simulated, side by side."""

from __future__ import annotations

import pandas as pd

from mibvh.metrics.registry import DIGITS
from mibvh.studies.analyse.styles import style_agreement, style_trees
from mibvh.studies.measure.styles import StylesResult
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

_SECTION = "Styles of traversal, timed and simulated"
_DEVIATION = (
    "A deviation is the logarithm of packets over scalar lanes, less the mean of the scene's "
    "trees: below zero, the tree gains from packets."
)


def style_sheets(records: Records) -> list[Sheet]:
    """Return whether simulation foretells times, and all trees; none where it was not run."""
    trees = style_trees(records)
    if trees.empty:
        return []
    widths = sorted({r.lane_width for record in records if (r := record.result(StylesResult))})
    lanes = f"{' and '.join(map(str, widths))} lanes"
    return [_agreement(trees, lanes), _trees(trees, lanes)]


def _agreement(trees: pd.DataFrame, lanes: str) -> Sheet:
    found = style_agreement(trees)
    if found["scene"].nunique() > 1:
        means = found.groupby("style", sort=False, as_index=False).mean(numeric_only=True)
        means["scene"] = "mean of the scenes"
        found = pd.concat([found, means[found.columns]], ignore_index=True)
    return Sheet(
        name="styles-agreement",
        section=_SECTION,
        title="Does the simulation foretell which tree gains from packets?",
        note=f"Packets of {lanes}. {_DEVIATION} Mean size over the trees, simulated (no noise) and "
        "timed; r between the two over the trees; by how much they are apart (root mean square), "
        "and how much of that the errors of the stopwatch alone would make.",
        frame=found,
        columns=[
            Column("scene"),
            Column("style"),
            Column("trees", format=".0f"),
            Column("simulated", "simulated deviation", ".1%"),
            Column("timed", "timed deviation", ".1%"),
            Column("r", "r", ".2f"),
            Column("apart", "apart by", ".1%"),
            Column("noise", "stopwatch's error", ".1%"),
        ],
    )


def _trees(trees: pd.DataFrame, lanes: str) -> Sheet:
    return Sheet(
        name="styles",
        section=_SECTION,
        title="Every tree in every style",
        note=f"Packets of {lanes}. {_DEVIATION} Costs are 1.2 per node step and 1.0 per triangle "
        "step that the packets issue, per ray; of the wide style, which traces the tree collapsed "
        "to eight children per node, steps.",
        frame=trees,
        columns=[
            Column("scene"),
            Column("style"),
            Column("builder"),
            Column("scalar_ns", "scalar ns/ray", DIGITS, error="scalar_error"),
            Column("simd_ns", "SIMD ns/ray", DIGITS, error="simd_error"),
            Column("scalar_cost", "scalar cost", ".2f"),
            Column("cost", "packets' cost", ".2f"),
            Column("simulated", "simulated deviation", "+.1%"),
            Column("timed", "timed deviation", "+.1%"),
        ],
    )
