"""Plants: broad-leaved trees over grass, a pine forest, and a tangle of ivy on a fence."""

from __future__ import annotations

import numpy as np

from .base import Parts, Recipe, SceneInfo, cells
from .primitives import (
    Array,
    Mesh,
    blades,
    boxes,
    cube_sphere,
    fractal,
    frames,
    height_field,
    instance,
    merge,
    normalized,
    rot_z,
    transform,
    tubes,
)


def _tree(
    rng: np.random.Generator, levels: int, children: int, sides: int, per_twig: int
) -> tuple[Mesh, Mesh]:
    """Grow a branching tree about 6 m high: wood, leaves."""
    base = np.zeros((1, 3))
    heading = np.array([[0.0, 0, 1]])
    length, radius, segs = 2.2, 0.2, 4
    wood = []
    for level in range(levels + 1):
        k = len(base)
        path = np.empty((k, segs + 1, 3))
        path[:, 0] = base
        step = heading
        for i in range(segs):
            step = normalized(step + 0.16 * rng.normal(size=(k, 3)) + [0, 0, 0.06])
            path[:, i + 1] = path[:, i] + step * length / segs
        taper = radius * np.linspace(1, 0.62, segs + 1)
        wood.append(tubes(path, taper[None], max(3, sides - level), caps=(False, True)))
        if level == levels:
            break
        own = np.repeat(np.arange(k), children)
        at = rng.uniform(0.55, 1.0, len(own)) * segs
        at[::children] = segs  # one child goes on where the branch ends
        lo = np.minimum(at.astype(int), segs - 1)
        base = path[own, lo] + (path[own, lo + 1] - path[own, lo]) * (at - lo)[:, None]
        heading = normalized(step[own] + 0.75 * rng.normal(size=(len(own), 3)))
        length, radius = 0.66 * length, 0.55 * radius
    tip = path.reshape(-1, 3)
    root = tip[rng.integers(0, len(tip), k * per_twig)] + 0.1 * rng.normal(size=(k * per_twig, 3))
    return merge(wood), _leaves(root, 0.32, rng)


def _leaves(root: Array, length: float, rng: np.random.Generator) -> Mesh:
    to = normalized(rng.normal(size=root.shape) + np.array([0, 0, -0.2]))
    side = normalized(np.cross(to, rng.normal(size=root.shape)))
    size = length * rng.uniform(0.6, 1.2, (len(root), 1))
    return blades(root, root + size * to, 0.3 * size * side)


def _ground(x: Array, y: Array, seed: int, amplitude: float, width: float) -> Array:
    q = np.stack(np.broadcast_arrays(x / width, y / width, 0.5), -1)
    return amplitude * fractal(q, seed, 4)


def build_vegetation(detail: float, rng: np.random.Generator) -> Parts:
    """Meadow of 60 x 60 m with trees, none of them within 4 m of the two paths x = 0, y = 0."""
    s = float(np.sqrt(detail))
    p = Parts()
    seed = int(rng.integers(1, 1000))
    n = min(300, cells(48, s, 8))
    e = np.linspace(-30, 30, n + 1)
    z = _ground(e[:, None], e[None, :], seed, 0.9, 14.0)
    p.add("ground", height_field(e, e, z))
    species = 6 if detail > 0.5 else 3
    levels = 4 if detail > 3 else 3 if detail > 0.3 else 2
    count = cells({2: 110, 3: 80, 4: 40}[levels], detail**0.55, 5)
    spot = rng.uniform(-29, 29, (6 * count, 2))
    spot = spot[np.abs(spot).min(axis=1) > 3.5][:count]
    kind = np.arange(len(spot)) % species
    turn = rng.uniform(0, 2 * np.pi, len(spot))
    size = rng.uniform(0.75, 1.35, len(spot))
    foot = np.c_[spot, _ground(spot[:, 0], spot[:, 1], seed, 0.9, 14.0) - 0.1]
    for i in range(species):
        wood, leaf = _tree(
            rng,
            levels,
            4,
            cells(6, s**0.3, 4),
            cells({2: 40, 3: 16, 4: 10}[levels], detail**0.2, 4),
        )
        m = rot_z(turn[kind == i]) * size[kind == i, None, None]
        p.add("bark", instance(wood, m, foot[kind == i]))
        p.add("leaves_green" if i % 3 else "leaves_yellow", instance(leaf, m, foot[kind == i]))
    k = cells(22000, detail, 100)
    g = rng.uniform(-29.5, 29.5, (k, 2))
    root = np.c_[g, _ground(g[:, 0], g[:, 1], seed, 0.9, 14.0) - 0.03]
    tip = root + np.c_[0.12 * rng.normal(size=(k, 2)), rng.uniform(0.15, 0.5, k)]
    a = rng.uniform(0, np.pi, k)
    p.add("grass", blades(root, tip, 0.03 * np.stack([np.cos(a), np.sin(a), 0 * a], 1)))
    return p


