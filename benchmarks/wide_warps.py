"""Wide trees in simulated warps: a lane per ray against a lane per child.

    python benchmarks/wide_warps.py [SCENE ...] [--trees FOLDER] [--rays NAME] [--save FOLDER]
        [-o TABLES.md]

Arguments are those of `wide.py`. Warps have 32 lanes. A step of nodes costs 1.2, and 0.2 for each
box beyond two that one lane tests (2.4 for eight); with a lane per child a lane tests one box: 1.2.
A step of triangles costs 1.0. Costs are issued steps times 32 lanes, per ray.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from markdown_tables import printed, table
from wide import WIDTHS, Given, SceneFigures, fitted, geometric_mean, measure_figures

import mibvh
from mibvh.builders import names
from mibvh.collapsing import collapse, unfold
from mibvh.files import write_text
from mibvh.metrics.predictor import finite_ray_cost, pearson
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.traversal.warp import LanePer, simulate

LANES = 32
#: Kernels: the loop of the published ones with a lane per child, and the paper's.
STYLES = ("single", "persistent")
#: Costs of a step of nodes with a lane per child, beside which its order is held.
OTHER_COSTS = (0.6, 2.4)


#: Marks the figures of trees with leaves that fill a step.
LEAVES = "leaves"


class Way(NamedTuple):
    """One way to deal rays to the lanes of warps."""

    style: str
    width: int
    lane_per: LanePer

    @property
    def key(self) -> str:
        """Where its figures are kept."""
        return " ".join(map(str, self))


WAYS = [Way(s, w, lane) for s in STYLES for w in WIDTHS for lane in get_args(LanePer)]


@dataclasses.dataclass
class Issued:
    """What warps issued for a tree: lane-steps per ray, and the share of them that had work."""

    nodes: float
    triangles: float
    c_inner: float
    utilisation: float

    def cost(self, c_inner: float | None = None) -> float:
        """What a ray costs."""
        return (c_inner or self.c_inner) * self.nodes + self.triangles


@dataclasses.dataclass
class InWarps:
    """A scene's trees: their figures, and what warps issued for each, by way."""

    figures: SceneFigures
    issued: dict[str, dict[str, Issued]]

    def costs(self, way: Way, c_inner: float | None = None) -> np.ndarray:
        """(K,) float64: cost of all trees."""
        return np.array([of[way.key].cost(c_inner) for of in self.issued.values()])

    def utilisation(self, way: Way) -> float:
        """Mean over the trees."""
        return float(np.mean([of[way.key].utilisation for of in self.issued.values()]))

    def cheapest(self, costs: np.ndarray) -> str:
        """The builder of the cheapest tree."""
        return list(self.issued)[int(np.argmin(costs))]


