"""Tables on the instrument itself: the stopwatch, its noise, the time that a study takes."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pandas as pd

from mibvh.studies.analyse.correlations import LANES, SCALAR, worst_error
from mibvh.studies.analyse.noise import headline_predictors, noise_table
from mibvh.studies.measure.rotation import RotationResult
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

_SECTION = "How well the stopwatch agrees with itself"
#: Difference of a level from one timing to the next that a reader is told of.
_MOVED = 0.1
#: What the stages of a study are.
_STAGES = {
    "trees": "building them, all builders",
    "metrics": "SAH and EPO of all trees",
    "counts": "rays traced with counters, point queries, lines",
    "warps": "warps in lockstep simulated",
    "stopwatch": "scalar and SIMD",
    "rotation": "all of it: trees, metrics, counts, stopwatch",
    "audit": "numbers checked by independent code",
    "styles": "styles of traversal, timed and simulated",
    "sensitivity": "trees of other leaf sizes, deeper bounces",
}


def instrument_sheets(records: Records, correlations: pd.DataFrame) -> list[Sheet]:
    """Return the tables of the stopwatch, of its noise, and of the seconds and memory spent."""
    known = [_memory(records)] if any(record.memory for record in records) else []
    return [_stopwatch(records), _noise(records, correlations), _seconds(records), *known]


def _stopwatch(records: Records) -> Sheet:
    rows = []
    for record in records:
        row: dict[str, Any] = {"scene": record.scene}
        for lanes in LANES:
            timing = record.timing[lanes.key]
            row[f"{lanes.key}_rounds"] = timing.rounds
            row[f"{lanes.key}_error"] = worst_error([record], lanes.error)
            row[f"{lanes.key}_twice"] = timing.repeat_difference
            row[f"{lanes.key}_clock"] = timing.clock if timing.portions else "none: too few rays"
        rotation = record.result(RotationResult)
        if rotation and rotation.trees:
            first = {tree.builder: tree[SCALAR.ns] for tree in record.trees}
            again = [t["scalar_ns_before"] / first[t.builder] for t in rotation.trees]
            row["again"] = float(np.mean(again)) - 1
        rows.append(row)
    frame = pd.DataFrame(rows)
    columns = [Column("scene")]
    for lanes in LANES:
        columns += [
            Column(f"{lanes.key}_rounds", f"{lanes.title} rounds"),
            Column(f"{lanes.key}_error", f"{lanes.title} worst error", ".1%"),
            Column(f"{lanes.key}_twice", f"{lanes.title} same tree twice", "+.1%"),
            Column(f"{lanes.key}_clock", f"{lanes.title} clock"),
        ]
    if "again" in frame:
        columns.append(Column("again", "scalar level again", "+.1%"))
    return Sheet(
        name="stopwatch",
        section=_SECTION,
        title="The stopwatch",
        note="Rounds, each of which times every tree once; the largest standard error of a "
        "tree's time relative to the others; and the difference of one tree timed twice under "
        "two names."
        + (
            " The common level of a scene's times is known less well: the trees of a rotated "
            "scene are timed once more, minutes later, and the last column is the difference "
            f"of the levels.{_level_moved(frame)}"
            if "again" in frame
            else ""
        ),
        frame=frame,
        columns=columns,
    )


def _level_moved(frame: pd.DataFrame) -> str:
    """Which scenes' levels moved by more than a tenth, so that nobody compares their times."""
    again = frame.set_index("scene")["again"]
    moved = [f"{scene} ({value:+.1%})" for scene, value in again[again.abs() > _MOVED].items()]
    if not moved:
        return ""
    return (
        f" Beyond {_MOVED:.0%}: {', '.join(moved)}: the nanoseconds of these scenes are to be "
        "compared among their own trees only."
    )


def _noise(records: Records, correlations: pd.DataFrame) -> Sheet:
    table = noise_table(records, correlations)
    frame = pd.DataFrame({"scene": table["scene"].unique()})
    columns = [Column("scene")]
    for lanes in LANES:
        of = table[table["lanes"] == lanes.key].reset_index()
        frame[f"{lanes.key}_most"] = of["r_at_most"]
        columns.append(Column(f"{lanes.key}_most", f"{lanes.title}: r at most", ".3f"))
        for name in headline_predictors():
            key = f"{lanes.key}_{name}"
            frame[key] = of[name]
            heading = f"{lanes.title}: noise in what {name} misses"
            columns.append(Column(key, heading, ".0%"))
    return Sheet(
        name="noise",
        section=_SECTION,
        title="What part of the missing correlation is noise",
        note="Of the variance of a scene's times, the mean square of their standard errors is "
        "noise; with it no predictor is expected to correlate better than 'r at most', though one "
        "may by chance, or where the errors are stated too large. What a predictor misses is "
        "1 − r²; the other columns say by what share of it r² would grow with times known "
        "exactly (Spearman's correction for attenuation).",
        frame=frame,
        columns=columns,
    )


def _seconds(records: Records) -> Sheet:
    frame = pd.DataFrame([{"scene": record.scene, **record.seconds} for record in records])
    stages = [str(name) for name in frame.columns[1:]]
    frame["all"] = frame[stages].sum(axis=1, skipna=False)
    return Sheet(
        name="seconds",
        section="Where the time of the study went",
        title="Seconds that the study took",
        note="Each piece counts with the time of the run that made it, even if the study was "
        "resumed. Loading the scene and writing the report are not counted. "
        + _from_folder(records),
        frame=frame,
        columns=[
            Column("scene"),
            *(Column(name, format=".1f", help=_STAGES.get(name, "")) for name in stages),
            Column("all", format=".1f"),
        ],
    )


def _memory(records: Records) -> Sheet:
    rows = [
        {"scene": record.scene, **{name: of / 1e9 for name, of in record.memory.items()}}
        for record in records
    ]
    frame = pd.DataFrame(rows)
    return Sheet(
        name="memory",
        section="Where the time of the study went",
        title="GB that the study took",
        note="The most that the process had in memory in each stage of the last run; pieces that "
        "were in the study's folder take next to nothing. Predicted before the first stage: the "
        "most of rays, trees and stopwatch, what was in memory then, and 0.3 GB of compiled code.",
        frame=frame,
        columns=[Column("scene"), *(Column(str(n), format=".2f") for n in frame.columns[1:])],
    )


def _from_folder(records: Records) -> str:
    """Say which pieces the last run took from the study's folder."""
    reused: Counter[str] = Counter()
    for record in records:
        reused.update(record.reused)
    pieces = ", ".join(f"{stage} ({count})" for stage, count in reused.items() if count)
    return f"Taken from the study's folder in the last run: {pieces or 'nothing'}."
