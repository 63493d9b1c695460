"""Tables of the sensitivity experiment."""

from __future__ import annotations

from typing import Any

import pandas as pd

from mibvh.studies.analyse.sensitivity import (
    sensitivity_summary,
    sensitivity_table,
    varied_predictors,
)
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

SECTION = "Does the conclusion hold with other choices?"
#: What the choices of an experiment are called where they stand in a table.
_CHOICES = {
    "leaf size": "largest leaf {}",
    "bounce": "bounce {} alone",
    "viewpoints": "{} viewpoint{}",
}
#: Predictors of which the tables per scene are.
_PER_SCENE = {"sah": "SAH", "fitted": "fitted"}


def sensitivity_sheets(records: Records) -> list[Sheet]:
    """Return the tables; none where the experiment was not run."""
    table = sensitivity_table(records)
    if table.empty:
        return []
    per_scene = [_per_scene(table, experiment) for experiment in ("leaf size", "bounce")]
    return [_summary(table), *per_scene, _viewpoints(table)]


def _summary(table: pd.DataFrame) -> Sheet:
    summary = sensitivity_summary(table)
    summary["used"] = [
        _CHOICES[experiment].format(choice, "s" if choice != 1 else "")
        for experiment, choice in zip(summary["experiment"], summary["choice"], strict=True)
    ]
    r = [
        Column(key, f"{one.varied}: {which}", ".3f")
        for one in varied_predictors()
        for key, which in ((one.key, "mean"), (f"{one.key}_min", "min"))
    ]
    return Sheet(
        name="sensitivity",
        section=SECTION,
        title="Other leaf sizes, bounces and viewpoints",
        note="r with counted cost. Leaf sizes: the same trees, their leaves collapsed up to "
        "another size. Bounces: the rays of one bounce alone. Viewpoints: every run of so many "
        "neighbouring viewpoints.",
        frame=summary,
        columns=[
            Column("used", "what is used"),
            Column("cases", format="d"),
            *r,
            Column("alpha", "α fitted", ".2f"),
        ],
    )


def _per_scene(table: pd.DataFrame, experiment: str) -> Sheet:
    of = table[table["experiment"] == experiment]
    parts: dict[str, Any] = {}
    for key, title in _PER_SCENE.items():
        wide = of.pivot(index="scene", columns="choice", values=key)
        parts |= {f"{title}, {choice}": wide[choice] for choice in wide}
    frame = pd.DataFrame(parts).reindex(of["scene"].unique()).reset_index(names="scene")
    return Sheet(
        name=f"sensitivity-{experiment.replace(' ', '-')}",
        section=SECTION,
        title=f"r with counted cost for each {experiment}, per scene",
        frame=frame,
        columns=[Column("scene"), *(Column(name, format=".3f") for name in parts)],
    )


def _viewpoints(table: pd.DataFrame) -> Sheet:
    rows = []
    for scene, of in table[table["experiment"] == "viewpoints"].groupby("scene", sort=False):
        alone, together = of[of["choice"] == 1], of[of["choice"] == of["choice"].max()]
        row: dict[str, Any] = {"scene": scene, "viewpoints": int(of["choice"].max())}
        for key, title in _PER_SCENE.items():
            row[f"{title}: worst alone"] = alone[key].min()
            row[f"{title}: best alone"] = alone[key].max()
            row[f"{title}: together"] = together[key].iloc[0]
        rows.append(row)
    frame = pd.DataFrame(rows)
    r = [str(name) for name in frame.columns[2:]]
    return Sheet(
        name="sensitivity-viewpoints",
        section=SECTION,
        title="r with counted cost of single viewpoints and of all, per scene",
        frame=frame,
        columns=[
            Column("scene"),
            Column("viewpoints", format="d"),
            *(Column(name, format=".3f") for name in r),
        ],
    )
