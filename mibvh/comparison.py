"""Comparison of two trees of a scene: metrics, depths at which they differ, cost of each ray."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mibvh.builders import build
from mibvh.builders.chosen import parse
from mibvh.errors import MibvhError
from mibvh.layouts import read_binary
from mibvh.metrics.epo import epo_per_depth
from mibvh.metrics.sah import sah_per_node
from mibvh.nodes import PAPER_COSTS
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import Scene, load
from mibvh.traversal.trace import Hits, trace
from mibvh.tree import Tree
from mibvh.triangles import F64, Triangles
from mibvh.variant import mitsuba
from mibvh.viewpoints import camera_rays

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Shares of the rays at which the difference of their costs is told.
QUANTILES = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)
#: Longer side of the picture in pixels, and rays per pixel along each side of it.
_SIDE, _GRID = 512, 2


@dataclasses.dataclass(frozen=True)
class DepthDifference:
    """Expected costs of the nodes at one depth of either tree."""

    depth: int
    sah: tuple[float, float]
    epo: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class OriginDifference:
    """Mean counted costs of the rays of one bounce from one viewpoint."""

    bounce: int
    viewpoint: int
    rays: int
    cost: tuple[float, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """A comparison of two trees. Differences are the second minus the first.

    Attributes
    ----------
    names : (str, str)
    trees : (Tree, Tree)
        With the paper's cost constants.
    figures : dict of str to (float, float)
        ``sah, epo, lcv, counted_cost, nodes, references, depth`` of either.
    by_depth : list of DepthDifference
        Where in the trees the expected cost and the overlap sit.
    difference : (R,) float64
        Of each ray, what it costs more in the second tree, counted.
    by_origin : list of OriginDifference
    """

    names: tuple[str, str]
    trees: tuple[Tree, Tree]
    figures: dict[str, tuple[float, float]]
    by_depth: list[DepthDifference]
    difference: F64
    by_origin: list[OriginDifference]

    @property
    def quantiles(self) -> dict[float, float]:
        """Quantiles of the difference over the rays, at :data:`QUANTILES`."""
        found = np.quantile(self.difference, QUANTILES)
        return dict(zip(QUANTILES, found.tolist(), strict=True))

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the rays that cost less, the same, and more in the second tree."""
        d = self.difference
        return {
            "cheaper": float((d < 0).mean()),
            "same": float((d == 0).mean()),
            "dearer": float((d > 0).mean()),
        }

    def to_json(self) -> dict[str, Any]:
        """Return everything but the trees and the single rays as JSON-able values."""
        return {
            "trees": list(self.names),
            "rays": len(self.difference),
            "figures": {name: list(pair) for name, pair in self.figures.items()},
            "by_depth": [dataclasses.asdict(level) for level in self.by_depth],
            "quantiles": {f"{share:g}": value for share, value in self.quantiles.items()},
            "shares": self.shares,
            "by_origin": [dataclasses.asdict(origin) for origin in self.by_origin],
        }


def compare(scene: Any, first: Any, second: Any, *, rays: RaySet | None = None) -> Comparison:
    """Compare two trees of a scene.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    first, second : Tree, path or str
        A tree, the file of one (:func:`mibvh.read_tree`), or a builder with its options, such as
        ``sbvh(budget=2)``.
    rays : RaySet, optional
        Diffuse rays from the scene's cameras by default, as in a quick study.

    Returns
    -------
    Comparison
        All costs are by the paper's constants, whatever the trees were built for.

    Raises
    ------
    MibvhError
        If there is no such file or builder, a tree or the rays are of another geometry, or the
        scene cannot be loaded.
    """
    waiting = [_named(one) for one in (first, second)]
    loaded = load(scene)
    triangles = loaded.triangles
    trees = [_tree(one, triangles) for one in waiting]
    if rays is None:
        rays = diffuse_rays(loaded, width=160, height=120, samples=1)
    hits = [trace(tree, triangles, rays, repeats=1) for tree in trees]
    costs = [found.costs() for found in hits]
    figures, by_depth = _figures(trees, triangles, hits)
    a, b = (_name(one) for one in waiting)
    return Comparison(
        names=(a, b if b != a else f"{b} (second)"),
        trees=(trees[0], trees[1]),
        figures=figures,
        by_depth=by_depth,
        # Costs are small multiples of tenths: what rounding leaves is no difference.
        difference=np.round(costs[1] - costs[0], 9),
        by_origin=_by_origin(rays, costs),
    )


