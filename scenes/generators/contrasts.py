"""Scenes whose triangles differ much in size, or lie in layers: terrain, stadium, circuit, pile."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells, even_cells
from .furniture import lathe
from .primitives import (
    Mesh,
    boxes,
    cube_sphere,
    cylinder,
    fractal,
    height_field,
    instance,
    merge,
    quad,
    random_rotations,
    revolve,
    rot_z,
    rounded_box,
    smooth_profile,
    sphere,
    surface,
    torus,
    transform,
    tubes,
)


def build_terrain(detail: float, rng: np.random.Generator) -> Parts:
    """Mountains of 2 x 2 km around a lake, with boulders on the slopes."""
    s = float(np.sqrt(detail))
    p = Parts()
    seed = int(rng.integers(1, 1000))
    n = cells(225, s, 24)
    e = np.linspace(-1000, 1000, n + 1)

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        q = np.stack(np.broadcast_arrays(x / 420.0, y / 420.0, 0.3), -1)
        ridge = 1.0 - np.abs(fractal(q, seed, 6, 0.48))
        bowl = np.clip((np.hypot(x, y) - 180) / 700, 0, 1)
        return 420 * bowl * (0.2 + ridge) - 25 + 30 * fractal(q * 3, seed + 7, 4) * (0.15 + bowl)

    v, f = height_field(e, e, height(e[:, None], e[None, :]))
    top = v[f].mean(axis=1)[:, 2]
    p.add("grass", (v, f[top < 120]))
    p.add("rock", (v, f[(top >= 120) & (top < 300)]))
    p.add("snow", (v, f[top >= 300]))
    p.add("lake", quad([-500, -500, 2], [1000, 0, 0], [0, 1000, 0]))
    sv, sf = cube_sphere(cells(6, s, 2))
    for i in range(3):
        stone = (sv * (1 + 0.35 * fractal(sv * 1.6, seed + i, 3))[:, None], sf)
        k = cells(14, s, 5)
        at = rng.uniform(-850, 850, (k, 2))
        r = 6 * np.exp(rng.normal(0, 0.6, k))
        at3 = np.c_[at, height(at[:, 0], at[:, 1])]
        p.add("boulders", instance(stone, random_rotations(rng, k) * r[:, None, None], at3))
    return p


def _teapot(s: float) -> Mesh:
    """Make a teapot 0.3 m high."""
    sides = cells(110, s, 12)
    body = lathe(
        [(0, 0), (0.12, 0), (0.19, 0.06), (0.2, 0.12), (0.14, 0.2), (0.12, 0.21)],
        cells(70, s, 8),
        sides,
    )
    lid = lathe(
        [
            (0.125, 0.21),
            (0.1, 0.235),
            (0.02, 0.25),
            (0.015, 0.262),
            (0.035, 0.28),
            (0.02, 0.295),
            (0, 0.298),
        ],
        cells(46, s, 8),
        sides,
    )
    t = np.linspace(0, 1, cells(60, s, 8) + 1)
    spout = smooth_profile(
        np.array([[0.15, 0, 0.07], [0.23, 0, 0.09], [0.27, 0, 0.16], [0.32, 0, 0.2]]), len(t) - 1
    )
    handle = smooth_profile(
        np.array([[-0.15, 0, 0.18], [-0.25, 0, 0.19], [-0.29, 0, 0.13], [-0.18, 0, 0.05]]),
        len(t) - 1,
    )
    return merge(
        [
            body,
            lid,
            tubes(spout, 0.05 - 0.028 * t, cells(36, s, 6)),
            tubes(handle, 0.016 + 0 * t, cells(28, s, 6)),
        ]
    )


def build_stadium(detail: float, rng: np.random.Generator) -> Parts:
    """Put a teapot in a stadium: 0.3 m of fine triangles in a bowl of 200 m, in a 2 km backdrop."""
    s = float(np.sqrt(detail))
    p = Parts()
    p.add("backdrop", boxes([[-1000, -1000, -1.0]], [[1000, 1000, -0.5]]))
    hills = revolve([[990, -0.5], [1000, 60], [1000, 160]], 48)
    v, f = hills
    v = v.copy()
    v[96:, 2] += rng.uniform(-60, 60, len(v) - 96)
    p.add("backdrop", (v, f))
    p.add("pitch", quad([-55, -36, 0], [110, 0, 0], [0, 72, 0], cells(11, 1, 1), 2))
    p.add("track", boxes([-75, -55, -0.5], [75, 55, -0.02]))
    # Seating: rings of oval steps; four towers with lamps.
    rows, around = 24, 96 if detail > 0.2 else 32
    a = np.arange(around) * (2 * np.pi / around)
    profile = []
    for i in range(rows):
        profile += [(i, 1.0 + 0.55 * i), (i, 1.55 + 0.55 * i), (i + 1, 1.55 + 0.55 * i)]
    pts = []
    for out, z in [(0, -0.5), *profile, (rows + 1, -0.5)]:
        pts.append(np.stack([(78 + out) * np.cos(a), (58 + out) * np.sin(a), 0 * a + z], 1))
    p.add("stands", surface(np.stack(pts), wrap_cols=True))
    k = cells(50, s, 6)
    step = 4 if detail < 0.5 else 1
    b = np.arange(k) * (2 * np.pi / k)
    for i in range(0, rows, step):
        seat = np.stack(
            [(78.4 + i) * np.cos(b), (58.4 + i) * np.sin(b), 0 * b + 1.55 + 0.55 * i], 1
        )
        p.add(
            "seats" if i // 4 % 2 else "seats_blue",
            instance(boxes([-0.2, -0.22, 0], [0.2, 0.22, 0.42]), rot_z(b), seat),
        )
    corner = np.array([[x, y, 0.0] for x in (-88, 88) for y in (-70, 70)])
    p.add("towers", boxes(corner - [0.8, 0.8, 0.5], corner + np.array([0.8, 0.8, 45])))
    p.add("towers", boxes(corner + np.array([-5, -1, 45]), corner + np.array([5, 1, 52])))
    for x in (-55.0, 55.0):
        posts = np.array([[x, -3.66, 0], [x, -3.66, 2.44], [x, 3.66, 2.44], [x, 3.66, 0]])
        p.add("towers", tubes(posts, 0.06, cells(10, s, 4)))
    p.add("teapot", transform(_teapot(s), None, [0, 0, 0.75]))
    p.add("stand", boxes([[-0.4, -0.3, 0.7]], [[0.4, 0.3, 0.75]]))
    p.add("stand", transform(cylinder(0.05, 0.7, cells(20, s, 6)), None, [0, 0, 0]))
    return p


def build_circuit(detail: float, rng: np.random.Generator) -> Parts:
    """Make a circuit board of 160 x 100 mm: copper in thin layers, chips with pins, parts."""
    s = float(np.sqrt(detail))
    p = Parts()
    p.add("board", boxes([0, 0, -1.6], [160, 100, 0]))
    p.add("table", quad([-120, -120, -4], [400, 0, 0], [0, 340, 0]))
    p.add(
        "metal",
        boxes(
            [[3, 3, -4], [153, 3, -4], [3, 93, -4], [153, 93, -4]],
            [[7, 7, -1.6], [157, 7, -1.6], [7, 97, -1.6], [157, 97, -1.6]],
        ),
    )
    # Traces: flat strips 0.035 mm high; legs along x, y and at 45 degrees, as routers lay them.
    k = cells(1100, detail, 60)
    at = rng.uniform([4, 4], [156, 96], (k, 2))
    turn = rng.integers(0, 8, k) * (np.pi / 4)
    for _ in range(2):
        length = rng.uniform(3, 22, k)
        to = at + np.stack([np.cos(turn), np.sin(turn)], 1) * length[:, None]
        to = np.clip(to, 2, [158, 98])
        ok = np.hypot(*(to - at).T) > 0.5
        d = (to - at)[ok]
        mid, long = (to + at)[ok] / 2, np.hypot(*d.T)
        width = rng.choice([0.25, 0.25, 0.5, 1.2], len(long))
        strip = boxes([-0.5, -0.5, 0], [0.5, 0.5, 0.035])
        m = (
            rot_z(np.arctan2(d[:, 1], d[:, 0]))
            * np.stack([long, width, np.ones(len(long))], 1)[:, None, :]
        )
        p.add("traces", instance(strip, m, np.c_[mid, np.zeros(len(mid))]))
        at, turn = to, turn + rng.choice([-1, 1], k) * (np.pi / 4)
    via = revolve([[0.2, 0.04], [0.45, 0.05], [0.45, 0.0]], cells(10, s, 5))
    p.add(
        "metal",
        instance(
            via, None, np.c_[at[: cells(300, detail, 10)], np.zeros(min(k, cells(300, detail, 10)))]
        ),
    )
    # Chips on a coarse grid, with gull-wing pins on four sides.
    u = np.linspace(0, 1, cells(4, s**0.6, 2) + 1)[:, None]
    wing = smooth_profile(
        np.array([[0, 0, 1.1], [0.6, 0, 1.05], [0.9, 0, 0.25], [1.6, 0, 0.1]]), len(u) - 1
    )
    pin = _ribbon(wing, 0.25, 0.12)
    chips = [
        (30, 30, 24),
        (75, 55, 30),
        (120, 30, 18),
        (128, 74, 14),
        (26, 76, 14),
        (76, 16, 12),
        (100, 86, 12),
    ]
    for x, y, w in chips:
        h = w / 2
        p.add(
            "chips",
            transform(rounded_box([h - 1, h - 1, 0.9], 0.15, even_cells(4, s)), None, [x, y, 1.3]),
        )
        n = max(3, int(w * min(1.6, max(0.25, 0.9 * s**0.4))))
        q = np.linspace(-h + 1.8, h - 1.8, n)
        for side in range(4):
            r = rot_z(side * np.pi / 2)
            where = np.stack([0 * q + h - 1.1, q, 0 * q], 1) @ r.T + [x, y, 0]
            p.add("pins", instance(pin, np.broadcast_to(r, (n, 3, 3)), where))
    # Small parts: resistors in rows, cans, connector strips, crystal balls of solder.
    n = cells(150, detail**0.7, 16)
    spot = rng.uniform([5, 5], [155, 95], (6 * n, 2))
    free = np.all(
        [np.maximum(abs(spot[:, 0] - x), abs(spot[:, 1] - y)) > w / 2 + 2.5 for x, y, w in chips],
        axis=0,
    )
    spot = spot[free][:n]
    r = rot_z(rng.integers(0, 2, len(spot)) * (np.pi / 2))
    c = np.c_[spot, np.zeros(len(spot))]
    p.add("resistors", instance(boxes([-0.7, -0.6, 0], [0.7, 0.6, 0.55]), r, c))
    p.add(
        "metal",
        instance(
            boxes([[-1.0, -0.62, 0], [0.7, -0.62, 0]], [[-0.7, 0.62, 0.57], [1.0, 0.62, 0.57]]),
            r,
            c,
        ),
    )
    can = lathe(
        [(0, 0), (3, 0), (3, 0.6), (2.8, 1.0), (3, 1.4), (3, 6.6), (2.7, 7), (0, 7)],
        cells(14, s, 7),
        cells(28, s, 8),
    )
    cans = [
        [52, 84, 0],
        [60, 84, 0],
        [68, 84, 0],
        [148, 50, 0],
        [148, 58, 0],
        [100, 60, 0.0],
        [8, 54, 0],
        [100, 12, 0],
    ]
    p.add("cans", instance(can, None, cans))
    legs = np.array([[x, y, 0.0] for y in (94, 96.5) for x in np.arange(20, 60, 2.54)])
    p.add("chips", boxes([18.5, 92.6, 0], [60.5, 98, 2.5]))
    p.add("pins", boxes(legs - [0.32, 0.32, 0], legs + np.array([0.32, 0.32, 9])))
    p.add("metal", boxes([[138, 8, 0], [140.5, 10, 1.2]], [[158, 22, 1.2], [161, 20, 11]]))
    p.add(
        "metal",
        boxes(
            [[140, 8, 1.2], [140, 21, 1.2], [140, 8, 11]],
            [[161, 9, 12], [161, 22, 12], [161, 22, 12]],
        ),
    )
    coil = np.linspace(0, 2 * np.pi * 14, cells(220, s, 60))
    path = np.stack(
        [
            52 + (4 + 1.4 * np.cos(coil)) * np.cos(coil / 14),
            50 + (4 + 1.4 * np.cos(coil)) * np.sin(coil / 14),
            2 + 1.6 * np.sin(coil),
        ],
        1,
    )
    p.add("copper", tubes(path, 0.35, cells(8, s, 4)))
    p.add("chips", transform(torus(4, 1.0, cells(40, s, 10), cells(12, s, 5)), None, [52, 50, 2]))
    ball = sphere(0.3, cells(8, s, 4))
    q = np.array(
        [[148 + i, 84 + j, 0.2] for i in np.arange(0, 8, 1.0) for j in np.arange(0, 8, 1.0)]
    )
    p.add("pins", instance(ball, None, q))
    return p


def _ribbon(path: np.ndarray, half: float, height: float) -> Mesh:
    """Make a flat bar along a path in the x-z plane."""
    off = np.array([[0, -half, 0], [0, half, 0], [0, half, height], [0, -half, height]])
    return surface(path[:, None, :] + off[None], wrap_cols=True)


def build_clutter(detail: float, rng: np.random.Generator) -> Parts:
    """Make a heap of toys in a tray of 4 x 4 m: eight kinds, turned at random, overlapping."""
    s = float(np.sqrt(detail))
    p = Parts()
    q = detail**0.3  # half of the growth goes into more things, the rest into finer ones
    kinds: list[tuple[str, Mesh]] = [
        ("bricks", boxes([-1, -0.5, -0.35], [1, 0.5, 0.35])),
        ("balls", sphere(0.6, cells(14, q, 6))),
        ("rings", torus(0.6, 0.2, cells(20, q, 8), cells(9, q, 4))),
        ("dice", rounded_box([0.5, 0.5, 0.5], 0.14, even_cells(6, q))),
        (
            "pins",
            lathe(
                [(0, -1), (0.3, -1), (0.42, -0.4), (0.2, 0.4), (0.26, 0.8), (0, 1)],
                cells(14, q, 6),
                cells(14, q, 5),
            ),
        ),
        ("sticks", tubes(np.array([[0, 0, -1.6], [0, 0, 1.6]]), 0.1, cells(8, q, 5))),
        ("stones", cube_sphere(cells(4, q, 2))),
        ("springs", _spring(q)),
    ]
    total = cells(520, detail**0.42, 40)
    for i, (name, mesh) in enumerate(kinds):
        k = total // 8 + (i < total % 8)
        ang, u = rng.uniform(0, 2 * np.pi, k), rng.uniform(0, 1, k)
        r = 1.6 * np.sqrt(u)
        # Inside a heap that is highest in the middle; fewer things are larger.
        big = 0.16 * (520 / total) ** 0.28
        z = big + rng.uniform(0, 1, k) ** 1.2 * 1.0 * np.maximum(0, 1 - (r / 1.75) ** 1.5)
        m = random_rotations(rng, k) * (big * rng.uniform(0.7, 1.3, k))[:, None, None]
        p.add(name, instance(mesh, m, np.stack([r * np.cos(ang), r * np.sin(ang), z], 1)))
    n = cells(6, s)
    p.add("tray", quad([-2, -2, 0], [4, 0, 0], [0, 4, 0], n, n))
    p.add(
        "tray",
        boxes(
            [[-2.1, -2.1, -0.05], [-2.1, 2, -0.05], [-2.1, -2, -0.05], [2, -2, -0.05]],
            [[2.1, -2, 0.35], [2.1, 2.1, 0.35], [-2, 2, 0.35], [2.1, 2, 0.35]],
        ),
    )
    p.add("table", quad([-6, -6, -0.06], [12, 0, 0], [0, 12, 0]))
    return p


def _spring(q: float) -> Mesh:
    a = np.linspace(0, 2 * np.pi * 5, cells(56, q, 24))
    return tubes(
        np.stack([0.45 * np.cos(a), 0.45 * np.sin(a), 0.06 * a - 0.95], 1), 0.08, cells(6, q, 3)
    )


RECIPES = [
    Recipe(
        SceneInfo("terrain", "Mountains around a lake, with boulders", "height field", 120_000),
        build_terrain,
    ),
    Recipe(
        SceneInfo(
            "stadium",
            "A finely cut teapot in a coarse stadium with a huge backdrop",
            "mixed scale",
            60_000,
        ),
        build_stadium,
    ),
    Recipe(
        SceneInfo(
            "circuit", "Printed circuit board: thin layers, chips, pins", "thin layers", 80_000
        ),
        build_circuit,
    ),
    Recipe(
        SceneInfo("clutter", "Heap of many copies of eight toys", "clutter", 150_000), build_clutter
    ),
]
