"""Four cities: Arabic, Babylonian and Italian quarters on one plan, and a skyline of towers."""

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
    instance,
    merge,
    quad,
    rot_z,
    sphere,
    torus,
    transform,
    tubes,
)

_PLOTS, _PITCH = 6, 22.0
_CENTRE = 3 * _PITCH  # the four plots about this point are left for the landmark


def _houses(rng: np.random.Generator) -> Array:
    """Lay out up to four houses a plot; rows are x0, y0, x1, y1, floors.

    Plots lie between streets of 5 m or so along the multiples of the pitch, where cameras stand.
    """
    out = []
    for i in range(_PLOTS):
        for j in range(_PLOTS):
            if i in (2, 3) and j in (2, 3):
                continue
            cx, cy = i * _PITCH + _PITCH / 2, j * _PITCH + _PITCH / 2
            for dx in (-1, 1):
                for dy in (-1, 1):
                    w, d = rng.uniform(5.5, 7.8, 2)
                    present, floors = rng.uniform() < 0.88, rng.integers(1, 5)
                    if present:
                        x, y = cx + dx * 4.3, cy + dy * 4.3
                        out.append([x - w / 2, y - d / 2, x + w / 2, y + d / 2, floors])
    return np.array(out)


def _walls(h: Array, floor_height: float) -> Mesh:
    lo = np.concatenate([h[:, :2], np.zeros((len(h), 1))], 1)
    return boxes(lo, np.stack([h[:, 2], h[:, 3], floor_height * h[:, 4]], 1))


def _facade(h: Array, spacing: float, floor_height: float, sill: float) -> tuple[Array, Array]:
    """Points on all four fronts of all houses, on each floor, and the outward headings."""
    where, heading = [], []
    for x0, y0, x1, y1, floors in h:
        z = sill + floor_height * np.arange(int(floors))
        for fixed, a, b, turn in (
            (x0, y0, y1, np.pi),
            (x1, y0, y1, 0.0),
            (y0, x0, x1, -np.pi / 2),
            (y1, x0, x1, np.pi / 2),
        ):
            k = max(1, int((b - a - 0.6) / spacing))
            u = a + (b - a) * (np.arange(k) + 0.5) / k
            uu, zz = (q.ravel() for q in np.meshgrid(u, z, indexing="ij"))
            on_x = turn in (0.0, np.pi)
            ff = np.full_like(uu, fixed)
            where.append(np.stack([ff, uu, zz] if on_x else [uu, ff, zz], 1))
            heading.append(np.full(len(uu), turn))
    return np.concatenate(where), np.concatenate(heading)


def _parapet(h: Array, spacing: float, floor_height: float) -> Array:
    """Points along the roof edges of all houses, `spacing` apart."""
    out = []
    for x0, y0, x1, y1, floors in h:
        nx, ny = max(2, int((x1 - x0) / spacing)), max(2, int((y1 - y0) / spacing))
        x, y = np.linspace(x0 + 0.2, x1 - 0.2, nx + 1), np.linspace(y0 + 0.2, y1 - 0.2, ny + 1)
        edge = [np.stack([x, 0 * x + e], 1) for e in (y0 + 0.2, y1 - 0.2)]
        edge += [np.stack([0 * y[1:-1] + e, y[1:-1]], 1) for e in (x0 + 0.2, x1 - 0.2)]
        at = np.concatenate(edge)
        out.append(np.c_[at, np.full(len(at), floor_height * floors)])
    return np.concatenate(out)


def _some(
    rng: np.random.Generator, points: Array, heading: Array, share: float
) -> tuple[Array, Array]:
    keep = rng.uniform(size=len(points)) < share
    keep[:1] = True
    return points[keep], heading[keep]


def _arch_window(n: int, sides: int, bars: int) -> Mesh:
    """Make an arched frame with upright bars in the plane x = 0, outward along +x."""
    a = np.linspace(0, np.pi, n)
    path = np.concatenate(
        [
            [[0, 0.45, 0]],
            np.stack([0 * a, 0.45 * np.cos(a), 0.9 + 0.45 * np.sin(a)], 1),
            [[0, -0.45, 0]],
        ]
    )
    parts = [tubes(path, 0.09, sides), boxes([0, -0.6, -0.1], [0.2, 0.6, 0.0])]
    if bars:
        y = np.linspace(-0.35, 0.35, bars)
        top = 0.9 + np.sqrt(np.maximum(0, 0.2 - y**2))
        start = np.stack([0 * y + 0.05, y, 0 * y], 1)
        parts.append(beams(start, np.stack([0 * y + 0.05, y, top], 1), 0.03, 0.03))
    return merge(parts)


