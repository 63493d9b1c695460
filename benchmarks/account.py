"""What the counted cost consists of, and where the finite predictors lose their r.

    python benchmarks/account.py SCENE ... [--builders NAMES]

Predictions with nothing fitted, each knowing more than the one before it: finite rays, finite by
lines, the same with the part of a line ahead of the ray's start, the nodes that a ray touches up to
its hit, and these with the nodes beyond it that are visited all the same. Prints, for
``docs/alpha.md``, r with counted cost over a scene's trees, and the mean over the trees of
predicted over counted cost.

A node beyond the hit is visited

- for certain, if its parent holds the hit and is above the triangle that is hit: when the parent is
  visited, the hit is not known;
- if it is below a node that holds the hit, is not above the triangle, and comes first by the order
  of entry (the left one of two that hold the start). What the ray would hit below that node is
  left out, so it is an upper bound.
"""

from __future__ import annotations

import argparse
from typing import Any, NamedTuple

import numpy as np

import mibvh
from mibvh._jit import njit
from mibvh.builders import names
from mibvh.metrics.lines import (
    BEYOND,
    RayLines,
    inside_box,
    line_costs,
    ray_lines,
    sah_of_lines,
)
from mibvh.metrics.points import Held, Nodes, point_costs, ray_starts, triangle_positions
from mibvh.metrics.predictor import finite_ray_cost, path_length_ratio, pearson
from mibvh.metrics.sah import node_costs
from mibvh.surface import on_surface

#: Lines that are walked through the boxes of a tree.
_LINES = 8192
_HEADS = (
    "finite rays",
    "finite by lines",
    "lines ahead",
    "touched",
    "and surely beyond",
    "and by order",
)


class _Ends(NamedTuple):
    """Rays that hit something: o, d, where what they touch ends, the hit, its triangle."""

    o: Any
    d: Any
    beyond: Any
    point: Any
    triangle: Any


@njit
def _span(nodes, node, o, d):
    """Where a line enters and leaves a box; the exit lies before the entry if it misses."""
    near, far = -np.inf, np.inf
    for k in range(3):
        a, b = nodes.lower[node, k] - o[k], nodes.upper[node, k] - o[k]
        if d[k] != 0.0:
            a, b = a / d[k], b / d[k]
            near, far = max(near, min(a, b)), min(far, max(a, b))
        elif a > 0.0 or b < 0.0:
            far = -np.inf
    return near, far


@njit
def _above(nodes, held, node, triangle):
    """Whether a node has a reference to a triangle below it."""
    for k in range(held.starts[triangle], held.starts[triangle + 1]):
        if 0 <= held.positions[k] - nodes.first[node] < nodes.count[node]:
            return True
    return False


@njit
def _holds(nodes, node, point):
    for k in range(3):
        if point[k] < nodes.lower[node, k] or point[k] > nodes.upper[node, k]:
            return False
    return True


@njit
def _comes_first(nodes, child, other, o, d):
    """Whether the traversal goes to a child before its sibling, which the ray also enters."""
    entry, of_other = max(0.0, _span(nodes, child, o, d)[0]), max(0.0, _span(nodes, other, o, d)[0])
    return entry < of_other or (entry == of_other and child < other)


@njit
def _beyond(ends, nodes, held, out):
    """Cost of the nodes beyond each hit: out[:, 0] those for certain, out[:, 1] those by order."""
    stack, unknown = np.empty(nodes.depth + 2, np.int32), np.empty(nodes.depth + 2, np.bool_)
    for i in range(len(ends.triangle)):
        o, d, point, triangle = ends.o[i], ends.d[i], ends.point[i], ends.triangle[i]
        # On the stack are nodes that hold the hit and are above its triangle, and whole parts of
        # the tree that are walked while the hit is not known.
        stack[0], unknown[0], top = 0, False, 1
        while top > 0:
            top -= 1
            node, foreign = stack[top], unknown[top]
            left = nodes.left[node]
            for child in range(left, left + 2 if left >= 0 else left):
                near, far = _span(nodes, child, o, d)
                around = _holds(nodes, child, point)
                if not around and max(near, ends.beyond[i]) > far:
                    continue
                if not around:
                    out[i, 1 if foreign else 0] += nodes.cost[child]
                follow = foreign
                if not foreign and around:
                    other = left if child > left else left + 1
                    follow = not _above(nodes, held, child, triangle)
                    if follow and not _comes_first(nodes, child, other, o, d):
                        continue
                elif not foreign:
                    continue
                stack[top], unknown[top] = child, follow
                top += 1


