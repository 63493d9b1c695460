"""How well each predictor explains the counted cost of each kind of rays, over the nine trees.

    python benchmarks/ray_kinds.py sponza conference --trees FOLDER

FOLDER/SCENE/BUILDER.npz are read where they are, and built otherwise. Scenes are what
``mibvh.load`` takes. One line per scene and kind, and the mixture that a path tracer of two
bounces sends.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

import mibvh
from mibvh.metrics.lines import line_costs, ray_lines
from mibvh.metrics.occlusion import (
    any_hit_ray_cost,
    estimate_alpha_any_hit,
    saved_by_any_hit,
)
from mibvh.metrics.points import estimate_epo, point_costs, ray_starts, weight_at
from mibvh.metrics.predictor import (
    estimate_alpha,
    finite_ray_cost,
    fit_alpha,
    path_length_ratio,
    pearson,
    predict,
)
from mibvh.metrics.sah import node_costs

BUILDERS = ["bbvh", "sbvh", "agglo", "lbvh", "hill", "anneal", "bittner", "treelet", "streelet"]
KINDS = ["primary", "diffuse", "bounce2", "bounce3", "shadow", "shadow2", "ao"]
MIXED = ("primary", "diffuse", "bounce2", "shadow", "shadow2")


@dataclasses.dataclass
class Row:
    """One kind of rays in one scene: per tree the counted cost, and what predicts it."""

    count: int
    hit: float  # share of the rays that hit something
    ended: float  # share of the rays that any hit ends, and that hit something
    length: float
    cost: np.ndarray
    finite: np.ndarray
    ours: np.ndarray
    touched: np.ndarray


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--trees", type=Path, default=Path("."))
    parser.add_argument("--folder", type=Path, help="look for SCENE/scene.xml here")
    parser.add_argument("--width", type=int, default=96)
    parser.add_argument("--height", type=int, default=72)
    asked = parser.parse_args()
    print(
        "scene kind rays hit s | alpha fitted, estimated, 1/(1+s) | r of SAH, SAH + EPO fitted, "
        "estimated, finite rays, any-hit, touched | levels of any-hit and touched | "
        "trees, cheapest first, and the dearest by the cheapest"
    )
    for name in asked.scenes:
        source = asked.folder / name / "scene.xml" if asked.folder else name
        scene = mibvh.load(source)
        trees = [_tree(scene, asked.trees / name / f"{b}.npz", b) for b in BUILDERS]
        sah = np.array([mibvh.sah(tree) for tree in trees])
        epo = np.array([estimate_epo(tree, scene.triangles, 200_000).value for tree in trees])
        rows = {}
        for kind in KINDS:
            try:
                rays = mibvh.make_rays(
                    scene, kind, width=asked.width, height=asked.height, samples=1
                )
            except mibvh.MibvhError as error:
                print(name, kind, error)
                continue
            rows[kind] = row = _row(scene, rays, trees, sah)
            _print(name, kind, row, sah, epo)
        mixed = [rows[kind] for kind in MIXED if kind in rows]
        _print(name, "mixed", _mixture(mixed), sah, epo)


def _tree(scene: mibvh.Scene, path: Path, builder: str) -> mibvh.Tree:
    return mibvh.Tree.load(path) if path.exists() else mibvh.build(scene, builder)


def _row(scene: mibvh.Scene, rays: mibvh.RaySet, trees: list[mibvh.Tree], sah: np.ndarray) -> Row:
    triangles = scene.triangles
    closest = mibvh.trace(trees[0], triangles, rays, any_hit=False, repeats=1)
    length = path_length_ratio(triangles, rays, closest)
    cost = [mibvh.trace(tree, triangles, rays, repeats=1).counted_cost() for tree in trees]
    query = [_starts(scene, rays, tree) for tree in trees]
    saved = [
        saved_by_any_hit(tree, triangles, rays, closest) if rays.occlusion else 0.0
        for tree in trees
    ]
    lines = ray_lines(triangles, rays, closest)
    touched = [line_costs(tree, lines, whole=False).mean() for tree in trees]
    finite = finite_ray_cost(sah, query, length)
    ours = any_hit_ray_cost(sah, query, length, saved)
    hit = float((closest.triangle >= 0).mean())
    return Row(
        len(rays),
        hit,
        hit if rays.occlusion else 0.0,
        length,
        np.array(cost),
        finite,
        ours,
        np.array(touched) - np.array(saved),
    )


def _starts(scene: mibvh.Scene, rays: mibvh.RaySet, tree: mibvh.Tree) -> float:
    """Cost of the nodes that hold the rays' starts, mean over the rays."""
    if (rays.source >= 0).any():
        starts = ray_starts(scene.triangles, rays)
        return float(
            point_costs(tree, scene.triangles, starts.points, starts.triangle).sum(1).mean()
        )
    return float(weight_at(tree, rays.o.astype(np.float64), node_costs(tree)).mean())


def _mixture(rows: list[Row]) -> Row:
    """All rays of a path tracer, by their numbers."""
    weights = np.array([row.count for row in rows], np.float64)

    def mean(name: str) -> np.ndarray:
        return np.average([getattr(row, name) for row in rows], axis=0, weights=weights)

    values: dict[str, Any] = {field.name: mean(field.name) for field in dataclasses.fields(Row)}
    return Row(**{**values, "count": int(weights.sum())})


def _print(scene: str, kind: str, row: Row, sah: np.ndarray, epo: np.ndarray) -> None:
    alpha = estimate_alpha_any_hit(row.length, row.ended)
    fitted = fit_alpha(sah, epo, row.cost)
    both, estimated = predict(sah, epo, fitted), predict(sah, epo, alpha)
    r = [pearson(x, row.cost) for x in (sah, both, estimated, row.finite, row.ours, row.touched)]
    levels = [np.mean(x / row.cost) for x in (row.ours, row.touched)]
    ranked = [BUILDERS[i] for i in np.argsort(row.cost)]
    print(
        f"{scene:12} {kind:8} {row.count:6} {row.hit:.2f} {row.length:.2f} | "
        f"{fitted:.2f} {alpha:.2f} {estimate_alpha(row.length):.2f} | "
        f"{' '.join(f'{v:.3f}' for v in r)} | {' '.join(f'{v:.2f}' for v in levels)} | "
        f"{' '.join(ranked)} {row.cost.max() / row.cost.min():.2f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
