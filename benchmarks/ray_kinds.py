"""How well each predictor explains the counted cost of each kind of rays, over the nine trees.

    python benchmarks/ray_kinds.py sponza conference --trees FOLDER [--save FOLDER] [-o TABLES.md]

FOLDER/SCENE/BUILDER.npz are read where they are, and built otherwise. Scenes are what
``mibvh.load`` takes. With --save, a scene's figures go to FOLDER/SCENE.json; such a file given for
a scene is read instead of measuring. Kinds of rays that any hit ends are traced by the any-hit
kernel, and their costs are what that visits.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markdown_tables import printed, table

import mibvh
from mibvh.files import write_text
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
from mibvh.studies.record.serialise import from_json, to_json

BUILDERS = ["bbvh", "sbvh", "agglo", "lbvh", "hill", "anneal", "bittner", "treelet", "streelet"]
KINDS = ["primary", "diffuse", "bounce2", "bounce3", "shadow", "shadow2", "ao"]
#: What a path tracer of two bounces sends, by the numbers of rays.
MIXED = ("primary", "diffuse", "bounce2", "shadow", "shadow2")


@dataclasses.dataclass
class Row:
    """One kind of rays in one scene: per tree the counted cost, and what predicts it."""

    count: int
    hit: float  # share of the rays that hit something
    ended: float  # share of the rays that any hit ends, and that hit something
    length: float
    cost: list[float]
    finite: list[float]
    ours: list[float]
    touched: list[float]


@dataclasses.dataclass
class SceneKinds:
    """One scene: SAH and EPO of its trees, and each kind of rays."""

    name: str
    sah: list[float]
    epo: list[float]
    kinds: dict[str, Row]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--trees", type=Path, default=Path("."))
    parser.add_argument("--folder", type=Path, help="look for SCENE/scene.xml here")
    parser.add_argument("--width", type=int, default=96)
    parser.add_argument("--height", type=int, default=72)
    parser.add_argument("--save", type=Path, help="folder for the figures of each scene")
    parser.add_argument("-o", "--output", type=Path, help="also write the tables here")
    asked = parser.parse_args()
    found = []
    for name in asked.scenes:
        if name.endswith(".json"):
            found.append(from_json(SceneKinds, json.loads(Path(name).read_text())))
            continue
        found.append(measure(name, asked))
        if asked.save:
            write_text(asked.save / f"{name}.json", json.dumps(to_json(found[-1])))
        print(f"{name} done", file=sys.stderr, flush=True)
    printed(tables(found), asked.output)


def measure(name: str, asked: argparse.Namespace) -> SceneKinds:
    """All kinds of rays in all trees of a scene."""
    scene = mibvh.load(asked.folder / name / "scene.xml" if asked.folder else name)
    trees = [_tree(scene, asked.trees / name / f"{b}.npz", b) for b in BUILDERS]
    sah = [mibvh.sah(tree) for tree in trees]
    epo = [estimate_epo(tree, scene.triangles, 200_000).value for tree in trees]
    found = SceneKinds(name, sah, epo, {})
    for kind in KINDS:
        try:
            rays = mibvh.make_rays(scene, kind, width=asked.width, height=asked.height, samples=1)
        except mibvh.MibvhError as error:
            print(name, kind, error, file=sys.stderr)
            continue
        found.kinds[kind] = _row(scene, rays, trees, np.array(sah))
    found.kinds["mixed"] = _mixture([found.kinds[k] for k in MIXED if k in found.kinds])
    return found


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
        cost,
        finite.tolist(),
        ours.tolist(),
        (np.array(touched) - np.array(saved)).tolist(),
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

    def mean(name: str) -> Any:
        return np.average([getattr(row, name) for row in rows], axis=0, weights=weights).tolist()

    values = {field.name: mean(field.name) for field in dataclasses.fields(Row)}
    return Row(**{**values, "count": int(weights.sum())})


# ------------------------------------------------------------ tables

PREDICTORS = ("SAH", "SAH + EPO, fitted", "by estimated alpha", "finite rays", "any-hit", "touched")


def tables(scenes: Sequence[SceneKinds]) -> Iterable[str]:
    """Lines of Markdown."""
    yield f"mibvh {mibvh.__version__}; {len(scenes)} scenes; costs are counted, not timed."
    yield ""
    yield from table(
        "Pearson's r with counted cost over the nine trees, mean / least over the scenes",
        ("rays", "scenes", "hit", "s", *PREDICTORS),
        (_over_scenes(kind, scenes) for kind in (*KINDS, "mixed")),
    )
    for kind in (*KINDS, "mixed"):
        yield from table(
            f"{kind}: r, alpha, level (predicted over counted cost), and the trees",
            (
                "scene",
                "rays",
                "hit",
                "s",
                *PREDICTORS,
                "alpha fitted",
                "estimated",
                "1/(1+s)",
                "level of finite rays",
                "any-hit",
                "touched",
                "dearest / cheapest",
            ),
            (_of_scene(scene, kind) for scene in scenes if kind in scene.kinds),
        )
    yield from table(
        "Mean rank of each builder's tree by counted cost (1: the cheapest), and on how many "
        "scenes it is the first",
        ("builder", *(*KINDS, "mixed")),
        (_ranks(place, builder, scenes) for place, builder in enumerate(BUILDERS)),
    )


def _r(scene: SceneKinds, kind: str) -> tuple[list[float], float, float]:
    """Pearson's r of each predictor, the fitted alpha and the estimated one."""
    row, sah, epo = scene.kinds[kind], np.array(scene.sah), np.array(scene.epo)
    alpha = estimate_alpha_any_hit(row.length, row.ended)
    fitted = fit_alpha(sah, epo, row.cost)
    both, estimated = predict(sah, epo, fitted), predict(sah, epo, alpha)
    predicted = (sah, both, estimated, row.finite, row.ours, row.touched)
    return [pearson(x, row.cost) for x in predicted], fitted, alpha