def build_pines(detail: float, rng: np.random.Generator) -> Parts:
    """Snowy slope of 80 x 80 m with conifers: whorls of needle-covered branches, and rocks."""
    s = float(np.sqrt(detail))
    p = Parts()
    seed = int(rng.integers(1, 1000))
    n = min(400, cells(60, s, 10))
    e = np.linspace(-40, 40, n + 1)

    def slope(x: Array, y: Array) -> Array:
        return 0.18 * y + _ground(x, y, seed, 1.6, 18.0)

    p.add("snow", height_field(e, e, slope(e[:, None], e[None, :])))
    count = cells(150, detail**0.5, 16)
    spot = rng.uniform(-39, 39, (8 * count, 2))
    # A clearing along x = 0 for the cameras.
    spot = spot[np.abs(spot[:, 0]) > 4.0][:count]
    foot = np.c_[spot, slope(spot[:, 0], spot[:, 1]) - 0.2]
    kinds = 3
    size = rng.uniform(0.6, 1.3, len(spot))
    turn = rng.uniform(0, 2 * np.pi, len(spot))
    for i in range(kinds):
        trunk, bough, needle = _pine(detail, s, rng)
        pick = np.arange(len(spot)) % kinds == i
        m = rot_z(turn[pick]) * size[pick, None, None]
        p.add("bark", instance(trunk, m, foot[pick]), instance(bough, m, foot[pick]))
        p.add("needles" if i else "needles_blue", instance(needle, m, foot[pick]))
    v, f = cube_sphere(cells(6, s, 2))
    k = cells(40, s, 8)
    at = rng.uniform(-39, 39, (k, 2))
    at = at[np.abs(at[:, 0]) > 3.0]
    rock = (v * (1 + 0.3 * fractal(v * 1.7, seed + 5, 3))[:, None], f)
    scale = rng.uniform(0.3, 1.3, (len(at), 1)) * rng.uniform(0.6, 1.2, (len(at), 3))
    p.add("rocks", instance(rock, scale, np.c_[at, slope(at[:, 0], at[:, 1])]))
    return p


def _pine(detail: float, s: float, rng: np.random.Generator) -> tuple[Mesh, Mesh, Mesh]:
    """Make one conifer 9 m high: trunk, boughs, needles."""
    z = np.linspace(0, 9, 7)
    trunk = tubes(np.stack([0 * z, 0 * z, z], 1), 0.2 * (1 - z / 9.3), cells(7, s**0.5, 4))
    whorls, per = cells(11, detail**0.15, 6), cells(6, detail**0.1, 4)
    h = np.repeat(np.linspace(1.2, 8.6, whorls), per)
    a = rng.uniform(0, 2 * np.pi, len(h))
    reach = 2.4 * (1 - h / 9.4) * rng.uniform(0.8, 1.1, len(h))
    u = np.linspace(0, 1, 4)
    out = reach[:, None] * u
    path = np.stack(
        [
            np.cos(a)[:, None] * out,
            np.sin(a)[:, None] * out,
            h[:, None] - 0.45 * out * (1.2 - 0.5 * u),
        ],
        -1,
    )
    bough = tubes(path, 0.04 * (1 - 0.8 * u)[None], cells(4, s**0.5, 3), caps=(False, False))
    k = cells(7, detail**0.35, 3)
    at = rng.uniform(0.15, 1.0, (len(h), k)) * 3
    lo = np.minimum(at.astype(int), 2)
    i = np.arange(len(h))[:, None]
    root = (path[i, lo] + (path[i, lo + 1] - path[i, lo]) * (at - lo)[..., None]).reshape(-1, 3)
    along = np.repeat(normalized(path[:, -1] - path[:, 0]), k, axis=0)
    to = normalized(along + 0.8 * rng.normal(size=root.shape) + [0, 0, -0.25])
    side = normalized(np.cross(to, rng.normal(size=root.shape)))
    # Fewer needles are wider ones, so that a small forest is as dense as a large one.
    size = rng.uniform(0.35, 0.6, (len(root), 1))
    return trunk, bough, blades(root, root + size * to, side * 0.28 / k**0.5)


