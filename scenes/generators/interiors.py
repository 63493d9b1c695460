"""Large interiors: a conference room, a library, a spiral staircase in a tower, a warehouse."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells, even_cells
from .furniture import (
    books,
    chair,
    cushion,
    lathe,
    planks,
    table,
    wall_with_openings,
    window_frame,
)
from .primitives import (
    Mesh,
    beams,
    boxes,
    cylinder,
    instance,
    merge,
    oriented_boxes,
    prism,
    quad,
    revolve,
    rot_z,
    rounded_box,
    sphere,
    torus,
    transform,
    tubes,
)


def _swivel_chair(s: float) -> tuple[Mesh, Mesh]:
    """Make an office chair that looks towards +y: upholstery, metal."""
    n = even_cells(10, s)
    seat = transform(cushion((0.25, 0.24, 0.05), n), None, [0, 0, 0.47])
    back = transform(cushion((0.23, 0.04, 0.3), n, 0.4), None, [0, -0.25, 0.85])
    sides = cells(10, s, 4)
    a = np.arange(5) * (2 * np.pi / 5)
    hub, toe = (
        np.tile([0.0, 0.0, 0.1], (5, 1)),
        np.stack([0.3 * np.cos(a), 0.3 * np.sin(a), 0 * a + 0.05], 1),
    )
    star = tubes(np.stack([hub, toe], 1), np.array([[0.03, 0.018]]), sides)
    wheel = instance(sphere(0.03, cells(8, s, 4)), None, toe * [1, 1, 0] + [0, 0, 0.03])
    post = tubes(np.array([[0, 0, 0.08], [0, 0, 0.44]]), 0.03, sides)
    spine = tubes(np.array([[0, -0.1, 0.43], [0, -0.27, 0.48], [0, -0.3, 0.8]]), 0.02, sides)
    arms = []
    for side in (-0.27, 0.27):
        u = np.linspace(0, 1, cells(6, s, 2) + 1)[:, None]
        bow = np.concatenate(
            [0 * u + side, -0.15 + 0.3 * u, 0.45 + 0.24 * np.sin(np.pi * u) ** 0.6], 1
        )
        arms.append(tubes(bow, 0.017, sides))
    return merge([seat, back]), merge([star, wheel, post, spine, *arms])


def build_conference(detail: float, rng: np.random.Generator) -> Parts:
    """Room of 12 x 8 x 3.2 m, windows with blinds in the wall y = 8, screen at x = 12."""
    s = float(np.sqrt(detail))
    p = Parts()
    windows = [(0.8 + 2.8 * i, 3.0 + 2.8 * i, 0.9, 2.6) for i in range(4)]
    p.add("walls", transform(wall_with_openings(12, 3.2, 0.25, windows), None, [0, 8, 0]))
    p.add("walls", boxes([[-0.1, 0, 0], [12, 0, 0]], [[0, 8, 3.2], [12.1, 8, 3.2]]))
    p.add("walls", transform(wall_with_openings(12, 3.2, 0.1, []), None, [0, -0.1, 0]))
    n = min(40, cells(10, s, 2))
    p.add("carpet", quad([0, 0, 0], [12, 0, 0], [0, 8.25, 0], 3 * n // 2, n))
    slats = min(120, cells(26, s, 3))
    for x0, x1, z0, z1 in windows:
        frame = window_frame(x0, x1, z0, z1, 0.05, 2, 1)
        p.add("frames", transform(frame, None, [0, 8.12, 0]))
        z = np.linspace(z0 + 0.3, z1 - 0.02, slats)
        start = np.stack([0 * z + x0 + 0.05, 0 * z + 7.95, z], 1)
        # Slightly tilted slats: long thin boxes that no axis-aligned box fits well.
        tilt = np.array([[0, 0.03, 0]])
        p.add("blinds", beams(start, start + np.array([[x1 - x0 - 0.1, 0, 0.004]]), 0.05, 0.002))
        p.add("blinds", beams(start[:1] - tilt, start[-1:] - tilt, 0.004, 0.004))
    # Ceiling: panels of 0.6 m on a grid, some of them lamps.
    gx, gy = np.meshgrid(np.arange(20) * 0.6, np.arange(13) * 0.615, indexing="ij")
    lo = np.stack([gx.ravel(), gy.ravel(), np.full(gx.size, 3.0)], 1)
    lamp = ((np.arange(20)[:, None] % 4 == 1) & (np.arange(13)[None, :] % 4 == 2)).ravel()
    size = np.array([0.58, 0.595, 0.03])
    if detail < 0.15:
        p.add("ceiling", boxes([0, 0, 3.03], [12, 8, 3.1]))
    else:
        p.add("ceiling", boxes(lo[~lamp], lo[~lamp] + size))
        p.add("ceiling", quad([0, 0, 3.2], [12, 0, 0], [0, 8, 0]))
    p.add("lamps", boxes(lo[lamp], lo[lamp] + size))
    # The table and what lies on it.
    top = rounded_box([3.4, 0.85, 0.03], 0.03, even_cells(24, s))
    p.add("wood", transform(top, None, [5.6, 4, 0.73]))
    p.add("wood", boxes([[3.2, 3.6, 0], [6.9, 3.6, 0]], [[4.3, 4.4, 0.71], [8.0, 4.4, 0.71]]))
    cloth, metal = _swivel_chair(s)
    x = 2.9 + 0.9 * np.arange(7)
    spots = [(xi, 2.75, 0.0) for xi in x] + [(xi, 5.25, np.pi) for xi in x]
    spots += [(1.75, 4.0, -np.pi / 2), (9.45, 4.0, np.pi / 2)]
    where = np.array([[a, b, 0.0] for a, b, _ in spots])
    turn = rot_z(np.array([c for *_, c in spots]) + rng.uniform(-0.25, 0.25, len(spots)))
    p.add("upholstery", instance(cloth, turn, where))
    p.add("metal", instance(metal, turn, where))
    place = where[:14] * [1, 1, 0] + [0, 0, 0.76]
    place[:, 1] = np.where(place[:, 1] < 4, 3.45, 4.55)
    p.add("paper", boxes(place - [0.1, 0.14, 0], place + np.array([0.1, 0.14, 0.004])))
    bottle = lathe(
        [(0, 0), (0.035, 0), (0.035, 0.13), (0.013, 0.19), (0.013, 0.22), (0, 0.22)],
        cells(12, s, 5),
        cells(14, s, 5),
    )
    p.add("glass", instance(bottle, None, place[::2] + np.array([0.2, 0.05, 0])))
    # A row of wooden chairs along the wall y = 0, the screen, the door.
    x = np.linspace(2.2, 10.6, 9)
    p.add("chairs", instance(chair(s), None, np.stack([x, 0 * x + 0.45, 0 * x], 1)))
    p.add("paper", boxes([11.93, 2.4, 1.0], [11.96, 5.6, 2.7]))
    p.add("metal", beams([[11.93, 2.35, 0.98]], [[11.93, 5.65, 0.98]], 0.05, 0.05))
    p.add("wood", boxes([0.4, 0.0, 0], [1.4, 0.04, 2.1]))
    p.add("frames", transform(window_frame(0.36, 1.44, 0, 2.14, 0.08, 1, 1), None, [0, 0.03, 0]))
    return p


def build_library(detail: float, rng: np.random.Generator) -> Parts:
    """Hall of 20 x 12 x 5 m with two blocks of double-sided shelves and reading tables between."""
    s = float(np.sqrt(detail))
    p = Parts()
    windows = [(1.0 + 2.8 * i, 2.6 + 2.8 * i, 3.2, 4.6) for i in range(7)]
    for y in (-0.3, 12.0):
        p.add("walls", transform(wall_with_openings(20, 5, 0.3, windows), None, [0, y, 0]))
        for w in windows:
            p.add("frames", transform(window_frame(*w, 0.06, 2, 2), None, [0, y + 0.15, 0]))
    p.add("walls", boxes([[-0.2, 0, 0], [20, 0, 0]], [[0, 12, 5], [20.2, 12, 5]]))
    p.add("ceiling", boxes([-0.2, -0.3, 5], [20.2, 12.3, 5.2]))
    x = np.linspace(0.5, 19.5, 8)
    p.add(
        "wood",
        boxes(
            np.stack([x - 0.12, 0 * x, 0 * x + 4.7], 1),
            np.stack([x + 0.12, 0 * x + 12, 0 * x + 5], 1),
        ),
    )
    p.add("floor", planks((20, 12), min(100, cells(34, s, 4)), 3, rng))
    p.add("floor", quad([0, 0, -0.02], [20, 0, 0], [0, 12, 0]))
    # Shelves along y, 4 m long, on both sides of the hall; ten books a running metre at most.
    rows, length, step = 6, 4.0, 0.37
    per = int(np.clip(round(42 * detail**0.8), 2, 160))
    shelf_x = np.concatenate([np.linspace(1.6, 7.6, 5), np.linspace(12.4, 18.4, 5)])
    tint = ("books_red", "books_green", "books_blue", "books_pale")
    for cx in shelf_x:
        for y0 in (0.3, 7.7):
            z = 0.1 + step * np.arange(rows + 1)
            one = np.ones_like(z)
            p.add(
                "shelves",
                boxes(
                    np.stack([one * (cx - 0.3), one * y0, z - 0.025], 1),
                    np.stack([one * (cx + 0.3), one * (y0 + length), z], 1),
                ),
            )
            up = np.linspace(y0, y0 + length, 5)[:, None] * [0, 1, 0]
            p.add(
                "shelves",
                boxes(
                    up + np.array([cx - 0.3, -0.015, 0]), up + np.array([cx + 0.3, 0.015, z[-1]])
                ),
            )
            p.add("shelves", boxes([cx - 0.006, y0, 0], [cx + 0.006, y0 + length, z[-1]]))
            for side in (-1.0, 1.0):
                for row in range(rows):
                    lo, hi = books(length - 0.05, step - 0.03, 0.27, per, rng)
                    keep = rng.uniform(size=per) < 0.93
                    kind = np.where(keep, rng.integers(0, 4, per), -1)
                    # Along the shelf is y; the spine is at the outer face.
                    ax, bx = side * (0.29 - lo[:, 1]), side * (0.29 - hi[:, 1])
                    a = np.stack(
                        [cx + np.minimum(ax, bx), y0 + 0.02 + lo[:, 0], z[row] + lo[:, 2]], 1
                    )
                    b = np.stack(
                        [cx + np.maximum(ax, bx), y0 + 0.02 + hi[:, 0], z[row] + hi[:, 2]], 1
                    )
                    for c, name in enumerate(tint):
                        p.add(name, boxes(a[kind == c], b[kind == c]))
    # Reading tables down the middle, each with chairs and green lamps.
    tx = np.array([2.5, 6.0, 14.0, 17.5])
    p.add("tables", instance(table(2.4, 1.1, 0.76, s), None, np.stack([tx, 0 * tx + 6, 0 * tx], 1)))
    spots = np.array([[x + d, 6 + e, 0] for x in tx for d in (-0.7, 0.7) for e in (-0.85, 0.85)])
    turn = np.where(spots[:, 1] < 6, 0.0, np.pi)
    if detail > 0.1:
        p.add("tables", instance(chair(0.8 * s), rot_z(turn), spots))
    lamp = spots * [1, 0, 0] + [0, 6, 0.76]
    lamp = np.unique(lamp, axis=0)
    foot = lathe([(0, 0), (0.08, 0), (0.02, 0.03), (0.012, 0.3)], cells(8, s, 3), cells(12, s, 4))
    p.add("brass", instance(foot, None, lamp))
    shade = tubes(np.array([[-0.16, 0, 0.34], [0.16, 0, 0.34]]), 0.06, cells(12, s, 5))
    p.add("lampshade", instance(shade, None, lamp))
    x = np.linspace(2.5, 17.5, 6)
    glow = np.concatenate([np.stack([x, 0 * x + y, 0 * x + 4.2], 1) for y in (3.6, 8.4)])
    p.add("lamps", instance(sphere(0.22, cells(12, s, 6)), None, glow))
    rod = glow + np.array([0, 0, 0.2])
    p.add("brass", beams(rod, rod + np.array([0, 0, 0.6]), 0.02, 0.02))
    globe = [10.0, 6.0, 0.0]
    p.add("globe", transform(sphere(0.5, cells(40, s, 8)), None, [10, 6, 1.1]))
    p.add(
        "brass", transform(torus(0.58, 0.03, cells(48, s, 10), cells(8, s, 4)), None, [10, 6, 1.1])
    )
    p.add(
        "tables",
        transform(
            lathe(
                [(0.45, 0), (0.3, 0.08), (0.08, 0.2), (0.08, 0.6)], cells(12, s, 4), cells(20, s, 6)
            ),
            None,
            globe,
        ),
    )
    return p


def build_staircase(detail: float, rng: np.random.Generator) -> Parts:
    """Make a round tower of radius 4 m and height 14 m with a spiral stair along its wall."""
    s = float(np.sqrt(detail))
    p = Parts()
    radius, height, turns = 4.0, 14.0, 3.5
    steps = 96
    a = 2 * np.pi * turns * (np.arange(steps) + 0.5) / steps
    rise = (height - 2.0) / steps
    z = rise * (np.arange(steps) + 1)
    # Each step: a wedge with a nosing, from radius 1.7 to the wall.
    w = 2 * np.pi * turns / steps * 1.12
    m = int(np.clip(round(3 * s), 1, 12))
    t = np.linspace(-w / 2, w / 2, m + 1)
    outer = np.stack([3.98 * np.cos(t), 3.98 * np.sin(t)], 1)
    inner = np.stack([1.7 * np.cos(t), 1.7 * np.sin(t)], 1)[::-1]
    wedge = prism(np.concatenate([outer, inner]), 0.06)
    at = np.stack([0 * z, 0 * z, z - 0.06], 1)
    p.add("steps", instance(wedge, rot_z(a), at))
    # Balusters and the two handrails.
    per = int(np.clip(round(2 * detail**0.5), 1, 12))
    k = steps * per
    b = 2 * np.pi * turns * (np.arange(k) + 0.5) / k
    zb = rise * (np.arange(k) // per + 1)
    rail_z = 0.95 + (height - 2.0) * b / (2 * np.pi * turns)
    foot = np.stack([1.78 * np.cos(b), 1.78 * np.sin(b), zb], 1)
    top = np.stack([1.78 * np.cos(b), 1.78 * np.sin(b), rail_z], 1)
    segs = cells(7, s, 1)
    u = np.linspace(0, 1, segs + 1)
    path = foot[:, None, :] * (1 - u)[None, :, None] + top[:, None, :] * u[None, :, None]
    bulge = 0.012 + 0.012 * np.exp(-(((u - 0.45) / 0.12) ** 2))
    p.add("iron", tubes(path, bulge[None, :], cells(6, s**0.7, 3), caps=(False, False)))
    n = cells(360, s, 80)
    c = np.linspace(0, 2 * np.pi * turns, n)
    zc = 0.97 + (height - 2.0) * c / (2 * np.pi * turns)
    for r, thick, part in ((1.78, 0.035, "rail"), (3.85, 0.03, "rail")):
        helix = np.stack([r * np.cos(c), r * np.sin(c), zc], 1)
        p.add(part, tubes(helix, thick, cells(9, s, 4)))
    # String under the inner edge of the steps.
    helix = np.stack([1.74 * np.cos(c), 1.74 * np.sin(c), zc - 1.08], 1)
    p.add("iron", tubes(helix, 0.06, cells(7, s, 4)))
    # Wall of staggered stones standing a little proud of a plain cylinder.
    sides = cells(64, s, 24)
    p.add("wall", revolve([[radius + 0.1, 0], [radius + 0.1, height]], sides))
    rows, cols = cells(22, s, 4), cells(26, s, 10)
    i, j = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    i, j = i.ravel(), j.ravel()
    ang = 2 * np.pi * (j + 0.5 * (i % 2)) / cols
    half = np.stack(
        [
            0.06 + rng.uniform(0, 0.025, len(i)),
            np.full(len(i), 0.97 * np.pi * (radius + 0.1) / cols),
            np.full(len(i), 0.485 * height / rows),
        ],
        1,
    )
    centre = np.stack(
        [(radius + 0.08) * np.cos(ang), (radius + 0.08) * np.sin(ang), (i + 0.5) * height / rows], 1
    )
    p.add("stones", oriented_boxes(centre, half, rot_z(ang)))
    # Patterned floor, skylight ring with bars, a hanging lamp of rings.
    rings = cells(10, s, 3)
    for q in range(rings):
        r0, r1 = 4.1 * q / rings, 4.1 * (q + 1) / rings
        disc = revolve([[r0, 0.0], [r1, 0.0]], sides)
        p.add("floor_light" if q % 2 else "floor_dark", disc)
    p.add("wall", transform(torus(3.6, 0.5, sides, cells(12, s, 6)), None, [0, 0, height]))
    bar = np.arange(12) * (np.pi / 12)
    e = np.stack([3.5 * np.cos(bar), 3.5 * np.sin(bar), 0 * bar + height], 1)
    p.add("iron", tubes(np.stack([e, e * [-1, -1, 1]], 1), 0.03, cells(6, s, 3)))
    bulb = []
    for z0, r in ((4.0, 0.5), (7.0, 0.65), (10.0, 0.5)):
        p.add(
            "iron", transform(torus(r, 0.025, cells(40, s, 10), cells(8, s, 4)), None, [0, 0, z0])
        )
        d = np.arange(8) * np.pi / 4
        bulb.append(np.stack([r * np.cos(d), r * np.sin(d), 0 * d + z0 + 0.1], 1))
    p.add("bulbs", instance(sphere(0.07, cells(10, s, 5)), None, np.concatenate(bulb)))
    p.add("iron", tubes(np.array([[0, 0, 3.8], [0, 0, height]]), 0.02, cells(6, s, 3)))
    return p


def _pallet() -> Mesh:
    x = np.linspace(-0.5, 0.5, 6)
    top = boxes(
        np.stack([x - 0.05, 0 * x - 0.4, 0 * x + 0.11], 1),
        np.stack([x + 0.05, 0 * x + 0.4, 0 * x + 0.135], 1),
    )
    y = np.array([-0.36, 0, 0.36])
    skid = boxes(
        np.stack([0 * y - 0.55, y - 0.04, 0 * y], 1),
        np.stack([0 * y + 0.55, y + 0.04, 0 * y + 0.11], 1),
    )
    return merge([top, skid])


def build_warehouse(detail: float, rng: np.random.Generator) -> Parts:
    """Hall of 40 x 24 x 9 m with five double racks along x, cartons, drums and roof trusses."""
    s = float(np.sqrt(detail))
    p = Parts()
    p.add("floor", quad([0, 0, 0], [40, 0, 0], [0, 24, 0], cells(10, s), cells(6, s)))
    p.add(
        "walls",
        boxes(
            [[-0.2, 0, 0], [40, 0, 0], [0, -0.2, 0], [0, 24, 0]],
            [[0, 24, 9], [40.2, 24, 9], [40, 0, 9], [40, 24.2, 9]],
        ),
    )
    p.add("roof", boxes([-0.2, -0.2, 9], [40.2, 24.2, 9.2]))
    ribs = cells(60, s, 8)
    x = np.linspace(0.3, 39.7, ribs)
    p.add(
        "roof",
        boxes(
            np.stack([x - 0.04, 0 * x, 0 * x + 8.92], 1),
            np.stack([x + 0.04, 0 * x + 24, 0 * x + 9], 1),
        ),
    )
    gx, gy = np.meshgrid(np.linspace(4, 36, 5), [2.4, 7.2, 12.0, 16.8, 21.6], indexing="ij")
    c = np.stack([gx.ravel(), gy.ravel(), np.full(gx.size, 7.9)], 1)
    p.add("lamps", boxes(c - [1.0, 0.12, 0.03], c + np.array([1.0, 0.12, 0.03])))
    # Trusses under the roof.
    panels = 12
    for x0 in np.linspace(2, 38, 7):
        y = np.linspace(0.1, 23.9, panels + 1)
        low = np.stack([0 * y + x0, y, 0 * y + 8.2], 1)
        high = low + np.array([0, 0, 0.65])
        p.add("steel", beams(low[:1], low[-1:], 0.09, 0.09), beams(high[:1], high[-1:], 0.09, 0.09))
        p.add("steel", beams(low[:-1], high[1:], 0.05, 0.05))
        p.add("steel", beams(low, high, 0.05, 0.05))
    # Racks: 10 bays of 3 m, 4 levels; loads are pallets with cartons or drums.
    pallet = _pallet()
    drum = lathe(
        [(0, 0), (0.2, 0), (0.2, 0.28), (0.21, 0.3), (0.2, 0.32), (0.2, 0.6), (0, 0.6)],
        cells(10, s, 6),
        cells(16, s, 6),
    )
    bays, levels, pitch = 10, 4, 1.75
    m = int(np.clip(round(2.6 * detail**0.34), 1, 12))
    tint = ("cartons_brown", "cartons_pale", "cartons_white")
    skip = 0.55 if detail < 0.1 else 0.15
    for ry in (2.2, 7.1, 12.0, 16.9, 21.8):
        post = np.array(
            [[5 + 3.0 * b, ry + d, 0.0] for b in range(bays + 1) for d in (-1.1, -0.1, 0.1, 1.1)]
        )
        p.add("rack_posts", boxes(post - [0.05, 0.04, 0], post + np.array([0.05, 0.04, 7.0])))
        bar = np.array(
            [
                [5.0, ry + d, 0.12 + pitch * z]
                for z in range(1, levels)
                for d in (-1.1, -0.1, 0.1, 1.1)
            ]
        )
        p.add("rack_beams", boxes(bar - [0, 0.03, 0.12], bar + np.array([30.0, 0.03, 0])))
        if detail > 0.2:
            start = post.reshape(bays + 1, 4, 3)
            for z in range(levels):
                lift = np.array([0, 0, pitch * z])
                p.add(
                    "rack_posts",
                    beams(start[:, 0] + lift, start[:, 1] + lift + [0, 0, pitch], 0.03, 0.03),
                )
                p.add(
                    "rack_posts",
                    beams(start[:, 3] + lift, start[:, 2] + lift + [0, 0, pitch], 0.03, 0.03),
                )
        spots = np.array(
            [
                [5.8 + 3.0 * b + 1.4 * h, ry + side * 0.6, 0.12 + pitch * z if z else 0.0]
                for b in range(bays)
                for h in range(2)
                for side in (-1, 1)
                for z in range(levels)
            ]
        )
        load = rng.uniform(size=len(spots))
        spots, load = spots[load > skip], load[load > skip]
        p.add("pallets", instance(pallet, None, spots))
        is_drum = load > 0.9
        four = np.array([[dx, dy, 0.135] for dx in (-0.24, 0.24) for dy in (-0.2, 0.2)])
        p.add("drums", instance(drum, None, (spots[is_drum][:, None] + four[None]).reshape(-1, 3)))
        cargo = spots[~is_drum]
        i, j, h = (q.ravel() for q in np.meshgrid(range(m), range(m), range(m), indexing="ij"))
        cell = np.array([1.06 / m, 0.78 / m, 1.1 / m])
        corner = np.stack([i, j, h], 1) * cell + np.array([-0.53, -0.39, 0.135])
        full = rng.integers(1, m + 1, len(cargo)) if m > 1 else np.ones(len(cargo), int)
        lo = cargo[:, None] + corner[None]
        there = h[None, :] < full[:, None]
        gap = rng.uniform(0.01, 0.05, (*there.shape, 1)) * cell
        kind = rng.integers(0, 3, len(cargo))
        for c_id, name in enumerate(tint):
            pick = there & (kind == c_id)[:, None]
            p.add(name, boxes(lo[pick], (lo + cell - gap)[pick]))
    # Loose drums by the gate and a fork-lift of blocks.
    loose = np.array([[1.2 + 0.5 * i, 1.2 + 0.5 * j, 0] for i in range(3) for j in range(3)])
    p.add("drums", instance(drum, None, loose))
    p.add(
        "truck",
        boxes(
            [[1.5, 11.0, 0.25], [1.5, 11.0, 0.9], [1.6, 11.1, 2.1]],
            [[3.6, 12.4, 0.9], [2.2, 12.4, 1.4], [3.0, 12.3, 2.18]],
        ),
    )
    p.add(
        "truck", boxes([[3.65, 11.2, 0], [3.65, 12.1, 0]], [[3.75, 11.3, 2.9], [3.75, 12.2, 2.9]])
    )
    p.add(
        "truck",
        boxes([[3.7, 11.25, 0.1], [3.7, 12.0, 0.1]], [[4.9, 11.4, 0.15], [4.9, 12.15, 0.15]]),
    )
    wheel = transform(
        cylinder(0.3, 0.25, cells(24, s, 8)), np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    )
    hubs = np.array([[2.0, 10.95, 0.3], [3.3, 10.95, 0.3], [2.0, 12.2, 0.3], [3.3, 12.2, 0.3]])
    p.add("tyres", instance(wheel, None, hubs))
    post = np.array([[1.65, 11.15], [1.65, 12.25], [2.95, 11.15], [2.95, 12.25]])
    p.add("truck", boxes(np.c_[post - 0.03, np.full(4, 0.9)], np.c_[post + 0.03, np.full(4, 2.1)]))
    return p


RECIPES = [
    Recipe(
        SceneInfo(
            "conference",
            "Conference room: long table, swivel chairs, blinds, panelled ceiling",
            "interior",
            90_000,
            "Conference",
        ),
        build_conference,
    ),
    Recipe(
        SceneInfo("library", "Reading hall between shelves full of books", "many boxes", 120_000),
        build_library,
    ),
    Recipe(
        SceneInfo(
            "staircase",
            "Spiral stair with iron balusters in a round stone tower",
            "architectural",
            60_000,
        ),
        build_staircase,
    ),
    Recipe(
        SceneInfo(
            "warehouse", "Racks of pallets, cartons and drums in a hall", "many boxes", 120_000
        ),
        build_warehouse,
    ),
]
