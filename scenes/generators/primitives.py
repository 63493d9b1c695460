"""Shapes that the scene generators are put together from.

A mesh is a pair ``(V, F)``: float64 corner positions ``(n, 3)`` and integer corner indices
``(m, 3)``. Everything is vectorised; where a scene holds many copies of a thing, the copies are
made by one call (`instance`, `boxes`, `tubes`), because a Python loop over a million objects is
what would make a generator slow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]

_TAU = 2.0 * np.pi


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one; corner indices are moved up accordingly."""
    kept = [m for m in meshes if len(m[1])]
    if not kept:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    starts = np.cumsum([0] + [len(v) for v, _ in kept[:-1]])
    v = np.concatenate([v for v, _ in kept])
    f = np.concatenate([f + s for (_, f), s in zip(kept, starts, strict=True)])
    return v, f


def transform(mesh: Mesh, matrix: ArrayLike | None = None, offset: ArrayLike = 0.0) -> Mesh:
    """Apply a 3 x 3 matrix (or a scalar/diagonal scale) and then an offset."""
    v, f = mesh
    if matrix is not None:
        m = np.asarray(matrix, dtype=float)
        v = v @ m.T if m.ndim == 2 else v * m
    return v + np.asarray(offset, dtype=float), f


def instance(mesh: Mesh, matrices: ArrayLike | None, offsets: ArrayLike) -> Mesh:
    """Copy a mesh many times.

    Parameters
    ----------
    mesh
        What to copy.
    matrices
        ``(k, 3, 3)`` matrices, ``(k, 3)`` scales per axis, ``(k,)`` uniform scales, or None.
    offsets
        ``(k, 3)`` positions of the copies.
    """
    v, f = mesh
    off = np.asarray(offsets, dtype=float).reshape(-1, 3)
    k = len(off)
    if k == 0 or len(f) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    if matrices is None:
        vs = np.broadcast_to(v, (k, *v.shape))
    else:
        m = np.asarray(matrices, dtype=float)
        if m.ndim == 3:
            vs = np.einsum("kij,nj->kni", m, v, optimize=True)
        elif m.ndim == 2:
            vs = v[None] * m[:, None, :]
        else:
            vs = v[None] * m[:, None, None]
    vs = vs + off[:, None, :]
    fs = f[None] + (np.arange(k) * len(v))[:, None, None]
    return vs.reshape(-1, 3), fs.reshape(-1, 3)


def rot_x(angle: ArrayLike) -> Array:
    """Rotation matrices about x; ``(3, 3)`` for a scalar, ``(k, 3, 3)`` for k angles."""
    return _axis_rotation(angle, 0)


def rot_y(angle: ArrayLike) -> Array:
    """Rotation matrices about y."""
    return _axis_rotation(angle, 1)


def rot_z(angle: ArrayLike) -> Array:
    """Rotation matrices about z."""
    return _axis_rotation(angle, 2)


