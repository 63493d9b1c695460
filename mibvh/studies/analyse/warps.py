"""Deviation of simulated warps from scalar rays, by tree, builder and scene."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.studies.analyse.correlations import SCALAR, SIMD
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.triangles import F64


def deviation(simd: F64, scalar: F64) -> F64:
    """Deviation of each tree of a scene from scalar lanes.

    Parameters
    ----------
    simd, scalar : (K,) float64
        Costs or times of the scene's trees.

    Returns
    -------
    (K,) float64
        The logarithm of their ratio, less its mean over the trees. NaN where some value is not
        known, or is zero, as LCV is where no ray meets a leaf.
    """
    values = np.array([simd, scalar])
    if not (np.isfinite(values) & (values > 0)).all():
        return np.full(len(simd), np.nan)
    ratio = np.log(simd / scalar)
    return np.asarray(ratio - ratio.mean())


def warp_deviation(records: Records) -> pd.DataFrame:
    """Deviation of every tree, simulated and timed.

    Returns
    -------
    DataFrame
        Columns ``scene, builder``, ``simulated`` (warp cost over counted cost of the same rays)
        and ``timed`` (SIMD over scalar time; NaN where times are not known), both as
        :func:`deviation` has them, and ``utilisation`` of the warps; ``lcv`` and ``spread``
        (standard deviation of a ray's cost over its mean), as logarithms less the scene's mean.
    """
    return pd.concat([_of_scene(record) for record in records], ignore_index=True)


def _of_scene(record: SceneRecord) -> pd.DataFrame:
    ones = np.ones(len(record.trees))
    return pd.DataFrame(
        {
            "scene": record.scene,
            "builder": [tree.builder for tree in record.trees],
            "simulated": deviation(record.column("warp_cost"), record.column("warp_scalar_cost")),
            "timed": deviation(record.column(SIMD.ns), record.column(SCALAR.ns)),
            "utilisation": record.column("warp_utilisation"),
            "lcv": deviation(record.column("lcv"), ones),
            "spread": deviation(record.column("cost_deviation"), record.column("counted_cost")),
        }
    )


def deviation_by_builder(records: Records) -> pd.DataFrame:
    """Mean over the scenes, per builder, in the order of the records.

    Returns
    -------
    DataFrame
        Columns ``builder, simulated, least, greatest`` (over the scenes), ``timed, utilisation``
        and ``scenes``.
    """
    groups = warp_deviation(records).groupby("builder", sort=False)
    simulated = groups["simulated"]
    return pd.DataFrame(
        {
            "simulated": simulated.mean(),
            "least": simulated.min(),
            "greatest": simulated.max(),
            "timed": groups["timed"].mean(),
            "utilisation": groups["utilisation"].mean(),
            "scenes": simulated.count(),
        }
    ).reset_index()


def deviation_by_scene(records: Records) -> pd.DataFrame:
    """Size of the deviation in each scene, and its correlations.

    Returns
    -------
    DataFrame
        Columns ``scene``, ``simulated`` and ``timed`` (mean size over the trees), ``largest``
        (of the simulated ones), ``r_lcv`` and ``r_spread`` (Pearson's, with the simulated
        deviation), and ``r_timed`` (of the simulated deviation with the timed one).
    """
    rows = []
    for scene, of in warp_deviation(records).groupby("scene", sort=False):
        found = {name: of[name].to_numpy() for name in ("simulated", "timed", "lcv", "spread")}
        size = np.abs(found["simulated"])
        known = bool(np.isfinite(found["timed"]).all())
        rows.append(
            {
                "scene": scene,
                "simulated": float(size.mean()),
                "largest": float(size.max()),
                "timed": float(np.abs(found["timed"]).mean()),
                "r_lcv": pearson(found["lcv"], found["simulated"]),
                "r_spread": pearson(found["spread"], found["simulated"]),
                "r_timed": pearson(found["simulated"], found["timed"]) if known else np.nan,
            }
        )
    return pd.DataFrame(rows)


def explained(records: Records) -> dict[str, float]:
    """Pearson's r with the simulated deviation, over trees with all quantities known.

    Returns
    -------
    dict of str to float
        Of ``lcv`` and ``spread``; see :func:`warp_deviation`.
    """
    of = warp_deviation(records).dropna(subset=["simulated", "lcv", "spread"])
    departs = of["simulated"].to_numpy()
    return {name: pearson(of[name].to_numpy(), departs) for name in ("lcv", "spread")}


def warp_rules(records: Records) -> str:
    """Return the width and style of the warps, in words."""
    rules = {(record.options.warp_width, record.options.warp_style) for record in records}
    return ", ".join(f"{width} wide, {style}" for width, style in sorted(rules))
