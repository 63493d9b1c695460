"""A Gothic church: fluted columns, pointed arches, groin vaults, pews."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells
from .furniture import wall_with_openings, window_frame
from .primitives import (
    Array,
    Mesh,
    beams,
    boxes,
    instance,
    merge,
    quad,
    revolve,
    rot_z,
    smooth_profile,
    sphere,
    surface,
    torus,
    transform,
    tubes,
)

_BAYS, _BAY = 7, 6.0
_LENGTH = _BAYS * _BAY


def _column(s: float) -> Mesh:
    sides, rows = 4 * cells(8, s, 2), cells(26, s, 8)
    profile = smooth_profile(
        np.array(
            [
                (0.95, 0),
                (0.95, 0.3),
                (0.8, 0.5),
                (0.6, 0.8),
                (0.55, 5.8),
                (0.62, 6.2),
                (0.95, 6.8),
                (0.95, 7.0),
            ]
        ),
        rows,
    )
    v, f = revolve(profile, sides)
    # Flutes: the shaft is drawn in along eight grooves.
    angle = np.arctan2(v[:, 1], v[:, 0])
    shaft = ((v[:, 2] > 0.8) & (v[:, 2] < 6.0)).astype(float)
    v = v.copy()
    v[:, :2] *= (1 - 0.1 * shaft * (0.5 + 0.5 * np.cos(8 * angle)))[:, None]
    return v, f


def _pointed(t: Array, rise: float) -> Array:
    """Height of a pointed arch over t in [-1, 1]."""
    return rise * np.sqrt(
        np.maximum(0.0, 1 - ((np.abs(t) + 0.35) ** 2 - 0.35**2) / (1.35**2 - 0.35**2))
    )


def _vault(size: tuple[float, float], rise: tuple[float, float], n: int) -> Mesh:
    """Make a groin vault over [0, a] x [0, b]: the higher one of two pointed barrels."""
    m = max(2, round(n * size[1] / size[0]))
    x, y = np.linspace(-1, 1, n + 1)[:, None], np.linspace(-1, 1, m + 1)[None, :]
    z = np.maximum(_pointed(x, rise[0]) + 0 * y, _pointed(y, rise[1]) + 0 * x)
    pts = np.stack([size[0] * (x + 1) / 2 + 0 * y, size[1] * (y + 1) / 2 + 0 * x, z], axis=-1)
    return surface(pts)


def build(detail: float, rng: np.random.Generator) -> Parts:
    """Nave along x from 0 to 42 m, 12 m wide, with an aisle of 5 m on either side; 16 m high."""
    s = float(np.sqrt(detail))
    p = Parts()
    n = cells(16, s, 4)
    k = np.arange(_BAYS)
    grid = np.arange(_BAYS + 1) * _BAY
    # Chequered floor.
    fx, fy = cells(42, s, 6), cells(22, s, 4)
    v, f = quad([0, -11, 0], [_LENGTH, 0, 0], [0, 22, 0], fx, fy)
    odd = (np.arange(fx)[:, None] + np.arange(fy)[None, :]).ravel() % 2 == 0
    f = f.reshape(-1, 2, 3)
    p.add("floor_dark", (v, f[odd].reshape(-1, 3)))
    p.add("floor_light", (v, f[~odd].reshape(-1, 3)))
    foot = np.concatenate([np.stack([grid, 0 * grid + y, 0 * grid], 1) for y in (-6.0, 6.0)])
    p.add("columns", instance(_column(s), None, foot))
    # Shafts from the capitals to the springing of the vault.
    z = np.linspace(7, 11.2, cells(4, s) + 1)
    shaft = foot[:, None, :] * np.array([1, 0.97, 0]) + z[None, :, None] * np.array([0, 0, 1.0])
    p.add("columns", tubes(shaft, 0.22, cells(12, s, 5)))
    # Arcade: moulded arches, and the wall between them and the clerestory.
    t = np.linspace(-1, 1, 2 * n + 1)
    arch = np.stack([_BAY / 2 * (t + 1), 0 * t, 7 + _pointed(t, 3.0)], 1)
    start = np.stack([k * _BAY, 0 * k, 0 * k], 1).astype(float)
    wall = np.stack([arch, arch * [1, 0, 0] + [0, 0, 10.6]], 0)
    holes = [(1.6 + _BAY * i, 4.4 + _BAY * i, 11.6, 14.6) for i in range(_BAYS)]
    lows = [(1.6 + _BAY * i, 4.4 + _BAY * i, 2.2, 5.6) for i in range(_BAYS)]
    clerestory = wall_with_openings(
        _LENGTH, 5.6, 0.5, [(a, b, c - 10.6, d - 10.6) for a, b, c, d in holes]
    )
    aisle = wall_with_openings(_LENGTH, 9.0, 0.5, lows)
    for y in (-6.0, 6.0):
        for dy, r in ((-0.3, 0.16), (0.0, 0.22), (0.3, 0.16)):
            path = arch[None] + start[:, None] + np.array([0, y + dy, 0])
            p.add("ribs", tubes(path, r, cells(9, s, 4)))
        p.add("walls", instance(surface(wall), None, start + np.array([0, y, 0])))
        p.add("walls", transform(clerestory, None, [0, y - (0.5 if y < 0 else 0.0), 10.6]))
        out = np.sign(y) * 11
        p.add("walls", transform(aisle, None, [0, out - (0.5 if y < 0 else 0.0), 0]))
        for x0, x1, z0, z1 in holes:
            p.add(
                "tracery",
                transform(_tracery(x1 - x0, z1 - z0, s), None, [x0, y + np.sign(y) * 0.25, z0]),
            )
        for x0, x1, z0, z1 in lows:
            p.add(
                "tracery",
                transform(_tracery(x1 - x0, z1 - z0, s), None, [x0, out + np.sign(y) * 0.25, z0]),
            )
    # Vaults and their ribs.
    nave = _vault((_BAY, 12.0), (4.2, 4.8), 2 * n)
    p.add("vaults", instance(nave, None, start + np.array([0, -6.0, 11.2])))
    side = _vault((_BAY, 5.0), (2.0, 2.0), n)
    p.add("vaults", instance(side, None, start + np.array([0, -11.0, 6.6])))
    p.add("vaults", instance(side, None, start + np.array([0, 6.0, 6.6])))
    cross = np.stack([0 * t, 6 * t, 11.2 + _pointed(t, 4.8) - 0.05], 1)
    p.add(
        "ribs",
        tubes(cross[None] + np.stack([grid, 0 * grid, 0 * grid], 1)[:, None], 0.2, cells(9, s, 4)),
    )
    for sign in (1.0, -1.0):
        zd = np.maximum(_pointed(t, 4.2), _pointed(t, 4.8)) - 0.05
        diagonal = np.stack([3 * (t + 1), sign * 6 * t, 11.2 + zd], 1)
        p.add("ribs", tubes(diagonal[None] + start[:, None], 0.13, cells(8, s, 4)))
    # West wall with the door, east wall with the rose.
    p.add("walls", boxes([-0.6, -11.5, 0], [0, 11.5, 17]))
    p.add("wood", boxes([0.0, -1.6, 0], [0.12, 1.6, 4.2]))
    east = wall_with_openings(23, 17, 0.6, [(8.0, 15.0, 6.5, 13.5)])
    p.add("walls", transform(east, rot_z(np.pi / 2), [_LENGTH + 0.6, -11.5, 0]))
    rose = [
        torus(r, w, cells(64, s, 16), cells(8, s, 4))
        for r, w in ((3.3, 0.25), (2.1, 0.14), (0.8, 0.14))
    ]
    a = np.arange(16) * np.pi / 8
    ray = np.stack([np.cos(a), np.sin(a), 0 * a], 1)
    rose.append(tubes(np.stack([0.8 * ray, 3.3 * ray], 1), 0.08, cells(7, s, 4)))
    foil = torus(0.42, 0.07, cells(24, s, 8), cells(6, s, 3))
    rose.append(instance(foil, None, 2.7 * ray @ rot_z(np.pi / 16).T))
    upright = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    p.add("tracery", transform(merge(rose), upright, [_LENGTH + 0.3, 0, 10]))
    low, high = [-0.6, -6.6, 16.6], [_LENGTH + 0.6, 6.6, 17]
    p.add("roof", boxes(low, high))
    for y in (-11.6, 6.5):
        p.add("roof", boxes([-0.6, y, 8.9], [_LENGTH + 0.6, y + 5.1, 9.1]))
    # Pews in two blocks, with turned ends; the altar on steps.
    x = np.linspace(7, 30, min(60, cells(20, s**0.5, 8)))
    for y in (-2.9, 2.9):
        c = np.stack([x, 0 * x + y, 0 * x], 1)
        for lo, hi in (
            ((-0.2, -2.0, 0.42), (0.22, 2.0, 0.47)),
            ((-0.25, -2.0, 0.42), (-0.2, 2.0, 0.95)),
        ):
            p.add("wood", boxes(c + np.array(lo), c + np.array(hi)))
        for e in (-2.0, 2.0):
            p.add(
                "wood",
                boxes(c + np.array([-0.27, e - 0.04, 0]), c + np.array([0.25, e + 0.04, 1.0])),
            )
            knob = c + np.array([-0.2, e, 1.06])
            p.add("wood", instance(sphere(0.07, cells(10, s, 4)), None, knob))
    p.add(
        "marble",
        boxes(
            [[34, -4, 0], [35, -3.2, 0.2], [37, -1.5, 0.4]],
            [[41, 4, 0.2], [40.5, 3.2, 0.4], [38.4, 1.5, 1.4]],
        ),
    )
    # Hoop chandeliers with candle bulbs.
    d = np.arange(12) * np.pi / 6
    hoop = np.stack([1.1 * np.cos(d), 1.1 * np.sin(d), 0 * d + 0.12], 1)
    hang = np.stack([3 + _BAY * k[:-1], 0 * k[:-1], 0 * k[:-1] + 6.5], 1)
    p.add("iron", instance(torus(1.1, 0.05, cells(40, s, 12), cells(6, s, 4)), None, hang))
    p.add("iron", beams(hang, hang * [1, 1, 0] + [0, 0, 15.4], 0.04, 0.04))
    p.add(
        "candles",
        instance(sphere(0.11, cells(8, s, 4)), None, (hang[:, None] + hoop[None]).reshape(-1, 3)),
    )
    return p


def _tracery(width: float, height: float, s: float) -> Mesh:
    """Make the bars of a two-light window with a circle at its head, in the plane y = 0."""
    r = 0.3 * width
    ring = transform(
        torus(r, 0.07, cells(28, s, 8), cells(6, s, 3)),
        np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    )
    t = np.linspace(-1, 1, cells(14, s, 4) + 1)
    light = np.stack([width / 4 * (t + 1), 0 * t, height * 0.5 + _pointed(t, height * 0.2)], 1)
    pair = np.stack([light, light + np.array([width / 2, 0, 0])])
    frame = window_frame(0, width, 0, height, 0.1, 2, 1)
    head = transform(ring, None, [width / 2, 0, height - r - 0.08])
    return merge([head, tubes(pair, 0.06, cells(6, s, 3)), frame])


RECIPES = [
    Recipe(
        SceneInfo(
            "cathedral",
            "Gothic nave: columns, pointed arches, vaults, pews",
            "architectural",
            120_000,
            "Sibenik",
        ),
        build,
    )
]