def build_ivy(detail: float, rng: np.random.Generator) -> Parts:
    """Make a fence of wire mesh and posts along x, 16 m long, overgrown by ivy on one half."""
    s = float(np.sqrt(detail))
    p = Parts()
    n = min(200, cells(20, s, 4))
    e = np.linspace(-10, 10, n + 1)
    y = np.linspace(-6, 6, n + 1)
    seed = int(rng.integers(1, 1000))
    p.add("ground", height_field(e, y, _ground(e[:, None], y[None, :], seed, 0.08, 1.5)))
    x = np.linspace(-8, 8, 9)
    post = np.stack([x, 0 * x, 0 * x - 0.2], 1)
    p.add("posts", tubes(np.stack([post, post + np.array([0, 0, 2.6])], 1), 0.05, cells(10, s, 5)))
    rail = np.array([[[-8, 0, z], [8, 0, z]] for z in (0.15, 2.3)])
    p.add("posts", tubes(rail, 0.03, cells(8, s, 4)))
    # Zig-zag wires that hook into each other: long, thin, and never parallel to an axis.
    k = cells(60, s, 8)
    pitch = 16.0 / k
    t = np.arange(cells(2.1 / pitch, 1.0, 3) + 1)
    zig = np.stack(
        [pitch * 0.52 * (t % 2), 0.02 * ((t % 2) - 0.5), 0.17 + t * (2.1 / (len(t) - 1))], 1
    )
    start = np.stack([-8 + pitch * np.arange(k), np.zeros(k), np.zeros(k)], 1)
    p.add("wire", tubes(zig[None] + start[:, None], 0.006, cells(4, s**0.4, 3)))
    # Ivy: vines that wander up the fence, with leaves facing outwards.
    vines, steps = cells(42, detail**0.5, 6), 24
    at = np.stack(
        [rng.uniform(-7.5, 4.0, vines), rng.choice([-0.04, 0.04], vines), np.zeros(vines)], 1
    )
    path = np.empty((vines, steps + 1, 3))
    path[:, 0] = at
    drift = rng.normal(0, 0.4, vines)
    for i in range(steps):
        drift = 0.8 * drift + 0.35 * rng.normal(size=vines)
        step = np.stack(
            [0.09 * drift, 0.02 * rng.normal(size=vines), rng.uniform(0.04, 0.14, vines)], 1
        )
        path[:, i + 1] = path[:, i] + step
        path[:, i + 1, 2] = np.minimum(path[:, i + 1, 2], 2.45)
        path[:, i + 1, 1] = np.clip(path[:, i + 1, 1], -0.15, 0.15)
    p.add("stems", tubes(path, np.linspace(0.014, 0.005, steps + 1)[None], cells(5, s**0.4, 3)))
    k = cells(4200, detail, 120)
    own, j = rng.integers(0, vines, k), rng.integers(1, steps + 1, k)
    root = path[own, j] + 0.03 * rng.normal(size=(k, 3))
    out = normalized(
        np.stack(
            [
                0.5 * rng.normal(size=k),
                np.sign(root[:, 1]) + 0.4 * rng.normal(size=k),
                0.3 * rng.normal(size=k),
            ],
            1,
        )
    )
    # A lobed leaf of six triangles, flat in its own x-y plane.
    rim = np.array(
        [
            [0, 0],
            [0.5, -0.15],
            [0.62, 0.4],
            [0.28, 0.55],
            [0, 1.0],
            [-0.28, 0.55],
            [-0.62, 0.4],
            [-0.5, -0.15],
        ]
    )
    leaf = (np.c_[rim, 0.12 * np.abs(rim[:, 0])], np.array([[0, i, i + 1] for i in range(1, 7)]))
    size = rng.uniform(0.07, 0.15, k) * (1.0 if detail > 0.3 else 1.5)
    spin = rot_z(rng.normal(np.pi, 0.5, k))
    m = (frames(out) @ spin) * size[:, None, None]
    dark = rng.uniform(size=k) < 0.5
    p.add("ivy_dark", instance(leaf, m[dark], root[dark]))
    p.add("ivy_light", instance(leaf, m[~dark], root[~dark]))
    stone = transform(cube_sphere(cells(8, s, 2)), [0.5, 0.35, 0.3])
    p.add("stones", instance(stone, None, [[-6.0, 2.4, 0.05], [3.5, -2.8, 0.0], [6.5, 3.0, 0.1]]))
    p.add(
        "posts",
        boxes(
            [[-1.5, 3.2, 0.4], [-1.4, 3.25, 0], [1.3, 3.25, 0]],
            [[1.5, 3.7, 0.46], [-1.3, 3.65, 0.4], [1.4, 3.65, 0.4]],
        ),
    )
    return p


RECIPES = [
    Recipe(
        SceneInfo(
            "vegetation", "Broad-leaved trees over rolling grass", "foliage", 200_000, "Vegetation"
        ),
        build_vegetation,
    ),
    Recipe(
        SceneInfo("pines", "Pine forest on a snowy slope with rocks", "foliage", 120_000),
        build_pines,
    ),
    Recipe(SceneInfo("ivy", "Wire fence overgrown by ivy", "foliage", 60_000), build_ivy),
]
