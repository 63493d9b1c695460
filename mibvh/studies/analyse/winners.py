"""The best tree of each scene, its lead, and whether the lead is significant."""

from __future__ import annotations

import dataclasses

import numpy as np

from mibvh.studies.analyse.correlations import LaneMode
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.record.sheet import digits_of
from mibvh.triangles import F64

_NONE = float("nan")
#: Standard errors beyond which a lead counts.
_SURE = 2.0


@dataclasses.dataclass(frozen=True)
class Winner:
    """The best tree of a scene by one measurement.

    Attributes
    ----------
    scene, builder : str
    second : str
        The builder of the next one; empty if there is none.
    lead : float
        By what share the second costs more.
    error : float
        Standard error of the lead: of counted cost over the rays, of times by the stopwatch.
    """

    scene: str
    builder: str
    second: str = ""
    lead: float = _NONE
    error: float = _NONE

    @property
    def sure(self) -> bool:
        """Whether the lead exceeds twice its error; false if the error is unknown."""
        return bool(self.lead > _SURE * self.error)

    @property
    def margin(self) -> str:
        """The lead with its error, as text."""
        lead = f"{self.lead:.1%}"
        if np.isfinite(self.error):
            digits = digits_of(self.error)
            lead = f"{self.lead:.{digits}%} ± {max(self.error, 1e-4):.{digits}%}"
        return lead

    def __str__(self) -> str:
        if not self.second:
            return self.builder
        lead = self.margin
        if self.sure:
            return f"{self.builder}, {lead} ahead of {self.second}"
        return f"{self.builder} or {self.second} ({lead} apart)"


def winner(record: SceneRecord) -> Winner:
    """Return the tree of lowest counted cost.

    The error is that of the ratio of the two costs over the random groups of rays that a study
    keeps: the trees trace the same rays, so what the rays have in common cancels.
    """
    first, second = _two_least(record, "counted_cost")
    if second is None:
        return Winner(record.scene, record.trees[first].builder)
    a, b = (np.array(record.trees[i].cost_groups, np.float64) for i in (first, second))
    error = _NONE
    if len(a) > 1 and (a > 0).all():
        error = float((b / a).std(ddof=1) / np.sqrt(len(a)))
    return _winner(record, "counted_cost", first, second, error)


def winner_in_time(record: SceneRecord, lanes: LaneMode) -> Winner | None:
    """Return the tree of lowest time; None if times are unknown."""
    if not record.knows(lanes.ns):
        return None
    first, second = _two_least(record, lanes.ns)
    if second is None:
        return Winner(record.scene, record.trees[first].builder)
    a, b = (record.trees[i][lanes.error] for i in (first, second))
    ratio = record.trees[second][lanes.ns] / record.trees[first][lanes.ns]
    return _winner(record, lanes.ns, first, second, float(ratio * np.hypot(a, b)))


def _two_least(record: SceneRecord, name: str) -> tuple[int, int | None]:
    order = np.argsort(record.column(name), kind="stable")
    return int(order[0]), int(order[1]) if len(order) > 1 else None


def _winner(record: SceneRecord, name: str, first: int, second: int, error: float) -> Winner:
    costs = record.column(name)
    lead = float(costs[second] / costs[first] - 1) if costs[first] > 0 else _NONE
    builders = [tree.builder for tree in record.trees]
    return Winner(record.scene, builders[first], builders[second], lead, error)


def wins(records: Records) -> dict[str, int]:
    """Number of scenes that each builder wins significantly by counted cost, most first."""
    found = [winner(record) for record in records]
    sure = [one.builder for one in found if one.sure or not one.second]
    names = sorted(set(sure), key=lambda name: (-sure.count(name), name))
    return {name: sure.count(name) for name in names}


@dataclasses.dataclass(frozen=True)
class InTime:
    """Number of scenes in which the winner by counted cost also wins in time.

    Attributes
    ----------
    same : int
        Its lead in time is beyond twice its error.
    another : int
        Another tree's is.
    open : int
        The first two in time are within twice their error.
    """

    same: int
    another: int
    open: int

    @property
    def scenes(self) -> int:
        """Number of scenes that were timed."""
        return self.same + self.another + self.open


def wins_in_time(records: Records, lanes: LaneMode) -> InTime:
    """Return whether the stopwatch confirms the winners by counted cost."""
    timed = [(winner(record), winner_in_time(record, lanes)) for record in records]
    known = [(best, time) for best, time in timed if time is not None and time.second]
    sure = [best.builder == time.builder for best, time in known if time.sure]
    return InTime(sum(sure), len(sure) - sum(sure), len(known) - len(sure))


def cost_over_best(records: Records) -> dict[str, F64]:
    """Counted cost of each builder's tree relative to the scene's best; (S,) float64 each.

    Only builders that have a tree of every scene, the one of the least mean first.
    """
    rows = [{tree.builder: tree["counted_cost"] for tree in record.trees} for record in records]
    common = [name for name in rows[0] if all(name in row for row in rows)]
    shares = {
        name: np.array([row[name] / min(row.values()) for row in rows])
        for name in common
        if all(min(row.values()) > 0 for row in rows)
    }
    return dict(sorted(shares.items(), key=lambda item: float(item[1].mean())))
