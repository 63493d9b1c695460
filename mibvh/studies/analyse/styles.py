"""Timed and simulated deviation of packets from scalar lanes, for each style."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.studies.analyse.warps import deviation
from mibvh.studies.measure.styles import StyleRun, StylesResult
from mibvh.studies.record.scene import Records, SceneRecord


def style_trees(records: Records) -> pd.DataFrame:
    """Tabulate every tree in every style; empty if the experiment was not run.

    Returns
    -------
    DataFrame
        Columns ``scene, style, builder``; ``scalar_ns, scalar_error, simd_ns, simd_error,
        scalar_cost, cost``, see :class:`~mibvh.studies.measure.styles.StyleTree`; ``timed`` and
        ``simulated``, the deviations of the times and of the costs, see
        :func:`~mibvh.studies.analyse.warps.deviation`; ``noise``, the relative standard error of
        SIMD over scalar time.
    """
    found = [
        _of_run(record, run)
        for record in records
        if (result := record.result(StylesResult))
        for run in result.runs
    ]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def _of_run(record: SceneRecord, run: StyleRun) -> pd.DataFrame:
    trees = pd.DataFrame([vars(tree) for tree in run.trees], dtype=np.float64)
    trees.insert(0, "scene", record.scene)
    trees.insert(1, "style", run.style)
    trees.insert(2, "builder", [tree.builder for tree in record.trees])
    column = {name: trees[name].to_numpy() for name in trees.columns[3:]}
    trees["timed"] = deviation(column["simd_ns"], column["scalar_ns"])
    trees["simulated"] = deviation(column["cost"], column["scalar_cost"])
    trees["noise"] = np.hypot(column["scalar_error"], column["simd_error"])
    return trees


def style_agreement(trees: pd.DataFrame) -> pd.DataFrame:
    """Agreement of timed and simulated deviations over a scene's trees.

    Parameters
    ----------
    trees : DataFrame
        As :func:`style_trees` has them.

    Returns
    -------
    DataFrame
        A row per scene and style: mean size of the deviations ``simulated`` and ``timed``, their
        ``r`` (NaN of fewer than three trees, or without times), the root mean square of what is
        between them, ``apart``, and that of the stopwatch's errors, ``noise``.
    """
    rows = []
    for (scene, style), of in trees.groupby(["scene", "style"], sort=False):
        known = bool(np.isfinite(of["timed"]).all())
        simulated, timed = of["simulated"].to_numpy(), of["timed"].to_numpy()
        rows.append(
            {
                "scene": scene,
                "style": style,
                "trees": len(of),
                "simulated": float(np.abs(simulated).mean()),
                "timed": float(np.abs(timed).mean()),
                "r": pearson(simulated, timed) if known and len(of) > 2 else np.nan,
                "apart": float(np.sqrt(((timed - simulated) ** 2).mean())),
                "noise": float(np.sqrt((of["noise"].to_numpy() ** 2).mean())),
            }
        )
    return pd.DataFrame(rows)
