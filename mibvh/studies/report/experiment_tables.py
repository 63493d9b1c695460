"""The answers of the experiments beside prediction, as tables for people."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from mibvh.studies.analyse.correlations import LANES, worst_time_error
from mibvh.studies.paper.catalogue import paper_comparison
from mibvh.studies.paper.claims import claims
from mibvh.studies.measure.depth import relative_to_best, remaining_relative
from mibvh.studies.measure.rotation import DEGREES, FACTORS, PAPER, average_alphas, rotation_factors
from mibvh.studies.measure.sensitivity import sensitivity_summary, sensitivity_table
from mibvh.studies.sheet import Sheet

#: The section of the rotation experiment.
TURNING = f"Scenes turned by {DEGREES:g}° about (1, 1, 1)"
#: Of the numbers of splits, those that are shown.
_SHOWN_SPLITS = (1, 3, 7, 15, 63, 255, 1023)
#: What the choices of an experiment are called where they stand in a table.
_CHOICES = {
    "leaf size": "largest leaf {}",
    "bounce": "bounce {} alone",
    "viewpoints": "{} viewpoint{}",
}


def claim_answers(records: list[dict[str, Any]], found: pd.DataFrame) -> list[Sheet]:
    """The paper's claims, and its own scenes if there are any among those studied.

    Parameters
    ----------
    records : list of dict
        A study's scenes.
    found : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    sheets = [
        Sheet(
            name="claims",
            section="The paper's claims",
            title="The paper's claims, and whether they held",
            note="The paper's figures are those of its slides (22 scenes, GTX 680), where nothing "
            "else is said. What it takes for a claim to have held is our choice, and stands in "
            "the last column. Times of a scene's trees are known relative to each other to "
            f"{_noise(records)}: claims on time say no more than that.",
            frame=claims(records, found),
            unfolded=True,
        )
    ]
    compared = paper_comparison(records, found)
    if len(compared):
        frame = compared.astype({
            c: float for c in compared if c not in ("scene", "triangles")
        }).rename(columns={
            "expected": "triangles expected", "r_sah": "r of SAH", "paper_r_sah": "paper: r of SAH",
            "r_sah_epo": "r of SAH + EPO", "paper_r_sah_epo": "paper: r of SAH + EPO",
            "alpha": "α", "paper_alpha": "paper: α",
        })  # fmt: skip
        sheets.append(
            Sheet(
                name="paper-scenes",
                section="The paper's claims",
                title="Scenes of the paper's own",
                note="r with scalar ns/ray, α fitted. Triangles expected are those of the file "
                "that is to be had (mibvh scenes paper); few of the paper's figures are known.",
                frame=frame,
                formats={c: ",.0f" if c.startswith("tri") else ".2f" if "α" in c else ".3f"
                         for c in frame},
            )
        )  # fmt: skip
    return sheets


def _noise(records: list[dict[str, Any]]) -> str:
    """How well the stopwatch knew the times: the worst of all scenes."""
    error = max(worst_time_error(records, lanes) for lanes in LANES)
    twice = [abs(t["repeat_difference"]) for r in records for t in r["timing"].values()]
    return f"±{error:.1%}, and the same tree timed twice differed by up to {max(twice):.1%}"


def experiment_answers(records: list[dict[str, Any]]) -> list[Sheet]:
    """Tables of the experiments that were run: depth, rotation, sensitivity."""
    return [*_depth(records), *_rotation(records), *_sensitivity(records)]


# ------------------------------------------------------------------ depth


def _depth(records: list[dict[str, Any]]) -> list[Sheet]:
    section = "What the builders optimise"
    best = relative_to_best(records).reset_index()
    best.columns = ["builder", "mean", "max", "where"]
    sheets = [
        Sheet(
            name="sah-over-best",
            section=section,
            title="SAH over the best tree found for the scene",
            frame=best,
            formats={"mean": ".3f", "max": ".3f"},
            best=("mean", "max"),
        )
    ]
    remaining = remaining_relative(records)
    if remaining.empty:
        return sheets
    remaining = remaining[[n for n in _SHOWN_SPLITS if remaining[n].notna().any()]]
    remaining.columns = [f"after {n}" for n in remaining.columns]
    frame = remaining.reset_index()
    sheets.append(
        Sheet(
            name="worst-case",
            section=section,
            title="Worst-case triangle cost that remains, relative to bbvh",
            note="A tree of so many splits, the largest part split first, with the rest taken as "
            "leaves: what a top-down sweep minimises, split by split. Mean over the scenes; "
            "a splitting builder starts with more references.",
            frame=frame,
            formats=dict.fromkeys(frame, ".0%"),
        )
    )
    return [*sheets, _where(records, section)]


def _where(records: list[dict[str, Any]], section: str) -> Sheet:
    """How far down half of each tree's cost and overlap is reached."""
    rows = [
        {"builder": t["builder"], "half of SAH": _half(t["sah_by_depth"]),
         "half of EPO": _half(t["epo_by_depth"]), "half of the nodes": _half(t["nodes_by_depth"]),
         "all": float(t["depth"])}
        for r in records for t in r["trees"] if "nodes_by_depth" in t
    ]  # fmt: skip
    frame = pd.DataFrame(rows).groupby("builder", sort=False).mean().reset_index()
    return Sheet(
        name="where",
        section=section,
        title="Where in the trees cost and overlap sit: depths, mean over the scenes",
        note="The depth above which half of the expected cost, of the overlap and of the nodes is "
        "found, and the depth of the tree.",
        frame=frame,
        formats=dict.fromkeys(frame, ".1f"),
    )


