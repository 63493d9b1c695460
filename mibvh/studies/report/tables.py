"""The study's answers as tables for people: one list, which every form of the report lays out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from mibvh.studies.analyse.correlations import (
    LANES,
    MEASUREMENTS,
    PREDICTORS,
    absolute_errors,
    calibrate,
    column,
    overview,
    pool,
    relative_to,
    sensitivity,
    worst_time_error,
)
from mibvh.studies.paper.claims import PAPER_EPO
from mibvh.studies.report.experiment_tables import claim_answers, experiment_answers
from mibvh.studies.sheet import Sheet
from mibvh.studies.analyse.noise import OF, noise_table, simd_deviation

#: The section that the figure of all correlations stands in.
PREDICTION = "How well cost is predicted"
#: What the paper's slides give for Pearson's r over 22 scenes (mean, minimum, maximum), scalar.
PAPER = {"SAH": (0.915, 0.652, 0.998), "fitted": (0.994, 0.988, 0.999),
         "fixed 0.79": (0.980, 0.886, 0.999)}  # fmt: skip
#: Columns of the per-builder table: key, heading, format, what it says.
COLUMNS = [
    ("sah", "SAH", ".2f", "surface area heuristic"),
    ("epo", "EPO", ".3f", "end-point overlap"),
    ("lcv", "LCV", ".3f", "leaf count variability"),
    ("counted_cost", "counted cost", ".2f", "1.2 per inner node and 1.0 per triangle, per ray"),
    ("scalar_ns", "scalar ns/ray", ".0f", "kernel time, one lane per packet"),
    ("simd_ns", "SIMD ns/ray", ".0f", "kernel time, all lanes"),
    ("inner_per_ray", "inner", ".1f", "inner nodes visited per ray"),
    ("leaves_per_ray", "leaves", ".2f", "leaves visited per ray"),
    ("triangles_per_ray", "triangles", ".2f", "triangles tested per ray"),
    ("lane_utilisation", "lanes busy", ".0%", "active lane-steps over issued ones"),
    ("nodes", "nodes", ",", "inner nodes and leaves"),
    ("references", "references", ",", "entries of the leaves"),
    ("depth", "depth", "", "levels"),
    ("mean_leaf_size", "leaf size", ".2f", "references per leaf"),
    ("build_seconds", "build s", ".2f", "seconds to build"),
]
#: Of :data:`COLUMNS`: what stands in the table over all scenes, and what is better smaller.
COSTS = ("sah", "epo", "lcv", "counted_cost", "scalar_ns", "simd_ns")
MAIN = (*COSTS, "build_seconds")
#: Columns of the agreement tables: key, heading, format, what it says.
AGREEMENT = [
    ("alpha", "α", ".2f", "weight of EPO"),
    ("pearson", "Pearson r", ".3f", "correlation over the trees"),
    ("low", "low", ".3f", "lower end of the 95% bootstrap interval of r over the rays"),
    ("high", "high", ".3f", "upper end of the 95% bootstrap interval of r over the rays"),
    ("held_out", "held out", ".3f", "r of trees predicted from a fit to the others"),
    ("without_worst", "r without one", ".3f", "r without the tree that changes it most"),
    ("spearman", "Spearman", ".3f", "rank correlation"),
    ("kendall", "Kendall", ".3f", "rank correlation"),
    ("worst_error", "worst error", ".1%", "largest relative error of the least-squares line"),
    ("trees", "trees", "d", "how many"),
]

#: Lane modes of the measurements that are times.
_TIMED = {f"{lanes}_ns": lanes for lanes in LANES}


def answers(records: list[dict[str, Any]], found: pd.DataFrame) -> list[Sheet]:
    """All tables over the scenes of a study, in the order in which they are read.

    Parameters
    ----------
    records : list of dict
        One per scene.
    found : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    return [
        *claim_answers(records, found),
        *(_overview(records, found, measurement) for measurement in MEASUREMENTS),
        _shared(records),
        *(_per_scene(records, found, measurement) for measurement in MEASUREMENTS),
        _absolute(records),
        _simd(records),
        *_relative(records),
        *experiment_answers(records),
        _calibration(records),
        _constants(records),
        _stopwatch(records),
        _noise(records, found),
        _seconds(records),
        _trees(records),
    ]


