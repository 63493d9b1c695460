"""What warps in lockstep cost, predicted from what single rays cost.

A warp takes as long as its lanes make it take together. How far that is from what its rays need
depends on how much they differ: these functions measure that, and estimate what a warp issues, from
counts per ray of scalar lanes. Nothing is fitted.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.triangles import F64, I32

Counts = npt.NDArray[Any]


def packets(values: Counts, width: int, dealt: I32 | None = None) -> F64:
    """Values of rays, a row of ``width`` for each packet of rays dealt side by side.

    Parameters
    ----------
    values : (R,) array
    width : int
    dealt : (R,) int32, optional
        Rays in the order in which they are dealt; as they stand by default. Rays that fill no
        packet are left out, unless there is not one full packet.

    Returns
    -------
    (R // width, width) float64
    """
    if width < 1:
        raise MibvhError(f"the width must be at least 1, not {width}")
    ordered = np.asarray(values if dealt is None else values[dealt], np.float64)
    full = len(ordered) // width
    return ordered[: full * width].reshape(full, width) if full else ordered[None]


def lcv(leaves: Counts) -> float:
    """Leaf count variability: standard deviation over the rays of the leaves visited.

    Aila, Karras and Laine, *On Quality Metrics of Bounding Volume Hierarchies* (HPG 2013).
    """
    return float(np.std(leaves, dtype=np.float64))


def relative_deviation(values: Counts) -> float:
    """Standard deviation over the rays, as a share of their mean; 0 where all are zero."""
    mean = float(np.mean(values, dtype=np.float64))
    return float(np.std(values, dtype=np.float64)) / mean if mean else 0.0


def within_packets(values: Counts, width: int, dealt: I32 | None = None) -> float:
    """Root mean square over packets of the standard deviation in a packet, over the mean.

    What :func:`relative_deviation` is without the share that lies between packets, which costs
    a warp nothing.
    """
    rows = packets(values, width, dealt)
    return float(np.sqrt(rows.var(axis=1).mean()) / rows.mean()) if rows.any() else 0.0


def expected_maximum(values: Counts, width: int) -> float:
    """Mean of the largest of ``width`` rays drawn at random, over the mean of a ray.

    Of the sorted values, the i-th of R is the largest of ``width`` draws (with replacement) with
    probability ``(i / R)**width - ((i - 1) / R)**width``.
    """
    ordered = np.sort(np.asarray(values, np.float64))
    if not ordered.any():
        return 1.0
    below = (np.arange(len(ordered) + 1) / len(ordered)) ** width
    return float((ordered * np.diff(below)).sum() / ordered.mean())


def packet_maximum(values: Counts, width: int, dealt: I32 | None = None) -> float:
    """Mean over packets of the largest of their rays, over the mean of a ray."""
    rows = packets(values, width, dealt)
    return float(rows.max(axis=1).mean() / rows.mean()) if rows.any() else 1.0


def simd_cost(costs: Counts, leaves: Counts | None = None) -> float:
    """Cost of a tree in wide warps, up to a factor that all trees of a scene share.

    The square root of mean times standard deviation of what scalar rays cost; for a kernel whose
    lanes wait for a warp's last ray, times the fourth root of LCV. The exponents are those found
    over seventeen scenes, rounded; ``docs/simd.md`` has what they explain.

    Parameters
    ----------
    costs : (R,) array
        Of each ray alone, for instance ``1.2 * hits.inner + hits.tests``.
    leaves : (R,) array, optional
        Leaves that each ray visits. Leave it out for kernels that fetch rays dynamically, and for
        a single loop.
    """
    mean, deviation = np.mean(costs, dtype=np.float64), np.std(costs, dtype=np.float64)
    return float(np.sqrt(mean * deviation)) * (1.0 if leaves is None else lcv(leaves) ** 0.25)


# ------------------------------------------------------------ rounds


@dataclasses.dataclass(frozen=True, eq=False)
class Rounds:
    """The rounds of many rays: each a descent to a leaf, or to the end, and that leaf.

    Attributes
    ----------
    per_ray : (R,) uint32
        Rounds that each ray takes.
    descents : (D,) int64
        How many rounds have 0, 1, 2, ... node steps.
    lengths : (L,) int64
        How many rounds have 0, 1, 2, ... triangle steps.
    """

    per_ray: npt.NDArray[np.uint32]
    descents: npt.NDArray[np.int64]
    lengths: npt.NDArray[np.int64]


#: Warps drawn to estimate what they cost: its error is a few thousandths.
_DRAWN = 4096
#: Rounds until warps whose lanes began together have forgotten it.
_SETTLED = 16


def rounds_cost(
    rounds: Rounds,
    width: int,
    *,
    fetch: bool,
    postpone: bool = True,
    dealt: I32 | None = None,
    c_inner: float = 1.2,
    c_tri: float = 1.0,
    seed: int = 0,
) -> float:
    """Estimate what a ray costs in warps in lockstep, from the rounds of single rays.

    The lanes of a warp are rounds drawn at random from all rounds of all rays. A descent takes
    as long as the longest of its lanes takes to its first leaf, which is also when a vote ends it;
    a lane that has a leaf by then goes on to the next one, and takes it if it gets there (with
    ``postpone``). The leaves take as long as the longest of the first, plus that of the second,
    and so on. Nothing is fitted; what is left out is that a ray's rounds, and those of rays side
    by side, are alike.

    Parameters
    ----------
    rounds : Rounds
        From :func:`mibvh.traversal.warp.ray_rounds`.
    width : int
    fetch : bool
        Lanes that are done fetch rays: all are always busy. Otherwise a warp takes ``width``
        rays, of as many rounds as those have, and lanes wait for the last one.
    postpone : bool
        Whether a lane puts its first leaf aside and goes on (the speculative kernels).
    dealt : (R,) int32, optional
        Without ``fetch``: rays in the order in which they are dealt, so that warps have rays
        of as many rounds as real ones; at random by default.
    c_inner, c_tri : float
        Costs of a step.
    seed : int
        Of the draws.

    Returns
    -------
    float
        At width 1, the counted cost.
    """
    rng = np.random.default_rng(seed)
    if fetch:
        rays = np.full((_DRAWN // _SETTLED, width), np.iinfo(np.int32).max)
    elif dealt is None:
        rays = rng.choice(rounds.per_ray, (_DRAWN, width)).astype(np.int64)
    else:
        rows = packets(rounds.per_ray, width, dealt).astype(np.int64)
        rays = rows[rng.permutation(len(rows))[:_DRAWN]]
    warps = _Drawn(rng, rounds, rays, postpone)
    if not fetch:
        total = 0.0
        while len(warps.left):
            total += float(warps.round(c_inner, c_tri).sum())
            warps.drop()
        return total * width / rays.size
    for _ in range(_SETTLED):  # all lanes began together: let that wear off
        warps.round(c_inner, c_tri)
    before = warps.left.sum()
    total = sum(float(warps.round(c_inner, c_tri).sum()) for _ in range(2 * _SETTLED))
    taken = float(before - warps.left.sum())
    return float(rounds.per_ray.mean(dtype=np.float64)) * total * width / taken


class _Drawn:
    """Warps whose lanes go through rounds drawn at random."""

    def __init__(
        self, rng: np.random.Generator, rounds: Rounds, left: npt.NDArray[np.int64], postpone: bool
    ) -> None:
        self.rng, self.postpone = rng, postpone
        self.descents, self.lengths = np.cumsum(rounds.descents), np.cumsum(rounds.lengths)
        #: (P, W) rounds that each lane has left, and node steps to its next leaf.
        self.left = left
        self.ahead = self._draw(self.descents)

    def _draw(self, below: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        at = self.rng.random(self.left.shape) * below[-1]
        return np.searchsorted(below, at, side="right")

    def drop(self) -> None:
        """Forget warps that are done."""
        going = (self.left > 0).any(axis=1)
        self.left, self.ahead = self.left[going], self.ahead[going]

    def round(self, c_inner: float, c_tri: float) -> F64:
        """What each warp issues in its next round."""
        holds = self.left > 0  # lanes that test a leaf
        steps = np.where(holds, self.ahead, 0).max(axis=1, initial=0)
        cost = c_inner * steps
        slack = np.where(holds & self.postpone, steps[:, None] - self.ahead, 0)
        while holds.any():
            cost = cost + c_tri * np.where(holds, self._draw(self.lengths), 0).max(axis=1)
            self.left = self.left - holds
            # The next leaf, if there is time to get to it; later ones, if they need no step.
            ahead = self._draw(self.descents)
            arrives = holds & (self.left > 0) & (ahead <= slack)
            self.ahead = np.where(holds, np.maximum(ahead - slack, 0), self.ahead)
            holds = arrives & self.postpone
            slack = np.zeros_like(slack)
        return cost
