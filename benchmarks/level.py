"""What the level of finite rays misses, scene by scene: which lines, along the line, order.

    python benchmarks/level.py SCENE ... [--builder bbvh]

Prints a table for ``docs/alpha.md``: finite rays over counted cost and the three factors that it is
the product of (:mod:`mibvh.studies.analyse.level`), and apart for rays that miss and rays that hit
what the formula with the rays' own lines says over what they touch. ``first half`` is the share of
what missing rays touch that they touch within the first half of their way out of the scene.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

import mibvh
from mibvh.metrics.lines import RayLines, inside_box, line_costs, ray_lines, sah_of_lines
from mibvh.metrics.points import point_costs, ray_starts
from mibvh.metrics.predictor import finite_ray_cost, path_length_ratio

#: Lines that are walked through the boxes of a tree.
_LINES = 8192
_HEADS = (
    "scene",
    "finite / counted",
    "which lines",
    "along the line",
    "order",
    "rays that miss",
    "said / touched, miss",
    "first half",
    "said / touched, hit",
)


def level(scene: mibvh.Scene, builder: str) -> list[str]:
    """Return a row of the table."""
    tree = mibvh.build(scene, builder)
    rays = mibvh.diffuse_rays(scene, width=160, height=120)
    hits = mibvh.trace(tree, scene, rays)
    lines = ray_lines(scene.triangles, rays, hits, _LINES)
    starts = ray_starts(scene.triangles, rays)
    at = point_costs(tree, scene.triangles, starts.points, starts.triangle).sum(axis=1)
    query, of_lines = float(at.mean()), sah_of_lines(tree, lines).value
    ratio = path_length_ratio(scene.triangles, rays, hits)
    finite = float(finite_ray_cost(mibvh.sah(tree), query, ratio))
    by_lines = float(finite_ray_cost(of_lines, query, float(lines.share.mean())))
    touched, first = line_costs(tree, lines, whole=False), _first_half(tree, lines, scene)
    counted = hits.counted_cost()
    misses = ~np.isfinite(lines.length)
    factors = finite / counted, finite / by_lines, by_lines / touched.mean()
    return [
        scene.name,
        *(f"{value:.2f}" for value in (*factors, touched.mean() / counted)),
        f"{misses.mean():.0%}",
        _ratio(query + lines.share[misses] * of_lines, touched[misses]),
        f"{first[misses].sum() / touched[misses].sum():.0%}" if misses.any() else "–",
        _ratio(query + lines.share[~misses] * of_lines, touched[~misses]),
    ]


def _first_half(tree: mibvh.Tree, lines: RayLines, scene: mibvh.Scene) -> np.ndarray:
    """What each ray touches on the first half of its way within the scene's box."""
    _, leaves = inside_box(scene.triangles.bounds.astype(np.float64), lines.o, lines.d)
    half = np.minimum(lines.length, np.maximum(leaves, 0)) / 2
    return line_costs(tree, dataclasses.replace(lines, length=half), whole=False)


def _ratio(said: np.ndarray, touched: np.ndarray) -> str:
    return f"{said.mean() / touched.mean():.2f}" if len(said) else "–"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--builder", default="bbvh")
    chosen = parser.parse_args()
    print("| " + " | ".join(_HEADS) + " |")
    print("|---" + "|---:" * (len(_HEADS) - 1) + "|")
    for name in chosen.scenes:
        row = level(mibvh.load(name), chosen.builder)
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
