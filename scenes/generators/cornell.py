"""The Cornell box, with a finely cut blob and a ring added so that it is not trivial."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells
from .primitives import Mesh, boxes, cube_sphere, quad, rot_x, rot_y, torus, transform


def _turned_box(half: tuple[float, float, float], angle: float, x: float, z: float) -> Mesh:
    block = boxes([-half[0], 0.0, -half[2]], [half[0], 2 * half[1], half[2]])
    return transform(block, rot_y(angle), [x, 0.0, z])


def _blob(n: int, rng: np.random.Generator) -> Mesh:
    """Make a sphere with a few dozen smooth bumps."""
    phase = rng.uniform(0, 2 * np.pi, 3)
    v, f = cube_sphere(n)
    bump = (
        np.sin(7 * v[:, 0] + phase[0])
        * np.sin(7 * v[:, 1] + phase[1])
        * np.sin(7 * v[:, 2] + phase[2])
    )
    return v * (0.27 * (1.0 + 0.16 * bump))[:, None], f


def build(detail: float, rng: np.random.Generator) -> Parts:
    """Box of 2 x 2 x 2, open towards +z, y up."""
    s = np.sqrt(detail)
    n = cells(12, s)
    p = Parts()
    p.add(
        "white",
        quad([-1, 0, -1], [0, 0, 2], [2, 0, 0], n, n),
        quad([-1, 2, -1], [2, 0, 0], [0, 0, 2], n, n),
        quad([-1, 0, -1], [2, 0, 0], [0, 2, 0], n, n),
    )
    p.add("red", quad([-1, 0, -1], [0, 2, 0], [0, 0, 2], n, n))
    p.add("green", quad([1, 0, -1], [0, 0, 2], [0, 2, 0], n, n))
    p.add("light", quad([-0.35, 1.985, -0.3], [0.7, 0, 0], [0, 0, 0.6], 2, 2))
    p.add("blocks", _turned_box((0.3, 0.6, 0.3), 0.31, -0.36, -0.35))
    p.add("blocks", _turned_box((0.3, 0.3, 0.3), -0.29, 0.37, 0.3))
    p.add("blob", transform(_blob(cells(33, s, 3), rng), None, [0.37, 0.88, 0.3]))
    ring = torus(0.24, 0.05, cells(84, s, 8), cells(26, s, 5))
    p.add("ring", transform(ring, rot_y(0.5) @ rot_x(0.28), [-0.42, 0.29, 0.42]))
    return p


RECIPES = [
    Recipe(
        SceneInfo(
            "cornell",
            "Cornell box with two blocks, a bumpy blob and a ring",
            "box room",
            20_000,
            "",
            "y",
        ),
        build,
    )
]
