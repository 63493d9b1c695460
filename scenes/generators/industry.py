"""Machinery: a power plant of steel and pipes, an engine room, turbine blades, lattice towers."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells
from .furniture import lathe
from .primitives import (
    Array,
    Mesh,
    beams,
    boxes,
    cylinder,
    grid_box,
    instance,
    merge,
    prism,
    quad,
    revolve,
    rot_x,
    rot_z,
    sphere,
    surface,
    torus,
    transform,
    tubes,
)


def _pipe_path(
    rng: np.random.Generator, lo: Array, hi: Array, legs: int, bend: float, steps: int
) -> Array:
    """Walk at right angles inside a box, with rounded corners."""
    at = rng.uniform(lo, hi)
    corner, axis = [at], int(rng.integers(0, 3))
    for _ in range(legs):
        axis = (axis + 1 + int(rng.integers(0, 2))) % 3
        to = at.copy()
        span = hi[axis] - lo[axis]
        to[axis] = np.clip(
            at[axis] + rng.choice([-1, 1]) * rng.uniform(0.2, 0.6) * span, lo[axis], hi[axis]
        )
        if abs(to[axis] - at[axis]) < 4 * bend:
            to[axis] = lo[axis] if at[axis] > (lo[axis] + hi[axis]) / 2 else hi[axis]
        corner.append(to)
        at = to
    c = np.array(corner)
    out = [c[:1]]
    u = np.linspace(0, 1, steps + 1)[:, None]
    for i in range(1, len(c) - 1):
        a = c[i] + (c[i - 1] - c[i]) / np.linalg.norm(c[i - 1] - c[i]) * bend
        b = c[i] + (c[i + 1] - c[i]) / np.linalg.norm(c[i + 1] - c[i]) * bend
        out.append((1 - u) ** 2 * a + 2 * u * (1 - u) * c[i] + u**2 * b)
    return np.concatenate([*out, c[-1:]])


def build_powerplant(detail: float, rng: np.random.Generator) -> Parts:
    """Steel frame of 8 x 5 bays and 6 floors (48 x 30 x 24 m) full of pipes, tanks and gratings."""
    s = float(np.sqrt(detail))
    p = Parts()
    nx, ny, nz = 8, 5, 6
    p.add("ground", quad([-15, -15, 0], [78, 0, 0], [0, 60, 0], cells(6, s), cells(5, s)))
    x, y, z = np.arange(nx + 1) * 6.0, np.arange(ny + 1) * 6.0, np.arange(1, nz + 1) * 4.0
    profile = detail > 0.25

    def steel(a: Array, b: Array) -> Mesh:
        # An I-profile is a web and two flanges; small versions have a plain bar.
        if not profile:
            return beams(a, b, 0.3, 0.3)
        axis = int(np.argmax(np.abs(b[0] - a[0])))
        off = np.zeros(3)
        off[(axis + 1) % 3 if axis != 1 else 2] = 0.14
        sizes = np.full(3, 0.0)
        web, fl = sizes.copy(), sizes.copy()
        long = (axis + 1) % 3 if axis != 1 else 2
        wide = 3 - axis - long
        web[long], web[wide] = 0.14, 0.01
        fl[long], fl[wide] = 0.015, 0.12
        return merge(
            [
                boxes(a - web, b + web),
                boxes(a - off - fl, b - off + fl),
                boxes(a + off - fl, b + off + fl),
            ]
        )

    gx, gy = (q.ravel() for q in np.meshgrid(x, y, indexing="ij"))
    base = np.stack([gx, gy, 0 * gx], 1)
    p.add("steel", steel(base, base + np.array([0, 0, 24.0])))
    for level in z:
        q = np.stack([0 * y, y, 0 * y + level], 1)
        p.add("steel", steel(q, q + np.array([48.0, 0, 0])))
        q = np.stack([x, 0 * x, 0 * x + level], 1)
        p.add("steel", steel(q, q + np.array([0, 30.0, 0])))
    # Gratings on about half of the bays; the lane y in (12, 18) is free of them.
    bars = min(60, cells(9, s, 2))
    for i in range(nx):
        for j in range(ny):
            for level in z[:-1]:
                on = rng.uniform() < 0.5
                if on and j != 2:
                    u = np.linspace(0.2, 5.8, bars)
                    lo = np.stack([i * 6 + u - 0.02, 0 * u + j * 6, 0 * u + level + 0.16], 1)
                    p.add("grating", boxes(lo, lo + np.array([0.04, 6.0, 0.04])))
                    u = u[:: max(1, bars // 6)]
                    lo = np.stack([0 * u + i * 6, j * 6 + u - 0.02, 0 * u + level + 0.15], 1)
                    p.add("grating", boxes(lo, lo + np.array([6.0, 0.04, 0.04])))
    # Rails along the lane.
    for yy in (12.0, 18.0):
        for level in z[:-1]:
            post = np.stack([np.arange(0, 48.1, 1.5), np.full(33, yy), np.full(33, level)], 1)
            if detail > 0.1:
                p.add("rails", beams(post, post + np.array([0, 0, 1.1]), 0.04, 0.04))
            ends = np.array([[0, yy, level + 0.6], [0, yy, level + 1.1]])
            p.add("rails", beams(ends, ends + np.array([48.0, 0, 0]), 0.04, 0.04))
    tint = ("pipes_grey", "pipes_red", "pipes_green")
    flange = cylinder(1.0, 1.0, cells(14, s**0.7, 6))
    for i in range(cells(110, detail**0.6, 14)):
        r = 0.04 * 10 ** rng.uniform(0, 0.95)
        half = int(rng.integers(0, 2))
        lo = np.array([0.5, 0.5 if half else 18.6, 0.6])
        hi = np.array([47.5, 11.4 if half else 29.5, 23.0])
        path = _pipe_path(rng, lo, hi, int(rng.integers(3, 11)), 2.2 * r, cells(5, s**0.7, 2))
        name = tint[i % 3]
        p.add(name, tubes(path, r, cells(12, s**0.7, 5)))
        where = np.stack([path[0], path[-1]]) - [0, 0, 0.06]
        p.add("steel", instance(flange, np.array([[1.5 * r, 1.5 * r, 0.12]] * 2), where))
    tank = lathe(
        [(0, 0), (0.6, 0.05), (1, 0.35), (1, 0.5), (1, 3.4), (1, 3.6), (0.6, 3.95), (0, 4.0)],
        cells(18, s, 6),
        cells(24, s, 8),
    )
    k = 22
    size = rng.uniform(0.6, 1.5, k)
    side = np.where(np.arange(k) % 2, 6.0, 24.0) + rng.uniform(-2.5, 2.5, k)
    at = np.stack([rng.uniform(2, 46, k), side, 4.0 * rng.integers(0, 5, k) + 0.2], 1)
    p.add("tanks", instance(tank, np.stack([size, size, 0.85 + 0 * size], 1), at))
    chimney = lathe(
        [(2.6, 0), (2.2, 12), (1.9, 30), (2.1, 31), (1.7, 31)], cells(20, s, 6), cells(32, s, 10)
    )
    p.add("chimneys", instance(chimney, None, [[-8, 8, 0], [-8, 22, 0.0]]))
    tower = lathe(
        [(7.5, 0), (6, 6), (5, 13), (5.2, 18), (5.6, 22)], cells(24, s, 6), cells(40, s, 12)
    )
    p.add("chimneys", transform(tower, None, [55.0, 37, 0]))
    return p


def _gear(teeth: int, radius: float, width: float, fine: int) -> Mesh:
    """Make a spur gear about z; `fine` points a tooth flank."""
    per = 4 * fine
    a = np.arange(teeth * per) * (2 * np.pi / (teeth * per))
    phase = (np.arange(teeth * per) % per) / per
    tooth = np.clip(2.2 * np.cos(2 * np.pi * phase), -1, 1)
    r = radius * (1 + 1.6 / teeth * tooth)
    ring = np.stack([r * np.cos(a), r * np.sin(a)], 1)
    bore = 0.25 * radius * np.stack([np.cos(a), np.sin(a)], 1)
    rim = 0.8 * radius * np.stack([np.cos(a), np.sin(a)], 1)
    loops = [
        (bore, 0.0),
        (rim * 0.45, 0.0),
        (rim * 0.47, 0.2),
        (rim * 0.97, 0.2),
        (rim, 0.0),
        (ring, 0.0),
        (ring, 1.0),
        (rim, 1.0),
        (rim * 0.97, 0.8),
        (rim * 0.47, 0.8),
        (rim * 0.45, 1.0),
        (bore, 1.0),
    ]
    pts = np.stack([np.c_[q, np.full(len(q), width * (h - 0.5))] for q, h in loops])
    return surface(pts, wrap_rows=True, wrap_cols=True)


def _bolt(n: int) -> Mesh:
    a = np.arange(6) * np.pi / 3
    head = prism(np.stack([np.cos(a), np.sin(a)], 1), 0.7)
    return merge([head, transform(cylinder(0.5, 0.9, n), None, [0, 0, 0.5])])


def build_engine(detail: float, rng: np.random.Generator) -> Parts:
    """Engine room of 10 x 7 x 4 m: a six-cylinder engine, a gear train, pipes, bolts, gauges."""
    s = float(np.sqrt(detail))
    p = Parts()
    p.add(
        "room",
        quad([0, 0, 4], [10, 0, 0], [0, 7, 0], 2, 2),
        quad([0, 7, 0], [10, 0, 0], [0, 0, 4]),
        quad([0, 0, 0], [10, 0, 0], [0, 0, 4]),
        quad([0, 0, 0], [0, 7, 0], [0, 0, 4]),
        quad([10, 0, 0], [0, 7, 0], [0, 0, 4]),
    )
    # Chequer plate floor: a pad on each square.
    p.add("floor", quad([0, 0, 0], [10, 0, 0], [0, 7, 0]))
    nx = cells(30, s, 5)
    gx, gy = (
        q.ravel()
        for q in np.meshgrid(
            np.linspace(0.2, 9.8, nx), np.linspace(0.2, 6.8, max(3, nx * 2 // 3)), indexing="ij"
        )
    )
    half = np.array([0.3, 0.07, 0]) * 10 / nx
    pad = np.stack([gx, gy, 0 * gx], 1)
    flip = (np.arange(len(pad)) % 2 == 0)[:, None]
    h = np.where(flip, half, half[[1, 0, 2]])
    p.add("floor", boxes(pad - h, pad + h + np.array([0, 0, 0.006])))
    at = np.array([[x, y, 3.9] for x in (2, 5, 8) for y in (2.2, 5.2)])
    p.add("lamps", boxes(at - [0.6, 0.08, 0], at + np.array([0.6, 0.08, 0.05])))
    # Block, head, sump; cylinders with cooling fins.
    p.add(
        "block",
        transform(grid_box([-2, -0.5, 0], [2, 0.5, 0.9], cells(16, s, 2)), None, [5, 3.5, 0.35]),
    )
    p.add("block", boxes([2.7, 2.8, 0], [7.3, 4.2, 0.35]))
    fins = cells(11, s**0.7, 4)
    profile = [(0.0, 0.0)]
    for i in range(fins):
        z = 0.9 * i / fins
        profile += [
            (0.24, z),
            (0.24, z + 0.45 / fins),
            (0.31, z + 0.5 / fins),
            (0.31, z + 0.8 / fins),
        ]
    profile += [(0.24, 0.9), (0.26, 1.0), (0.1, 1.08), (0.0, 1.08)]
    barrel = revolve(profile, cells(26, s, 8))
    cx = np.array([[3.35 + 0.66 * i, 3.5, 1.25] for i in range(6)])
    p.add("cylinders", instance(barrel, None, cx))
    bolt = transform(_bolt(cells(8, s, 4)), 0.028)
    a = np.arange(8) * np.pi / 4
    ring = np.stack([0.28 * np.cos(a), 0.28 * np.sin(a), 0 * a + 1.0], 1)
    p.add("bolts", instance(bolt, None, (cx[:, None] + ring[None]).reshape(-1, 3)))
    ex = np.linspace(3.1, 6.9, cells(20, s, 5))
    edge = np.concatenate([np.stack([ex, 0 * ex + y, 0 * ex + 1.25], 1) for y in (3.05, 3.95)])
    p.add("bolts", instance(bolt, None, edge))
    # Exhausts: one bent pipe a cylinder into a manifold.
    sides = cells(14, s, 5)
    t = np.linspace(0, np.pi / 2, cells(9, s, 3) + 1)
    bend = np.stack([0 * t, -0.26 - 0.5 * np.sin(t), 0.55 - 0.5 * (1 - np.cos(t)) + 0.25], 1)
    p.add("pipes_copper", tubes(bend[None] + cx[:, None], 0.075, sides))
    p.add(
        "pipes_copper",
        tubes(
            np.array([[2.2, 2.72, 1.52], [8.6, 2.72, 1.52], [8.9, 2.72, 1.9], [8.9, 2.72, 3.9]]),
            0.16,
            sides,
        ),
    )
    # Gear train at the end x = 2.9, shafts and belt.
    coarse = min(1.0, 1.5 * s)  # a small version has gears of fewer teeth
    fine = cells(2, s**0.6)
    turned = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    for yy, zz, teeth, r in (
        (3.5, 0.95, 36, 0.5),
        (2.86, 1.35, 18, 0.24),
        (4.2, 1.25, 20, 0.26),
        (3.5, 1.85, 28, 0.38),
        (4.35, 0.62, 26, 0.36),
    ):
        p.add(
            "gears",
            transform(_gear(max(8, round(teeth * coarse)), r, 0.14, fine), turned, [2.75, yy, zz]),
        )
        shaft = np.array([[2.5, yy, zz], [3.05, yy, zz]])
        p.add("bolts", tubes(shaft, 0.06, sides))
    # Flywheel at the other end.
    p.add(
        "gears",
        transform(_gear(max(8, round(80 * coarse)), 0.72, 0.2, fine), turned, [7.35, 3.5, 1.05]),
    )
    p.add(
        "block", transform(grid_box([0, 0, 0], [1.3, 1.4, 1.2], cells(6, s)), None, [7.6, 2.8, 0.0])
    )
    # Pipes along the walls, with valves (hand wheels) and flanges; gauges on a board.
    k = cells(9, s**0.7, 4)
    wheel = merge(
        [
            torus(0.12, 0.018, cells(24, s, 8), cells(8, s, 4)),
            tubes(
                np.array([[[-0.12, 0, 0], [0.12, 0, 0]], [[0, -0.12, 0], [0, 0.12, 0]]]),
                0.012,
                cells(6, s, 3),
            ),
            transform(cylinder(0.025, 0.14, cells(10, s, 5)), None, [0, 0, -0.14]),
        ]
    )
    joint = cylinder(1.0, 0.06, cells(18, s, 6))
    out = rot_x(-np.pi / 2)
    for i in range(k):
        z, r = 0.5 + 3.1 * i / k, rng.uniform(0.04, 0.10)
        x0 = rng.uniform(0.6, 2.0)
        path = np.array(
            [[x0, 6.75, 0.0], [x0, 6.75, z], [9.3 - x0 / 3, 6.75, z], [9.3 - x0 / 3, 6.75, 4.0]]
        )
        p.add(
            "pipes_red" if i % 2 else "pipes_green",
            tubes(_round(path, 0.15, cells(5, s, 2)), r, sides),
        )
        xs = rng.uniform(2.5, 8.0, 3)
        p.add(
            "gears",
            instance(
                transform(joint, [1.5 * r, 1.5 * r, 1]),
                np.broadcast_to(turned, (3, 3, 3)),
                np.stack([xs, 0 * xs + 6.75, 0 * xs + z], 1),
            ),
        )
        p.add("wheels", transform(wheel, out @ rot_z(i), [xs[0] + 0.2, 6.75 - r - 0.14, z]))
    p.add("panel", boxes([0.02, 1.0, 1.0], [0.12, 3.4, 2.4]))
    face = np.array([[0.12, y, z] for y in np.linspace(1.3, 3.1, 5) for z in (1.35, 1.75, 2.1)])
    dial = transform(
        lathe(
            [(0.0, 0.0), (0.1, 0.0), (0.14, 0.03), (0.15, 0.05), (0.13, 0.06), (0, 0.03)],
            cells(8, s, 5),
            cells(24, s, 8),
        ),
        np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]),
    )
    p.add("dials", instance(dial, None, face))
    tank = lathe(
        [(0, 0), (0.4, 0.06), (0.55, 0.3), (0.55, 1.6), (0.4, 1.84), (0, 1.9)],
        cells(20, s, 6),
        cells(30, s, 8),
    )
    p.add("tanks", instance(tank, None, [[1.0, 5.4, 0.1], [9.2, 0.9, 0.1], [9.2, 2.1, 0.1]]))
    return p


def _round(path: Array, bend: float, steps: int) -> Array:
    u = np.linspace(0, 1, steps + 1)[:, None]
    out = [path[:1]]
    for i in range(1, len(path) - 1):
        a, b = path[i - 1] - path[i], path[i + 1] - path[i]
        a, b = path[i] + a / np.linalg.norm(a) * bend, path[i] + b / np.linalg.norm(b) * bend
        out.append((1 - u) ** 2 * a + 2 * u * (1 - u) * path[i] + u**2 * b)
    return np.concatenate([*out, path[-1:]])


def build_blades(detail: float, rng: np.random.Generator) -> Parts:
    """Make an axial turbine: five rows of twisted blades on a drum along x, in half a casing."""
    s = float(np.sqrt(detail))
    p = Parts()
    nu, nv = cells(22, s, 4), cells(18, s, 2)
    u = np.linspace(0, 2 * np.pi, nu, endpoint=False)
    v = np.linspace(0, 1, nv + 1)[:, None]
    # Section: a thin cambered teardrop; it twists and narrows towards the tip.
    along = 0.5 * np.cos(u)
    thick = 0.06 * np.sin(u) * (1 - 0.75 * np.cos(u)) + 0.14 * (1 - (2 * along) ** 2)
    turned = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    thin = 40 if detail < 0.1 else 1
    for row in range(5):
        count = (34, 40, 46, 52, 58)[row]
        if thin > 1:
            count = count // 3
        chord, r0, r1 = 0.42 - 0.03 * row, 0.78 - 0.05 * row, 1.75 - 0.06 * row
        x = -1.7 + 0.82 * row
        twist = (0.35 + 0.75 * v) * (-1 if row % 2 else 1)
        width = chord * (1 - 0.25 * v)
        cx, cy = width * along[None], width * thick[None]
        c, sn = np.cos(twist), np.sin(twist)
        pts = np.stack(
            [x + c * cx - sn * cy, sn * cx + c * cy, r0 - 0.03 + (r1 - r0) * v + 0 * cx], -1
        )
        blade = surface(pts, wrap_cols=True)
        tip = pts[-1]
        lid = (tip, np.array([[0, i, i + 1] for i in range(1, len(tip) - 1)]))
        a = np.arange(count) * (2 * np.pi / count)
        blade = merge([blade, lid])
        p.add("stator" if row % 2 else "rotor", instance(blade, rot_x(a), np.zeros((count, 3))))
    drum = lathe(
        [
            (0, -2.9),
            (0.3, -2.75),
            (0.6, -2.4),
            (0.78, -1.9),
            (0.6, 1.8),
            (0.5, 2.4),
            (0.3, 2.6),
            (0, 2.6),
        ],
        cells(40, s, 10),
        cells(60, s, 16),
    )
    p.add("drum", transform(drum, turned))
    # The lower half of the casing, with a bolted rim.
    n, m = cells(48, s, 8), cells(60, s, 10)
    ang = np.linspace(np.pi, 2 * np.pi, n + 1)[None, :]
    xs = np.linspace(-2.6, 2.6, m + 1)[:, None]
    for extra in (0.06, 0.22):
        r = 1.85 - 0.06 * (xs + 1.7) + extra
        p.add("casing", surface(np.stack([xs + 0 * ang, r * np.cos(ang), r * np.sin(ang)], -1)))
    p.add(
        "casing",
        boxes([[-2.6, 1.85, -0.12], [-2.6, -2.35, -0.12]], [[2.6, 2.35, 0.0], [2.6, -1.85, 0.0]]),
    )
    k = cells(22, s**0.7, 6)
    bx = np.linspace(-2.4, 2.4, k)
    at = np.concatenate([np.stack([bx, 0 * bx + e, 0 * bx], 1) for e in (-2.2, 2.2)])
    p.add("bolts", instance(transform(_bolt(cells(8, s, 4)), 0.06), None, at))
    p.add("floor", quad([-8, -8, -2.4], [16, 0, 0], [0, 16, 0], cells(10, s), cells(10, s)))
    p.add(
        "stand",
        boxes([[-2.2, -1.6, -2.4], [1.6, -1.6, -2.4]], [[-1.6, 1.6, -1.4], [2.2, 1.6, -1.4]]),
    )
    return p


def build_truss(detail: float, rng: np.random.Generator) -> Parts:
    """Make a cable-stayed bridge along x, 220 m long, and guyed lattice masts: all slivers."""
    s = float(np.sqrt(detail))
    p = Parts()
    p.add("ground", quad([-130, -60, 0], [260, 0, 0], [0, 120, 0], cells(4, s), cells(2, s)))
    p.add("water", quad([-70, -60, 0.4], [140, 0, 0], [0, 120, 0]))
    p.add("deck", boxes([-110, -5, 11], [110, 5, 11.6]))
    sides = cells(5, s**0.4, 3)
    # Lattice girders under the deck edges.
    n = cells(40, s**0.7, 12)
    x = np.linspace(-110, 110, n + 1)
    for y in (-5.0, 5.0):
        low = np.stack([x, 0 * x + y, 0 * x + 8], 1)
        high = low + np.array([0, 0, 3.0])
        p.add("steel", beams(low[:1], low[-1:], 0.3, 0.3), beams(low[:-1], high[1:], 0.12, 0.12))
        p.add("steel", beams(low[1:], high[:-1], 0.12, 0.12), beams(low, high, 0.12, 0.12))
        rail = high + np.array([0, 0, 0.6])
        p.add("steel", beams(rail, rail + np.array([0, 0, 1.1]), 0.05, 0.05))
        ends = np.array([[-110, y, 12.7], [-110, y, 12.2]])
        p.add("cables", tubes(np.stack([ends, ends + np.array([220, 0, 0])], 1), 0.04, sides))
    cross = np.stack([x, 0 * x - 5, 0 * x + 8], 1)
    p.add("steel", beams(cross[:-1], cross[1:] + np.array([0, 10.0, 0]), 0.1, 0.1))
    # Pylons, from each of which a fan of cables goes to both deck edges.
    k = cells(22, s, 6)
    for px in (-50.0, 50.0):
        for y in (-6.5, 6.5):
            p.add("pylons", beams([[px, y, 0]], [[px, y * 0.6, 62]], 2.2, 1.6))
            reach = np.linspace(5, 55, k)
            for sign in (-1, 1):
                a = np.stack([px + 0 * reach, 0 * reach + y * 0.62, 30 + 30 * (reach / 55)], 1)
                b = np.stack([px + sign * reach, 0 * reach + np.sign(y) * 5, 0 * reach + 11.6], 1)
                p.add("cables", tubes(np.stack([a, b], 1), 0.07, sides))
        p.add(
            "pylons",
            beams([[px, -5.5, 24]], [[px, 5.5, 24]], 1.2, 1.2),
            beams([[px, -4, 58]], [[px, 4, 58]], 1.2, 1.2),
        )
    # Lattice masts on both banks with guy ropes, and sagging lines between them.
    levels = cells(26, s**0.8, 8)
    place = np.array([[sx, sy] for sx in (-105.0, -85.0, 85.0, 105.0) for sy in (-35.0, 35.0)])
    mast = _mast(levels, 44.0, 2.6, 0.8)
    p.add("masts", instance(mast, None, np.c_[place, np.zeros(len(place))]))
    ropes = []
    g = np.arange(3) * (2 * np.pi / 3) + 0.4
    for c in place:
        for h in (22.0, 42.0):
            for w in range(cells(2, s**0.6)):
                foot = np.c_[
                    c + 16 * np.stack([np.cos(g + 0.05 * w), np.sin(g + 0.05 * w)], 1), np.zeros(3)
                ]
                ropes.append(np.stack([np.broadcast_to([*c, h], (3, 3)), foot], 1))
    p.add("cables", tubes(np.concatenate(ropes), 0.03, sides))
    m = cells(30, s**0.6, 8)
    u = np.linspace(0, 1, m + 1)
    lines = []
    for sy in (-35.0, 35.0):
        for dy in np.linspace(-3, 3, cells(7, s**0.5, 3)):
            for a, b in ((-105.0, -85.0), (-85.0, 85.0), (85.0, 105.0)):
                sag = 4.0 * ((b - a) / 170) ** 2 * 4 * u * (1 - u)
                lines.append(
                    np.stack([a + (b - a) * u, 0 * u + sy + dy, 40 + 0.3 * abs(dy) - sag], 1)
                )
    p.add("cables", tubes(np.array(lines), 0.04, sides))
    arm = np.c_[place, np.full(len(place), 40.0)]
    p.add("masts", beams(arm - [0, 3.5, 0], arm + np.array([0, 3.5, 0]), 0.25, 0.25))
    return p


def _mast(levels: int, height: float, low: float, top: float) -> Mesh:
    """Make a square lattice mast with crossed braces."""
    z = np.linspace(0, height, levels + 1)
    r = np.linspace(low, top, levels + 1) / 2
    sign = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    leg = np.concatenate(
        [r[:, None, None] * sign[None], np.broadcast_to(z[:, None, None], (levels + 1, 4, 1))], -1
    )
    nxt = np.roll(leg, -1, axis=1)
    pairs = [
        (leg[:-1], leg[1:], 0.14),
        (leg[1:], nxt[1:], 0.07),
        (leg[:-1], nxt[1:], 0.06),
        (nxt[:-1], leg[1:], 0.06),
    ]
    return merge([beams(a.reshape(-1, 3), b.reshape(-1, 3), w, w) for a, b, w in pairs])


def build_clusters(detail: float, rng: np.random.Generator) -> Parts:
    """Coarse room of 20 x 20 x 8 with clusters of finely cut bubbles and tentacles."""
    s = float(np.sqrt(detail))
    p = Parts()
    p.add(
        "room",
        boxes(
            [[-0.2, 0, 0], [20, 0, 0], [0, -0.2, 0], [0, 20, 0]],
            [[0, 20, 8], [20.2, 20, 8], [20, 0, 8], [20, 20.2, 8]],
        ),
    )
    p.add("floor", boxes([-0.2, -0.2, -0.2], [20.2, 20.2, 0]))
    p.add("ceiling", boxes([-0.2, -0.2, 8], [20.2, 20.2, 8.2]))
    at = np.array([[x, y, 7.9] for x in (4.5, 10, 15.5) for y in (4.5, 10, 15.5)])
    p.add("lamps", boxes(at - [0.5, 0.5, 0.04], at + np.array([0.5, 0.5, 0.0])))
    tint = ("bubbles_pink", "bubbles_blue", "bubbles_green")
    # Clusters keep to the places of a 4 x 4 grid without its corners; cameras stand in the corners.
    spots = np.array(
        [[i, j] for i in range(4) for j in range(4) if not (i in (0, 3) and j in (0, 3))]
    )
    for c, spot in enumerate(spots):
        centre = np.array([*(2.9 + 4.7 * spot), rng.uniform(1.4, 5.5)])
        k = 16 + int(rng.integers(0, 20)) if detail > 0.3 else 6
        r = np.exp(rng.uniform(np.log(0.05), np.log(0.6), k))
        off = centre + np.clip(rng.normal(0, 0.7, (k, 3)), -1.5, 1.5)
        off[:, 2] = np.clip(off[:, 2], 0.3, 7.4)
        # The fineness has nothing to do with the size of a bubble: dense next to coarse.
        level = rng.integers(0, 4, k)
        for q, n in enumerate((6, 12, 18, 30)):
            pick = level == q
            p.add(tint[c % 3], instance(sphere(1.0, cells(n, s, 5)), r[pick], off[pick]))
        arms, segs = 6, cells(18, s, 6)
        step = rng.normal(size=(arms, 3))
        path = np.empty((arms, segs + 1, 3))
        path[:, 0] = centre
        for i in range(segs):
            step = 0.9 * step + 0.45 * rng.normal(size=(arms, 3)) * (18 / segs) ** 0.5
            unit = step / np.linalg.norm(step, axis=1, keepdims=True)
            to = path[:, i] + unit * 2.2 / segs
            path[:, i + 1] = np.clip(to, [0.1, 0.1, 0.1], [19.9, 19.9, 7.8])
        # Clipping can hold a tip still; a nudge keeps its tube from folding to nothing.
        path += 1e-4 * rng.normal(size=path.shape)
        p.add("tentacles", tubes(path, np.linspace(0.12, 0.03, segs + 1)[None], cells(10, s, 4)))
    return p


RECIPES = [
    Recipe(
        SceneInfo(
            "powerplant",
            "Steel frame with pipes, tanks and gratings",
            "machinery",
            150_000,
            "Powerplant",
        ),
        build_powerplant,
    ),
    Recipe(
        SceneInfo(
            "engine", "Engine room: cylinders, gears, pipes, bolts, gauges", "machinery", 100_000
        ),
        build_engine,
    ),
    Recipe(
        SceneInfo(
            "blades",
            "Turbine: rows of twisted blades on a drum in half a casing",
            "fine curved surfaces",
            150_000,
            "Blade",
        ),
        build_blades,
    ),
    Recipe(
        SceneInfo("truss", "Cable-stayed bridge and guyed lattice masts", "thin triangles", 50_000),
        build_truss,
    ),
    Recipe(
        SceneInfo(
            "clusters",
            "Finely cut bubbles and tentacles in a coarse room",
            "mixed scale",
            120_000,
            "Bubs",
        ),
        build_clusters,
    ),
]
