"""Evenly and finely cut surfaces, as a scanner gives them: a stone bust, a knotted serpent."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells
from .furniture import lathe
from .primitives import (
    Array,
    boxes,
    cube_sphere,
    fractal,
    frames,
    instance,
    normalized,
    quad,
    revolve,
    transform,
    tubes,
)


def _exit(
    direction: Array, centre: tuple[float, float, float], radii: tuple[float, float, float]
) -> Array:
    """Distance from the origin to where rays leave an ellipsoid; 0 for rays that miss it."""
    d = direction / np.array(radii)
    c = np.array(centre) / np.array(radii)
    a, b = np.sum(d * d, axis=1), d @ c
    disc = b * b - a * (c @ c - 1.0)
    return np.where(disc > 0, (b + np.sqrt(np.maximum(disc, 0))) / a, 0.0).clip(0.0)


def build_sculpture(detail: float, rng: np.random.Generator) -> Parts:
    """Make a weathered bust, 1 m high, on a plinth; the surface is star-shaped about its neck."""
    s = float(np.sqrt(detail))
    p = Parts()
    seed = int(rng.integers(1, 1000))
    v, f = cube_sphere(cells(88, s, 4))
    # Ellipsoids: head, jaw, neck, shoulders, chest, nose, hair knot, ears, brows.
    pieces = [
        ((0, 0, 0.34), (0.17, 0.2, 0.24)),
        ((0, -0.08, 0.24), (0.12, 0.14, 0.14)),
        ((0, 0.02, 0.02), (0.11, 0.11, 0.3)),
        ((0, 0.03, -0.2), (0.42, 0.17, 0.16)),
        ((0, -0.02, -0.3), (0.28, 0.2, 0.26)),
        ((0, -0.2, 0.32), (0.028, 0.07, 0.06)),
        ((0, 0.17, 0.45), (0.1, 0.12, 0.1)),
        ((0.17, 0.02, 0.32), (0.03, 0.04, 0.07)),
        ((-0.17, 0.02, 0.32), (0.03, 0.04, 0.07)),
        ((0.07, -0.17, 0.38), (0.06, 0.04, 0.025)),
        ((-0.07, -0.17, 0.38), (0.06, 0.04, 0.025)),
        ((0, -0.18, 0.23), (0.05, 0.05, 0.02)),
    ]
    reach = np.stack([_exit(v, c, r) for c, r in pieces])
    # A soft maximum rounds the seams between the pieces.
    r = np.log(np.exp(40 * reach).sum(0)) / 40
    q = v * r[:, None]
    curl = (q[:, 2] > 0.4) | ((q[:, 1] > 0.03) & (q[:, 2] > 0.22))
    r = r + 0.012 * curl * np.sin(70 * q[:, 0] + 6 * np.sin(24 * q[:, 2])) * np.sin(60 * q[:, 2])
    r = r + 0.012 * fractal(q * 9, seed, 5) * (q[:, 2] > -0.5)
    q = v * r[:, None]
    q[:, 2] = np.maximum(q[:, 2], -0.46)
    p.add("stone", (q + np.array([0, 0, 1.46]), f))
    p.add(
        "plinth",
        boxes(
            [[-0.45, -0.45, 0], [-0.4, -0.4, 0.12], [-0.45, -0.45, 0.86]],
            [[0.45, 0.45, 0.12], [0.4, 0.4, 0.86], [0.45, 0.45, 1.0]],
        ),
    )
    p.add("floor", quad([-4, -4, 0], [8, 0, 0], [0, 8, 0], 2, 2))
    return p


def build_knot(detail: float, rng: np.random.Generator) -> Parts:
    """Make a scaled serpent tied in a (2, 5) torus knot, with spines, lying on a turned base."""
    s = float(np.sqrt(detail))
    p = Parts()
    n, sides = cells(1150, s, 90), cells(44, s, 6)
    t = np.arange(n) * (2 * np.pi / n)
    ring = 1.0 + 0.36 * np.cos(5 * t)
    path = np.stack([ring * np.cos(2 * t), ring * np.sin(2 * t), 0.36 * np.sin(5 * t) + 1.05], 1)
    thick = 0.15 * (1 + 0.18 * np.sin(3 * t + rng.uniform(0, 6)))
    v, f = tubes(path, thick, sides, closed=True)
    v = v.reshape(n, sides, 3)
    centre = path[:, None, :]
    a = np.arange(sides) * (2 * np.pi / sides)
    # Overlapping scales: a diamond pattern in length along the body and angle about it.
    u, w = 150 * t[:, None] / (2 * np.pi), 9 * a[None, :] / (2 * np.pi)
    scale = np.maximum(np.abs(np.sin(np.pi * (u + w))), np.abs(np.sin(np.pi * (u - w))))
    v = centre + (v - centre) * (1 + 0.1 * (scale - 0.5))[..., None]
    p.add("scales", (v.reshape(-1, 3), f))
    k = cells(110, s**0.6, 20)
    i = (np.arange(k) * n) // k
    out = normalized(path[i] - np.array([0, 0, 1.05]) - 0.9 * normalized(path[i] * [1, 1, 0]))
    spine = revolve([[0.035, 0.0], [0.03, 0.06], [0.014, 0.13], [0.0, 0.2]], cells(9, s, 4))
    p.add("spines", instance(spine, frames(out), path[i] + 0.9 * thick[i, None] * out))
    base = lathe(
        [
            (0, 0),
            (1.7, 0),
            (1.75, 0.1),
            (1.5, 0.2),
            (1.4, 0.42),
            (1.55, 0.5),
            (1.5, 0.55),
            (0, 0.55),
        ],
        cells(24, s, 8),
        cells(72, s, 12),
    )
    p.add("base", base)
    p.add("floor", quad([-6, -6, 0], [12, 0, 0], [0, 12, 0], 2, 2))
    p.add("base", transform(cube_sphere(cells(12, s, 2)), 0.28, [0, 0, 0.86]))
    return p


RECIPES = [
    Recipe(
        SceneInfo(
            "sculpture",
            "Weathered stone bust on a plinth, cut evenly like a scan",
            "scan",
            100_000,
            "Buddha",
        ),
        build_sculpture,
    ),
    Recipe(
        SceneInfo("knot", "Scaled serpent tied in a torus knot", "scan", 120_000, "Dragon"),
        build_knot,
    ),
]