def main() -> None:
    """Simulate the scenes and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["livingroom@20000", "city_italian@20000"])
    parser.add_argument("--trees", type=Path, help="folder of trees and ray sets")
    parser.add_argument("--rays", default="rays160", help="name of the ray sets' files")
    parser.add_argument("--save", type=Path, help="folder for the figures of each scene")
    parser.add_argument("-o", "--output", type=Path, help="also write the tables here")
    asked = parser.parse_args()
    found = []
    for source in asked.scenes:
        if source.endswith(".json"):
            found.append(read(Path(source)))
            continue
        found.append(measure(Given.of(source, asked.trees, asked.rays)))
        name = found[-1].figures.name
        if asked.save:
            write_text(asked.save / f"{name}.json", json.dumps(to_json(found[-1])))
        print(f"{name} done", file=sys.stderr, flush=True)
    printed(tables(found), asked.output)


def measure(given: Given) -> InWarps:
    """Figures of all trees of a scene, and what warps issue for them."""
    triangles, rays = given.scene.triangles, given.rays
    figures = SceneFigures(given.name, len(triangles), len(rays), 0.0, {}, {}, {}, {}, {})
    found = InWarps(figures, {})
    for builder in names():
        tree = given.tree(builder)
        measure_figures(figures, builder, tree, triangles, rays)
        trees = {width: collapse(tree, width) for width in WIDTHS}
        found.issued[builder] = {way.key: _issued(trees[way.width], given, way) for way in WAYS}
        found.issued[builder] |= larger_leaves(tree, given)
    return found


def larger_leaves(tree: mibvh.Tree, given: Given) -> dict[str, Issued]:
    """What warps issue where a leaf of as many triangles as there are children is one step."""
    single = unfold(tree, given.scene.triangles)
    found = {}
    for width in WIDTHS[1:]:
        # A step of nodes against a triangle's share of a step; all boxes are tested at once.
        wide = collapse(single, width, max_leaf=width, c_inner=1.2 * width, c_box=0.0)
        for lane_per in get_args(LanePer):
            way = Way("single", width, lane_per)
            found[f"{way.key} {LEAVES}"] = _issued(wide, given, way)
    return found


def _issued(tree: mibvh.WideTree, given: Given, way: Way) -> Issued:
    warps = simulate(
        tree, given.scene.triangles, given.rays, LANES, way.style, lane_per=way.lane_per
    )
    nodes, triangles = (float(n) for n in warps.issued.sum(axis=0) * LANES / len(warps))
    return Issued(nodes, triangles, warps.c_inner, warps.utilisation())


def read(file: Path) -> InWarps:
    """Figures that ``--save`` wrote; JSON has no numbers for keys."""
    found = from_json(InWarps, json.loads(file.read_text()))
    trees = found.figures.trees
    by_width = {b: {int(w): f for w, f in of.items()} for b, of in trees.items()}
    return InWarps(dataclasses.replace(found.figures, trees=by_width), found.issued)


# ------------------------------------------------------------ tables


def tables(scenes: Sequence[InWarps]) -> Iterable[str]:
    """Lines of Markdown."""
    yield f"mibvh {mibvh.__version__}; {len(scenes)} scenes; warps of {LANES} lanes, simulated."
    yield ""
    for style in STYLES:
        yield from _modes(style, scenes)
        yield from _predictors(style, scenes)
        yield from _builders(style, scenes)
    yield from _leaves(scenes)


def _modes(style: str, scenes: Sequence[InWarps]) -> Iterable[str]:
    """A lane per child against a lane per ray, and both against counted cost."""
    rows = []
    for width in WIDTHS:
        ray, child = Way(style, width, "ray"), Way(style, width, "child")
        values = []
        for scene in scenes:
            counted = scene.figures.column(width, "cost")
            by_ray, by_child = scene.costs(ray), scene.costs(child)
            values.append(
                [
                    scene.utilisation(ray),
                    scene.utilisation(child),
                    geometric_mean(by_child / by_ray),
                    pearson(counted, by_ray),
                    pearson(counted, by_child),
                    pearson(by_ray, by_child),
                    *(pearson(scene.costs(child, c), by_child) for c in OTHER_COSTS),
                ]
            )
            cheapest = [scene.cheapest(costs) for costs in (counted, by_ray, by_child)]
            rows.append(
                [scene.figures.name, str(width), *(f"{x:.3f}" for x in values[-1]), *cheapest]
            )
        mean = [f"{x:.3f}" for x in np.mean(values, axis=0)]
        rows.append(["mean", str(width), *mean, "", "", ""])
    heads = [
        "scene",
        "children",
        "utilisation: lane per ray",
        "per child",
        "cost of per child over per ray",
        "r: counted, per ray",
        "counted, per child",
        "per ray, per child",
        *(f"per child at 1.2 and at {c}" for c in OTHER_COSTS),
        "cheapest: counted",
        "per ray",
        "per child",
    ]
    yield from table(f"`{style}`: a lane per ray, and a lane per child", heads, rows)


def _predictors(style: str, scenes: Sequence[InWarps]) -> Iterable[str]:
    """The width's own figures against what warps issue."""
    rows = []
    for width in WIDTHS:
        values = []
        for scene in scenes:
            of = scene.figures
            sah, epo, query = (of.column(width, name) for name in ("sah", "epo", "query"))
            finite = finite_ray_cost(sah, query, of.ratio)
            cells: list[float] = []
            for lane_per in ("ray", "child"):
                cost = scene.costs(Way(style, width, lane_per))
                alpha, r = fitted(sah, epo, cost)
                cells += [pearson(sah, cost), r, pearson(finite, cost), alpha]
            values.append(cells)
            rows.append([of.name, str(width), *(f"{x:.3f}" for x in cells)])
        rows.append(["mean", str(width), *(f"{x:.3f}" for x in np.mean(values, axis=0))])
    heads = ["scene", "children"]
    for lane in ("ray", "child"):
        heads += [f"per {lane}: SAH", "SAH + EPO", "finite rays", "alpha"]
    yield from table(f"`{style}`: r of the tree's own figures with its cost", heads, rows)


def _builders(style: str, scenes: Sequence[InWarps]) -> Iterable[str]:
    """Cost of each builder's tree over the best of the scene."""
    ways = [way for way in WAYS if way.style == style]
    rows = []
    for place, builder in enumerate(scenes[0].issued):
        row = [builder]
        for way in ways:
            over = [scene.costs(way)[place] / scene.costs(way).min() for scene in scenes]
            row.append(f"{geometric_mean(over):.3f} ({sum(x == 1 for x in over)})")
        rows.append(row)
    heads = ["builder", *(f"{way.width} children, lane per {way.lane_per}" for way in ways)]
    yield from table(
        f"`{style}`: cost over that of the scene's cheapest tree (geometric mean), and on how many "
        "scenes it is the cheapest",
        heads,
        rows,
    )


def _leaves(scenes: Sequence[InWarps]) -> Iterable[str]:
    """Leaves that fill a step, over leaves of least SAH."""
    rows = []
    for scene in scenes:
        row = [scene.figures.name]
        for width in WIDTHS[1:]:
            for lane_per in get_args(LanePer):
                key = Way("single", width, lane_per).key
                over = [
                    of[f"{key} {LEAVES}"].cost() / of[key].cost() for of in scene.issued.values()
                ]
                row.append(f"{geometric_mean(over):.3f} ({min(over):.3f} to {max(over):.3f})")
        rows.append(row)
    heads = [
        f"{width} children, lane per {lane}" for width in WIDTHS[1:] for lane in ("ray", "child")
    ]
    yield from table(
        "`single`: leaves of up to as many triangles as children, where a step of nodes costs 1.2 "
        "and a triangle its share of a step: cost over that of the collapse above (geometric mean, "
        "least and most over the trees)",
        ["scene", *heads],
        rows,
    )


if __name__ == "__main__":
    main()
