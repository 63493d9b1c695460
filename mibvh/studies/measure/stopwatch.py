"""The stopwatch: trees measured round-robin until the error is small enough.

A shared machine drifts by more than good trees differ. Each round times every tree once; a round's
times are divided by their mean, which takes the drift out, and the median over the rounds of that
ratio is a tree's figure, times the grand median. Within a round the trees take turns after every
portion of the rays, some hundredths of a second, so that a drift that is shorter than a round
meets all trees alike: that makes the errors a fourth or a fifth of what they are if each tree
has all rays at a time.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

import numpy as np

from mibvh.triangles import F64

_FEWEST_ROUNDS = 7


@dataclasses.dataclass(frozen=True, eq=False)
class Timings:
    """Times of several trees.

    Attributes
    ----------
    seconds : (rounds, trees) float64
    complete : bool
        Whether the error asked for was reached before the time ran out.
    """

    seconds: F64
    complete: bool

    @property
    def _ratios(self) -> F64:
        return self.seconds / self.seconds.mean(axis=1, keepdims=True)

    @property
    def estimate(self) -> F64:
        """(trees,) float64: seconds of each tree."""
        return np.median(self._ratios, axis=0) * np.median(self.seconds.mean(axis=1))

    @property
    def relative_error(self) -> F64:
        """(trees,) float64: standard error of each estimate, relative to it.

        That of a median of normal values, 1.2533 sigma / sqrt(rounds), with sigma from the
        median absolute deviation, so that a few disturbed rounds do not count.
        """
        ratios = self._ratios
        middle = np.median(ratios, axis=0)
        sigma = 1.4826 * np.median(np.abs(ratios - middle), axis=0)
        return 1.2533 * sigma / np.sqrt(len(ratios)) / middle


def measure(
    launches: Sequence[Callable[[int], float]],
    *,
    portions: int = 1,
    seconds: float,
    standard_error: float,
    progress: Callable[[float], None] | None = None,
) -> Timings:
    """Time launches round-robin.

    Parameters
    ----------
    launches : sequence of callable
        Each traces the portion of the rays with that number through one tree, and returns its
        kernel time in seconds.
    portions : int
        How many there are.
    seconds : float
        Time budget; at least seven rounds are measured whatever it is.
    standard_error : float
        Relative error of every tree at which to stop.
    progress : callable, optional
        Called with the share of the budget used.
    """
    for launch in launches:  # warm up: compile, fill caches
        launch(0)
    rounds: list[list[float]] = []
    started = time.perf_counter()
    while True:
        # Start each round at another tree, so that none always follows the same one.
        shift = len(rounds) % len(launches)
        row = [0.0] * len(launches)
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
        timings = Timings(np.array(rounds), True)
        if (timings.relative_error <= standard_error).all():
            return timings
        if spent >= seconds:
            return Timings(np.array(rounds), False)
