"""Things that stand in rooms, shared by the interior scenes. Each stands on z = 0."""

from __future__ import annotations

import numpy as np

from .base import cells, even_cells
from .primitives import (
    Array,
    Mesh,
    beams,
    boxes,
    instance,
    merge,
    revolve,
    rounded_box,
    smooth_profile,
    surface,
    transform,
    tubes,
)


def wall_with_openings(
    length: float,
    height: float,
    thickness: float,
    openings: list[tuple[float, float, float, float]],
) -> Mesh:
    """Make a wall along +x with rectangular holes ``(x0, x1, z0, z1)`` that do not overlap in x."""
    lo, hi = [], []
    x = 0.0
    for x0, x1, z0, z1 in sorted(openings):
        lo.append([x, 0, 0])
        hi.append([x0, thickness, height])
        if z0 > 0:
            lo.append([x0, 0, 0])
            hi.append([x1, thickness, z0])
        lo.append([x0, 0, z1])
        hi.append([x1, thickness, height])
        x = x1
    lo.append([x, 0, 0])
    hi.append([length, thickness, height])
    return boxes(lo, hi)


def window_frame(
    x0: float, x1: float, z0: float, z1: float, bar: float, columns: int, rows: int
) -> Mesh:
    """Frame and glazing bars of a window in the plane y = 0."""
    xs, zs = np.linspace(x0, x1, columns + 1), np.linspace(z0, z1, rows + 1)
    nx, nz = len(xs), len(zs)
    start = [np.stack([xs, np.zeros(nx), np.full(nx, z0)], 1)]
    end = [np.stack([xs, np.zeros(nx), np.full(nx, z1)], 1)]
    start.append(np.stack([np.full(nz, x0), np.zeros(nz), zs], 1))
    end.append(np.stack([np.full(nz, x1), np.zeros(nz), zs], 1))
    return beams(np.concatenate(start), np.concatenate(end), bar, bar)


def planks(size: tuple[float, float], rows: int, per_row: int, rng: np.random.Generator) -> Mesh:
    """Floor boards along y with top at about z = 0, staggered, with gaps of 2 mm."""
    width = size[0] / rows
    x = np.repeat(np.arange(rows) * width, per_row)
    cut = np.sort(rng.uniform(0.15, 0.85, (rows, max(0, per_row - 1))), axis=1)
    y0 = np.concatenate([np.zeros((rows, 1)), cut], axis=1).ravel() * size[1]
    y1 = np.concatenate([cut, np.ones((rows, 1))], axis=1).ravel() * size[1]
    top = rng.uniform(-0.0015, 0.0, len(x))
    lo = np.stack([x + 0.001, y0 + 0.001, np.full(len(x), -0.02)], 1)
    return boxes(lo, np.stack([x + width - 0.001, y1 - 0.001, top], 1))


def lathe(points: list[tuple[float, float]], rows: int, sides: int) -> Mesh:
    """Make a turned object from a few (radius, z) points, smoothed."""
    profile = smooth_profile(np.array(points), rows)
    profile[:, 0] = np.maximum(profile[:, 0], 0.0)
    return revolve(profile, sides)


def chair(s: float, slats: int = 4) -> Mesh:
    """Make a wooden chair that looks towards +y; seat 0.44 m square at 0.46 m."""
    sides, seg = cells(9, s, 4), cells(5, s, 1)
    t = np.linspace(0, 1, seg + 1)[:, None]
    foot = np.array([[-0.19, -0.19], [0.19, -0.19], [-0.19, 0.19], [0.19, 0.19]])
    # The two back legs go on upwards as the posts of the backrest, leaning a little.
    legs = []
    for i, (x, y) in enumerate(foot):
        top = np.array([x, y - 0.07, 0.95]) if i < 2 else np.array([x, y, 0.44])
        legs.append(np.array([x * 1.08, y * 1.08, 0.0]) * (1 - t) + top * t)
    parts = [tubes(np.array(legs), 0.018, sides)]
    z = np.linspace(0.58, 0.9, slats)
    u = np.linspace(-1, 1, seg + 2)
    lean = -0.2 - 0.05 * (z - 0.44) / 0.5
    path = np.stack(
        [
            np.broadcast_to(0.19 * u, (slats, len(u))),
            lean[:, None] - 0.02 * (1 - u**2)[None, :],
            np.broadcast_to(z[:, None], (slats, len(u))),
        ],
        axis=-1,
    )
    parts.append(tubes(path, 0.014, sides))
    seat = rounded_box([0.22, 0.22, 0.025], 0.02, even_cells(8, s))
    parts.append(transform(seat, None, [0, 0, 0.455]))
    rail = np.array([[-0.19, 0.0, 0.25], [0.19, 0.0, 0.25]])
    parts.append(beams(rail[:1], rail[1:], 0.02, 0.02))
    return merge(parts)


