"""What a study does, and the two ready-made sets of choices."""

from __future__ import annotations

import dataclasses
from typing import Any

from mibvh.errors import MibvhError


@dataclasses.dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Choices of a study.

    Attributes
    ----------
    builders : tuple of str
        Empty for all that are registered.
    width, height, samples, bounces, viewpoints, seed
        As for :func:`mibvh.diffuse_rays`; ``viewpoints`` 0 means all of a scene.
    scalar_rays : int
        Largest number of rays timed with one lane per packet (every k-th of the set).
    seconds : float
        Time budget for the stopwatch, per scene and lane mode.
    standard_error : float
        Relative standard error of a tree's time at which measuring stops.
    cull : bool
        Re-test popped nodes; off as in the paper.
    """

    builders: tuple[str, ...] = ()
    width: int = 160
    height: int = 120
    samples: int = 1
    bounces: int = 1
    viewpoints: int = 0
    seed: int = 0
    scalar_rays: int = 32768
    seconds: float = 2.0
    standard_error: float = 0.005
    cull: bool = False

    def __post_init__(self) -> None:
        for name in ("width", "height", "samples", "bounces", "scalar_rays"):
            if getattr(self, name) < 1:
                raise MibvhError(f"{name} must be at least 1, not {getattr(self, name)}")
        for name in ("viewpoints", "seconds", "standard_error"):
            if getattr(self, name) < 0:
                raise MibvhError(f"{name} must not be negative, not {getattr(self, name)}")

    def rays(self) -> dict[str, Any]:
        """Arguments for :func:`mibvh.diffuse_rays`."""
        names = ("width", "height", "samples", "bounces", "seed")
        return {"viewpoints": self.viewpoints or None, **{n: getattr(self, n) for n in names}}


#: ``quick`` for a first look and for tests, ``paper`` for figures to be cited.
PROFILES: dict[str, dict[str, Any]] = {
    "quick": {},
    "paper": {
        "width": 320,
        "height": 240,
        "samples": 4,
        "scalar_rays": 131072,
        "seconds": 60.0,
    },
}
