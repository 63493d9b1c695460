"""Cost and overlap at each depth of the trees, and the worst case that remains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.studies.measure.depth import SPLITS, Cuts, DepthResult
from mibvh.studies.record.scene import Records, SceneRecord, TreeRow


def cut_trees(records: Records) -> Iterator[tuple[SceneRecord, TreeRow, Cuts]]:
    """Yield the trees of the scenes that have this experiment, with their cuts."""
    for record in records:
        if found := record.result(DepthResult):
            for tree, cuts in zip(record.trees, found.trees, strict=True):
                yield record, tree, cuts


def depth_table(records: Records) -> pd.DataFrame:
    """Tabulate cost and overlap at each depth.

    Returns
    -------
    DataFrame
        One row per scene, builder and depth: ``scene, builder, depth, sah, epo`` (shares of the
        nodes at that depth), ``spent, remaining`` (see
        :func:`mibvh.studies.measure.depth.remaining_by_depth`).
    """
    rows = []
    for record, tree, cuts in cut_trees(records):
        levels = zip(
            tree.sah_by_depth,
            tree.epo_by_depth,
            cuts.spent_by_depth,
            cuts.remaining_by_depth,
            strict=True,
        )
        rows += [
            (record.scene, tree.builder, depth, *values) for depth, values in enumerate(levels)
        ]
    names = ["scene", "builder", "depth", "sah", "epo", "spent", "remaining"]
    return pd.DataFrame(rows, columns=names)


def remaining_relative(records: Records, base: str = "bbvh") -> pd.DataFrame:
    """Worst-case triangle cost that remains, relative to the sweep's, mean over the scenes.

    Returns
    -------
    DataFrame
        Index ``builder``, a column per number of splits; empty without the base builder.
    """
    by_scene: dict[str, dict[str, np.ndarray]] = {}
    for record, tree, cuts in cut_trees(records):
        remaining = np.array(cuts.remaining_after_splits, dtype=np.float64)
        by_scene.setdefault(record.scene, {})[tree.builder] = remaining
    rows = [
        {"builder": name, **dict(zip(SPLITS, remaining / trees[base], strict=True))}
        for trees in by_scene.values()
        if base in trees
        for name, remaining in trees.items()
    ]
    if not rows:
        return pd.DataFrame()
    return pd.DataFrame(rows).groupby("builder", sort=False).mean()


def half_depths(records: Records) -> pd.DataFrame:
    """Depth above which half of the cost and of the overlap lies, mean over the scenes.

    Returns
    -------
    DataFrame
        Columns ``builder, sah, epo, nodes`` (depths above which half of each lies), ``depth``.
    """
    rows = [
        {
            "builder": tree.builder,
            "sah": _half(tree.sah_by_depth),
            "epo": _half(tree.epo_by_depth),
            "nodes": _half(cuts.nodes_by_depth),
            "depth": float(tree["depth"]),
        }
        for _, tree, cuts in cut_trees(records)
    ]
    return pd.DataFrame(rows).groupby("builder", sort=False).mean().reset_index()


def _half(by_depth: list[float] | list[int]) -> float:
    """Depth above which half of a sum lies, interpolated; NaN if the sum is 0."""
    total = np.concatenate([[0.0], np.cumsum(by_depth)])
    if not total[-1] > 0:
        return float("nan")
    return float(np.interp(total[-1] / 2, total, np.arange(len(total))))
