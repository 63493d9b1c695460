"""Hair: curly strands, as thin seven-sided tubes, growing out of a hidden sphere."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells
from .primitives import normalized, tubes

_SIDES, _SEGMENTS = 7, 20
_PER_STRAND = 2 * _SIDES * _SEGMENTS + _SIDES - 2


def build(detail: float, rng: np.random.Generator) -> Parts:
    """Random-walk strands held inside a ball of radius one or so.

    Fewer strands are made thicker, by less than would keep the ball equally opaque: a small
    version should still stop rays and still be hair.
    """
    count = cells(100_000 / _PER_STRAND, detail, 4)
    direction = normalized(rng.normal(size=(count, 3)))
    point = 0.35 * direction
    path = np.empty((count, _SEGMENTS + 1, 3))
    path[:, 0] = point
    wind = np.zeros_like(point)
    for i in range(1, _SEGMENTS + 1):
        wind = 0.75 * wind + 0.66 * rng.normal(size=point.shape)
        out = np.linalg.norm(point, axis=1, keepdims=True)
        direction = normalized(
            direction + 0.55 * wind - 12.0 * np.maximum(out - 0.9, 0.0) * point / out
        )
        point = point + 0.062 * direction
        path[:, i] = point
    thick = 0.0022 * (10_000 / count) ** 0.35
    radius = thick * np.linspace(1.0, 0.3, _SEGMENTS + 1)
    p = Parts()
    shade = np.arange(count) % 3
    for i, name in enumerate(("hair_dark", "hair_brown", "hair_fair")):
        p.add(name, tubes(path[shade == i], radius[None, :], _SIDES, caps=(False, True)))
    return p


RECIPES = [
    Recipe(
        SceneInfo("hairball", "Ball of curly strands of hair", "hair", 100_000, "Hairball"), build
    )
]