def _overview(records: list[dict[str, Any]], found: pd.DataFrame, measurement: str) -> Sheet:
    summary = overview(found).loc[measurement]
    frame = summary[["mean", "min", "max", "worst_error", "scenes"]].reset_index()
    frame = frame.rename(columns={"worst_error": "worst error"})
    if measurement == "scalar_ns":
        text = {name: "{:.3f} ({:.3f} to {:.3f})".format(*r) for name, r in PAPER.items()}
        frame["paper"] = frame["predictor"].map(text).fillna("")
    return Sheet(
        name=f"overview-{measurement}",
        section=PREDICTION,
        title=f"r over the scenes: {MEASUREMENTS[measurement]}",
        note=times_known(records, measurement),
        frame=frame,
        formats={**dict.fromkeys(("mean", "min", "max"), ".3f"), "worst error": ".0%"},
        help={"worst error": "largest misprediction of any tree by the least-squares line",
              "paper": "mean (minimum to maximum) over the 22 scenes of the slides", **PREDICTORS},
    )  # fmt: skip


def times_known(records: list[dict[str, Any]], measurement: str) -> str:
    """How well the times are known that an r is against; nothing for counted cost."""
    if measurement not in _TIMED:
        return ""
    error = worst_time_error(records, _TIMED[measurement])
    return f"Times of a scene's trees are known relative to each other to ±{error:.1%} or better."


def _per_scene(records: list[dict[str, Any]], found: pd.DataFrame, measurement: str) -> Sheet:
    of = found[found["measurement"] == measurement]
    frame = of.pivot(index="scene", columns="predictor", values="pearson")
    frame = frame.reindex(index=of["scene"].unique(), columns=list(PREDICTORS))
    fitted = of[of["predictor"] == "fitted"].set_index("scene")
    frame["fitted, held out"] = fitted["held_out"]
    frame["α fitted"] = fitted["alpha"]
    frame["α estimated"] = of[of["predictor"] == "estimated"].set_index("scene")["alpha"]
    if measurement in _TIMED:
        frame["times known to"] = [worst_time_error([r], _TIMED[measurement]) for r in records]
    frame = frame.rename_axis(columns=None).reset_index()
    return Sheet(
        name=f"r-{measurement}",
        section=PREDICTION,
        title=f"r per scene: {MEASUREMENTS[measurement]}",
        frame=frame,
        formats={
            c: ".2f" if c.startswith("α") else ".1%" if c.startswith("times") else ".3f"
            for c in frame
        },
        help={
            "times known to": "largest standard error of a tree's time, relative to the scene's "
            "other trees",
            **PREDICTORS,
        },
    )


def _relative(records: list[dict[str, Any]]) -> list[Sheet]:
    found = {title: relative_to(records, key) for key, title, _, _ in COLUMNS if key in COSTS}
    frame = pd.DataFrame(found).rename_axis("builder")
    if frame.empty:
        return []
    frame["paper: EPO"] = pd.Series(PAPER_EPO)
    frame = frame.reset_index()
    return [
        Sheet(
            name="builders",
            section="What the builders optimise",
            title="Builders relative to lbvh, mean over the scenes",
            frame=frame,
            formats=dict.fromkeys(frame, ".0%"),
        )
    ]


def _calibration(records: list[dict[str, Any]]) -> Sheet:
    rows = []
    for lanes, title in LANES.items():
        c = calibrate(records, f"{lanes}_ns")
        rows.append({
            "lanes": title, "ns per inner node": c["ns_per_inner"],
            "ns per triangle": c["ns_per_test"], "ns per ray": c["ns_per_ray"],
            "C_inner / C_tri": c["c_inner"], "95% from": c["c_inner_low"], "to": c["c_inner_high"],
            "mean error": c["mean_error"],
            "worst error": c["worst_error"], "trees": c["trees"],
        })  # fmt: skip
    return Sheet(
        name="step-costs",
        section="What a step costs",
        title="What a step costs",
        note="Nanoseconds fitted to all trees of all scenes: per inner node, per triangle test, "
        "and per ray whatever it visits. The paper takes 1.2 for C_inner / C_tri. The 95% interval "
        "of this ratio is by the bootstrap over scenes and their trees: where it is wide, the "
        "times do not tell.",
        frame=pd.DataFrame(rows),
        formats={"ns per inner node": ".2f", "ns per triangle": ".2f", "ns per ray": ".1f",
                 "C_inner / C_tri": ".2f", "95% from": ".2f", "to": ".2f",
                 "mean error": ".1%", "worst error": ".1%"},
    )  # fmt: skip


