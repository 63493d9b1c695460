"""Tables of the pages of all builders: the later builders beside the paper's, and cost for cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mibvh.builders import later_names, names
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.record.sheet import Column, Sheet

_SECTION = "Later builders"
_MEASURES = {
    "counted_cost": "counted cost",
    "scalar_ns": "scalar time",
    "simd_ns": "SIMD time",
    "warp_cost": "warp cost",
}
#: What a quantity is divided by: whether it takes as much of one for as much of the other.
_RATIOS = {
    "scalar time per counted cost": ("scalar_ns", "counted_cost"),
    "SIMD time per counted cost": ("simd_ns", "counted_cost"),
    "counted cost per SAH": ("counted_cost", "sah"),
    "scalar time per SAH": ("scalar_ns", "sah"),
}
_MEAN = "geometric mean"


def later_sheets(records: Sequence[SceneRecord]) -> list[Sheet]:
    """Return the tables of scenes that all have the same trees; none without later builders.

    Parameters
    ----------
    records : sequence of SceneRecord
    """
    over = {measure: over_best(records, measure) for measure in _MEASURES}
    means = pd.DataFrame({measure: _geometric(frame) for measure, frame in over.items()})
    if means["counted_cost"].isna().all():
        return []
    ratios = pd.DataFrame({name: _ratio(records, *of) for name, of in _RATIOS.items()})
    cheapest = str(means["counted_cost"].idxmin())
    of_cheapest = pd.DataFrame({measure: frame[cheapest] for measure, frame in over.items()})
    of_cheapest.loc[_MEAN] = means.loc[cheapest]
    counted = over["counted_cost"]
    counted.loc[_MEAN] = means["counted_cost"]
    measures = [Column(measure, head, ".3f") for measure, head in _MEASURES.items()]
    return [
        Sheet(
            name="later-scenes",
            section=_SECTION,
            title="Counted cost relative to the best of the paper's nine in that scene",
            frame=counted.rename_axis("scene").reset_index(),
            columns=[Column("scene"), *(Column(name, format=".3f") for name in counted)],
        ),
        Sheet(
            name="later-means",
            section=_SECTION,
            title="The same by each measure, geometric mean over the scenes",
            frame=means.rename_axis("builder").reset_index(),
            columns=[Column("builder"), *measures],
        ),
        Sheet(
            name="later-cheapest",
            section=_SECTION,
            title=f"{cheapest} by each measure, relative to the best of the nine by the same",
            frame=of_cheapest.rename_axis("scene").reset_index(),
            columns=[Column("scene"), *measures],
        ),
        Sheet(
            name="cost-for-cost",
            section=_SECTION,
            title="What a tree costs for what is predicted, by builder",
            note="Relative to the mean over the scene's trees; mean over the scenes.",
            frame=ratios.rename_axis("builder").reset_index(),
            columns=[Column("builder"), *(Column(name, format=".2f") for name in _RATIOS)],
        ),
    ]


def over_best(records: Sequence[SceneRecord], measure: str) -> pd.DataFrame:
    """Return a measure of the later builders' trees over that of the best of the paper's.

    Returns
    -------
    DataFrame
        A row per scene, a column per builder; NaN where it is not known.
    """
    table = _table(records, measure)
    best = table[[name for name in names() if name in table]].min(axis=1, skipna=False)
    return table[[name for name in later_names() if name in table]].div(best, axis=0)


def _table(records: Sequence[SceneRecord], measure: str) -> pd.DataFrame:
    rows = {
        record.scene: {tree.builder: tree[measure] for tree in record.trees} for record in records
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def _geometric(frame: pd.DataFrame) -> pd.Series:
    return np.exp(np.log(frame).mean(skipna=False))


def _ratio(records: Sequence[SceneRecord], measure: str, by: str) -> pd.Series:
    """Return per builder the mean of a ratio, relative to the mean over the scene's trees."""
    ratio = _table(records, measure) / _table(records, by)
    return ratio.div(ratio.mean(axis=1), axis=0).mean()
