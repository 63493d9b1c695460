"""The stopwatch: trees measured round-robin until the error is small enough.

A shared machine drifts by more than good trees differ. Each round times every tree once; a round's
times are divided by their mean, which takes the drift out, and the median over the rounds of that
ratio is a tree's figure, times the grand median. Within a round the trees take turns after every
portion of the rays, some hundredths of a second, so that a drift that is shorter than a round
meets all trees alike: that makes the errors a fourth or a fifth of what they are if each tree
has all rays at a time.

Two clocks are read at every launch. The kernel's wall time counts what other programs take away;
the CPU time of the process does not, but it counts what cores cost each other. The clock that
agrees better with itself gives the ratios between trees; the wall time gives their level. On a GPU
there is only the kernel's time.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from mibvh.traversal.trace import LaunchSeconds
from mibvh.triangles import F64

#: Wall time of the kernels, or CPU time of the process while they run.
Clock = Literal["kernel", "process"]
CLOCKS: tuple[Clock, ...] = ("kernel", "process")  # in the order of LaunchSeconds
#: A launch shorter than this, in seconds, is not timed: starting it costs a share of that.
SHORTEST = 0.02

_FEWEST_ROUNDS = 7
_RESAMPLES = 400


@dataclasses.dataclass(frozen=True, eq=False)
class Timings:
    """Times of several trees.

    Attributes
    ----------
    seconds : dict of str to (rounds, trees) float64
        By each clock.
    same : tuple of pairs of int
        Columns that are one and the same tree, timed under two names.
    complete : bool
        Whether the error asked for was reached before the time ran out.
    """

    seconds: Mapping[Clock, F64]
    same: tuple[tuple[int, int], ...] = ()
    complete: bool = True

    @property
    def rounds(self) -> int:
        """How often each tree was timed."""
        return len(self.seconds["kernel"])

    @property
    def clock(self) -> Clock:
        """The clock by which the largest error of a tree is smaller; one that ran."""
        ran = [clock for clock in CLOCKS if np.isfinite(self.seconds[clock]).all()]
        return min(ran, key=lambda clock: float(self.relative_error_by(clock).max()))

    @property
    def estimate(self) -> F64:
        """(trees,) float64: seconds of each tree, as ratios by :attr:`clock`."""
        return self.estimate_by(self.clock)

    @property
    def relative_error(self) -> F64:
        """(trees,) float64: standard error of each estimate, relative to it."""
        return self.relative_error_by(self.clock)

    def estimate_by(self, clock: Clock) -> F64:
        """(trees,) float64: seconds of each tree.

        The ratios between trees are the clock's, their level is the kernel time's.
        """
        level = np.median(self.seconds["kernel"].mean(axis=1))
        return np.median(_ratios(self.seconds[clock]), axis=0) * level

    def relative_error_by(self, clock: Clock) -> F64:
        """(trees,) float64: standard error of each estimate, relative to it.

        That of the median over blocks of rounds drawn anew (neighbouring rounds are not
        independent), and never less than by how much the same tree differed from itself.
        """
        ratios = _ratios(self.seconds[clock])
        drawn = np.median(ratios[_blocks(len(ratios))], axis=1)
        error = drawn.std(axis=0, ddof=1) / np.median(ratios, axis=0)
        return np.maximum(error, np.abs(self.same_tree_differences(clock)).max(initial=0.0))

    def same_tree_differences(self, clock: Clock) -> F64:
        """(pairs,) float64: how far the second of each pair :attr:`same` is from the first."""
        estimate = self.estimate_by(clock)
        return np.array([estimate[b] / estimate[a] - 1 for a, b in self.same], np.float64)


def _ratios(seconds: F64) -> F64:
    return seconds / seconds.mean(axis=1, keepdims=True)


def _blocks(rounds: int) -> np.ndarray:
    """(resamples, rounds) int: rounds drawn with replacement, in runs of neighbours.

    The moving block bootstrap (Kuensch 1989), with blocks of the cube root of the rounds.
    """
    length = max(1, round(rounds ** (1 / 3)))
    rng = np.random.default_rng(0)
    begin = rng.integers(0, rounds - length + 1, (_RESAMPLES, -(-rounds // length)))
    index = begin[:, :, None] + np.arange(length)
    return index.reshape(_RESAMPLES, -1)[:, :rounds]


def measure(
    launches: Sequence[Callable[[int], LaunchSeconds]],
    *,
    portions: int = 1,
    seconds: float,
    standard_error: float,
    same: Sequence[tuple[int, int]] = (),
    progress: Callable[[float], None] | None = None,
) -> Timings:
    """Time launches round-robin.

    Parameters
    ----------
    launches : sequence of callable
        Each traces the portion of the rays with that number through one tree, and returns what
        the clocks say. None should be shorter than :data:`SHORTEST`.
    portions : int
        How many there are.
    seconds : float
        Time budget; at least seven rounds are measured whatever it is.
    standard_error : float
        Relative error of every tree at which to stop.
    same : sequence of pairs of int
        Launches that trace the same tree: no error is smaller than their difference.
    progress : callable, optional
        Called with the share of the budget used.
    """
    for launch in launches:  # warm up: compile, fill caches
        launch(0)
    rounds: list[np.ndarray] = []
    started = time.perf_counter()
    while True:
        # Start each round at another tree, so that none always follows the same one.
        shift = len(rounds) % len(launches)
        row = np.zeros((len(launches), len(CLOCKS)))
        for portion in range(portions):
            for i in range(len(launches)):
                k = (i + portion + shift) % len(launches)
                row[k] += launches[k](portion)
        rounds.append(row)
        spent = time.perf_counter() - started
        if progress:
            progress(min(spent / max(seconds, 1e-9), 1.0))
        if len(rounds) < _FEWEST_ROUNDS:
            continue
        table = np.stack(rounds)
        by_clock = {clock: table[:, :, i] for i, clock in enumerate(CLOCKS)}
        timings = Timings(by_clock, tuple(same))
        if (timings.relative_error <= standard_error).all():
            return timings
        if spent >= seconds:
            return dataclasses.replace(timings, complete=False)
