"""One case: a random, mostly degenerate soup through a builder and a traversal.

The hits must be those of testing every triangle, to the last bit; and where float64 leaves no doubt
which triangle is hit, or that none is, also those of float64 and of Mitsuba.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

import mibvh
from mibvh.builders import names
from mibvh.scene import mitsuba_geometry
from mibvh.variant import mitsuba
from tools.fuzz.files import flat_tree, random_rays, same
from tools.fuzz.mutate import Random

F64 = npt.NDArray[np.float64]
RAYS = 256
STYLES = ("single", "while-while", "speculative", "wide")
#: Barycentric margin, and sine of the angle to the triangle, within which there is doubt.
MARGIN = 1e-3


class Soups:
    """Random soups."""

    def run(self, seed: int) -> str:
        """Run a case; return what became of it."""
        rng = np.random.default_rng(seed)
        kind, triangles = soup(rng)
        builder = names()[int(rng.integers(len(names())))]
        style: Any = STYLES[int(rng.integers(len(STYLES)))]
        tree = mibvh.build(triangles, builder, max_leaf=int(rng.integers(1, 9)))
        if found := tree.validate(triangles):
            raise AssertionError(f"{builder} on {kind}: {found[0]}")
        rays = random_rays(triangles, RAYS)
        lower, upper = triangles.corners.min((0, 1)), triangles.corners.max((0, 1))
        place = lower + rays.o * (upper - lower).max()
        rays = mibvh.RaySet(
            place.astype(np.float32),
            rays.d,
            rays.tmax,
            rays.viewpoint,
            rays.bounce,
            np.full(RAYS, -1, np.int32),
            rays.meta,
        )
        hits = mibvh.trace(tree, triangles, rays, style=style, repeats=1)
        every = mibvh.trace(flat_tree(triangles), triangles, rays, repeats=1)
        same(f"hits of {builder}, {style}, on {kind}", hits.t, every.t)
        t, sure = truth(triangles, rays)
        extent = float((upper - lower).max())
        near("hits", hits.t, t, sure, extent, f"{builder} on {kind}")
        near("Mitsuba's hits", mitsuba_t(triangles, rays), t, sure, extent, kind)
        return kind


def soup(rng: Random) -> tuple[str, Any]:
    """Return what kind of soup it is, and its triangles."""
    count = int(rng.choice([1, 2, 3, 17, 150, 400]))
    corners = rng.random((count, 1, 3)) + rng.normal(size=(count, 3, 3)) * rng.choice([0.02, 0.3])
    kind = str(rng.choice(["soup", "points", "slivers", "sheet", "copies", "layers", "far"]))
    if kind == "points":
        corners[rng.random(count) < 0.5, 1:] = corners[0, 0]
    elif kind == "slivers":
        corners[:, 2] = corners[:, 1] + rng.normal(size=(count, 3)) * 1e-6
    elif kind == "sheet":
        corners[..., int(rng.integers(3))] = 0.5
    elif kind == "copies":
        corners = corners[rng.integers(0, max(count // 4, 1), count)]
    elif kind == "layers":
        corners[..., 2] = np.round(corners[..., 2] * 4) / 4
    elif kind == "far":
        corners += rng.normal(size=3) * 50
    scale = 10.0 ** rng.uniform(-3, 3)
    return kind, mibvh.Triangles((corners * scale).astype(np.float32), kind)


def truth(triangles: Any, rays: Any) -> tuple[F64, npt.NDArray[np.bool_]]:
    """Distances in float64, by every triangle, and for which rays there is no doubt."""
    a, b, c = triangles.corners.astype(np.float64).transpose(1, 0, 2)
    o, d = (x.astype(np.float64)[:, None] for x in (rays.o, rays.d))
    e1, e2 = b - a, c - a
    p = np.cross(d, e2)
    det = (e1 * p).sum(-1)
    with np.errstate(all="ignore"):
        s = o - a
        u = (s * p).sum(-1) / det
        q = np.cross(s, e1)
        v = (d * q).sum(-1) / det
        t = (e2 * q).sum(-1) / det
        sine = np.abs(det) / (np.linalg.norm(e1, axis=1) * np.linalg.norm(e2, axis=1))
        margin = np.minimum(np.minimum(u, v), 1 - u - v)
    extent = np.ptp(triangles.corners)
    slim = ~(sine > MARGIN)  # also where it is no number: a triangle without area
    flat = (np.linalg.norm(np.cross(e1, e2), axis=1) == 0)[None]
    surely = (margin > MARGIN) & (t > MARGIN * extent) & ~slim
    perhaps = ~flat & ((margin > -MARGIN) | slim) & ((t > -MARGIN * extent) | slim) & ~surely
    nearest = np.where(surely, t, np.inf).min(1)
    # Where a triangle is seen from its edge, its distance is not known either.
    doubt = np.where(perhaps, np.where(slim, 0.0, t), np.inf).min(1)
    return nearest, doubt > nearest * (1 + MARGIN) + MARGIN * extent


def near(
    what: str,
    found: npt.NDArray[Any],
    wanted: F64,
    sure: npt.NDArray[np.bool_],
    extent: float,
    where: str,
) -> None:
    """Fail unless distances agree where there is no doubt."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(found - wanted) > 1e-3 * (np.abs(wanted) + extent)
    wrong = sure & (apart | (np.isfinite(found) != np.isfinite(wanted)))
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise AssertionError(
            f"wrong {what} of {where}: {wrong.sum()} of {sure.sum()}, such as ray {i}: "
            f"{found[i]}, not {wanted[i]}"
        )


def mitsuba_t(triangles: Any, rays: Any) -> F64:
    """Distances by Mitsuba's own intersection."""
    mi = mitsuba()
    o, d = (mi.Point3f(*x.T.copy()) for x in (rays.o, rays.d))
    found = mitsuba_geometry(triangles).ray_intersect_preliminary(mi.Ray3f(o, mi.Vector3f(d)))
    return np.array(found.t, dtype=np.float64)