def _axis_rotation(angle: ArrayLike, axis: int) -> Array:
    a = np.asarray(angle, dtype=float)
    m = np.zeros((*a.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    m[..., axis, axis] = 1.0
    m[..., i, i] = m[..., j, j] = np.cos(a)
    m[..., j, i] = np.sin(a)
    m[..., i, j] = -np.sin(a)
    return m


def random_rotations(rng: np.random.Generator, k: int) -> Array:
    """Uniformly distributed rotation matrices, ``(k, 3, 3)``."""
    q = rng.normal(size=(k, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def normalized(v: Array) -> Array:
    """Scale vectors along the last axis to unit length; zero vectors stay zero."""
    n = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(n > 0, n, 1.0)


def frames(direction: Array) -> Array:
    """Rotations ``(k, 3, 3)`` that take +z to each direction."""
    z = normalized(np.asarray(direction, dtype=float).reshape(-1, 3))
    helper = np.where(np.abs(z[:, 2:3]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = normalized(np.cross(helper, z))
    y = np.cross(z, x)
    return np.stack([x, y, z], axis=2)


def surface(points: Array, wrap_rows: bool = False, wrap_cols: bool = False) -> Mesh:
    """Triangulate a grid of points ``(rows, cols, 3)``; wrapping joins the last to the first."""
    n, m = points.shape[:2]
    i = np.arange(n if wrap_rows else n - 1)[:, None]
    j = np.arange(m if wrap_cols else m - 1)[None, :]
    i1, j1 = (i + 1) % n, (j + 1) % m
    a, b, c, d = (i * m + j, i1 * m + j, i1 * m + j1, i * m + j1)
    f = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2)
    return points.reshape(-1, 3), f.reshape(-1, 3).astype(np.int64)


def quad(origin: ArrayLike, u: ArrayLike, v: ArrayLike, nu: int = 1, nv: int = 1) -> Mesh:
    """Make a parallelogram with corner `origin` and edges `u`, `v`, cut into nu x nv cells."""
    o, du, dv = (np.asarray(a, dtype=float) for a in (origin, u, v))
    s = np.linspace(0, 1, nu + 1)[:, None, None]
    t = np.linspace(0, 1, nv + 1)[None, :, None]
    return surface(o + s * du + t * dv)


_CUBE_V = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
_CUBE_F = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int64,
)  # fmt: skip


def boxes(lo: ArrayLike, hi: ArrayLike) -> Mesh:
    """Axis-aligned boxes of 12 triangles each from ``(k, 3)`` (or one) lower and upper corners."""
    a, b = np.broadcast_arrays(
        np.asarray(lo, dtype=float).reshape(-1, 3), np.asarray(hi, dtype=float).reshape(-1, 3)
    )
    return instance((_CUBE_V, _CUBE_F), b - a, a)


def oriented_boxes(centre: ArrayLike, half: ArrayLike, rotation: ArrayLike) -> Mesh:
    """Boxes with ``(k, 3)`` centres and half sizes, turned by ``(k, 3, 3)`` rotations."""
    c = np.asarray(centre, dtype=float).reshape(-1, 3)
    h = np.broadcast_to(np.asarray(half, dtype=float), c.shape)
    r = np.broadcast_to(np.asarray(rotation, dtype=float), (len(c), 3, 3))
    return instance((2.0 * _CUBE_V - 1.0, _CUBE_F), r * h[:, None, :], c)


def beams(start: ArrayLike, end: ArrayLike, width: ArrayLike, depth: ArrayLike) -> Mesh:
    """Rectangular bars between pairs of points; `width` and `depth` are full sizes."""
    a, b = np.broadcast_arrays(
        np.asarray(start, dtype=float).reshape(-1, 3), np.asarray(end, dtype=float).reshape(-1, 3)
    )
    length = np.linalg.norm(b - a, axis=1)
    half = np.stack(
        [
            np.broadcast_to(np.asarray(width, dtype=float) / 2, length.shape),
            np.broadcast_to(np.asarray(depth, dtype=float) / 2, length.shape),
            length / 2,
        ],
        axis=1,
    )
    return oriented_boxes((a + b) / 2, half, frames(b - a))


def grid_box(lo: ArrayLike, hi: ArrayLike, n: int) -> Mesh:
    """One box whose faces are grids, about `n` cells along its longest edge."""
    a, b = np.asarray(lo, dtype=float), np.asarray(hi, dtype=float)
    size = b - a
    cells = np.maximum(1, np.round(n * size / size.max())).astype(int)
    out = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        u, v = np.zeros(3), np.zeros(3)
        u[i], v[j] = size[i], size[j]
        top = a.copy()
        top[axis] = b[axis]
        out.append(quad(a, u, v, int(cells[i]), int(cells[j])))
        out.append(quad(top, u, v, int(cells[i]), int(cells[j])))
    return merge(out)


def cube_sphere(n: int) -> Mesh:
    """Make a unit sphere of 12 n^2 triangles of nearly even size, from the six faces of a cube."""
    t = np.tan(np.linspace(-np.pi / 4, np.pi / 4, n + 1))
    a, b = np.meshgrid(t, t, indexing="ij")
    one = np.ones_like(a)
    faces = []
    for sign in (1.0, -1.0):
        for axis in range(3):
            p = np.empty((n + 1, n + 1, 3))
            p[..., axis] = sign * one
            p[..., (axis + 1) % 3] = a * sign
            p[..., (axis + 2) % 3] = b
            faces.append(surface(normalized(p)))
    return merge(faces)


def rounded_box(half: ArrayLike, radius: float, n: int) -> Mesh:
    """Box with rounded edges about the origin, 12 n^2 triangles; `n` is made even.

    An even n puts a grid line through the middle of each face, where the eight sphere octants
    are pulled apart, so no crack appears.
    """
    v, f = cube_sphere(max(2, 2 * ((n + 1) // 2)))
    h = np.asarray(half, dtype=float)
    r = min(float(radius), float(h.min()))
    direction = np.where(np.abs(v) < 1e-9, 0.0, v)
    return np.sign(direction) * (h - r) + r * direction, f


def revolve(profile: ArrayLike, sides: int) -> Mesh:
    """Surface of revolution about z of a profile ``(n, 2)`` of (radius, z)."""
    p = np.asarray(profile, dtype=float)
    a = np.arange(sides) * (_TAU / sides)
    pts = np.empty((len(p), sides, 3))
    pts[..., 0] = p[:, :1] * np.cos(a)
    pts[..., 1] = p[:, :1] * np.sin(a)
    pts[..., 2] = p[:, 1:]
    v, f = surface(pts, wrap_cols=True)
    f = f.reshape(len(p) - 1, sides, 2, 3)
    keep = np.ones(f.shape[:3], dtype=bool)
    # A profile point on the axis makes one of the two triangles of each cell a line: leave it out.
    keep[p[:-1, 0] == 0.0, :, 1] = False
    keep[p[1:, 0] == 0.0, :, 0] = False
    # Turned round so that normals point outwards for a profile that goes up: lamps need it.
    return v, f[keep][:, ::-1]


def smooth_profile(points: ArrayLike, n: int) -> Array:
    """Catmull-Rom curve through ``(k, d)`` points, resampled at n + 1 values."""
    p = np.asarray(points, dtype=float)
    q = np.concatenate([[2 * p[0] - p[1]], p, [2 * p[-1] - p[-2]]])
    t = np.linspace(0, len(p) - 1, n + 1)
    i = np.minimum(t.astype(int), len(p) - 2)
    s = (t - i)[:, None]
    a, b, c, d = q[i], q[i + 1], q[i + 2], q[i + 3]
    out = 0.5 * (
        2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3
    )
    out[0], out[-1] = p[0], p[-1]
    return out


def sphere(radius: float, n: int) -> Mesh:
    """Latitude-longitude sphere with n sides and n / 2 rows: about n (n - 2) triangles."""
    sides = max(3, n)
    a = np.linspace(0, np.pi, max(2, sides // 2) + 1)
    profile = np.stack([radius * np.sin(a), -radius * np.cos(a)], axis=1)
    profile[0, 0] = profile[-1, 0] = 0.0
    return revolve(profile, sides)


def cylinder(radius: float, height: float, sides: int, segments: int = 1) -> Mesh:
    """Make a closed cylinder along z from 0 to `height`."""
    z = np.linspace(0, height, segments + 1)
    profile = np.concatenate(
        [[[0.0, 0.0]], np.stack([np.full_like(z, radius), z], axis=1), [[0.0, height]]]
    )
    return revolve(profile, sides)


def torus(major: float, minor: float, n_major: int, n_minor: int) -> Mesh:
    """Torus about z."""
    a = np.arange(n_major)[:, None] * (_TAU / n_major)
    b = np.arange(n_minor)[None, :] * (_TAU / n_minor)
    r = major + minor * np.cos(b)
    pts = np.stack([r * np.cos(a), r * np.sin(a), minor * np.sin(b) + 0 * a], axis=-1)
    return surface(pts, wrap_rows=True, wrap_cols=True)


def tubes(
    paths: ArrayLike,
    radius: ArrayLike,
    sides: int,
    caps: tuple[bool, bool] = (True, True),
    closed: bool = False,
) -> Mesh:
    """Round tubes along polylines that all have the same number of points.

    Parameters
    ----------
    paths
        ``(k, n, 3)`` or one ``(n, 3)`` polyline.
    radius
        A number, ``(k,)``, ``(n,)`` for one path, or ``(k, n)``.
    sides
        Corners of the cross section.
    caps
        Whether the start and the end are closed by a fan of ``sides - 2`` triangles.
    closed
        Whether the last point joins the first (then there are no caps).
    """
    p = np.asarray(paths, dtype=float)
    if p.ndim == 2:
        p = p[None]
    k, n = p.shape[:2]
    if k == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    r = np.asarray(radius, dtype=float)
    if r.ndim == 1 and len(r) == k and not (k == 1 and len(r) == n):
        r = r[:, None]
    r = np.broadcast_to(r, (k, n))
    if closed:
        t = normalized(np.roll(p, -1, axis=1) - np.roll(p, 1, axis=1))
    else:
        t = normalized(np.gradient(p, axis=1))
    # Carry one normal along the path instead of building frames point by point: no sudden twist.
    normal = np.empty_like(p)
    u = frames(t[:, 0])[:, :, 0]
    for i in range(n):
        u = u - t[:, i] * np.sum(u * t[:, i], axis=1, keepdims=True)
        u = normalized(u)
        normal[:, i] = u
    binormal = np.cross(t, normal)
    if closed:
        # The carried frame comes back turned by some angle; spread that turn over the path.
        end = normal[:, -1] - t[:, 0] * np.sum(normal[:, -1] * t[:, 0], axis=1, keepdims=True)
        gap = np.arctan2(np.sum(end * binormal[:, 0], axis=1), np.sum(end * normal[:, 0], axis=1))
        twist = -gap[:, None] * (np.arange(n) / n)[None, :]
        c, s = np.cos(twist)[..., None], np.sin(twist)[..., None]
        normal, binormal = c * normal + s * binormal, c * binormal - s * normal
    a = np.arange(sides) * (_TAU / sides)
    ring = (
        np.cos(a)[None, None, :, None] * normal[:, :, None, :]
        + np.sin(a)[None, None, :, None] * binormal[:, :, None, :]
    )
    v = p[:, :, None, :] + r[:, :, None, None] * ring
    _, f = surface(np.zeros((n, sides, 3)), wrap_rows=closed, wrap_cols=True)
    if not closed:
        fan = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], 1)
        if caps[0]:
            f = np.concatenate([f, fan[:, ::-1]])
        if caps[1]:
            f = np.concatenate([f, fan + (n - 1) * sides])
    fs = f[None] + (np.arange(k) * (n * sides))[:, None, None]
    return v.reshape(-1, 3), fs.reshape(-1, 3)


def prism(outline: ArrayLike, height: float) -> Mesh:
    """Make a closed prism along z over a convex (or star-shaped) outline ``(n, 2)``."""
    q = np.asarray(outline, dtype=float)
    n = len(q)
    ring = np.concatenate([q, q])
    z = np.repeat([0.0, height], n)[:, None]
    centre = np.array([[*q.mean(axis=0), 0.0], [*q.mean(axis=0), height]])
    v = np.concatenate([np.concatenate([ring, z], axis=1), centre])
    i = np.arange(n)
    j = (i + 1) % n
    low, high = np.full(n, 2 * n), np.full(n, 2 * n + 1)
    f = np.concatenate(
        [
            np.stack([i, j, j + n], 1),
            np.stack([i, j + n, i + n], 1),
            np.stack([low, j, i], 1),
            np.stack([high, i + n, j + n], 1),
        ]
    )
    return v, f.astype(np.int64)


def height_field(x: Array, y: Array, z: Array) -> Mesh:
    """Height field over the grid x cross y; `z` is ``(len(x), len(y))``."""
    gx, gy = np.meshgrid(x, y, indexing="ij")
    return surface(np.stack([gx, gy, z], axis=-1))


def blades(base: Array, tip: Array, side: Array) -> Mesh:
    """Flat two-triangle blades: ``(k, 3)`` foot points, tips, and half-width vectors.

    A blade is a kite: foot, the two points at 40 % of its length, tip.
    """
    mid = base + 0.4 * (tip - base)
    v = np.stack([base, mid - side, tip, mid + side], axis=1)
    f = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int64)
    fs = f[None] + 4 * np.arange(len(base))[:, None, None]
    return v.reshape(-1, 3), fs.reshape(-1, 3)


def _lattice(ix: NDArray, iy: NDArray, iz: NDArray, seed: int) -> Array:
    """Hash lattice points to numbers in [-1, 1); no table is needed."""
    m = np.uint64(0xFFFFFFFF)
    h = (
        ix.astype(np.uint64) * np.uint64(73856093)
        ^ iy.astype(np.uint64) * np.uint64(19349663)
        ^ iz.astype(np.uint64) * np.uint64(83492791)
        ^ np.uint64((seed * 2654435761 + 1013904223) & 0xFFFFFFFF)
    ) & m
    for _ in range(2):
        h = ((h ^ (h >> np.uint64(16))) * np.uint64(0x45D9F3B)) & m
    h = h ^ (h >> np.uint64(16))
    return h.astype(np.float64) / 2.0**31 - 1.0


def noise(points: Array, seed: int) -> Array:
    """Smooth value noise in [-1, 1] at points ``(..., 3)``; features about one unit wide."""
    p = np.asarray(points, dtype=float)
    cell = np.floor(p)
    t = p - cell
    t = t * t * (3.0 - 2.0 * t)
    i = cell.astype(np.int64)
    out = np.zeros(p.shape[:-1])
    for dx in (0, 1):
        wx = t[..., 0] if dx else 1.0 - t[..., 0]
        for dy in (0, 1):
            wy = t[..., 1] if dy else 1.0 - t[..., 1]
            for dz in (0, 1):
                wz = t[..., 2] if dz else 1.0 - t[..., 2]
                out += wx * wy * wz * _lattice(i[..., 0] + dx, i[..., 1] + dy, i[..., 2] + dz, seed)
    return out


def fractal(points: Array, seed: int, octaves: int = 5, gain: float = 0.5) -> Array:
    """Sum of noise octaves, each at about twice the frequency and `gain` times the height."""
    out = np.zeros(np.shape(points)[:-1])
    amplitude, frequency = 1.0, 1.0
    for o in range(octaves):
        out += amplitude * noise(np.asarray(points) * frequency + 17.3 * o, seed + 101 * o)
        amplitude *= gain
        frequency *= 2.03
    return out