def _dark_panes(where: Array, heading: Array) -> Mesh:
    pane = boxes([-0.02, -0.45, 0], [0.02, 0.45, 1.15])
    return instance(pane, rot_z(heading), where)


def _streets(p: Parts, s: float) -> None:
    n = min(400, cells(16, s, 4))
    p.add("ground", quad([-12, -12, 0], [156, 0, 0], [0, 156, 0], n, n))


def build_arabic(detail: float, rng: np.random.Generator) -> Parts:
    """Flat roofs with crenels, arched windows, domes, minarets and a mosque in the middle."""
    s = float(np.sqrt(detail))
    p = Parts()
    _streets(p, s)
    h, fh = _houses(rng), 3.2
    kind = np.arange(len(h)) % 3
    for i, name in enumerate(("walls_white", "walls_sand", "walls_ochre")):
        p.add(name, _walls(h[kind == i], fh))
    where, heading = _facade(h, 2.2, fh, 1.0)
    where, heading = _some(rng, where, heading, min(0.8, 3.0 * detail))
    window = _arch_window(cells(8, s**0.8, 3), cells(5, s**0.8, 3), min(12, cells(2, s, 0)))
    p.add("frames", instance(window, rot_z(heading), where))
    p.add("panes", _dark_panes(where, heading))
    edge = _parapet(h, float(np.clip(1.0 / s**0.6, 0.3, 4.0)), fh)
    p.add("walls_sand", boxes(edge - [0.15, 0.15, 0], edge + np.array([0.15, 0.15, 0.6])))
    domed = h[rng.uniform(size=len(h)) < 0.18]
    centre = np.stack([domed[:, [0, 2]].mean(1), domed[:, [1, 3]].mean(1), fh * domed[:, 4]], 1)
    dome = lathe(
        [(2.3, 0), (2.3, 0.6), (2.5, 1.4), (1.7, 2.9), (0.5, 3.7), (0, 4.4)],
        cells(16, s, 4),
        cells(26, s, 6),
    )
    p.add("domes", instance(dome, None, centre))
    # The mosque: hall, great dome, four minarets, an arcade around the court.
    c = _CENTRE
    p.add("walls_white", boxes([c - 12, c - 6, 0], [c + 12, c + 14, 9]))
    p.add("domes", transform(dome, [3.2, 3.2, 3.0], [c, c + 4, 9]))
    minaret = lathe(
        [
            (1.5, 0),
            (1.4, 9),
            (1.3, 14),
            (2.0, 15),
            (2.0, 15.8),
            (1.0, 16),
            (0.9, 20),
            (1.5, 21),
            (1.5, 21.5),
            (0.9, 22),
            (0.7, 24),
            (0, 27),
        ],
        cells(40, s, 14),
        cells(18, s, 6),
    )
    corner = np.array([[c + a, c + b, 0] for a in (-14.0, 14.0) for b in (-8.0, 16.0)])
    some = centre[:: max(1, len(centre) // 5)] * [1, 1, 0] + [4.2, 4.2, 0]
    p.add(
        "minarets",
        instance(minaret, None, corner),
        instance(minaret, np.full(len(some), 0.6), some),
    )
    x = np.linspace(c - 14, c + 14, 12)
    for y in (c - 9.0, c - 14.0):
        base = np.stack([x, 0 * x + y, 0 * x], 1)
        p.add(
            "walls_white",
            instance(
                lathe(
                    [(0.35, 0), (0.25, 0.4), (0.25, 3.4), (0.4, 3.8)],
                    cells(8, s, 3),
                    cells(14, s, 5),
                ),
                None,
                base,
            ),
        )
        a = np.linspace(0, np.pi, cells(14, s, 4))
        span = x[1] - x[0]
        arc = np.stack([span / 2 * (1 - np.cos(a)), 0 * a, 3.8 + 1.2 * np.sin(a)], 1)
        p.add("frames", tubes(arc[None] + base[:-1, None], 0.22, cells(7, s, 4)))
    return p


def build_babylonian(detail: float, rng: np.random.Generator) -> Parts:
    """Mud-brick houses with pilasters and stepped crenels around a ziggurat, in a city wall."""
    s = float(np.sqrt(detail))
    p = Parts()
    _streets(p, s)
    h, fh = _houses(rng), 3.0
    h[:, 4] = np.minimum(h[:, 4], 3)
    kind = np.arange(len(h)) % 2
    for i, name in enumerate(("brick_pale", "brick_brown")):
        p.add(name, _walls(h[kind == i], fh))
    # Pilasters in front of the walls: tall thin boxes.
    where, heading = _facade(
        h * [1, 1, 1, 1, 0] + [0, 0, 0, 0, 1], float(np.clip(1.1 / s**0.5, 0.35, 3.5)), fh, 0.0
    )
    tall = np.repeat(fh * h[:, 4], np.bincount(_owner(h, where), minlength=len(h)))
    order = np.argsort(_owner(h, where), kind="stable")
    rib = boxes([-0.05, -0.18, 0], [0.14, 0.18, 1.0])
    scale = rot_z(heading[order])
    scale[:, 2, 2] = tall - 0.2
    where = where[order]
    p.add("brick_brown", instance(rib, scale, where))
    doors, turn = _facade(h, 2.6, fh, 0.9)
    doors, turn = _some(rng, doors, turn, min(0.5, 2.0 * detail))
    frame = merge(
        [
            boxes([-0.02, -0.5, -0.1], [0.22, 0.5, 0]),
            boxes([-0.02, -0.5, 1.1], [0.22, 0.5, 1.25]),
            boxes([[-0.02, -0.5, 0], [-0.02, 0.4, 0]], [[0.22, -0.4, 1.1], [0.22, 0.5, 1.1]]),
        ]
    )
    p.add("brick_pale", instance(frame, rot_z(turn), doors))
    p.add("panes", _dark_panes(doors, turn))
    _crenels(p, "brick_pale", _parapet(h, float(np.clip(1.1 / s**0.5, 0.5, 4.0)), fh), 0.5)
    # Roof poles sticking out of the walls, and awnings of cloth.
    poles, turn = _facade(h, float(np.clip(0.9 / s**0.5, 0.4, 3.0)), fh, 2.6)
    pole = tubes(np.array([[-0.2, 0, 0], [0.5, 0, 0.0]]), 0.07, cells(6, s**0.7, 4))
    poles, turn = _some(rng, poles, turn, min(0.7, 2 * detail))
    p.add("poles", instance(pole, rot_z(turn), poles))
    # Ziggurat of seven steps with a stair.
    c = _CENTRE
    for i in range(7):
        r, z = 19.0 - 2.3 * i, 3.2 * i
        name = ("brick_brown", "glazed", "brick_pale")[i % 3]
        p.add(name, boxes([c - r, c - r, z], [c + r, c + r, z + 3.2]))
        ring = _parapet(
            np.array([[c - r, c - r, c + r, c + r, 1.0]]),
            float(np.clip(1.2 / s**0.5, 0.4, 4.0)),
            z + 3.2,
        )
        _crenels(p, name, ring, 0.45)
    steps = cells(70, s**0.5, 24)
    i = np.arange(steps)
    top, tread = 3.2 * 7 * (i + 1) / steps, 16.0 / steps
    y0 = c - 20.0 + tread * i
    p.add(
        "brick_pale",
        boxes(
            np.stack([0 * top + c - 2, y0, 0 * top], 1),
            np.stack([0 * top + c + 2, y0 + tread, top], 1),
        ),
    )
    # City wall with towers.
    lo, hi = -9.0, _PLOTS * _PITCH + 9.0
    p.add(
        "brick_brown",
        boxes(
            [[lo, lo, 0], [lo, hi - 2, 0], [lo, lo, 0], [hi - 2, lo, 0]],
            [[hi, lo + 2, 7], [hi, hi, 7], [lo + 2, hi, 7], [hi, hi, 7]],
        ),
    )
    t = np.linspace(lo + 1, hi - 1, 9)
    tower = np.concatenate(
        [np.stack([t, 0 * t + e], 1) for e in (lo + 1, hi - 1)]
        + [np.stack([0 * t + e, t], 1) for e in (lo + 1, hi - 1)]
    )
    tower = np.unique(tower, axis=0)
    p.add(
        "glazed",
        boxes(
            np.c_[tower - 2.2, np.zeros(len(tower))], np.c_[tower + 2.2, np.full(len(tower), 10.0)]
        ),
    )
    box = np.c_[tower - 2.2, tower + 2.2, np.ones(len(tower))]
    _crenels(p, "glazed", _parapet(box, float(np.clip(1.4 / s**0.5, 0.5, 4.0)), 10.0), 0.5)
    return p


def _owner(h: Array, where: Array) -> Array:
    """Index of the house whose front each point lies on (the nearest centre)."""
    centre = np.stack([h[:, [0, 2]].mean(1), h[:, [1, 3]].mean(1)], 1)
    return np.argmin(((where[:, None, :2] - centre[None]) ** 2).sum(-1), axis=1)


def _crenels(p: Parts, part: str, at: Array, size: float) -> None:
    """Two-step crenels: a wide block with a narrow one on top."""
    p.add(part, boxes(at - [size / 2, size / 2, 0], at + np.array([size / 2, size / 2, size])))
    q = at + np.array([0, 0, size])
    p.add(part, boxes(q - [size / 4, size / 4, 0], q + np.array([size / 4, size / 4, size * 0.7])))


def build_italian(detail: float, rng: np.random.Generator) -> Parts:
    """Pitched roofs of round tiles, shutters, chimneys; a piazza with a bell tower and fountain."""
    s = float(np.sqrt(detail))
    p = Parts()
    _streets(p, s)
    h, fh = _houses(rng), 3.2
    kind = np.arange(len(h)) % 3
    for i, name in enumerate(("walls_cream", "walls_rose", "walls_orange")):
        p.add(name, _walls(h[kind == i], fh))
    spacing = float(np.clip(0.5 / s**0.6, 0.12, 3.0))
    sides, segs = cells(6, s**0.5, 3), cells(2, s**0.8)
    u = np.linspace(0, 1, segs + 1)
    for x0, y0, x1, y1, floors in h:
        # The ridge runs along x; rows of tiles run down both slopes, with eaves of 0.4 m.
        n = max(2, int((x1 - x0 + 0.4) / spacing))
        x = np.linspace(x0 - 0.2, x1 + 0.2, n + 1)
        z, mid, rise = fh * floors, (y0 + y1) / 2, 0.32 * (y1 - y0)
        for eave in (y0 - 0.4, y1 + 0.4):
            drop = rise * 0.4 / (mid - y0)
            y = mid + (eave - mid) * u
            zz = z + rise - (rise + drop) * u
            path = np.stack(np.broadcast_arrays(x[:, None], y[None], zz[None]), -1)
            p.add("tiles", tubes(path, 0.5 * (x[1] - x[0]), sides, caps=(False, True)))
        gable = np.array(
            [
                [x0, y0, z],
                [x0, y1, z],
                [x0, mid, z + rise],
                [x1, y0, z],
                [x1, y1, z],
                [x1, mid, z + rise],
            ]
        )
        p.add("walls_cream", (gable, np.array([[0, 1, 2], [3, 4, 5]])))
    where, heading = _facade(h, 2.2, fh, 1.0)
    where, heading = _some(rng, where, heading, min(0.85, 2.5 * detail))
    p.add(
        "frames",
        instance(_arch_window(cells(7, s**0.8, 3), cells(5, s**0.8, 3), 0), rot_z(heading), where),
    )
    p.add("panes", _dark_panes(where, heading))
    slats = min(40, cells(5, s, 1))
    z = np.linspace(0.05, 1.0, slats)
    leaf = [
        boxes(
            np.stack([0 * z + 0.02, 0 * z + y, z], 1),
            np.stack([0 * z + 0.08, 0 * z + y + 0.4, z + 0.7 / slats], 1),
        )
        for y in (-1.0, 0.6)
    ]
    p.add("shutters", instance(merge(leaf), rot_z(heading), where))
    pot = h[:, :2] + 1.5
    top = np.c_[pot, fh * h[:, 4] + 0.5]
    p.add("chimneys", boxes(top - [0.3, 0.3, 0.5], top + np.array([0.3, 0.3, 2.2])))
    # Piazza: campanile, church with a dome, fountain.
    c = _CENTRE
    p.add("walls_rose", boxes([c + 9, c + 9, 0], [c + 15, c + 15, 30]))
    tower = np.array([[c + 9.0, c + 9.0, c + 15.0, c + 15.0, 9.0]])
    at, turn = _facade(tower, 1.9, 3.2, 1.0)
    p.add("frames", instance(_arch_window(cells(7, s, 3), cells(5, s, 3), 0), rot_z(turn), at))
    p.add(
        "tiles",
        transform(
            lathe([(5.2, 0), (2.6, 4.0), (0, 8)], cells(8, s, 2), cells(12, s, 4)),
            None,
            [c + 12, c + 12, 30],
        ),
    )
    p.add("walls_cream", boxes([c - 17, c + 4, 0], [c + 3, c + 17, 11]))
    dome = lathe(
        [(5, 0), (5, 3), (4.8, 5), (3.2, 8), (0.8, 9.4), (0.7, 11), (0, 12)],
        cells(24, s, 6),
        cells(32, s, 8),
    )
    p.add("tiles", transform(dome, None, [c - 7, c + 10.5, 11]))
    p.add(
        "marble",
        transform(torus(3.2, 0.3, cells(48, s, 12), cells(10, s, 4)), None, [c + 4, c - 8, 0.5]),
    )
    p.add(
        "marble",
        transform(
            lathe(
                [
                    (0.6, 0),
                    (0.4, 1.0),
                    (1.6, 1.9),
                    (1.5, 2.0),
                    (0.3, 1.8),
                    (0.3, 3),
                    (0.9, 3.5),
                    (0, 3.3),
                ],
                cells(20, s, 8),
                cells(28, s, 8),
            ),
            None,
            [c + 4, c - 8, 0],
        ),
    )
    return p


def build_skyline(detail: float, rng: np.random.Generator) -> Parts:
    """10 x 10 blocks of towers, up to 180 m, with windows as panes between thin mullions."""
    s = float(np.sqrt(detail))
    p = Parts()
    n, pitch = 10, 40.0
    p.add(
        "ground",
        quad(
            [-60, -60, 0],
            [n * pitch + 120, 0, 0],
            [0, n * pitch + 120, 0],
            cells(8, s),
            cells(8, s),
        ),
    )
    i, j = (q.ravel() for q in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    cx, cy = (i + 0.5) * pitch, (j + 0.5) * pitch
    p.add(
        "pavement",
        boxes(
            np.stack([cx - 15, cy - 15, 0 * cx], 1), np.stack([cx + 15, cy + 15, 0 * cx + 0.3], 1)
        ),
    )
    middle = np.exp(-((cx - 200) ** 2 + (cy - 200) ** 2) / 2.2e4)
    height = 18 + 150 * middle * rng.uniform(0.25, 1.0, n * n) + rng.uniform(0, 16, n * n)
    style = rng.permutation(np.arange(n * n) % 3)
    # Parks are where they are for every seed, so that no part is ever empty.
    park = np.arange(n * n) % 17 == 5
    glass = ("glass_blue", "glass_green", "glass_grey")
    for name in glass:
        p.add(name)
    for b in np.flatnonzero(~park):
        tiers = 1 + int(height[b] > 60) + int(height[b] > 110)
        half = np.array([rng.uniform(9.5, 13), rng.uniform(9.5, 13)])
        z0 = 0.3
        c = np.array([cx[b], cy[b]])
        for tier in range(tiers):
            z1 = 0.3 + height[b] * (tier + 1) / tiers
            p.add(glass[style[b]], boxes([*(c - half), z0], [*(c + half), z1]))
            p.add("roofs", boxes([*(c - half - 0.3), z1], [*(c + half + 0.3), z1 + 0.8]))
            k = cells(7 if style[b] != 1 else 4, s, 1)
            if k:
                _mullions(p, c, half, z0, z1, k, cells((z1 - z0) / 6, s, 1), int(style[b]))
            z0, half = z1 + 0.8, half * 0.72
        # Roof: plant room and mast.
        p.add("roofs", boxes([*(c - half * 0.6), z0], [*(c + half * 0.6), z0 + 3]))
        if tiers > 1:
            p.add(
                "masts",
                tubes(
                    np.array([[*c, z0 + 3], [*c, z0 + 24.0]]), np.array([0.5, 0.08]), cells(6, s, 3)
                ),
            )
    trunk = tubes(np.array([[0, 0, 0.3], [0, 0, 3.0]]), 0.25, cells(5, s, 3))
    crown = transform(sphere(2.2, cells(9, s, 4)), None, [0, 0, 4.6])
    k = cells(10, s, 3)
    for b in np.flatnonzero(park):
        at = np.c_[rng.uniform(-13, 13, (k, 2)) + np.array([cx[b], cy[b]]), np.zeros(k)]
        p.add("trees", instance(trunk, None, at), instance(crown, None, at))
    lanes = np.arange(n + 1) * pitch
    k = cells(2.0, s, 1)
    car = merge(
        [boxes([-2.1, -0.9, 0.3], [2.1, 0.9, 0.9]), boxes([-1.2, -0.8, 0.9], [1.0, 0.8, 1.5])]
    )
    at = np.array([[rng.uniform(0, 400), y + 2.2, 0.0] for y in lanes for _ in range(4 * k)])
    at = at[
        np.abs((at[:, 0] + 20) % pitch - 20) > 9
    ]  # leaves the crossings, where cameras stand, free
    p.add("cars", instance(car, None, at))
    return p


def _mullions(
    p: Parts, c: Array, half: Array, z0: float, z1: float, k: int, floors: int, style: int
) -> None:
    """Uprights and floor bands around a tower; style 2 has bands only, hence wide long boxes."""
    lo, hi = [], []
    z = np.linspace(z0, z1, floors + 1)[:-1]
    lo.append(np.stack([0 * z + c[0] - half[0] - 0.15, 0 * z + c[1] - half[1] - 0.15, z], 1))
    hi.append(np.stack([0 * z + c[0] + half[0] + 0.15, 0 * z + c[1] + half[1] + 0.15, z + 0.35], 1))
    if style != 2:
        for axis in (0, 1):
            u = np.linspace(c[axis] - half[axis], c[axis] + half[axis], k + 1)
            other = 1 - axis
            for sign in (-1, 1):
                e = c[other] + sign * half[other]
                pt = np.empty((k + 1, 3))
                pt[:, axis], pt[:, other], pt[:, 2] = u, e, z0
                lo.append(pt - [0.1, 0.1, 0])
                hi.append(pt + np.array([0.1, 0.1, 0]) + np.array([0, 0, z1 - z0]))
    else:
        x = c[0] + half[0] * np.array([-1, 1])
        lo.append(
            np.array(
                [[a - 0.3, b - 0.3, z0] for a in x for b in c[1] + half[1] * np.array([-1, 1])]
            )
        )
        hi.append(lo[-1] + np.array([0.6, 0.6, z1 - z0]))
        pane = cylinder(0.12, z1 - z0, 6)
        edge = np.linspace(-1, 1, k + 1)
        at = np.concatenate(
            [
                np.stack(
                    [c[0] + half[0] * edge, 0 * edge + c[1] + sign * half[1], 0 * edge + z0], 1
                )
                for sign in (-1, 1)
            ]
        )
        p.add("mullions", instance(pane, None, at))
    p.add("mullions", boxes(np.concatenate(lo), np.concatenate(hi)))


RECIPES = [
    Recipe(
        SceneInfo(
            "city_arabic",
            "Arabic quarter: flat roofs, arched windows, domes, minarets",
            "city",
            150_000,
            "Arabic",
        ),
        build_arabic,
    ),
    Recipe(
        SceneInfo(
            "city_babylonian",
            "Babylonian city: brick houses, a ziggurat, a city wall",
            "city",
            120_000,
            "Babylonian",
        ),
        build_babylonian,
    ),
    Recipe(
        SceneInfo(
            "city_italian",
            "Italian quarter: tiled roofs, shutters, piazza",
            "city",
            150_000,
            "Italian",
        ),
        build_italian,
    ),
    Recipe(
        SceneInfo(
            "skyline", "Blocks of towers with window grids, streets and parks", "city", 100_000
        ),
        build_skyline,
    ),
]