@njit
def _ahead(o, d, nodes, out):
    """Cost of the nodes that each half-line enters, and that do not hold its start."""
    stack = np.empty(nodes.depth + 2, np.int32)
    for i in range(len(o)):
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            near, far = _span(nodes, node, o[i], d[i])
            if far < max(near, 0.0):
                continue
            if near > 0.0:
                out[i] += nodes.cost[node]
            if nodes.left[node] >= 0:
                stack[top], stack[top + 1] = nodes.left[node], nodes.left[node] + 1
                top += 2


def account(scene: mibvh.Scene, builders: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return (builders, 6) predictions of a scene's trees, and (builders,) counted costs."""
    triangles, rays = scene.triangles, mibvh.diffuse_rays(scene, width=160, height=120)
    starts = ray_starts(triangles, rays)
    predicted, counted, lines = [], [], None
    for name in builders:
        tree = mibvh.build(scene, name)
        hits = mibvh.trace(tree, scene, rays)
        if lines is None:
            lines = ray_lines(triangles, rays, hits, _LINES)
            ratio = path_length_ratio(triangles, rays, hits)
            step = max(1, -(-len(rays) // _LINES))  # that of the lines
            ends = _ends(triangles, lines, hits.triangle[::step])
        arrays = tree.lower, tree.upper, tree.left, tree.first, tree.count, tree.depth
        nodes = Nodes(*arrays, node_costs(tree))
        held = Held(*triangle_positions(tree, len(triangles)))
        query = float(
            point_costs(tree, triangles, starts.points, starts.triangle).sum(axis=1).mean()
        )
        of_lines = sah_of_lines(tree, lines).value
        beyond = np.zeros((len(ends.triangle), 2))
        _beyond(ends, nodes, held, beyond)
        touched = float(line_costs(tree, lines, whole=False).mean())
        sure, by_order = np.cumsum(beyond.sum(axis=0) / len(lines))
        predicted.append(
            [
                float(finite_ray_cost(mibvh.sah(tree), query, ratio)),
                float(finite_ray_cost(of_lines, query, float(lines.share.mean()))),
                query + _entered(triangles, lines, nodes),
                touched,
                touched + sure,
                touched + by_order,
            ]
        )
        counted.append(hits.counted_cost())
    return np.array(predicted), np.array(counted)


def _ends(triangles: mibvh.Triangles, lines: RayLines, triangle: np.ndarray) -> _Ends:
    hit = np.flatnonzero(triangle >= 0)
    o, d, length = lines.o[hit], lines.d[hit], lines.length[hit]
    point = on_surface(triangles, o + d * length[:, None], triangle[hit])
    return _Ends(o, d, length * (1 + BEYOND), point, triangle[hit])


def _entered(triangles: mibvh.Triangles, lines: RayLines, nodes: Nodes) -> float:
    """Cost of the nodes ahead of each start, by the share of the way ahead that the ray covers."""
    _, leaves = inside_box(triangles.bounds.astype(np.float64), lines.o, lines.d)
    out = np.zeros(len(lines))
    _ahead(lines.o, lines.d, nodes, out)
    inside = leaves > 0
    share = np.minimum(lines.length[inside] / leaves[inside], 1.0)
    return float((share * out[inside]).sum() / len(lines))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--builders", default=",".join(names()))
    chosen = parser.parse_args()
    print("| scene | " + " | ".join(_HEADS) + " |")
    print("|---" + "|---:" * len(_HEADS) + "|")
    r, level = [], []
    for source in chosen.scenes:
        scene = mibvh.load(source)
        predicted, counted = account(scene, chosen.builders.split(","))
        r.append([pearson(column, counted) for column in predicted.T])
        level.append((predicted / counted[:, None]).mean(axis=0))
        cells = [f"{a:.3f}, {b:.2f}" for a, b in zip(r[-1], level[-1], strict=True)]
        print(f"| {scene.name} | " + " | ".join(cells) + " |", flush=True)
    means = (
        f"{a:.3f}, {b:.2f}" for a, b in zip(np.mean(r, axis=0), np.mean(level, axis=0), strict=True)
    )
    print("| mean | " + " | ".join(means) + " |")
    within = (np.abs(np.array(level) - 1) <= 0.15).sum(axis=0)
    worst = (f"{a:.3f}, {b}" for a, b in zip(np.min(r, axis=0), within, strict=True))
    print("| least r, scenes within 15% | " + " | ".join(worst) + " |")


if __name__ == "__main__":
    main()
