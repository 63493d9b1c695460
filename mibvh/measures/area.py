"""The interface of a measure, and the surface area."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol


class Measure(Protocol):
    """The cost of a box in a tree.

    A measure must be 0 or more, and no less for a box than for one inside it: the searches of
    the optimisers leave out what cannot be better by this rule.
    """

    @property
    def name(self) -> str:
        """Its name in reports."""
        ...

    def compiled(self, scale: float) -> Any:
        """Return what kernels take: None for the area, otherwise tables or a function.

        Parameters
        ----------
        scale : float
            From scene to builder units, in which kernels keep their boxes.

        Returns
        -------
        None or compiled function
            ``numba.njit`` of ``function(x0, y0, z0, x1, y1, z1)``: the measure of a box in
            builder units, in units of half a surface area there. Kernels are compiled for each
            such function, once in a process, so make it once for a scale.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Area:
    """Half the surface area of the box: the surface area heuristic's measure."""

    @property
    def name(self) -> str:
        """Its name in reports."""
        return "area"

    def compiled(self, scale: float) -> None:
        """Return None: kernels compute the area themselves."""
        return
