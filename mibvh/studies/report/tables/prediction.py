"""Tables on how well cost is predicted."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.metrics.predictors import Predictor, glossary, predictors
from mibvh.studies.analyse.calibration import absolute_errors
from mibvh.studies.analyse.correlations import LANES, overview, shared_weights, worst_error
from mibvh.studies.analyse.level import level_pieces
from mibvh.studies.analyse.noise import simd_deviation
from mibvh.studies.analyse.pooled import pooled
from mibvh.studies.paper.published import published
from mibvh.studies.record.quantities import targets
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet, within

#: The section that the figure of all correlations stands in.
SECTION = "How well cost is predicted"
#: The measurements that predictors are first held against.
_FIRST = ("counted_cost", "scalar_ns")


#: The predictors that a reader chooses from; all others are told on demand.
NAMED = ("SAH", "fitted", "estimated", "finite rays", "finite by lines")


#: Quantities that are known only of rays that were traced through the tree.
_TRACED = {"touched", "lcv", "counted_cost", "cost_deviation", "steps_deviation", "warp_cost"}


def by_traversal() -> list[str]:
    """Return the predictors that need the tree to be traced: they explain, but do not predict."""
    return [one.name for one in predictors() if _TRACED & set(one.needs)]


def prediction_sheets(records: Records, correlations: pd.DataFrame) -> list[Sheet]:
    """Return the tables, those over all scenes first."""
    return [
        _overview(records, correlations),
        *_pooled(records),
        _absolute(records),
        *_level(records),
        _per_scene(records, correlations),
        _others(correlations),
        _shared(records),
        _simd(records),
    ]


def time_errors(records: Records) -> str:
    """Largest standard errors of times, by lane mode; empty where there are none."""
    errors = {lanes.title: worst_error(records, lanes.error) for lanes in LANES}
    return " and ".join(f"{within(e)} ({name})" for name, e in errors.items() if np.isfinite(e))


def times_known(records: Records) -> str:
    """How well the times are known that an r is against, in a sentence."""
    told = time_errors(records)
    if not told:
        return ""
    return (
        f"Times of a scene's trees are known relative to each other to {told} or better, one "
        "standard error; a lead, the difference of two trees, has the errors of both."
    )


def _overview(records: Records, correlations: pd.DataFrame) -> Sheet:
    """Every predictor against every measurement: the mean over the scenes, and the worst."""
    summary = overview(correlations)
    frame = pd.DataFrame({"predictor": [one.name for one in _shown(correlations)]})
    columns = [Column("predictor")]
    for target in targets():
        of = summary.loc[target.name]
        for key, heading in (("mean", "mean"), ("min", "worst")):
            name = f"{target.name}_{key}"
            frame[name] = frame["predictor"].map(of[key])
            columns.append(Column(name, f"{target.heading}: {heading}", ".3f"))
    frame["error"] = frame["predictor"].map(summary.loc["counted_cost"]["worst_error"])
    error = "largest misprediction of any tree's counted cost by the least-squares line"
    columns.append(Column("error", "counted cost: worst error", ".0%", error))
    text = {name: f"{r.mean:.3f} ({r.low:.3f})" for name, r in published().r.items()}
    frame["paper"] = frame["predictor"].map(text).fillna("")
    over = f"mean (worst) with scalar time over the {published().scenes} scenes of the slides"
    columns.append(Column("paper", help=over))
    return Sheet(
        name="overview",
        section=SECTION,
        title="r over the scenes",
        note=f"Pearson's r over each scene's trees: the mean over the scenes, and the worst. "
        f"{times_known(records)}",
        frame=frame,
        columns=columns,
        glossary=glossary(),
        unfolded=True,
    )


def _shown(correlations: pd.DataFrame) -> list[Predictor]:
    """Return the predictors that are known, the named ones first."""
    known = [one for one in predictors() if one.name in set(correlations["predictor"])]
    return sorted(known, key=lambda one: one.name not in NAMED)


def _pooled(records: Records) -> list[Sheet]:
    named = [one for one in predictors() if one.name in NAMED]
    sheets = []
    for target in targets():
        if target.name not in _FIRST:
            continue
        frame = pooled(records, target, named)
        if frame.empty:
            continue
        sheets.append(
            Sheet(
                name=f"pooled-{target.name}",
                section=SECTION,
                title="All scenes pooled, and weights from other scenes or builders: "
                f"{target.heading}",
                note="Costs relative to their scene's mean. Other scenes: weights are the mean of "
                "those fitted to all other scenes. Other builders: the trees of a family of "
                "builders are predicted from weights and a line fitted to the scene's other trees.",
                frame=frame,
                columns=[
                    Column("predictor"),
                    Column("mean", "mean of r", ".3f"),
                    Column("pooled", "pooled r", ".3f"),
                    Column("spearman", "pooled rank r", ".3f", "Spearman's, over all trees"),
                    Column("by_scene", "from other scenes", ".3f"),
                    Column("by_family", "from other builders", ".3f"),
                    Column("family_error", "mean error of these", ".1%"),
                ],
                glossary=glossary(),
            )
        )
    return sheets


def _by_scene(correlations: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Pearson's r of some predictors, a row per scene and measurement."""
    headings = {target.name: target.heading for target in targets()}
    of = correlations[correlations["predictor"].isin(names)]
    frame = of.pivot(index=["measurement", "scene"], columns="predictor", values="pearson")
    order = pd.MultiIndex.from_product([headings, correlations["scene"].unique()])
    frame = frame.reindex(index=order, columns=names).rename_axis(columns=None)
    frame = frame.rename_axis(["measurement", "scene"]).reset_index()
    frame["measured"] = frame["measurement"].map(headings)
    return frame


