"""Claims on how well time is predicted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.studies.analyse.correlations import SCALAR, overview
from mibvh.studies.paper.claims.common import BY_COUNT, NONE, mean_and_least, r_words, steady
from mibvh.studies.paper.published import published
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.scene import Records

_TOPIC = "prediction"


def prediction_claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    """Judge the claims by times where they are known well enough, otherwise by counted cost."""
    by_time = steady(records, SCALAR)
    target, by = (SCALAR.ns, "") if by_time else ("counted_cost", BY_COUNT)
    of_target = correlations[correlations["measurement"] == target]
    yield from _by_sah(overview(correlations), of_target, target, by)
    yield from _by_both(overview(correlations), target, by)
    yield _alpha(correlations)


def _by_sah(
    summary: pd.DataFrame, of_target: pd.DataFrame, target: str, by: str
) -> Iterator[Claim]:
    r, paper = summary.loc[(target, "SAH")], published().r["SAH"]
    known = bool(np.isfinite(r["mean"]))
    yield Claim(
        topic=_TOPIC,
        claim="SAH alone is not a reliable predictor of time",
        paper=r_words(paper.mean, paper.low),
        ours=_time_and_count(summary, "SAH"),
        judged="some scene's r below 0.90 (borderline, say the slides)" + by,
        conditions=(bool(r["min"] < 0.90),) if known else (),
        scenes=int(r["scenes"]),
    )
    worst = of_target.loc[of_target["predictor"] == "SAH", "worst_error"].dropna()
    told = _worst_words(summary, "SAH")
    many = f"30% or more in {(worst >= 0.3).sum()} of {len(worst)} scene{'s' * (len(worst) != 1)}"
    many += f" ({'scalar time' if target == SCALAR.ns else 'counted cost'})"
    yield Claim(
        topic=_TOPIC,
        claim="SAH routinely allows mispredictions of 30%",
        paper="30%",
        ours=f"{told}; {many}" if known else NONE,
        judged="some tree off the line by 30% in a quarter of the scenes" + by,
        conditions=(bool((worst >= 0.3).mean() >= 0.25),) if known else (),
        scenes=len(worst),
    )


def _by_both(summary: pd.DataFrame, target: str, by: str) -> Iterator[Claim]:
    alone, fitted, fixed = (summary.loc[(target, name)] for name in ("SAH", "fitted", "fixed 0.79"))
    paper = published().r
    yield Claim(
        topic=_TOPIC,
        claim="with EPO, α fitted per scene, time is predicted very well",
        paper=r_words(paper["fitted"].mean, paper["fitted"].low),
        ours=_time_and_count(summary, "fitted"),
        judged="mean r at least 0.99 (very good, say the slides); every scene's at least 0.90" + by,
        conditions=(bool(fitted["mean"] >= 0.99), bool(fitted["min"] >= 0.90))
        if np.isfinite(fitted["mean"])
        else (),
        scenes=int(fitted["scenes"]),
    )
    yield Claim(
        topic=_TOPIC,
        claim="with one α for all scenes EPO still helps",
        paper=f"α 0.79: {r_words(paper['fixed 0.79'].mean, paper['fixed 0.79'].low)}",
        ours=f"α 0.79: {_time_and_count(summary, 'fixed 0.79')}",
        judged="α 0.79 above SAH alone in the mean, and at the worst" + by,
        conditions=tuple(bool(fixed[c] > alone[c]) for c in ("mean", "min"))
        if np.isfinite(alone["mean"])
        else (),
        scenes=int(fixed["scenes"]),
    )


def _alpha(correlations: pd.DataFrame) -> Claim:
    fitted = (correlations["measurement"] == "counted_cost") & (
        correlations["predictor"] == "fitted"
    )
    alpha = correlations.loc[fitted, "alpha"].dropna()
    known = [scene.alpha for scene in published().known_scenes if scene.alpha is not None]
    return Claim(
        topic=_TOPIC,
        claim="the best α depends on the scene",
        paper=f"scene-dependent; {min(known):.2f} to {max(known):.2f} in three scenes, says "
        "tinybvh's source",
        ours=f"{_range(alpha)} (counted cost)" if len(alpha) else NONE,
        judged="a range of 0.2 or more",
        conditions=(bool(np.ptp(alpha) >= 0.2),) if len(alpha) > 1 else (),
        scenes=len(alpha),
    )


def _range(alpha: pd.Series) -> str:
    low, high = f"{alpha.min():.2f}", f"{alpha.max():.2f}"
    return low if low == high else f"{low} to {high}"


def _worst_words(summary: pd.DataFrame, name: str) -> str:
    """Worst misprediction of any tree by a predictor, of scalar time and of counted cost."""
    of = {"scalar time": SCALAR.ns, "counted cost": "counted_cost"}
    errors = {key: summary.loc[(target, name), "worst_error"] for key, target in of.items()}
    told = (f"{key} {error:.0%}" for key, error in errors.items() if np.isfinite(error))
    return f"{', '.join(told)} at worst"


def _time_and_count(summary: pd.DataFrame, name: str) -> str:
    """Mean and least r of a predictor, with scalar time and with counted cost."""
    timed, counted = (summary.loc[(target, name)] for target in (SCALAR.ns, "counted_cost"))
    return f"{mean_and_least(timed)}; counted cost: {mean_and_least(counted)}"
