"""A furnished living room: soft finely cut furniture, books, a rug of threads, flat walls."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells, even_cells
from .furniture import (
    books,
    chair,
    curtain,
    cushion,
    lathe,
    planks,
    potted_plant,
    sofa,
    table,
    wall_with_openings,
    window_frame,
)
from .primitives import (
    beams,
    blades,
    boxes,
    instance,
    quad,
    rot_z,
    sphere,
    transform,
    tubes,
)

_X, _Y, _Z = 6.0, 5.0, 2.8
_WINDOW = (1.6, 4.4, 0.8, 2.3)


def _shell(p: Parts, s: float, rng: np.random.Generator) -> None:
    p.add("walls", transform(wall_with_openings(_X, _Z, 0.2, [_WINDOW]), None, [0, _Y, 0]))
    p.add(
        "walls",
        boxes([-0.1, -0.1, 0], [0, _Y, _Z]),
        boxes([_X, -0.1, 0], [_X + 0.1, _Y, _Z]),
        boxes([0, -0.1, 0], [_X, 0, _Z]),
    )
    p.add("ceiling", boxes([-0.1, -0.1, _Z], [_X + 0.1, _Y + 0.2, _Z + 0.1]))
    rows = min(48, cells(24, s, 4))
    p.add("floor", planks((_X, _Y), rows, 1 + min(4, cells(2, s)), rng))
    p.add("floor", quad([0, 0, -0.02], [_X, 0, 0], [0, _Y, 0]))
    frame = window_frame(*_WINDOW, 0.05, 3, 2)
    p.add("frames", transform(frame, None, [0, _Y + 0.08, 0]))
    p.add("frames", boxes([1.5, _Y - 0.12, 0.76], [4.5, _Y, 0.8]))
    p.add("frames", boxes([[0, 0, 0], [0, 0, 0]], [[_X, 0.015, 0.08], [0.015, _Y, 0.08]]))
    # A door in the wall y = 0: frame, leaf with panels, handle.
    p.add("frames", transform(window_frame(0.5, 1.4, 0, 2.05, 0.08, 1, 1), None, [0, 0.02, 0]))
    p.add("wood", boxes([0.54, 0.005, 0.0], [1.36, 0.03, 2.02]))
    p.add(
        "wood",
        boxes([[0.62, 0.03, 0.2], [0.62, 0.03, 1.1]], [[1.28, 0.04, 0.95], [1.28, 0.04, 1.9]]),
    )
    p.add("metal", transform(sphere(0.035, cells(12, s, 5)), None, [1.3, 0.07, 1.02]))
    n = cells(64, s, 10)
    for x in (1.05, 4.3):
        cloth = curtain(0.65, 2.3, 6, n, cells(28, s, 2))
        p.add("curtains", transform(cloth, None, [x, _Y - 0.2, 0.12]))
    rod = np.array([[0.9, _Y - 0.2, 2.45], [5.1, _Y - 0.2, 2.45]])
    p.add("metal", tubes(rod, 0.015, cells(12, s, 4)))


def _seating(p: Parts, s: float, detail: float, rng: np.random.Generator) -> None:
    body, soft = sofa(2.2, s)
    p.add("sofa", transform(body, None, [0.1, 2.3, 0]))
    p.add("cushions", transform(soft, None, [0.1, 2.3, 0]))
    pillow = cushion((0.2, 0.07, 0.2), even_cells(12, s), 0.6)
    for y, turn in ((1.5, 1.9), (3.05, 1.2)):
        p.add("pillows", transform(pillow, rot_z(turn), [0.5, y, 0.7]))
    p.add("wood", transform(table(1.1, 0.6, 0.42, s), rot_z(np.pi / 2), [1.95, 2.3, 0]))
    # The rug: a mat with upright threads.
    p.add("rug", boxes([1.05, 1.1, 0.0], [2.95, 3.5, 0.008]))
    n = cells(5500, detail, 40)
    root = rng.uniform([1.05, 1.1, 0.008], [2.95, 3.5, 0.008], (n, 3))
    tip = root + np.stack([*rng.normal(0, 0.008, (2, n)), rng.uniform(0.02, 0.035, n)], 1)
    a = rng.uniform(0, np.pi, n)
    side = 0.004 * np.stack([np.cos(a), np.sin(a), 0 * a], 1)
    p.add("rug", blades(root, tip, side))
    # Round table with four chairs.
    profile = [(0.0, 0.0), (0.28, 0.0), (0.25, 0.03), (0.05, 0.08), (0.05, 0.6), (0.1, 0.71)]
    p.add("wood", transform(lathe(profile, cells(20, s, 6), cells(28, s, 6)), None, [4.3, 1.5, 0]))
    top = lathe(
        [(0, 0.71), (0.55, 0.71), (0.58, 0.725), (0.55, 0.74), (0, 0.74)],
        cells(8, s, 4),
        cells(48, s, 8),
    )
    p.add("wood", transform(top, None, [4.3, 1.5, 0]))
    a = np.array([0.4, 1.95, 3.5, 5.1])
    where = np.stack([4.3 + 0.72 * np.cos(a), 1.5 + 0.72 * np.sin(a), 0 * a], 1)
    p.add("chairs", instance(chair(s), rot_z(a + np.pi / 2), where))


def _shelf(p: Parts, s: float, rng: np.random.Generator) -> None:
    x, y0, y1, rows = 5.65, 2.5, 4.5, 6
    step = 2.1 / rows
    z = 0.05 + step * np.arange(rows + 1)
    p.add(
        "wood",
        boxes(
            np.stack([0 * z + x, 0 * z + y0, z], 1),
            np.stack([0 * z + _X, 0 * z + y1, z + 0.025], 1),
        ),
    )
    sides = np.array([y0 - 0.03, (y0 + y1) / 2, y1])
    p.add(
        "wood",
        boxes(
            np.stack([0 * sides + x, sides, 0 * sides], 1),
            np.stack([0 * sides + _X, sides + 0.03, 0 * sides + z[-1]], 1),
        ),
    )
    n = min(40, cells(14, s, 2))
    for row in range(rows):
        for half in range(2):
            lo, hi = books(0.93 * rng.uniform(0.6, 1.0), step - 0.04, 0.3, n, rng)
            # Rows run along +y here, spines towards the room.
            corner = np.array([x + 0.02, y0 + 0.02 + half * 1.01, z[row] + 0.025])
            swap = [1, 0, 2]
            kind = rng.integers(0, 3, n)
            for c, name in enumerate(("books_red", "books_blue", "books_pale")):
                p.add(name, boxes(lo[kind == c][:, swap] + corner, hi[kind == c][:, swap] + corner))


def _small(p: Parts, s: float, detail: float, rng: np.random.Generator) -> None:
    pot, stem, leaf = potted_plant(s, detail, rng)
    at = [0.6, 4.3, 0.0]
    p.add("pot", transform(pot, None, at))
    p.add("plant", transform(stem, None, at), transform(leaf, None, at))
    # Floor lamp: foot and pole, shade, glowing bulb.
    pole = [(0.0, 0.0), (0.16, 0.0), (0.15, 0.03), (0.02, 0.05), (0.012, 0.7), (0.012, 1.45)]
    at = [0.55, 0.55, 0.0]
    p.add("metal", transform(lathe(pole, cells(16, s, 6), cells(16, s, 5)), None, at))
    shade = lathe([(0.24, 1.4), (0.2, 1.57), (0.16, 1.75)], cells(6, s, 2), cells(32, s, 8))
    p.add("lampshade", transform(shade, None, at))
    p.add("bulb", transform(sphere(0.06, cells(12, s, 6)), None, [0.55, 0.55, 1.55]))
    p.add("bulb", boxes([2.4, 2.0, 2.74], [3.6, 2.8, 2.78]))
    p.add("frames", boxes([2.35, 1.95, 2.78], [3.65, 2.85, 2.8]))
    # On the coffee table: bowl with fruit, a vase; on the round table: plates.
    bowl = [
        (0.0, 0.0),
        (0.06, 0.0),
        (0.13, 0.05),
        (0.17, 0.1),
        (0.16, 0.1),
        (0.11, 0.05),
        (0.0, 0.02),
    ]
    p.add("pot", transform(lathe(bowl, cells(14, s, 6), cells(28, s, 6)), None, [1.95, 2.15, 0.42]))
    a = np.arange(6) * 1.05
    fruit = np.stack([1.95 + 0.07 * np.cos(a), 2.15 + 0.07 * np.sin(a), 0 * a + 0.5], 1)
    fruit = np.concatenate([fruit, [[1.95, 2.15, 0.56]]])
    p.add("fruit", instance(sphere(0.037, cells(14, s, 5)), None, fruit))
    vase = [
        (0, 0),
        (0.05, 0),
        (0.09, 0.09),
        (0.05, 0.19),
        (0.03, 0.24),
        (0.045, 0.28),
        (0.03, 0.27),
        (0, 0.2),
    ]
    p.add("vase", transform(lathe(vase, cells(24, s, 8), cells(24, s, 6)), None, [1.9, 2.68, 0.42]))
    plate = lathe(
        [(0, 0), (0.07, 0.002), (0.12, 0.018), (0.118, 0.022), (0, 0.006)],
        cells(8, s, 4),
        cells(28, s, 6),
    )
    where = [[4.3 + 0.34 * np.cos(t), 1.5 + 0.34 * np.sin(t), 0.742] for t in (0.4, 1.95, 3.5, 5.1)]
    p.add("vase", instance(plate, None, where))
    # Pictures: on the wall y = 0 and over the sofa.
    for x, z, w, h in ((2.6, 1.6, 0.8, 0.55), (3.8, 1.6, 0.5, 0.7), (4.9, 1.65, 0.7, 0.5)):
        frame = window_frame(x - w / 2, x + w / 2, z - h / 2, z + h / 2, 0.03, 1, 1)
        p.add("wood", transform(frame, None, [0, 0.02, 0]))
        p.add("pictures", quad([x - w / 2, 0.01, z - h / 2], [w, 0, 0], [0, 0, h]))
    edge = np.array([[1.6, 1.35], [3.0, 1.35], [3.0, 2.15], [1.6, 2.15]])
    ring = np.stack([np.full(4, 0.02), edge[:, 0], edge[:, 1]], 1)
    p.add("wood", beams(ring, np.roll(ring, -1, axis=0), 0.04, 0.04))
    p.add("pictures", quad([0.01, 1.6, 1.35], [0, 1.4, 0], [0, 0, 0.8]))


def build(detail: float, rng: np.random.Generator) -> Parts:
    """Room of 6 x 5 x 2.8 m; the floor from the origin, window in the wall y = 5."""
    s = float(np.sqrt(detail))
    p = Parts()
    _shell(p, s, rng)
    _seating(p, s, detail, rng)
    _shelf(p, s, rng)
    _small(p, s, detail, rng)
    return p


RECIPES = [
    Recipe(
        SceneInfo(
            "livingroom",
            "Living room with sofa, shelves of books, plant, rug and a window",
            "interior",
            80_000,
            "Bathroom",
        ),
        build,
    )
]
