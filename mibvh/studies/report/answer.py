"""The main findings of a study, for the head of the report and for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.builders import get, later_names
from mibvh.builders import names as builder_names
from mibvh.builders.chosen import builder_of
from mibvh.metrics.predictors import glossary
from mibvh.studies.analyse.advice import Advice, advice
from mibvh.studies.analyse.choice import cost_of_choice
from mibvh.studies.analyse.correlations import LANES, SCALAR, LaneMode, overview
from mibvh.studies.analyse.winners import (
    cost_over_best,
    winner,
    winner_in_time,
    wins,
    wins_in_time,
)
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.report.tables.audit import audits, failures
from mibvh.studies.report.tables.prediction import NAMED, time_errors
from mibvh.triangles import F64

#: Scenes that are told one by one; of more there is a sum.
_FEW = 3
_COUNTED = "counted cost (per ray: 1.2 for each inner node visited, 1.0 for each triangle tested)"
_ALONE = "SAH is the cost of infinite random lines through the scene"
#: Why predictors say what they say.
_WHY = {
    "finite rays": f"{_ALONE}; rays are shorter and begin on surfaces, where boxes overlap. Finite "
    "rays = s × SAH + the cost of the nodes that hold a ray's start, where s is the rays' mean "
    "length over the mean chord of the scene's box",
    "finite by lines": f"{_ALONE}; rays are shorter and begin on surfaces, where boxes overlap. "
    "Finite by lines = s × the cost of the rays' own lines through the whole scene + the cost "
    "of the nodes that hold a ray's start, where s is the share of the lines that the rays cover",
    "estimated": f"{_ALONE}; rays end on surfaces, where boxes overlap (EPO). So estimated mixes "
    "the two, and the shorter the rays are, the greater is EPO's share α",
    "SAH": f"{_ALONE}, and no other predictor did better here by more than the noise",
}


def answer(records: Records, correlations: pd.DataFrame) -> list[str]:
    """Return the findings in ten lines at most, each "what it is about: what was found".

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
        *_chosen(records, advised),
        *_why(advised),
        *_mix(correlations),
        *_others(correlations, advised),
    ]


def _each(records: Records) -> Iterator[str]:
    """State the best tree of each scene, its lead, and whether times agree."""
    for place, record in enumerate(records):
        best, timed = winner(record), winner_in_time(record, SCALAR)
        line = f"{record.scene}: {best}, by {'counted cost' if place else _COUNTED}"
        if timed is not None and timed.second:
            line += f"; in scalar time {timed}"
        yield "; ".join([line, *_given(record)])


def _best(records: Records) -> Iterator[str]:
    """State how often each builder is the best, and what one builder for all scenes costs."""
    won = wins(records)
    told = ", ".join(
        f"{name} in {'all ' if count == len(records) else ''}{count}" for name, count in won.items()
    )
    open_ = len(records) - sum(won.values())
    tied = f"; in {open_} the first two are within their errors" if open_ else ""
    best = f"Best tree of {len(records)} scenes: {told or 'none for sure'}{tied}, by {_COUNTED}"
    over = cost_over_best(records)
    yield best + _trained(list(won), list(over))
    if over:
        time = _pooled_time(records, list(over)[:2])
        yield f"One for all: {_one_for_all(over)}{time}"
    yield _believed(records, sum(won.values()))


def _trained(won: list[str], ranked: list[str]) -> str:
    """State which of the builders saw rays, and which is the best of those that did not.

    Parameters
    ----------
    won : list of str
        Builders that are the best of a scene.
    ranked : list of str
        All builders of all scenes, the one of the least mean first.
    """
    seen = [name for name in won if _sees(name)]
    if not seen:
        return ""
    blind = next((name for name in ranked if not _sees(name)), "")
    least = f"; the best that knows no cameras is {blind}" if blind else ""
    were = "was" if len(seen) == 1 else "were"
    return f". {' and '.join(seen)} {were} built for different rays from the same cameras{least}"


def _sees(name: str) -> bool:
    """Return whether a builder asks for the scene, whose cameras tell it of rays."""
    known = builder_of(name) in {*builder_names(), *later_names()}
    return known and get(builder_of(name)).asks_scene


