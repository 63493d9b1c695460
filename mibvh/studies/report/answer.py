"""What a study found, in a few lines: for the head of the report, and for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.metrics.predictors import glossary
from mibvh.studies.analyse.advice import Advice, advice
from mibvh.studies.analyse.correlations import SCALAR, overview
from mibvh.studies.analyse.winners import (
    cost_over_best,
    winner,
    winner_in_time,
    wins,
    wins_in_time,
)
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.report.tables.audit import audits, failures
from mibvh.studies.report.tables.prediction import NAMED, times_known

#: Scenes that are told one by one; of more there is a sum.
_FEW = 3
_COUNTED = "counted cost (per ray, 1.2 for an inner node visited and 1.0 for a triangle tested)"
_ALONE = "SAH is the cost of endless random lines through the scene"
#: Why predictors say what they say.
_WHY = {
    "finite rays": f"{_ALONE}; rays are shorter and begin on surfaces, where boxes overlap. So "
    "finite rays takes the share s of SAH (the rays' mean length over the mean chord of the "
    "scene's box) and adds the cost of the nodes that hold a ray's start",
    "finite by lines": f"{_ALONE}; rays are shorter and begin on surfaces, where boxes overlap. So "
    "finite by lines counts SAH along the rays' own lines, takes the share s of it that the rays "
    "cover, and adds the cost of the nodes that hold a ray's start",
    "estimated": f"{_ALONE}; rays end on surfaces, where boxes overlap (EPO). So estimated mixes "
    "the two, and the shorter the rays are, the greater is EPO's share α",
    "SAH": f"{_ALONE}, and no other predictor did better here by more than the noise",
}


def answer(records: Records, correlations: pd.DataFrame) -> list[str]:
    """Return the findings in ten lines or so.

    Parameters
    ----------
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    advised = advice(correlations)
    return [
        *(_each(records) if len(records) <= _FEW else _best(records)),
        *_without(records),
        *_checked(records),
        *_predicted(correlations, advised),
        *_why(correlations, advised),
    ]


def _each(records: Records) -> Iterator[str]:
    """The best tree of each scene, by how much, and whether times say the same."""
    for record in records:
        best, timed = winner(record), winner_in_time(record, SCALAR)
        line = f"{record.scene}: {best}, by {_COUNTED}"
        if timed is not None and timed.second:
            line += f"; in scalar time {timed}"
        yield line
        yield from _given(record)


def _best(records: Records) -> Iterator[str]:
    """Which tree is the best how often, what one builder for all costs, whether that is sure."""
    won = wins(records)
    told = ", ".join(f"{name} in {count}" for name, count in won.items())
    open_ = len(records) - sum(won.values())
    tied = f"; in {open_} the first two are within their errors" if open_ else ""
    yield f"Best tree by {_COUNTED}, of {len(records)} scenes: {told or 'none for sure'}{tied}"
    over = list(cost_over_best(records).items())[:3]
    if over:
        told = "; ".join(f"{name} {_more(shares - 1)}" for name, shares in over)
        yield f"One builder for all scenes costs more than each scene's best, on average: {told}"
    yield _believed(records, sum(won.values()))


def _more(over: np.ndarray) -> str:
    return f"{over.mean():.1%} (median {np.median(over):.1%}, worst {over.max():.1%})"


def _believed(records: Records, sure: int) -> str:
    """How many leads are beyond their errors, by counts and by the stopwatch."""
    line = (
        "Can it be believed? Counts are exact for their rays, and the winner would stay with "
        f"other rays in {sure} of {len(records)} scenes (a lead beyond twice its error)"
    )
    timed = wins_in_time(records, SCALAR)
    if not timed.scenes:
        return line
    return (
        f"{line}. In scalar time the same tree leads for sure in {timed.same} of {timed.scenes}, "
        f"another in {timed.another or 'none'}; in {timed.open} the first two are within the error"
    )


def _given(record: SceneRecord) -> Iterator[str]:
    """Where the trees stand that were not built here."""
    cost, built = record.column("counted_cost"), record.column("build_seconds")
    best = int(np.argmin(cost))
    for i, tree in enumerate(record.trees):
        if np.isnan(built[i]) and i != best:
            place = f"number {1 + int((cost < cost[i]).sum())} of {len(cost)}"
            above = f"{cost[i] / cost[best] - 1:.1%} above {record.trees[best].builder}"
            yield f"{record.scene}: {tree.builder} is {place}, {above}"


def _without(records: Records) -> Iterator[str]:
    """Over how many trees the figures of scenes are that some tree is missing of."""
    told = [f"{record.over} of {record.scene}" for record in records if record.over]
    if told:
        yield f"Figures and correlations are over {', '.join(told)}: the others could not be had"


def _checked(records: Records) -> Iterator[str]:
    """What the numbers were checked by, and how well times are known."""
    checks = sum(len(of) for record in records for _, of in audits(record))
    if checks:
        line = f"{checks:,} comparisons with independent code, {len(failures(records)) or 'none'}"
        yield f"Checked: {line} failed. {times_known(records)}".rstrip(". ")


def _predicted(correlations: pd.DataFrame, advised: Advice | None) -> Iterator[str]:
    """Which predictor to use, and how well the other named ones did."""
    if advised is None:
        return
    table = overview(correlations)
    counted, timed = (table.loc[measured] for measured in ("counted_cost", SCALAR.ns))
    first = (
        f"Predict with {advised.name}, which fits nothing: its r (Pearson's, predicted against "
        f"measured over a scene's trees) is {_r(counted.loc[advised.name])} with counted cost"
    )
    if np.isfinite(timed.loc[advised.name]["mean"]):
        first += f", {_r(timed.loc[advised.name])} with scalar time"
    if advised.equals:
        first += f"; within the noise {' and '.join(advised.equals)} did as well"
    yield first
    others = [name for name in NAMED if name in counted.index and name != advised.name]
    told = [f"{n} {_r(counted.loc[n])}" for n in others if np.isfinite(counted.loc[n]["mean"])]
    if told:
        yield f"The others, r with counted cost: {', '.join(told)}"


def _r(row: pd.Series) -> str:
    """Mean r over the scenes, and the worst if there are several."""
    worst = f" (worst {row['min']:.3f})" if row["scenes"] > 1 else ""
    return f"{row['mean']:.3f}{worst}"


def _why(correlations: pd.DataFrame, advised: Advice | None) -> Iterator[str]:
    """Why the predictor is advised, and what the fitted weights say of where the cost is."""
    if advised is not None:
        yield f"Why: {_WHY.get(advised.name, glossary()[advised.name])}"
    of = correlations[
        (correlations["predictor"] == "fitted") & (correlations["measurement"] == "counted_cost")
    ]
    alpha = of["alpha"].dropna()
    if not len(alpha):
        return
    fits = f"{alpha.iloc[0]:.2f}"
    if len(alpha) > 1:
        fits = f"another in each scene, {alpha.min():.2f} to {alpha.max():.2f}"
    yield (
        "fitted and estimated are the paper's mix, (1 − α) SAH + α EPO (end-point overlap: the "
        "cost of nodes that hold a surface point, but not its triangle), α fitted to the trees or "
        f"taken from the rays' length; the α that fits best is {fits}"
    )
