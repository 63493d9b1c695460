"""What the claims share: how figures are written, and when times are known well enough."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from mibvh.studies.analyse.correlations import LaneMode
from mibvh.studies.measure.rotation import RotationResult
from mibvh.studies.record.scene import Records

#: What stands where there is nothing to say.
NONE = "–"
#: Said of what is judged by counted cost because times are not known well enough.
BY_COUNT = "; by counted cost, as times are not known well enough"
#: Builders that go from the top down by the surface area heuristic.
TOP_DOWN = ("bbvh", "sbvh")
#: Standard error of a tree's time above which no claim is judged by times.
_NOISE = 0.05


def scenes_with(records: Records, *builders: str) -> int:
    """How many scenes have trees of all these builders."""
    return sum(set(builders) <= {tree.builder for tree in record.trees} for record in records)


def steady(records: Records, lanes: LaneMode) -> bool:
    """Whether every tree's time is known well enough to judge by."""
    return all(tree[lanes.error] <= _NOISE for record in records for tree in record.trees)


def steady_rotated(records: Records) -> bool:
    """Whether the times of all rotated trees are."""
    results = [found for record in records if (found := record.result(RotationResult))]
    return all(tree["scalar_error"] <= _NOISE for found in results for tree in found.trees)


def number(value: float) -> str:
    """Three digits, or a dash for NaN."""
    return f"{value:.3f}" if np.isfinite(value) else NONE


def mean_and_least(row: pd.Series) -> str:
    """Mean and least r of a row of an overview."""
    if not np.isfinite(row["mean"]):
        return NONE
    return r_words(row["mean"], row["min"])


def r_words(mean: float, least: float) -> str:
    """Mean and least r over scenes, in words; they are the same over one scene."""
    if mean == least:
        return f"r {mean:.3f}"
    return f"r {mean:.3f} on average, {least:.3f} at worst"


def shares(values: Mapping[str, float]) -> str:
    """Shares by name, in percent."""
    return ", ".join(f"{name} {value:.0%}" for name, value in values.items())
