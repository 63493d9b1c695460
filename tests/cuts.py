"""Small pieces of the geometry that real scenes are made of, and deep split trees over them.

Random soups hide faults: their triangles are alike, and few are split. Here long triangles cross
small ones, sheets lie in one plane or a hair apart, and boxes are flat.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest

import mibvh


def _quads(a, b, c, d):
    """(2 N, 3, 3) triangles of N quads, corners in order."""
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def _box(low, high):
    """(12, 3, 3) triangles of an axis-aligned box."""
    corner = np.array([low, high])
    faces = []
    for k in range(3):
        for side in (0, 1):
            at = np.zeros((4, 3), int)
            at[:, k] = side
            at[:, (k + 1) % 3] = [0, 1, 1, 0]
            at[:, (k + 2) % 3] = [0, 0, 1, 1]
            faces.append(corner[at, np.arange(3)])
    a, b, c, d = np.stack(faces, 1)
    return _quads(a, b, c, d)


def pipes(seed: int = 0) -> np.ndarray:
    """Long cylinders of thin triangles at all angles, through each other, with collars."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(8):
        along = rng.normal(size=3) * [4, 2, 1]
        across = np.linalg.qr(np.column_stack([along, rng.normal(size=(3, 2))]))[0][:, 1:]
        middle, radius = rng.random(3) * [3, 2, 1], rng.uniform(0.02, 0.1)
        for length, wide in ((1.0, 1.0), (0.05, 1.6)):
            angle = np.linspace(0, 2 * np.pi, 33)
            ring = wide * radius * np.stack([np.cos(angle), np.sin(angle)], 1) @ across.T
            low, high = middle - 0.5 * length * along, middle + 0.5 * length * along
            parts.append(_quads(low + ring[:-1], low + ring[1:], high + ring[1:], high + ring[:-1]))
    return np.concatenate(parts).astype(np.float32)


def tiles(seed: int = 2) -> np.ndarray:
    """A floor of thin tiles and walls over two large triangles in their plane; all axis-aligned."""
    rng = np.random.default_rng(seed)
    parts = [_box([-1, -1, -0.5], [11, 9, 0])]
    for i, j in np.ndindex(10, 8):
        gap = rng.uniform(0, 0.08, 2)
        parts.append(_box([i + gap[0], j + gap[1], 0], [i + 1, j + 1, 0.02]))
    for _ in range(12):
        at, size = rng.integers(0, 8, 2), rng.choice([0.1, 6.0], 2)
        parts.append(_box([*at, 0.02], [*(at + size), rng.uniform(0.5, 3)]))
    return np.concatenate(parts).astype(np.float32)


def needles(seed: int = 0) -> np.ndarray:
    """Blades far longer than wide among small triangles."""
    rng = np.random.default_rng(seed)
    root = rng.random((500, 3)) * [4, 4, 0.2]
    tip = root + rng.normal(size=(500, 3)) * [1.5, 1.5, 0.6]
    blades = np.stack([root, root + rng.normal(size=(500, 3)) * 0.01, tip], 1)
    dust = rng.random((600, 1, 3)) * [4, 4, 1] + rng.normal(size=(600, 3, 3)) * 0.03
    return np.concatenate([blades, dust]).astype(np.float32)


def layers(seed: int = 0) -> np.ndarray:
    """Tilted sheets a hair apart, coarse and fine ones in turn, with small parts between."""
    rng = np.random.default_rng(seed)
    parts = []
    for level in range(8):
        cells = (1, 9)[level % 2]
        g = np.linspace(0, 1, cells + 1)
        i, j = (v.ravel() for v in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
        grid = [np.stack([g[i + a], g[j + b]], 1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        height = [0.01 * level + 0.3 * xy[:, :1] + 0.1 * xy[:, 1:] ** 2 for xy in grid]
        corners = [np.hstack([grid[c] * [5, 3], height[c]]) for c in range(4)]
        parts.append(_quads(*corners))
    for low in rng.random((40, 3)) * [5, 3, 0.4]:
        parts.append(_box(low, low + rng.uniform(0.01, 0.1, 3)))
    return np.concatenate(parts).astype(np.float32)


CUTS: dict[str, Callable[..., np.ndarray]] = {
    "pipes": pipes,
    "tiles": tiles,
    "needles": needles,
    "layers": layers,
}

#: Trees with triangles in several leaves: builders that split, and optimisers started from them.
SPLIT_TREES: dict[str, tuple[str, dict[str, object]]] = {
    "sbvh": ("sbvh", {}),
    "sbvh, all splits": ("sbvh", {"alpha": 0.0, "max_leaf": 2}),
    "streelet": ("streelet", {}),
    "streelet, many splits": ("streelet", {"beta": 1.0}),
    "bittner from sbvh": ("bittner", {"start": "sbvh"}),
    "hill from streelet": ("hill", {"start": "streelet"}),
    "treelet from sbvh": ("treelet", {"start": "sbvh"}),
}

#: An arbitrary rotation.
_TILT = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


@functools.cache
def cut(name: str, tree: str, tilted: bool = False) -> tuple[mibvh.Triangles, mibvh.Tree]:
    """Triangles of a cut, and a split tree over them; if tilted, with no face along an axis."""
    corners = CUTS[name]()
    triangles = mibvh.Triangles((corners @ _TILT.T).astype(np.float32) if tilted else corners, name)
    builder, options = SPLIT_TREES[tree]
    return triangles, mibvh.build(triangles, builder, **options)


#: Every cut with every kind of tree: ``@every_cut`` calls a test with ``triangles, tree``.
every_cut = pytest.mark.parametrize(
    ("name", "kind"), [(name, kind) for name in CUTS for kind in SPLIT_TREES]
)