def _half(by_depth: list[float]) -> float:
    """Depth above which half of a sum lies, interpolated; NaN for nothing."""
    total = np.concatenate([[0.0], np.cumsum(by_depth)])
    if not total[-1] > 0:
        return float("nan")
    return float(np.interp(total[-1] / 2, total, np.arange(len(total))))


# ------------------------------------------------------------------ rotation


def _rotation(records: list[dict[str, Any]]) -> list[Sheet]:
    factors = rotation_factors(records)
    if factors.empty:
        return []
    alpha, of_lines = average_alphas(records)
    by_scene = factors.groupby("scene", sort=False)[list(FACTORS)].mean()
    mean = by_scene.mean().rename("mean of the scenes")
    paper = pd.Series(PAPER, name="paper").reindex(list(FACTORS))
    by_scene = pd.concat([by_scene, mean.to_frame().T, paper.to_frame().T])
    same = {r["scene"]: r["rotation"]["same_hits"] for r in records if "rotation" in r}
    by_scene["rays that hit the same"] = pd.Series(same)
    by_builder = factors.groupby("builder", sort=False)[list(FACTORS)].mean()
    sheets = []
    for what, table in (("scene", by_scene), ("builder", by_builder)):
        frame = table.rename(columns=FACTORS).rename_axis(what).reset_index()
        other = "trees of a scene" if what == "scene" else "scenes"
        sheets.append(
            Sheet(
                name=f"rotation-{what}s",
                section=TURNING,
                title=f"What turning costs, per {what}",
                note="Cost in the turned frame over that in the given one, mean over the "
                f"{other}; the trees are built anew, the rays are the same. Average α: the mean "
                f"over the scenes of those fitted to counted cost, {alpha:.2f} with EPO, "
                f"{of_lines:.2f} with the rays' own ends and lines.",
                frame=frame,
                formats={**dict.fromkeys(FACTORS.values(), ".2f"),
                         "rays that hit the same": ".3%"},
            )
        )  # fmt: skip
    return sheets


# ------------------------------------------------------------------ sensitivity


def _sensitivity(records: list[dict[str, Any]]) -> list[Sheet]:
    table = sensitivity_table(records)
    if table.empty:
        return []
    section = "Does the conclusion stand with other choices?"
    summary = sensitivity_summary(table)
    summary.insert(0, "what is used", [
        _CHOICES[e].format(c, "s" if c != 1 else "")
        for e, c in zip(summary["experiment"], summary["choice"], strict=True)
    ])  # fmt: skip
    frame = summary.drop(columns=["experiment", "choice"]).rename(columns={
        "sah": "SAH: mean", "sah_min": "SAH: min", "fitted": "fitted: mean",
        "fitted_min": "fitted: min", "fixed": "fixed 0.79: mean", "fixed_min": "fixed 0.79: min",
        "alpha": "α fitted",
    })  # fmt: skip
    note = (
        "r with counted cost. Leaf sizes: the same trees, their leaves collapsed up to another "
        "size. Bounces: the rays of one bounce alone. Viewpoints: every run of so many neighbours."
    )
    sheets = [
        Sheet(
            name="sensitivity",
            section=section,
            title="Other leaf sizes, bounces and viewpoints",
            note=note,
            frame=frame,
            formats={c: "d" if c == "cases" else ".2f" if "α" in c else ".3f" for c in frame},
        )
    ]
    return [*sheets, *(_per_scene(table, name, section) for name in ("leaf size", "bounce")),
            _viewpoints(table, section)]  # fmt: skip


def _per_scene(table: pd.DataFrame, experiment: str, section: str) -> Sheet:
    of = table[table["experiment"] == experiment]
    parts: dict[str, Any] = {}
    for name, title in (("sah", "SAH"), ("fitted", "fitted")):
        wide = of.pivot(index="scene", columns="choice", values=name)
        parts |= {f"{title}, {choice}": wide[choice] for choice in wide}
    frame = pd.DataFrame(parts).reindex(of["scene"].unique()).reset_index(names="scene")
    return Sheet(
        name=f"sensitivity-{experiment.replace(' ', '-')}",
        section=section,
        title=f"r with counted cost for each {experiment}, per scene",
        frame=frame,
        formats=dict.fromkeys(frame, ".3f"),
    )


def _viewpoints(table: pd.DataFrame, section: str) -> Sheet:
    rows = []
    for scene, of in table[table["experiment"] == "viewpoints"].groupby("scene", sort=False):
        alone, together = of[of["choice"] == 1], of[of["choice"] == of["choice"].max()]
        row: dict[str, Any] = {"scene": scene, "viewpoints": int(of["choice"].max())}
        for name, title in (("sah", "SAH"), ("fitted", "fitted")):
            row[f"{title}: worst alone"] = alone[name].min()
            row[f"{title}: best alone"] = alone[name].max()
            row[f"{title}: together"] = together[name].iloc[0]
        rows.append(row)
    frame = pd.DataFrame(rows)
    return Sheet(
        name="sensitivity-viewpoints",
        section=section,
        title="r with counted cost of single viewpoints and of all, per scene",
        frame=frame,
        formats={c: "d" if c == "viewpoints" else ".3f" for c in frame},
    )