def difference_figure(scene: Any, found: Comparison, sensor: int = 0) -> Figure:
    """Draw images of the cost of camera rays in each tree, and of the difference.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    found : Comparison
        Of trees of this scene.
    sensor : int
        Which of the scene's viewpoints.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    MibvhError
        If there is no such viewpoint.
    """
    from mibvh.mitsuba.heatmap import cost_figure

    loaded = load(scene)
    if not 0 <= sensor < len(loaded.sensors):
        raise MibvhError(f"{loaded.name} has {len(loaded.sensors)} cameras; there is no {sensor}")
    rays, height, width = _camera_grid(loaded, sensor)
    hits = [trace(tree, loaded.triangles, rays, repeats=1) for tree in found.trees]

    def image(values: Any) -> Any:
        cells = np.asarray(values, np.float64).reshape(height, _GRID, width, _GRID)
        return cells.mean(axis=(1, 3)).astype(np.float32)

    # A dot separates a layer's name from what it shows.
    names = [name.replace(".", "·") for name in found.names]
    a, b = (one.costs() for one in hits)
    channels = {
        f"{names[0]}.cost": image(a),
        f"{names[1]}.cost": image(b),
        "difference.cost": image(b - a),
        "hit": image(hits[0].triangle >= 0),
    }
    return cost_figure(channels, ["cost"])


def _named(given: Any) -> Any:
    """Tell apart a tree, an existing file and a known builder, before any work."""
    if isinstance(given, Tree):
        return given
    if not isinstance(given, str | os.PathLike):
        raise MibvhError(f"a tree is a Tree, a file or a builder, not a {type(given).__name__}")
    if Path(given).exists() or not isinstance(given, str):
        return Path(given)
    if Path(given).suffix and "(" not in given:
        raise MibvhError(f"{given}: there is no such file")
    chosen = parse(given)
    if len(chosen) > 1:
        raise MibvhError(f"{given} stands for {len(chosen)} trees; name one")
    return chosen[0]


def _name(given: Any) -> str:
    if isinstance(given, Tree):
        return str(given.meta.get("builder", "tree"))
    return given.stem if isinstance(given, Path) else str(given.name)


def _tree(given: Any, triangles: Triangles) -> Tree:
    if isinstance(given, Path):
        tree = read_binary(given)
    elif isinstance(given, Tree):
        tree = given
    else:
        tree = build(triangles, given.builder, **dict(given.options))
    tree.check_matches(triangles)
    return tree.replace(meta={**tree.meta, **PAPER_COSTS})


def _figures(
    trees: list[Tree], triangles: Triangles, hits: list[Hits]
) -> tuple[dict[str, tuple[float, float]], list[DepthDifference]]:
    """Return the metrics of both trees, and their expected cost by depth."""
    levels = 1 + max(tree.depth for tree in trees)
    sah = [np.bincount(tree.depths, sah_per_node(tree), levels) for tree in trees]
    overlap = [_padded(epo_per_depth(tree, triangles), levels) for tree in trees]
    stats = [tree.stats() for tree in trees]
    pairs = {
        "sah": [float(of.sum()) for of in sah],
        "epo": [float(of.sum()) for of in overlap],
        "lcv": [found.lcv for found in hits],
        "counted_cost": [found.counted_cost(**PAPER_COSTS) for found in hits],
        **{name: [s[name] for s in stats] for name in ("nodes", "references", "depth")},
    }
    by_depth = [
        DepthDifference(
            depth,
            (float(sah[0][depth]), float(sah[1][depth])),
            (float(overlap[0][depth]), float(overlap[1][depth])),
        )
        for depth in range(levels)
    ]
    return {name: (pair[0], pair[1]) for name, pair in pairs.items()}, by_depth


def _padded(values: F64, levels: int) -> F64:
    return np.concatenate([values, np.zeros(levels - len(values))])


def _by_origin(rays: RaySet, costs: list[F64]) -> list[OriginDifference]:
    """Mean costs of the rays of each bounce and viewpoint."""
    origins = np.stack([rays.bounce, rays.viewpoint], axis=1)
    kinds, which = np.unique(origins, axis=0, return_inverse=True)
    count = np.bincount(which.ravel())
    a, b = (np.bincount(which.ravel(), of) / count for of in costs)
    return [
        OriginDifference(int(bounce), int(viewpoint), int(n), (float(x), float(y)))
        for (bounce, viewpoint), n, x, y in zip(kinds, count, a, b, strict=True)
    ]


def _camera_grid(scene: Scene, sensor: int) -> tuple[RaySet, int, int]:
    """Return rays of a camera through a grid in each pixel, row by row, and the image's size."""
    mi = mitsuba()
    camera = scene.sensors[sensor]
    size = np.array(camera.film().size(), dtype=np.float64).ravel()
    width, height = np.maximum(1, np.round(size * min(1.0, _SIDE / size.max()))).astype(int)
    x = (np.arange(width * _GRID) + 0.5) / (width * _GRID)
    y = (np.arange(height * _GRID) + 0.5) / (height * _GRID)
    across, down = np.meshgrid(x, y)
    place = mi.Point2f(mi.Float(across.ravel()), mi.Float(down.ravel()))
    ray = camera_rays(camera, place, mi.Point2f(0.5))
    o, d = (np.array(of, dtype=np.float32).T for of in (ray.o, ray.d))
    rays = RaySet(np.broadcast_to(o, d.shape), d, meta={"kind": "primary"})
    return rays, int(height), int(width)
