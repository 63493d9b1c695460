"""Mixtures of kinds of rays, weighted as in a renderer."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from mibvh.errors import MibvhError
from mibvh.rays.rayset import RaySet


@dataclasses.dataclass(frozen=True, eq=False)
class Mixture:
    """Ray sets with weights.

    Attributes
    ----------
    parts : tuple of RaySet
        One per kind: each is traced on its own, to the closest hit or to any.
    weights : tuple of float
        Of the kinds; they need not sum to 1. By default the numbers of rays, which for sets made
        from the same paths are a path tracer's: ``primary``, ``shadow``, ``diffuse``,
        ``shadow2``, ``bounce2`` and so on are what it sends with next-event estimation.

    Raises
    ------
    MibvhError
        If there are no parts, a weight is negative, or all are 0.
    """

    parts: Sequence[RaySet]
    weights: Sequence[float] = ()

    def __post_init__(self) -> None:
        weights = tuple(self.weights) or tuple(float(len(part)) for part in self.parts)
        if len(weights) != len(self.parts):
            raise MibvhError(f"{len(self.parts)} ray sets and {len(weights)} weights")
        if not all(0 <= weight < float("inf") for weight in weights) or not sum(weights) > 0:
            raise MibvhError(f"weights must be finite, not negative, and not all 0, not {weights}")
        object.__setattr__(self, "parts", tuple(self.parts))
        object.__setattr__(self, "weights", weights)

    def mean(self, value: Callable[[RaySet], float]) -> float:
        """Weighted mean of a value over the ray sets.

        Parameters
        ----------
        value : callable
            From a ray set to a mean over its rays, such as the counted cost of a tree.
        """
        told = [
            value(part) if weight else 0.0
            for part, weight in zip(self.parts, self.weights, strict=True)
        ]
        weighted = (weight * v for weight, v in zip(self.weights, told, strict=True))
        return sum(weighted) / sum(self.weights)
