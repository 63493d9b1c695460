"""The measure of a ray set: how many of its segments start in a box or enter it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.measures.lookup import FluxTables
from mibvh.measures.segments import Segments
from mibvh.measures.tables import box_area, lookup_of, summed_tables
from mibvh.triangles import F32, F64

#: Counts beyond this would not be exact in float32.
MAX_SEGMENTS = 4_000_000
#: Starts within this share of the diagonal are on one floor or wall.
_BRACKET = 2e-5
#: A coordinate is that of a floor or a wall where so many quantiles in a row lie within a bracket.
_ATOM = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Flux:
    """Share of segments that start in a box or enter it, and a share of its area.

    ``m(B) = area_weight * A(B) + A(rays) * P(segment touches B)``, where ``A`` is half the
    surface area and ``A(rays)`` that of the box around all segments, so that the measure is in
    units of area. Both terms are additive over rays and grow with the box. Exact where the faces
    of the box are on planes; in between, interpolated between the exact counts of the boxes
    inside and outside whose faces are.

    Parameters
    ----------
    rays : Segments
        Cut where they hit; at most four millions.
    planes : int
        Per axis, about: they are quantiles of the starts, two around each floor or wall, and two
        outside. Memory is 64 bytes times the third power.
    area_weight : float
        Weight of the area. It tells boxes apart that no ray touches, and is a guard against
        rays that are not in the set.

    Raises
    ------
    MibvhError
        If a number is out of range, or there are too many segments.
    """

    rays: Segments
    planes: int = 64
    area_weight: float = 0.2

    def __post_init__(self) -> None:
        if not 4 <= self.planes <= 256:
            raise MibvhError(f"planes must be from 4 to 256, not {self.planes}")
        if not 0.0 <= self.area_weight <= 1e6:
            raise MibvhError(f"area_weight must be from 0 to 1e6, not {self.area_weight}")
        if len(self.rays) > MAX_SEGMENTS:
            raise MibvhError(
                f"{len(self.rays)} segments are more than can be counted exactly "
                f"({MAX_SEGMENTS}); select some of them"
            )

    @property
    def name(self) -> str:
        """What reports call it."""
        return "flux"

    @functools.cached_property
    def bounds(self) -> F64:
        """(2, 3) float64: the box around all segments, in scene units."""
        ends = (self.rays.start, self.rays.end)
        low = np.minimum(*(points.min(axis=0) for points in ends))
        high = np.maximum(*(points.max(axis=0) for points in ends))
        return np.stack([low, high]).astype(np.float64)

    @functools.cached_property
    def plane_positions(self) -> F32:
        """(3, P) float32: the planes in scene units, rising along each axis."""
        reach = _BRACKET * float(np.linalg.norm(self.bounds[1] - self.bounds[0]))
        rows = [
            _planes_of_axis(
                self.rays.start[:, k], self.bounds[0, k], self.bounds[1, k], self.planes, reach
            )
            for k in range(3)
        ]
        longest = max(len(row) for row in rows)
        # Axes with fewer planes get more behind the last, where nothing changes.
        return np.stack([_lengthened(row, longest) for row in rows])

    @functools.cached_property
    def _table(self) -> F32:
        return summed_tables(self.plane_positions, self.rays.start, self.rays.end)

    def with_weight(self, area_weight: float) -> Flux:
        """The same measure with another weight of the area; the tables are shared."""
        other = dataclasses.replace(self, area_weight=area_weight)
        vars(other)["_table"] = self._table
        vars(other)["plane_positions"] = self.plane_positions
        return other

    def compiled(self, scale: float = 1.0) -> Any:
        """Return what kernels take; see :meth:`Measure.compiled`."""
        planes = (self.plane_positions.astype(np.float64) * scale).astype(np.float32)
        cells, lookup, above = lookup_of(planes)
        inverse = np.ones_like(planes)
        apart = np.diff(planes.astype(np.float64), axis=1)
        inverse[:, :-1] = 1.0 / np.maximum(apart, 1e-38)
        inverse = np.nextafter(inverse, np.float32(np.inf))  # a plane is all the way to itself
        whole = box_area(self.bounds * scale)
        return FluxTables(
            self._table,
            planes.reshape(-1),
            above,
            inverse.reshape(-1),
            cells,
            lookup,
            planes.shape[1],
            float(self.area_weight),
            whole / len(self.rays),
        )


def _lengthened(row: F32, count: int) -> F32:
    last, out = row[-1], list(row)
    while len(out) < count:
        last = np.nextafter(last, np.float32(np.inf))
        out.append(last)
    return np.array(out, np.float32)


def _just_around(low: float, high: float, step: float) -> list[float]:
    """Two planes around an interval, the next that float32 has or a step away."""
    inf = np.float32(np.inf)
    return [
        min(float(np.nextafter(np.float32(low), -inf)), low - step),
        max(float(np.nextafter(np.float32(high), inf)), high + step),
    ]


def _planes_of_axis(starts: F32, low: float, high: float, count: int, reach: float) -> F32:
    """Planes on one axis: quantiles of the starts, and two around what many starts share.

    As near as float32 has them: a floor is a hair's breadth below the starts on it, and its box
    is to hold none of them.
    """
    sorted_starts = np.sort(starts).astype(np.float64)
    places = np.linspace(0, len(starts) - 1, count).round().astype(np.int64)
    quantiles = sorted_starts[places]
    # Runs of quantiles within a bracket are a floor or a wall: its middle, between two planes.
    run = np.concatenate([[0], np.cumsum(np.diff(quantiles) > reach)])
    planes = []
    for members in np.split(quantiles, np.flatnonzero(np.diff(run)) + 1):
        if len(members) >= _ATOM:
            first = np.searchsorted(sorted_starts, members[0] - reach)
            last = np.searchsorted(sorted_starts, members[-1] + reach, side="right") - 1
            planes += _just_around(sorted_starts[first], sorted_starts[last], 1e-6 * reach)
        else:
            planes.append(members[0])
    # Planes that leave nothing outside, by more than float32 rounds.
    margin = max(reach, 4e-7 * max(abs(low), abs(high)), 1e-36)
    planes += [low - 2 * margin, high + 2 * margin]
    return np.unique(np.array(planes, np.float64).astype(np.float32))