def _one_for_all(over: dict[str, F64]) -> str:
    """State what the builders that are best over all scenes cost more than each scene's best."""
    names = list(over)[:3]
    never_beaten = bool(over[names[0]].max() == 1)
    told = "; ".join(
        f"{name} {_share(over[name].mean())} (median {_share(np.median(over[name]))}, "
        f"worst {_share(over[name].max())})"
        for name in names[never_beaten:]
    )
    if not never_beaten:
        return f"above each scene's best, on average: {told}"
    after = f". The next cost more, on average: {told}" if told else ""
    return f"no tree has a lower counted cost than {names[0]} in any scene{after}"


def _pooled_time(records: Records, names: list[str]) -> str:
    """State how much more time the second takes than the builder best over all scenes.

    Over many scenes that is known where no single scene's is. Its error is of the scatter.
    """
    if len(names) < 2:
        return ""
    told = []
    for lanes in LANES:
        ratios = np.log([_time_ratio(record, lanes, *names) for record in records])
        ratios = ratios[np.isfinite(ratios)]
        if len(ratios) > _FEW:
            more = np.exp(-ratios.mean())
            error = more * ratios.std(ddof=1) / np.sqrt(len(ratios))
            told.append(f"{lanes.title} {more - 1:+.1%} ± {error:.1%}")
    if not told:
        return ""
    return (
        f". The time of {names[1]} over that of {names[0]}: {', '.join(told)} (geometric mean ± "
        "standard error over the scenes)"
    )


def _time_ratio(record: SceneRecord, lanes: LaneMode, first: str, second: str) -> float:
    times = {tree.builder: tree[lanes.ns] for tree in record.trees}
    return float(times[first] / times[second])


def _more(over: F64) -> str:
    """Format how far costs are above the best: the mean, and the worst if there are several."""
    worst = f" (worst {_share(over.max())})" if len(over) > 1 else ""
    return f"{_share(over.mean())}{worst}"


def _share(over: float) -> str:
    """Format how far a cost is above the best, with another digit if it rounds to 0."""
    more = float(over) - 1
    return f"{more:.{2 if 0 < more < 0.0005 else 1}%}"


def _believed(records: Records, sure: int) -> str:
    """State how many leads exceed their errors, by counts and by the stopwatch."""
    line = (
        "How sure: counts are exact for their rays, and with other rays the same tree would win "
        f"in {sure} of {len(records)} scenes (its lead is beyond twice its error)"
    )
    timed = wins_in_time(records, SCALAR)
    if not timed.scenes:
        return line
    same = "the same tree leads beyond twice its error"
    told = [f"In scalar time {same} in {timed.same} of {timed.scenes}"]
    told += [f"another tree in {timed.another}"] if timed.another else []
    told += [f"in {timed.open} the first two are too near to tell"] if timed.open else []
    return f"{line}. {', '.join(told)}"


def _given(record: SceneRecord) -> Iterator[str]:
    """State the ranks of the given trees."""
    cost, built = record.column("counted_cost"), record.column("build_seconds")
    best = int(np.argmin(cost))
    for i, tree in enumerate(record.trees):
        if np.isnan(built[i]) and i != best:
            place = f"number {1 + int((cost < cost[i]).sum())} of {len(cost)}"
            above = f"{cost[i] / cost[best] - 1:.1%} above {record.trees[best].builder}"
            yield f"{tree.builder} is {place}, {above}"


def _without(records: Records) -> Iterator[str]:
    """State the number of trees of the scenes that have missing trees."""
    told = [f"{record.over} of {record.scene}" for record in records if record.over]
    if told:
        yield f"Missing trees: figures and correlations are over {', '.join(told)}"


def _checked(records: Records) -> Iterator[str]:
    """State the result of the audit, and the error of the times."""
    checks = sum(len(of) for record in records for _, of in audits(record))
    if checks:
        line = f"{checks:,} comparisons with independent code, {len(failures(records)) or 'none'}"
        times = time_errors(records)
        known = f". The time of a tree in a scene is known to {times} or better, one standard error"
        yield f"Checked: {line} failed{known if times else ''}"


def _predicted(correlations: pd.DataFrame, advised: Advice | None) -> Iterator[str]:
    """State the advised predictor, and how well it did."""
    if advised is None:
        return
    table = overview(correlations)
    counted, timed = (table.loc[measured] for measured in ("counted_cost", SCALAR.ns))
    first = (
        f"Predictor: {advised.name}, nothing fitted: r (Pearson's, over a scene's trees) is "
        f"{_r(counted.loc[advised.name], _worst(correlations, advised.name))} with counted cost"
    )
    if np.isfinite(timed.loc[advised.name]["mean"]):
        first += f", {_r(timed.loc[advised.name])} with scalar time"
    if advised.equals:
        first += f"; {_equals(advised)} did as well within the error of r"
    yield first


