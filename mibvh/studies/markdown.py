"""The study's answers as Markdown, to stand in a document."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mibvh.studies.analyse import (
    MEASUREMENTS,
    PREDICTORS,
    absolute_errors,
    calibrate,
    column,
    overview,
    pool,
    relative_to,
    sensitivity,
)


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table; columns after the first are right-aligned."""
    lines = ["| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def _r(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def write_markdown(records: list[dict[str, Any]], found: Any) -> str:
    """All tables of a study: overview, r per scene, builders, calibration, stopwatch, trees."""
    parts = []
    summary = overview(found)
    for measurement, title in MEASUREMENTS.items():
        rows = [
            [p, *(_r(row[c]) for c in ("mean", "min", "max")), f"{row['worst_error']:.0%}",
             str(int(row["scenes"]))]
            for p, row in summary.loc[measurement].iterrows()
        ]  # fmt: skip
        parts += [
            f"### r over the scenes: {title}\n",
            table(["predictor", "mean", "min", "max", "worst error", "scenes"], rows),
        ]
    parts += ["### Weights that the scenes share\n", _shared(records)]
    for measurement, title in MEASUREMENTS.items():
        parts += [f"### r per scene: {title}\n", _per_scene(found, records, measurement)]
    relative = {n: relative_to(records, n) for n in ("sah", "epo", "lcv", "counted_cost",
                                                     "scalar_ns", "simd_ns")}  # fmt: skip
    rows = [[b, *(f"{relative[n][b]:.0%}" for n in relative)] for b in relative["sah"].index]
    parts += [
        "### Builders relative to lbvh, mean over the scenes\n",
        table(["builder", "SAH", "EPO", "LCV", "counted cost", "scalar ns", "SIMD ns"], rows),
    ]
    rows = []
    for lanes in ("scalar", "simd"):
        c = calibrate(records, f"{lanes}_ns")
        rows.append([lanes, f"{c['ns_per_inner']:.2f}", f"{c['ns_per_test']:.2f}",
                     f"{c['ns_per_ray']:.1f}", f"{c['c_inner']:.2f}", f"{c['mean_error']:.1%}",
                     f"{c['worst_error']:.1%}", str(int(c["trees"]))])  # fmt: skip
    heads = ["lanes", "ns per inner node", "ns per triangle", "ns per ray", "C_inner / C_tri",
             "mean error", "worst error", "trees"]  # fmt: skip
    parts += ["### What a step costs\n", table(heads, rows)]
    rows = [
        [row["constants"], f"{row['c_inner']:.2f}", _r(row["sah"]), _r(row["fitted"])]
        for _, row in sensitivity(records, "scalar_ns").iterrows()
    ]
    parts += [
        "### Other cost constants: mean r against scalar ns/ray\n",
        table(["constants", "C_inner / C_tri", "SAH", "fitted"], rows),
        "### Finite rays against counted cost, nothing fitted\n",
        _absolute(records),
    ]
    parts += ["### The stopwatch\n", _stopwatch(records), "### Trees\n", _trees(records)]
    return "\n".join(parts)


def _per_scene(found: Any, records: list[dict[str, Any]], measurement: str) -> str:
    of = found[found["measurement"] == measurement]
    r = of.pivot(index="scene", columns="predictor", values="pearson")
    fitted = of[of["predictor"] == "fitted"].set_index("scene")
    estimated = of[of["predictor"] == "estimated"].set_index("scene")
    rows = [
        [record["scene"], *(_r(r.loc[record["scene"], p]) for p in PREDICTORS),
         _r(fitted.loc[record["scene"], "held_out"]),
         f"{fitted.loc[record['scene'], 'alpha']:.2f}",
         f"{estimated.loc[record['scene'], 'alpha']:.2f}"]
        for record in records
    ]  # fmt: skip
    heads = ["scene", *PREDICTORS, "fitted, held out", "α fitted", "α estimated"]
    return table(heads, rows)


def _shared(records: list[dict[str, Any]]) -> str:
    rows = []
    for measurement, title in MEASUREMENTS.items():
        found = pool(records, measurement)
        others = [p.lcv_from_others for p in found]
        weights = (found[0].alpha, found[0].lcv, np.min(others), np.max(others))
        rows.append([title, *(f"{w:.2f}" if np.isfinite(w) else "–" for w in weights)])
    heads = ["measurement", "best fixed α", "best fixed β of LCV", "smallest β without a scene",
             "largest"]  # fmt: skip
    return table(heads, rows)


def _absolute(records: list[dict[str, Any]]) -> str:
    rows = [
        [row["scene"], f"{row['s']:.2f}", f"{row['hit_share']:.0%}", f"{row['bias']:+.0%}",
         f"{row['worst']:+.0%}", f"{row['spread']:.0%}", f"{row['sigma']:.1f}"]
        for _, row in absolute_errors(records).iterrows()
    ]  # fmt: skip
    heads = ["scene", "s", "rays that hit", "mean error", "worst error", "worst without the mean",
             "σ / mean of EPO at starts"]  # fmt: skip
    return table(heads, rows)


def _stopwatch(records: list[dict[str, Any]]) -> str:
    rows = []
    for record in records:
        row = [record["scene"]]
        for lanes in ("scalar", "simd"):
            timing = record["timing"][lanes]
            worst = column(record, f"{lanes}_error").max()
            row += [str(timing["rounds"]), f"{worst:.1%}", f"{timing['repeat_difference']:+.1%}"]
        rows.append(row)
    heads = ["scene", "scalar rounds", "worst error", "same tree twice",
             "SIMD rounds", "worst error", "same tree twice"]  # fmt: skip
    return table(heads, rows)


def _trees(records: list[dict[str, Any]]) -> str:
    rows = [
        [record["scene"], f"{record['triangles']:,}", tree["builder"], f"{tree['sah']:.2f}",
         f"{tree['epo']:.3f}", f"{tree['lcv']:.3f}", f"{tree['counted_cost']:.2f}",
         f"{tree['scalar_ns']:.0f}", f"{tree['simd_ns']:.0f}", f"{tree['build_seconds']:.2f}"]
        for record in records
        for tree in record["trees"]
    ]  # fmt: skip
    heads = ["scene", "triangles", "builder", "SAH", "EPO", "LCV", "counted cost", "scalar ns/ray",
             "SIMD ns/ray", "build s"]  # fmt: skip
    return table(heads, rows)
