"""Launches: a ray set in Dr.Jit's memory, laid out for one kernel, and what its packets issue."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from mibvh.traversal.kernel_rays import KernelRays
from mibvh.traversal.pages import own_memory
from mibvh.traversal.records import Records
from mibvh.traversal.schedule import Schedule, issued_by_bursts, issued_in_step
from mibvh.traversal.visits import Visits
from mibvh.triangles import I32
from mibvh.variant import lane_width, mitsuba

U32 = npt.NDArray[np.uint32]


class Launch(Protocol):
    """Rays ready for one kernel."""

    def __call__(self, records: Records, count: bool) -> Visits:
        """Trace once; the columns are evaluated."""
        ...

    def fetch(self, column: Any) -> npt.NDArray[Any]:
        """One column as a NumPy array with an entry per ray."""
        ...

    def issued(self, records: Records, visits: Visits) -> int:
        """Lane-steps that the packets went through for rays of such visits (NumPy columns)."""
        ...


class OneRayPerLane:
    """Rays side by side in packets; in scalar mode one in each, and all other lanes have exited.

    Parameters
    ----------
    rays : KernelRays
    scalar : bool
    walk : callable
        A kernel: takes records, rays and ``count``, and returns :class:`Visits`.
    """

    def __init__(self, rays: KernelRays, scalar: bool, walk: Callable[..., Visits]) -> None:
        import drjit as dr

        mi = mitsuba()
        self.count, self.width, self.scalar = len(rays.tmax), lane_width(), scalar
        self._walk = walk
        spread = self.width if scalar else 1
        self._active = mi.Bool(np.repeat(rays.tmax >= 0, spread))
        if spread > 1:
            self._active &= dr.arange(mi.UInt32, self.count * spread) % spread == 0
        self._o = mi.Point3f(np.repeat(rays.o, spread, axis=0).T)
        self._d = mi.Vector3f(np.repeat(rays.d, spread, axis=0).T)
        self._tmax = mi.Float(np.repeat(rays.tmax, spread))
        dr.eval(self._o, self._d, self._tmax, self._active)

    def __call__(self, records: Records, count: bool) -> Visits:
        """Trace once."""
        return self._trace(records, count)

    def _trace(self, records: Records, count: bool, **options: Any) -> Visits:
        import drjit as dr

        rays = self._o, self._d, self._tmax, self._active
        visits = self._walk(records, *rays, count=count, **options)
        dr.eval(*(visits if count else visits[:2]))
        return visits

    def fetch(self, column: Any) -> npt.NDArray[Any]:
        """One column as a NumPy array with an entry per ray."""
        values = np.array(column)
        return values[:: self.width].copy() if self.scalar else values

    def issued(self, records: Records, visits: Visits) -> int:
        """Of a single loop: all lanes wait for the longest."""
        return issued_in_step(visits.inner + visits.tests, self.width, self.scalar)


class InRounds(OneRayPerLane):
    """The same, for kernels whose lanes wait for each other in every round."""

    def __call__(self, records: Records, count: bool) -> Visits:
        """Trace once."""
        return self._trace(records, count, longest=None)

    def issued(self, records: Records, visits: Visits) -> int:
        """Launches once more, to measure the rounds."""
        return int(self.rounds(records, visits.leaves)[1].sum(dtype=np.int64)) * self.width

    def rounds(self, records: Records, leaves: U32) -> tuple[I32, U32]:
        """Launch once more, to see how long the rounds of each packet are.

        Parameters
        ----------
        records : Records
        leaves : (R,) uint32
            Leaves that each ray visits.

        Returns
        -------
        start : (P,) int32
            Each packet's first round.
        steps : (N, 2) uint32
            The most steps that a lane took in a round, in the descent and in the leaves. A packet
            has room for more rounds than it may take: the rest are zero.
        """
        import drjit as dr

        mi = mitsuba()
        lanes = 1 if self.scalar else self.width
        # Every round but the last has a leaf.
        room = np.maximum.reduceat(leaves, np.arange(0, self.count, lanes)).astype(np.int64) + 1
        start = np.cumsum(room) - room
        longest = [dr.zeros(mi.UInt32, int(room.sum())) for _ in range(2)]
        place = np.repeat(start.astype(np.uint32), self.width)[: dr.width(self._o)]
        self._trace(records, True, longest=(mi.UInt32(place), *longest))
        dr.eval(longest)
        return start.astype(np.int32), np.stack([np.array(column) for column in longest], axis=1)


class LanesFetch:
    """Rays in rows, dealt out beforehand to lanes that fetch one after the other (``wide``)."""

    def __init__(self, rays: KernelRays, scalar: bool, any_hit: bool) -> None:
        from mibvh.traversal.wide import RAY_ROW

        self.count, self._any_hit = len(rays.tmax), any_hit
        rows = np.zeros((self.count, RAY_ROW), np.float32)
        rows[:, :3], rows[:, 3:6], rows[:, 6] = rays.o, rays.d, rays.tmax
        self._rows = own_memory(rows)
        self._schedule = Schedule.of(self.count, lane_width(), scalar)
        self._first, self._end = self._schedule.rays()

    def __call__(self, records: Records, count: bool) -> Visits:
        """Trace once."""
        import drjit as dr

        from mibvh.traversal.wide import walk_wide

        mi = mitsuba()
        t = dr.empty(mi.Float, self.count)
        triangle, *counts = (dr.empty(mi.UInt32, self.count) for _ in range(5))
        walk_wide(
            records,
            self._rows,
            self._first,
            self._end,
            self._schedule.lanes,
            dr.opaque(mi.UInt32, self._schedule.burst),
            t,
            triangle,
            counts,
            count=count,
            any_hit=self._any_hit,
        )
        dr.eval(t, triangle, counts)
        inner, boxes, leaves, tests = counts
        return Visits(t, triangle, inner, leaves, tests, boxes)

    def fetch(self, column: Any) -> npt.NDArray[Any]:
        """One column as a NumPy array with an entry per ray."""
        return np.array(column)

    def issued(self, records: Records, visits: Visits) -> int:
        """Lanes wait for the longest between two fetches."""
        return issued_by_bursts(visits.inner + visits.tests, self._schedule)