def _per_scene(records: Records, correlations: pd.DataFrame) -> Sheet:
    names = [one.name for one in _shown(correlations) if one.name in NAMED]
    frame = _by_scene(correlations, names).set_index(["measurement", "scene"])
    of = correlations.set_index(["predictor", "measurement", "scene"])
    finite = of.loc["finite rays"] if "finite rays" in names else None
    if finite is not None:
        for key in ("trees_low", "trees_high", "spearman"):
            frame[key] = finite[key]
    for key, name, column in (
        ("held_out", "fitted", "held_out"),
        ("alpha", "fitted", "alpha"),
        ("estimate", "estimated", "alpha"),
    ):
        frame[key] = of.loc[name][column] if name in names else float("nan")
    for target in targets():
        for record in records:
            at = (target.name, record.scene)
            frame.loc[at, "known"] = worst_error([record], target.error) if target.error else 0.0
    known = "largest standard error of a tree's time, relative to the scene's other trees"
    interval = "95% interval over the trees (Fisher), of finite rays"
    columns = [
        Column("scene"),
        Column("measured"),
        *(Column(name, format=".3f", help=glossary()[name]) for name in names),
        *(
            [
                Column("trees_low", "finite rays: from", ".3f", interval),
                Column("trees_high", "to", ".3f", interval),
                Column("spearman", "finite rays: rank r", ".3f", "Spearman's"),
            ]
            if finite is not None
            else []
        ),
        Column(
            "held_out",
            "fitted, held out",
            ".3f",
            "each tree from α and a line fitted to the others",
        ),
        Column("alpha", "α fitted", ".2f"),
        Column("estimate", "α estimated", ".2f"),
        Column("known", "known to", ".1%", known),
    ]
    return Sheet(
        name="r",
        section=SECTION,
        title="r per scene, the named predictors",
        note="An r over few trees is uncertain: the interval is where it could be over as many "
        "other trees.",
        frame=frame.reset_index(),
        columns=columns,
    )


def _others(correlations: pd.DataFrame) -> Sheet:
    names = [one.name for one in _shown(correlations) if one.name not in NAMED]
    return Sheet(
        name="r-others",
        section=SECTION,
        title="r per scene, the other predictors",
        frame=_by_scene(correlations, names),
        columns=[
            Column("scene"),
            Column("measured"),
            *(Column(name, format=".3f", help=glossary()[name]) for name in names),
        ],
    )


def _shared(records: Records) -> Sheet:
    return Sheet(
        name="shared-weights",
        section=SECTION,
        title="Weights that the scenes share",
        frame=shared_weights(records),
        columns=[
            Column("measurement"),
            Column("alpha", "best fixed α", ".2f"),
            Column("beta", "best fixed β of LCV", ".2f"),
            Column("beta_low", "smallest β without a scene", ".2f"),
            Column("beta_high", "largest", ".2f"),
        ],
    )


def _absolute(records: Records) -> Sheet:
    return Sheet(
        name="finite-rays",
        section=SECTION,
        title="Finite rays against counted cost, nothing fitted",
        frame=absolute_errors(records),
        columns=[
            Column("scene"),
            Column("s", format=".2f", help="mean ray length over mean chord"),
            Column("hit_share", "rays that hit", ".0%"),
            Column("bias", "mean error", "+.0%"),
            Column("worst", "worst error", "+.0%"),
            Column("spread", "worst without the mean", ".0%"),
            Column("sigma", "σ / mean of EPO at starts", ".1f"),
        ],
    )


def _level(records: Records) -> list[Sheet]:
    frame = level_pieces(records)
    if frame.empty:
        return []
    sheet = Sheet(
        name="level",
        section=SECTION,
        title="What the level of finite rays misses",
        note="Finite rays over counted cost, mean over a scene's trees, and the three factors that "
        "it is the product of. Which lines: rays do not lie on uniform lines. Along the line: a "
        "ray begins in dense geometry and, where it leaves the scene, ends in empty space, while "
        "the formula spreads the cost evenly. Order: nodes are visited that were pushed before "
        "the hit was known.",
        frame=frame,
        columns=[
            Column("scene"),
            Column("hit_share", "rays that hit", ".0%"),
            Column("level", "finite / counted", ".2f"),
            Column("which_lines", "which lines", ".2f", "finite rays over finite by lines"),
            Column("along", "along the line", ".2f", "finite by lines over touched"),
            Column("order", format=".2f", help="touched over counted cost"),
        ],
    )
    return [sheet]


def _simd(records: Records) -> Sheet:
    return Sheet(
        name="simd-deviation",
        section=SECTION,
        title="How SIMD departs from scalar time, and what LCV explains of it",
        note="A tree's deviation is the logarithm of SIMD over scalar time, less the mean of the "
        "scene's trees. Explained is the square of r, with its sign; noise is the share of the "
        "deviations' variance that is the stopwatch's.",
        frame=simd_deviation(records),
        columns=[
            Column("scene"),
            Column("deviation", "mean deviation", ".1%"),
            Column("r", "r of LCV", ".2f"),
            Column("explained", "explained by LCV", ".0%"),
            Column("noise", format=".0%"),
        ],
    )