def _constants(records: list[dict[str, Any]]) -> Sheet:
    frame = sensitivity(records, "scalar_ns").rename(
        columns={"c_inner": "C_inner / C_tri", "sah": "SAH"}
    )
    return Sheet(
        name="cost-constants",
        section="What a step costs",
        title="Other cost constants: mean r against scalar ns/ray",
        frame=frame,
        formats={"C_inner / C_tri": ".2f", "SAH": ".3f", "fitted": ".3f"},
    )


def _shared(records: list[dict[str, Any]]) -> Sheet:
    rows = []
    for measurement, title in MEASUREMENTS.items():
        found = pool(records, measurement)
        others = pd.Series([p.lcv_from_others for p in found])
        rows.append({
            "measurement": title, "best fixed α": found[0].alpha,
            "best fixed β of LCV": found[0].lcv, "smallest β without a scene": others.min(),
            "largest": others.max(),
        })  # fmt: skip
    frame = pd.DataFrame(rows)
    return Sheet(
        name="shared-weights",
        section=PREDICTION,
        title="Weights that the scenes share",
        frame=frame,
        formats=dict.fromkeys(frame, ".2f"),
    )


def _absolute(records: list[dict[str, Any]]) -> Sheet:
    frame = absolute_errors(records)
    frame = frame.rename(columns={
        "hit_share": "rays that hit", "bias": "mean error", "worst": "worst error",
        "spread": "worst without the mean", "sigma": "σ / mean of EPO at starts",
    })  # fmt: skip
    return Sheet(
        name="finite-rays",
        section=PREDICTION,
        title="Finite rays against counted cost, nothing fitted",
        frame=frame,
        formats={"s": ".2f", "rays that hit": ".0%", "mean error": "+.0%", "worst error": "+.0%",
                 "worst without the mean": ".0%", "σ / mean of EPO at starts": ".1f"},
        help={"s": "mean ray length over mean chord"},
    )  # fmt: skip


def _stopwatch(records: list[dict[str, Any]]) -> Sheet:
    rows = []
    for record in records:
        row: dict[str, Any] = {"scene": record["scene"]}
        for lanes, title in LANES.items():
            timing = record["timing"][lanes]
            row[f"{title} rounds"] = timing["rounds"]
            row[f"{title} worst error"] = worst_time_error([record], lanes)
            row[f"{title} same tree twice"] = timing["repeat_difference"]
        if "rotation" in record:
            again = [t["scalar_ns_before"] for t in record["rotation"]["trees"]]
            row["scalar level again"] = float(np.mean(again / column(record, "scalar_ns"))) - 1
        rows.append(row)
    frame = pd.DataFrame(rows)
    return Sheet(
        name="stopwatch",
        section="How well the stopwatch agrees with itself",
        title="The stopwatch",
        note="Rounds in which every tree was timed once, the largest standard error of a tree's "
        "time relative to the others, and by how much one tree, timed twice under two names, "
        "differed. The level of all times of a scene is known less well: where the scene was "
        "turned its trees were timed once more, minutes later, and the last column says by how "
        "much the level differed then.",
        frame=frame,
        formats={
            c: "+.1%" if c.endswith(("twice", "again")) else ".1%"
            for c in frame
            if "rounds" not in c
        },
    )


def _noise(records: list[dict[str, Any]], found: pd.DataFrame) -> Sheet:
    table = noise_table(records, found)
    frame = pd.DataFrame({"scene": table["scene"].unique()})
    for lanes, title in LANES.items():
        of = table[table["lanes"] == lanes].reset_index()
        frame[f"{title}: r at most"] = of["r_at_most"]
        for name in OF:
            frame[f"{title}: noise in what {name} misses"] = of[name]
    return Sheet(
        name="noise",
        section="How well the stopwatch agrees with itself",
        title="What part of the missing correlation is noise",
        note="Of the variance of a scene's times, the mean square of their standard errors is "
        "noise; no predictor can be expected to correlate better than 'r at most'. What a "
        "predictor misses is 1 − r²; the other columns say what share of it is that noise.",
        frame=frame,
        formats={c: ".3f" if c.endswith("most") else ".0%" for c in frame},
    )


