"""What every generator is made of: the description, the parts under construction, the size knob."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .primitives import Mesh, merge

PartDict = dict[str, tuple[NDArray[np.float32], NDArray[np.int32]]]


@dataclass(frozen=True)
class SceneInfo:
    """One line of the catalogue.

    Attributes
    ----------
    name
        Short lower-case name, also the name of the XML template.
    title
        One line: what the scene shows.
    kind
        Short category of its geometry.
    triangles
        Triangle count aimed at by default.
    paper_scene
        Nearest scene of the 2013 study, or "".
    up
        The axis that points up, "y" or "z".
    """

    name: str
    title: str
    kind: str
    triangles: int
    paper_scene: str = ""
    up: str = "z"


class Parts:
    """Meshes under construction, by the name of their material."""

    def __init__(self) -> None:
        self._meshes: dict[str, list[Mesh]] = {}

    def add(self, part: str, *meshes: Mesh) -> None:
        """Put meshes into a part; a part appears when it is first named."""
        self._meshes.setdefault(part, []).extend(meshes)

    def count(self) -> int:
        """Triangles so far."""
        return sum(len(f) for ms in self._meshes.values() for _, f in ms)

    def result(self) -> PartDict:
        """Float32 positions and int32 indices of each part, zero-area triangles left out."""
        return {name: _clean(merge(meshes)) for name, meshes in self._meshes.items()}


def _clean(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    v = np.ascontiguousarray(mesh[0], dtype=np.float32)
    f = np.ascontiguousarray(mesh[1], dtype=np.int32)
    # Judged on the rounded positions: those are the ones that are written.
    a = v[f[:, 0]].astype(np.float64)
    n = np.cross(v[f[:, 1]] - a, v[f[:, 2]] - a)
    return v, np.ascontiguousarray(f[np.any(n != 0.0, axis=1)])


Build = Callable[[float, np.random.Generator], Parts]


@dataclass(frozen=True)
class Recipe:
    """A catalogue entry with the function that builds it.

    ``build(detail, rng)`` makes about ``detail * info.triangles`` triangles. Detail changes how
    finely things are cut or how many there are; never the extents of the world, nor what stands
    where a camera is.
    """

    info: SceneInfo
    build: Build


def cells(base: float, scale: float, least: int = 1) -> int:
    """Round `base * scale` to a whole number of cells, never below `least`."""
    return max(least, round(base * scale))


def even_cells(base: float, scale: float, least: int = 2) -> int:
    """Like `cells`, but even."""
    return max(least, 2 * round(base * scale / 2))


def build_to_size(recipe: Recipe, triangles: int, seed: int) -> Parts:
    """Build a recipe so that its triangle count comes close to the one asked for.

    The count is a step function of the detail that nobody can invert, so it is searched for:
    detail is corrected by the ratio of the counts, or by halving (in the logarithm) once the
    target is bracketed. Every trial starts from the same seed, hence the result depends on
    nothing but name, count and seed. If no trial comes within 8 % the nearest one is kept: that
    is the scene's natural minimum, or a step of it.
    """
    label = zlib.crc32(recipe.info.name.encode())
    detail = triangles / recipe.info.triangles
    low, high = 0.0, np.inf
    best: Parts | None = None
    best_error = np.inf
    last_count, last_detail = 0, 0.0
    for _ in range(12):
        parts = recipe.build(detail, np.random.default_rng([seed, label]))
        ratio = parts.count() / triangles
        error = abs(np.log(ratio))
        if error < best_error:
            best, best_error = parts, error
        if error < 0.08:
            break
        # Much less detail and hardly fewer triangles: this is the natural minimum.
        if ratio > 1.2 and detail < 0.6 * last_detail and parts.count() > 0.9 * last_count:
            break
        last_count, last_detail = parts.count(), detail
        if ratio < 1.0:
            low = max(low, detail)
        else:
            high = min(high, detail)
        guess = detail / np.clip(ratio, 0.05, 20.0)
        if low > 0.0 and np.isfinite(high):
            if high / low < 1.005:
                break
            if not low * 1.001 < guess < high / 1.001:
                guess = np.sqrt(low * high)
        elif guess < 1e-5:
            break
        detail = float(guess)
    assert best is not None
    return best


def thin(parts: PartDict, triangles: int) -> PartDict:
    """Leave out the smallest pieces of a scene that is larger than asked for.

    Scenes of many objects cannot be cut more coarsely than a box each. Below that, whole
    connected pieces go, smallest surface first, so that walls and houses stay and bolts and
    crenels go; every part keeps its largest piece.
    """
    areas, counts, owners, labels = [], [], [], {}
    for name, (v, f) in parts.items():
        link = coo_matrix(
            (np.ones(2 * len(f)), (f[:, :2].ravel(), f[:, 1:].ravel())), (len(v),) * 2
        )
        k, of_corner = connected_components(link, directed=False)
        own = of_corner[f[:, 0]]
        a = v[f[:, 0]].astype(np.float64)
        area = 0.5 * np.linalg.norm(np.cross(v[f[:, 1]] - a, v[f[:, 2]] - a), axis=1)
        labels[name] = own
        areas.append(np.bincount(own, weights=area, minlength=k))
        counts.append(np.bincount(own, minlength=k))
        owners.append(k)
    start = np.concatenate([[0], np.cumsum(owners)])
    area, count = np.concatenate(areas), np.concatenate(counts)
    keep = np.zeros(len(area), dtype=bool)
    for i in range(len(owners)):
        keep[start[i] + np.argmax(areas[i])] = True
    left = triangles - int(count[keep].sum())
    for piece in np.argsort(-area, kind="stable"):
        if not keep[piece] and count[piece] <= left:
            keep[piece] = True
            left -= int(count[piece])
    out: PartDict = {}
    for i, (name, (v, f)) in enumerate(parts.items()):
        kept = f[keep[start[i] + labels[name]]]
        used, new = np.unique(kept, return_inverse=True)
        out[name] = v[used], new.reshape(-1, 3).astype(np.int32)
    return out