def table(length: float, width: float, height: float, s: float) -> Mesh:
    """Rectangular table with a rounded top and four tapering legs, centred on the origin."""
    top = rounded_box([length / 2, width / 2, 0.02], 0.018, even_cells(8, s))
    x, y = length / 2 - 0.08, width / 2 - 0.08
    t = np.linspace(0, 1, cells(4, s) + 1)
    foot = np.array([[-x, -y], [x, -y], [-x, y], [x, y]])
    path = np.stack(
        [
            np.repeat(foot[:, :1], len(t), 1),
            np.repeat(foot[:, 1:], len(t), 1),
            np.repeat((t * (height - 0.03))[None], 4, 0),
        ],
        axis=-1,
    )
    radius = np.broadcast_to(0.02 + 0.015 * t, (4, len(t)))
    return merge(
        [transform(top, None, [0, 0, height - 0.02]), tubes(path, radius, cells(10, s, 4))]
    )


def cushion(half: tuple[float, float, float], n: int, puff: float = 0.25) -> Mesh:
    """Make a rounded block whose faces bulge in the middle."""
    v, f = rounded_box(half, 0.9 * min(half), n)
    h = np.asarray(half)
    q = np.clip(v / h, -1, 1)
    thin = int(np.argmin(h))
    others = [a for a in range(3) if a != thin]
    swell = np.prod([1 - q[:, a] ** 2 for a in others], axis=0)
    v = v.copy()
    v[:, thin] *= 1.0 + puff * swell
    return v, f


def sofa(length: float, s: float, seats: int = 3) -> tuple[Mesh, Mesh]:
    """Make the body and cushions of a sofa that looks towards +x, its back at x = 0."""
    n = even_cells(12, s)
    body = [
        transform(rounded_box([0.42, length / 2, 0.1], 0.04, n), None, [0.45, 0, 0.2]),
        transform(rounded_box([0.1, length / 2, 0.36], 0.07, n), None, [0.12, 0, 0.46]),
    ]
    for side in (-1, 1):
        arm = rounded_box([0.42, 0.1, 0.27], 0.08, n)
        body.append(transform(arm, None, [0.45, side * (length / 2), 0.37]))
    feet = np.array([[x, side * (length / 2 - 0.1)] for x in (0.12, 0.78) for side in (-1, 1)])
    foot = np.concatenate([feet, np.zeros((4, 1))], axis=1)
    body.append(boxes(foot - np.array([0.03, 0.03, 0]), foot + np.array([0.03, 0.03, 0.12])))
    width = (length - 0.24) / seats
    y = (np.arange(seats) - (seats - 1) / 2) * width
    seat = cushion((0.33, width / 2 - 0.01, 0.08), n)
    back = cushion((0.09, width / 2 - 0.015, 0.22), n)
    soft = [
        instance(seat, None, np.stack([np.full(seats, 0.52), y, np.full(seats, 0.38)], 1)),
        instance(back, None, np.stack([np.full(seats, 0.30), y, np.full(seats, 0.64)], 1)),
    ]
    return merge(body), merge(soft)


