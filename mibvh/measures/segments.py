"""Segments: what rays run through before they end."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.triangles import F32, F64, I32


@dataclasses.dataclass(frozen=True, eq=False)
class Segments:
    """Rays from their start to their hit, or to where they would end if nothing stopped them.

    Attributes
    ----------
    start, end : (R, 3) float32
        In scene units.
    viewpoint : (R,) int32
        The camera that the ray's path began at; 0 where there is none.
    any_hit : bool
        Whether the first hit that is found ends a ray. Such segments are not cut.
    reach : (R,) float64, optional
        How far a ray looks for a hit, in lengths of its direction; by default for ever.
    direction : (R, 3) float, optional
        Where a ray goes; by default from its start to its end. Float32 rounds an end that is next
        to its start.

    Raises
    ------
    MibvhError
        If the shapes do not fit, there are none, or a coordinate is NaN or infinite.
    """

    start: F32
    end: F32
    viewpoint: I32
    any_hit: bool = False
    reach: F64 | None = None
    direction: F32 | F64 | None = None

    def __post_init__(self) -> None:
        if self.start.ndim != 2 or self.start.shape[1:] != (3,):
            raise MibvhError(f"segments start at (R, 3) points, not {self.start.shape}")
        if self.end.shape != self.start.shape or self.viewpoint.shape != self.start.shape[:1]:
            raise MibvhError("segments need as many ends and viewpoints as starts")
        if self.direction is not None and self.direction.shape != self.start.shape:
            raise MibvhError("segments need as many directions as starts")
        if self.reach is not None and self.reach.shape != self.start.shape[:1]:
            raise MibvhError("segments need as many reaches as starts")
        if len(self.start) == 0:
            raise MibvhError("there are no segments")
        if not (np.isfinite(self.start).all() and np.isfinite(self.end).all()):
            raise MibvhError("a segment's coordinate is NaN or infinite")

    def __len__(self) -> int:
        return len(self.start)

    def select(self, chosen: Any) -> Segments:
        """Keep some of the segments.

        Parameters
        ----------
        chosen : index array, boolean mask or slice
        """
        return dataclasses.replace(
            self,
            start=self.start[chosen],
            end=self.end[chosen],
            viewpoint=self.viewpoint[chosen],
            direction=None if self.direction is None else self.direction[chosen],
            reach=None if self.reach is None else self.reach[chosen],
        )