def _equals(advised: Advice) -> str:
    """Name the predictors that did as well, and what they are if that is told nowhere else."""
    briefly = {"finite by lines": " (SAH of the rays' own lines)"}
    return " and ".join(name + briefly.get(name, "") for name in advised.equals)


def _chosen(records: Records, advised: Advice | None) -> Iterator[str]:
    """State the cost of following the predictor, and of following SAH."""
    if advised is None:
        return
    names = dict.fromkeys((advised.name, "SAH"))
    over = {name: cost_of_choice(records, name) for name in names}
    if not all(np.isfinite(shares).all() for shares in over.values()):
        return
    told = (
        f"the tree that the predictor {name} puts first {_choice(of)}" for name, of in over.items()
    )
    yield f"Its choice: {'; '.join(told)}"


def _choice(over: F64) -> str:
    """Format how good the trees are that a predictor ranks first."""
    if len(over) == 1:
        return f"costs {_more(over)} more than the best" if over[0] > 1 else "is the best"
    best = int((over == 1).sum())
    often = f"is the best in {best or 'none'} of {len(over)} scenes"
    return f"{often}, and costs {_more(over)} more than the best on average"


def _others(correlations: pd.DataFrame, advised: Advice | None) -> Iterator[str]:
    """State how well the other named predictors did."""
    if advised is None:
        return
    counted = overview(correlations).loc["counted_cost"]
    others = [name for name in NAMED if name in counted.index and name != advised.name]
    told = [f"{n} {_r(counted.loc[n])}" for n in others if np.isfinite(counted.loc[n]["mean"])]
    if told:
        yield f"Others: r with counted cost is {', '.join(told)}{_leaning(correlations, advised)}"


def _leaning(correlations: pd.DataFrame, advised: Advice) -> str:
    """State what is left of r without one tree: a very bad one raises every r."""
    counted = correlations[correlations["measurement"] == "counted_cost"]
    left = counted.pivot(index="scene", columns="predictor", values="without_worst")
    left = left.reindex(columns=list(dict.fromkeys((advised.name, "SAH"))))
    known = left.dropna()
    if known.empty:
        return ""
    told = [f"{name} {r:.3f}" for name, r in known.mean().items()]
    few = f"the {len(known)} scenes that then have an r"
    where = "each scene" if len(known) == len(left) else few
    return f". Without the tree that changes it most, in {where}, r is {', '.join(told)}"


def _worst(correlations: pd.DataFrame, name: str) -> str:
    """Return the scene in which a predictor has its least r with counted cost."""
    of = correlations[
        (correlations["predictor"] == name) & (correlations["measurement"] == "counted_cost")
    ].dropna(subset="pearson")
    return str(of["scene"].iloc[int(of["pearson"].argmin())])


def _r(row: pd.Series, scene: str = "") -> str:
    """Format the mean r over the scenes, and the worst if there are several."""
    of = f", {scene}" if scene else ""
    worst = f" (worst {row['min']:.3f}{of})" if row["scenes"] > 1 else ""
    return f"{row['mean']:.3f}{worst}"


def _why(advised: Advice | None) -> Iterator[str]:
    """State why the predictor is advised."""
    if advised is not None:
        yield f"Why: {_WHY.get(advised.name, glossary()[advised.name])}"


def _mix(correlations: pd.DataFrame) -> Iterator[str]:
    """State what the paper's predictor is, and what its fitted weights say about the cost."""
    of = correlations[
        (correlations["predictor"] == "fitted") & (correlations["measurement"] == "counted_cost")
    ]
    alpha = of["alpha"].dropna()
    if not len(alpha):
        return
    fits = f"{alpha.iloc[0]:.2f}"
    if len(alpha) > 1:
        fits = f"different in each scene, {alpha.min():.2f} to {alpha.max():.2f}"
    yield (
        "The paper's mix: (1 − α) SAH + α EPO (end-point overlap: the cost of nodes that hold a "
        "surface point, but not its triangle), α fitted to each scene's trees (fitted) or taken "
        "from the rays' length (estimated). EPO takes all surfaces alike, wherever rays start; the "
        f"α that fits best is {fits}"
    )