def _simd(records: list[dict[str, Any]]) -> Sheet:
    frame = simd_deviation(records).rename(columns={
        "deviation": "mean deviation", "r": "r of LCV", "explained": "explained by LCV",
        "noise": "noise",
    })  # fmt: skip
    return Sheet(
        name="simd-deviation",
        section=PREDICTION,
        title="How SIMD departs from scalar time, and what LCV explains of it",
        note="A tree's deviation is the logarithm of SIMD over scalar time, less the mean of the "
        "scene's trees. Explained is the square of r, with its sign; noise is the share of the "
        "deviations' variance that is the stopwatch's.",
        frame=frame,
        formats={"mean deviation": ".1%", "r of LCV": ".2f", "explained by LCV": ".0%",
                 "noise": ".0%"},
    )  # fmt: skip


def _seconds(records: list[dict[str, Any]]) -> Sheet:
    frame = pd.DataFrame([{"scene": r["scene"], **r["seconds"]} for r in records])
    frame["all"] = frame.iloc[:, 1:].sum(axis=1, skipna=False)
    return Sheet(
        name="seconds",
        section="Where the time of the study went",
        title="Seconds that the study took",
        note="Each piece counts as in the run that made it, however often the study was begun "
        "again. Loading the scene and writing the report are not counted.",
        frame=frame,
        formats=dict.fromkeys(frame.columns[1:], ".1f"),
        help={
            "trees": "building them, all builders",
            "metrics": "SAH and EPO of all trees",
            "counts": "rays traced with counters, point queries, lines",
            "stopwatch": "scalar and SIMD",
            "rotation": "all of it: trees, metrics, counts, stopwatch",
            "sensitivity": "trees of other leaf sizes, deeper bounces",
        },
    )


def _trees(records: list[dict[str, Any]]) -> Sheet:
    shown = [c for c in COLUMNS if c[0] in MAIN]
    rows = [
        {"scene": r["scene"], "triangles": r["triangles"], "builder": t["builder"],
         **{title: t[key] for key, title, _, _ in shown}}
        for r in records for t in r["trees"]
    ]  # fmt: skip
    return Sheet(
        name="trees",
        section="Trees",
        title="Trees",
        frame=pd.DataFrame(rows),
        formats={"triangles": ",", **{title: form for _, title, form, _ in shown}},
        help={title: text for _, title, _, text in shown},
    )


def scene_answers(record: dict[str, Any], found: pd.DataFrame) -> list[Sheet]:
    """The tables of one scene: its trees, and how well their cost is predicted."""
    title = {key: title for key, title, _, _ in COLUMNS}
    trees = pd.DataFrame([
        {"builder": t["builder"], **{title[key]: t[key] for key in title},
         "scalar error": t["scalar_error"], "SIMD error": t["simd_error"]}
        for t in record["trees"]
    ])  # fmt: skip
    of = found[found["scene"] == record["scene"]]
    agreement = pd.DataFrame({
        "measured": of["measurement"].map(MEASUREMENTS), "predictor": of["predictor"],
        **{title: of[key] for key, title, _, _ in AGREEMENT},
    })  # fmt: skip
    return [
        Sheet(
            name=f"{record['scene']}-trees",
            section=record["scene"],
            title=f"Trees of {record['scene']}",
            frame=trees,
            formats={title: form for _, title, form, _ in COLUMNS},
            help={title: text for _, title, _, text in COLUMNS},
            errors={"scalar ns/ray": "scalar error", "SIMD ns/ray": "SIMD error"},
            best=tuple(title[key] for key in COSTS),
        ),
        Sheet(
            name=f"{record['scene']}-agreement",
            section=record["scene"],
            title=f"Agreement of predicted and measured cost, {record['scene']}",
            frame=agreement,
            formats={title: form for _, title, form, _ in AGREEMENT},
            help={**{title: text for _, title, _, text in AGREEMENT}, **PREDICTORS},
        ),
    ]
