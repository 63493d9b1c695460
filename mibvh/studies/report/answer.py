"""What a study found, in a few lines: for the head of the report, and for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.metrics.predictors import predictors
from mibvh.studies.analyse.correlations import SCALAR, overview, worst_error
from mibvh.studies.analyse.winners import mean_cost_over_best, winner, wins
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.report.tables.audit import audits, failures
from mibvh.studies.report.tables.prediction import NAMED

#: Scenes that are told one by one; of more there is a sum.
_FEW = 3


def answer(records: Records, correlations: pd.DataFrame) -> list[str]:
    """Return the findings in ten lines at most.

    Parameters
    ----------
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    return [
        *_best(records),
        *_trusted(records),
        *_predicted(correlations),
        *_why(correlations),
    ]


def _best(records: Records) -> Iterator[str]:
    """Which tree is the best, by how much, and whether that is sure."""
    if len(records) <= _FEW:
        for record in records:
            yield f"{record.scene}: {winner(record)} (counted cost)"
            yield from _given(record)
        return
    won = wins(records)
    told = ", ".join(f"{name} in {count}" for name, count in won.items())
    open_ = len(records) - sum(won.values())
    tied = f"; in {open_} the first two are within their errors" if open_ else ""
    yield f"Best by counted cost, of {len(records)} scenes: {told or 'none for sure'}{tied}"
    over = list(mean_cost_over_best(records).items())[:3]
    if over:
        told = ", ".join(f"{name} +{share - 1:.1%}" for name, share in over)
        yield f"Over the scene's best on average: {told}"


def _given(record: SceneRecord) -> Iterator[str]:
    """Where the trees stand that were not built here."""
    cost, built = record.column("counted_cost"), record.column("build_seconds")
    best = int(np.argmin(cost))
    for i, tree in enumerate(record.trees):
        if np.isnan(built[i]) and i != best:
            place = f"number {1 + int((cost < cost[i]).sum())} of {len(cost)}"
            above = f"{cost[i] / cost[best] - 1:.1%} above {record.trees[best].builder}"
            yield f"{record.scene}: {tree.builder} is {place}, {above}"


def _trusted(records: Records) -> Iterator[str]:
    """What the numbers were checked by, and how well times are known."""
    checks = sum(len(of) for record in records for _, of in audits(record))
    if not checks:
        return
    failed = len(failures(records))
    error = worst_error(records, SCALAR.error)
    known = f"; times are known to ±{error:.1%} or better" if np.isfinite(error) else ""
    yield (
        f"Checked: {checks:,} comparisons with independent code, {failed or 'none'} failed; "
        f"counted cost has no noise but that of the rays{known}"
    )


def _predicted(correlations: pd.DataFrame) -> Iterator[str]:
    """How well each named predictor did; the best one with nothing fitted comes first."""
    table = overview(correlations)
    done = set(correlations["predictor"])
    told: list[tuple[float, str, str]] = []
    for one in predictors():
        if one.name not in NAMED or one.name not in done:
            continue
        of = [table.loc[(measured, one.name)] for measured in ("counted_cost", SCALAR.ns)]
        counted, timed = (f"{row['mean']:.3f} (worst {row['min']:.3f})" for row in of)
        if np.isfinite(of[0]["mean"]):
            with_time = f", scalar time {timed}" if np.isfinite(of[1]["mean"]) else ""
            unfitted = of[0]["mean"] if one.free == "0" else -np.inf
            told.append((unfitted, one.name, f"r with counted cost {counted}{with_time}"))
    best = max(told, default=None)
    if best is not None and np.isfinite(best[0]):
        told.remove(best)
        yield f"Predict with {best[1]}, which fits nothing: {best[2]}"
    for _, name, line in told:
        yield f"{name}: {line}"


def _why(correlations: pd.DataFrame) -> Iterator[str]:
    """What the fitted weights say of where the cost comes from."""
    of = correlations[
        (correlations["predictor"] == "fitted") & (correlations["measurement"] == "counted_cost")
    ]
    alpha = of["alpha"].dropna()
    if len(alpha):
        range_ = (
            f"{alpha.min():.2f} to {alpha.max():.2f}" if len(alpha) > 1 else f"{alpha.min():.2f}"
        )
        yield (
            "Why: SAH knows rays that pass through, EPO what they meet where they end; the share α "
            f"of EPO that fits best is {range_}"
        )