def _over_scenes(kind: str, scenes: Sequence[SceneKinds]) -> list[str]:
    of = [scene for scene in scenes if kind in scene.kinds]
    r = np.array([_r(scene, kind)[0] for scene in of])
    rows = [scene.kinds[kind] for scene in of]
    return [
        kind,
        str(len(of)),
        f"{np.mean([row.hit for row in rows]):.2f}",
        f"{np.mean([row.length for row in rows]):.2f}",
        *(f"{m:.3f} / {low:.3f}" for m, low in zip(r.mean(axis=0), r.min(axis=0), strict=True)),
    ]


def _of_scene(scene: SceneKinds, kind: str) -> list[str]:
    row = scene.kinds[kind]
    r, fitted, alpha = _r(scene, kind)
    cost = np.array(row.cost)
    levels = [float(np.mean(np.array(x) / cost)) for x in (row.finite, row.ours, row.touched)]
    return [
        scene.name,
        f"{row.count:,}",
        f"{row.hit:.2f}",
        f"{row.length:.2f}",
        *(f"{x:.3f}" for x in r),
        *(f"{x:.2f}" for x in (fitted, alpha, estimate_alpha(row.length), *levels)),
        f"{cost.max() / cost.min():.2f}",
    ]


def _ranks(place: int, builder: str, scenes: Sequence[SceneKinds]) -> list[str]:
    cells = [builder]
    for kind in (*KINDS, "mixed"):
        costs = [np.array(s.kinds[kind].cost) for s in scenes if kind in s.kinds]
        ranks = [1 + int((cost < cost[place]).sum()) for cost in costs]
        cells.append(f"{np.mean(ranks):.1f} ({sum(rank == 1 for rank in ranks)})")
    return cells


if __name__ == "__main__":
    main()
