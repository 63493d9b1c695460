"""Which lane takes which ray, and how many lane-steps the packets go through for it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh._jit import njit
from mibvh.variant import mitsuba

U32 = npt.NDArray[np.uint32]

#: Steps between two fetches of rays.
_BURST = 4
#: Rays per lane, at most: few enough to keep a packet's rays near each other.
_PER_LANE = 64
#: Packets that keep the machine busy: a share for each of many cores, or a GPU's warps.
_PACKETS = {"llvm": 256, "cuda": 8192}


@dataclasses.dataclass(frozen=True)
class Schedule:
    """Rays handed out to lanes beforehand, so that every launch does the same.

    A packet owns consecutive rays, ``per_lane`` for each of its ``lanes`` that carry any; lane i
    takes the i-th of them, and then every ``lanes``-th.
    """

    count: int
    width: int
    lanes: int
    per_lane: int
    burst: int = _BURST

    @classmethod
    def of(cls, count: int, width: int, scalar: bool) -> Schedule:
        """Schedule for so many rays on packets of ``width`` lanes, one of them if scalar."""
        lanes = 1 if scalar else width
        packets = _PACKETS[mitsuba().variant().split("_")[0]]
        return cls(count, width, lanes, max(1, min(_PER_LANE, count // (lanes * packets))))

    @property
    def packets(self) -> int:
        """Packets in a launch."""
        return -(-self.count // (self.lanes * self.per_lane))

    def rays(self) -> tuple[Any, Any]:
        """First ray of each lane of a launch, and the end of its packet's rays (UInt32)."""
        import drjit as dr

        mi = mitsuba()
        lane = np.arange(self.packets * self.width, dtype=np.uint32)
        start = lane // self.width * np.uint32(self.lanes * self.per_lane)
        first = start + lane % self.width
        end = np.minimum(start + np.uint32(self.lanes * self.per_lane), np.uint32(self.count))
        end[lane % self.width >= self.lanes] = 0
        first_end = mi.UInt32(first), mi.UInt32(end)
        dr.eval(first_end)
        return first_end


def issued_in_step(steps: U32, width: int, scalar: bool) -> int:
    """Lane-steps of packets whose lanes take one ray each: all wait for the longest."""
    if scalar:
        return int(steps.sum(dtype=np.int64)) * width
    padded = np.zeros(-(-len(steps) // width) * width, np.uint32)
    padded[: len(steps)] = steps
    return int(padded.reshape(-1, width).max(axis=1).sum(dtype=np.int64)) * width


def issued_by_bursts(steps: U32, schedule: Schedule) -> int:
    """Lane-steps of packets whose lanes fetch rays between bursts of steps."""
    s = schedule
    return int(_bursts(steps.astype(np.int64), s.lanes, s.per_lane, s.burst)) * s.width


@njit
def _bursts(steps, lanes, per_lane, burst):
    issued = 0
    left, ray = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
    for start in range(0, len(steps), lanes * per_lane):
        end = min(start + lanes * per_lane, len(steps))
        for lane in range(lanes):
            left[lane], ray[lane] = 0, start + lane
        while True:
            longest, waiting = 0, False
            for lane in range(lanes):
                if left[lane] == 0 and ray[lane] < end:
                    left[lane] = steps[ray[lane]]
                    ray[lane] += lanes
                taken = min(left[lane], burst)
                left[lane] -= taken
                longest = max(longest, taken)
                waiting |= ray[lane] < end
            issued += longest
            if longest == 0 and not waiting:
                break
    return issued
