"""One case: a mutated tree, ray or hit file through ``metrics`` and ``trace``.

A case passes if the file is refused in a sentence, or if what comes out is right: the same hits as
testing every triangle, SAH as by a formula of its own, EPO as an estimate from points.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import mibvh
from tools.fuzz import mutate

BUILDERS = ("bbvh", "sbvh", "streelet", "lbvh")
RAYS = 192


class Bench:
    """A small scene with large and small triangles, its trees, rays and hits, as files."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="mibvh-fuzz-"))
        self.triangles = sticks(150)
        self.trees = {name: mibvh.build(self.triangles, name, max_leaf=4) for name in BUILDERS}
        self.rays = random_rays(self.triangles, RAYS)
        self.flat = flat_tree(self.triangles)
        self.truth = self.trace(self.flat, self.rays)
        self.files: list[tuple[str, str, bytes]] = []
        for name, tree in self.trees.items():
            self._keep("tree", name, tree)
        self._keep("rays", "rays", self.rays)
        self._keep("hits", "hits", self.truth)

    def _keep(self, kind: str, name: str, value: Any) -> None:
        path = self.folder / f"{name}.npz"
        value.save(path)
        self.files.append((kind, name, path.read_bytes()))

    def trace(self, tree: Any, rays: Any, style: Any = "single") -> Any:
        """Trace once."""
        return mibvh.trace(tree, self.triangles, rays, style=style, repeats=1)

    def run(self, seed: int) -> str:
        """Run a case; return what became of it. An exception other than MibvhError is a fault."""
        rng = np.random.default_rng(seed)
        # Trees twice as often as rays and hits.
        kind, name, data = self.files[int(rng.choice(len(self.files)))]
        change = mutate.hostile if seed % 2 else mutate.damaged
        path = self.folder / "case.npz"
        path.write_bytes(change(data, rng))
        styles = ["single", "while-while", "wide"]
        style = styles[rng.integers(len(styles))]
        try:
            getattr(self, f"_{kind}")(path, name, style)
        except mibvh.MibvhError as error:
            sentence = str(error)
            if not sentence or "\n" in sentence or len(sentence) > 600:
                raise AssertionError(f"no sentence: {sentence!r}") from None
            return f"{kind} refused"
        return f"{kind} accepted"

    def _tree(self, path: Path, _name: str, style: str) -> None:
        tree = mibvh.Tree.load(path)
        stats = tree.stats()
        value, exact = mibvh.sah(tree), mibvh.epo(tree, self.triangles)
        hits = self.trace(tree, self.rays, style)
        same("hits", hits.t, self.truth.t)
        agree("SAH", value, slow_sah(tree), 1e-9)
        estimate = mibvh.estimate_epo(tree, self.triangles, samples=2000)
        agree("EPO", exact, estimate.value, 1e-6, 6 * estimate.standard_error)
        if stats["triangles"] != len(self.triangles):
            raise AssertionError(f"{stats['triangles']} triangles")

    def _rays(self, path: Path, _name: str, style: str) -> None:
        rays = mibvh.RaySet.load(path)
        tree = self.trees["sbvh"]
        hits, truth = self.trace(tree, rays, style), self.trace(self.flat, rays)
        same("hits", hits.t, truth.t)
        starts, ends = mibvh.ray_ends(self.triangles, rays, hits)
        for found in (starts, ends):
            if not np.isfinite(found.points).all():
                raise AssertionError("ray ends that are no points")

    def _hits(self, path: Path, _name: str, _style: str) -> None:
        hits = mibvh.Hits.load(path)
        hits.counters()
        lines = mibvh.ray_lines(self.triangles, self.rays, hits)
        _, ends = mibvh.ray_ends(self.triangles, self.rays, hits)
        if not (np.isfinite(lines.share).all() and np.isfinite(ends.points).all()):
            raise AssertionError("ray ends that are no points")


def same(what: str, found: np.ndarray, wanted: np.ndarray) -> None:
    """Fail unless two arrays are equal to the last bit."""
    if not np.array_equal(found, wanted):
        count = int((found != wanted).sum()) if found.shape == wanted.shape else -1
        raise AssertionError(f"wrong {what}: {count} of {len(wanted)}")


def agree(what: str, found: float, wanted: float, share: float, error: float = 0.0) -> None:
    """Fail unless two numbers agree to a share of them, or a standard error."""
    if not abs(found - wanted) <= share * max(abs(found), abs(wanted)) + error:
        raise AssertionError(f"wrong {what}: {found}, not {wanted} ± {error}")


def slow_sah(tree: Any) -> float:
    """SAH by its definition, in float64."""
    extent = tree.upper.astype(np.float64) - tree.lower.astype(np.float64)
    area = sum(extent[:, i] * extent[:, (i + 1) % 3] for i in range(3))
    c_inner, c_tri = tree.meta.get("c_inner", 1.2), tree.meta.get("c_tri", 1.0)
    cost = np.where(tree.left < 0, c_tri * tree.count, c_inner)
    return float((cost * area).sum() / area[0])


@functools.cache
def sticks(count: int) -> Any:
    """Long thin slanted triangles among small ones: what spatial splits are for."""
    rng = np.random.default_rng(5)
    start = rng.random((count, 1, 3))
    along = rng.normal(size=(count, 1, 3)) * rng.choice([0.05, 0.5], (count, 1, 1))
    corners = start + along * [[[0], [1], [1]]] + rng.normal(size=(count, 3, 3)) * 0.02
    return mibvh.Triangles(corners.astype(np.float32), "sticks")


def random_rays(triangles: Any, count: int) -> Any:
    """Rays between random points around the triangles."""
    rng = np.random.default_rng(6)
    o, d = rng.random((count, 3)) * 1.6 - 0.3, rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ids = np.zeros(count, np.int32)
    return mibvh.RaySet(
        o.astype(np.float32),
        d.astype(np.float32),
        np.full(count, np.inf, np.float32),
        ids,
        ids + 1,
        rng.integers(-1, len(triangles), count).astype(np.int32),
        {"digest": triangles.digest, "scene": triangles.name},
    )


def flat_tree(triangles: Any) -> Any:
    """One leaf of all triangles: tracing it tests every one, by the same arithmetic."""
    lower, upper = triangles.bounds
    ids = np.arange(len(triangles), dtype=np.int32)
    return mibvh.Tree(
        lower[None],
        upper[None],
        np.full(1, -1, np.int32),
        np.zeros(1, np.int32),
        np.full(1, len(ids), np.int32),
        ids,
        {"triangles": len(ids)},
    )