def books(
    width: float, height: float, depth: float, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Corners of a row of upright books along +x, spines at y = 0, standing on z = 0."""
    w = rng.uniform(0.6, 1.5, count)
    w *= 0.95 * width / w.sum()
    x = np.concatenate([[0.0], np.cumsum(w)[:-1]])
    tall = height * rng.uniform(0.62, 0.93, count)
    deep = depth * rng.uniform(0.65, 0.95, count)
    set_back = rng.uniform(0.0, 0.02, count)
    lo = np.stack([x + 0.001, set_back, np.zeros(count)], 1)
    return lo, np.stack([x + w - 0.001, deep, tall], 1)


def curtain(width: float, height: float, folds: int, nu: int, nv: int) -> Mesh:
    """Hanging cloth along +x from z = 0 to `height`, folded in y."""
    u = np.linspace(0, 1, nu + 1)[:, None]
    v = np.linspace(0, 1, nv + 1)[None, :]
    y = 0.05 * (1 - 0.35 * v) * np.sin(2 * np.pi * folds * u + 0.8 * np.sin(3 * v + 5 * u))
    return surface(np.stack([width * u + 0 * v, y, height * v + 0 * u], axis=-1))


def potted_plant(s: float, detail: float, rng: np.random.Generator) -> tuple[Mesh, Mesh, Mesh]:
    """About 1.5 m high: pot, stems, leaves."""
    pot = lathe(
        [(0.0, 0.0), (0.13, 0.0), (0.17, 0.2), (0.19, 0.32), (0.16, 0.33), (0.15, 0.28), (0, 0.27)],
        cells(16, s, 6),
        cells(24, s, 6),
    )
    stems = cells(14, detail**0.33, 4)
    seg = cells(7, s, 3)
    t = np.linspace(0, 1, seg + 1)
    a = np.arange(stems) * 2.4 + rng.uniform(0, 0.5, stems)
    reach = rng.uniform(0.1, 0.42, stems)
    tall = rng.uniform(0.6, 1.2, stems)
    bend = reach[:, None] * t[None] ** 2
    path = np.stack(
        [np.cos(a)[:, None] * bend, np.sin(a)[:, None] * bend, 0.27 + tall[:, None] * t], axis=-1
    )
    stem = tubes(path, 0.012 * (1 - 0.7 * t)[None], cells(6, s, 3))
    per = cells(9, detail**0.33, 3)
    n = stems * per
    at = rng.uniform(0.35, 1.0, n)
    own = np.repeat(np.arange(stems), per)
    root = np.stack(
        [
            np.cos(a[own]) * reach[own] * at**2,
            np.sin(a[own]) * reach[own] * at**2,
            0.27 + tall[own] * at,
        ],
        axis=1,
    )
    return pot, stem, leaves(root, rng.uniform(0, 2 * np.pi, n), 0.28, 0.05, cells(4, s), rng)


def leaves(
    root: Array, heading: Array, length: float, half_width: float, n: int, rng: np.random.Generator
) -> Mesh:
    """Drooping folded leaves of 4 n triangles from each root point, seen from the z axis."""
    u = np.linspace(0, 1, n + 1)
    w = half_width * np.sqrt(np.maximum(u * (1 - u), 0)) * 2
    droop = 0.5 * u - 0.9 * u**2
    pts = np.empty((n + 1, 3, 3))
    for j, side in enumerate((-1.0, 0.0, 1.0)):
        pts[:, j] = np.stack([length * u, side * w, length * droop + 0.4 * abs(side) * w], axis=1)
    v, f = surface(pts)
    c, s = np.cos(heading), np.sin(heading)
    size = rng.uniform(0.6, 1.1, len(root))
    m = np.zeros((len(root), 3, 3))
    m[:, 0, 0] = m[:, 1, 1] = c * size
    m[:, 0, 1], m[:, 1, 0] = -s * size, s * size
    m[:, 2, 2] = size
    # The pointed ends make half of the first and last cells a line.
    a = v[f[:, 0]]
    area = np.linalg.norm(np.cross(v[f[:, 1]] - a, v[f[:, 2]] - a), axis=1)
    return instance((v, f[area > 1e-12]), m, root)
