"""Tables on how well cost is predicted."""

from __future__ import annotations

import pandas as pd

from mibvh.metrics.predictors import glossary, predictors
from mibvh.metrics.registry import Quantity
from mibvh.studies.analyse.calibration import absolute_errors
from mibvh.studies.analyse.correlations import overview, shared_weights, worst_error
from mibvh.studies.analyse.noise import simd_deviation
from mibvh.studies.paper.published import published
from mibvh.studies.record.quantities import targets
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

#: The section that the figure of all correlations stands in.
SECTION = "How well cost is predicted"
#: The measurement that the paper's figures are against.
_PAPER_TARGET = "scalar_ns"


def prediction_sheets(records: Records, found: pd.DataFrame) -> list[Sheet]:
    """Return the tables, those over all scenes first."""
    return [
        *(_overview(records, found, target) for target in targets()),
        _shared(records),
        *(_per_scene(records, found, target) for target in targets()),
        _absolute(records),
        _simd(records),
    ]


def times_known(records: Records, target: Quantity) -> str:
    """How well the times are known that an r is against; nothing for what has no noise."""
    if not target.error:
        return ""
    error = worst_error(records, target.error)
    return f"Times of a scene's trees are known relative to each other to ±{error:.1%} or better."


def _overview(records: Records, found: pd.DataFrame, target: Quantity) -> Sheet:
    frame = overview(found).loc[target.name].reset_index()
    columns = [
        Column("predictor"),
        Column("mean", format=".3f"),
        Column("min", format=".3f"),
        Column("max", format=".3f"),
        Column(
            "worst_error",
            "worst error",
            ".0%",
            "largest misprediction of any tree by the least-squares line",
        ),
        Column("scenes"),
    ]
    if target.name == _PAPER_TARGET:
        text = {name: f"{r.mean:.3f} ({r.low:.3f} to {r.high:.3f})"
                for name, r in published().r.items()}  # fmt: skip
        frame["paper"] = frame["predictor"].map(text).fillna("")
        over = f"mean (minimum to maximum) over the {published().scenes} scenes of the slides"
        columns.append(Column("paper", help=over))
    return Sheet(
        name=f"overview-{target.name}",
        section=SECTION,
        title=f"r over the scenes: {target.heading}",
        note=times_known(records, target),
        frame=frame,
        columns=columns,
        glossary=glossary(),
    )


def _per_scene(records: Records, found: pd.DataFrame, target: Quantity) -> Sheet:
    of = found[found["measurement"] == target.name]
    shown = [one for one in predictors() if one.name in set(of["predictor"])]
    frame = of.pivot(index="scene", columns="predictor", values="pearson")
    frame = frame.reindex(index=of["scene"].unique(), columns=[one.name for one in shown])
    fitted = of[of["predictor"] == "fitted"].set_index("scene")
    frame["held_out"] = fitted["held_out"]
    frame["alpha"] = fitted["alpha"]
    frame["estimate"] = of[of["predictor"] == "estimated"].set_index("scene")["alpha"]
    columns = [
        Column("scene"),
        *(Column(one.name, format=".3f", help=one.formula) for one in shown),
        Column("held_out", "fitted, held out", ".3f"),
        Column("alpha", "α fitted", ".2f"),
        Column("estimate", "α estimated", ".2f"),
    ]
    if target.error:
        frame["known"] = [worst_error([record], target.error) for record in records]
        known = "largest standard error of a tree's time, relative to the scene's other trees"
        columns.append(Column("known", "times known to", ".1%", known))
    return Sheet(
        name=f"r-{target.name}",
        section=SECTION,
        title=f"r per scene: {target.heading}",
        frame=frame.rename_axis(columns=None).reset_index(),
        columns=columns,
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
