"""Whether the paper's conclusions hold for trees of four and eight children per node.

    python benchmarks/wide.py [SCENE ...] [--trees FOLDER] [--save FOLDER] [-o TABLES.md]

Builds nine trees of each scene, collapses them to every width, and prints how well SAH, EPO and
finite rays explain the counted cost of diffuse rays there, which builder makes the best wide tree,
and what the choices of the collapse and of the children's order for any-hit rays give. SCENE is
whatever `mibvh build` takes. With --trees, FOLDER/SCENE/BUILDER.npz and FOLDER/SCENE/RAYS.npz are
read where they are there, SCENE being the name of the file or of its folder. With --save, a scene's
figures go to FOLDER/SCENE.json; such a file given for a SCENE is read instead of measuring. For
scenes that are too large for more, --builders takes some of the trees, --only-figures leaves out
other collapses and orders, and files of one scene with different trees (their names begin with the
scene's) are put together.

All costs are counted: 1.2 for an inner node, 0.2 for each child box beyond two, 1.0 for a triangle.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar, get_args

import numpy as np
from markdown_tables import printed, table

import mibvh
from mibvh.builders import names
from mibvh.collapsing import binary_nodes, collapse, unfold
from mibvh.files import write_text
from mibvh.metrics.epo import overlap
from mibvh.metrics.points import point_costs, ray_starts
from mibvh.metrics.predictor import (
    FEWEST_TREES,
    finite_ray_cost,
    fit_alpha,
    path_length_ratio,
    pearson,
    predict,
)
from mibvh.metrics.sah import node_costs
from mibvh.quantise import quantised
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.traversal.child_order import ChildOrder, child_priority
from mibvh.traversal.wide_rows import as_wide
from mibvh.traversal.wide_walk import node_visits

Kept = TypeVar("Kept")
WIDTHS = (2, 4, 8)
#: Optimisers, and what they start from.
STARTS = {"hill": "bbvh", "anneal": "bbvh", "bittner": "bbvh", "treelet": "lbvh"}
#: The cost of the issue's trial: per node of eight children, and per triangle.
TRIAL_NODE, TRIAL_TRIANGLE = 2.4, 1.0


@dataclasses.dataclass
class Figures:
    """One tree at one width."""

    sah: float
    epo: float
    query: float
    cost: float
    lcv: float
    inner: float
    boxes: float
    tests: float


@dataclasses.dataclass
class SceneFigures:
    """What one scene gave, by builder.

    Attributes
    ----------
    trees : dict
        Figures by width, for each builder.
    trial : dict
        Counted cost of the issue's trial.
    choices : dict
        Cost of other ways to collapse to eight children, over that of the first way.
    by_visits : dict
        Cost of eight children chosen by the visits of half of the rays, over that of those chosen
        by area, for the other half.
    any_hit : dict
        Cost of any-hit rays in other orders of children, over near first.
    """

    name: str
    triangles: int
    rays: int
    ratio: float
    trees: dict[str, dict[int, Figures]]
    trial: dict[str, float]
    choices: dict[str, dict[str, float]]
    any_hit: dict[str, dict[str, float]]
    by_visits: dict[str, dict[str, float]]

    def column(self, width: int, quantity: str) -> np.ndarray:
        """(K,) float64: a quantity of all trees."""
        return np.array([getattr(tree[width], quantity) for tree in self.trees.values()])


def main() -> None:
    """Measure the scenes and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["livingroom@20000", "city_italian@20000"])
    parser.add_argument("--trees", type=Path, help="folder of trees and ray sets")
    parser.add_argument("--rays", default="rays160", help="name of the ray sets' files")
    parser.add_argument("--save", type=Path, help="folder for the figures of each scene")
    parser.add_argument("--builders", default=",".join(names()), help="names, comma-separated")
    parser.add_argument("--only-figures", action="store_true", help="no other collapses, no orders")
    parser.add_argument("-o", "--output", type=Path, help="also write the tables here")
    arguments = parser.parse_args()
    found = []
    for scene in arguments.scenes:
        if scene.endswith(".json"):
            found.append(read(Path(scene)))
            continue
        builders = arguments.builders.split(",")
        of = measure(scene, arguments.trees, arguments.rays, builders, arguments.only_figures)
        found.append(of)
        if arguments.save:
            part = "" if builders == list(names()) else f"-{'-'.join(builders)}"
            write_text(arguments.save / f"{of.name}{part}.json", json.dumps(to_json(of)))
        print(f"{found[-1].name} done", file=sys.stderr, flush=True)
    printed(tables(together(found)), arguments.output)


# ------------------------------------------------------------ measuring


def together(scenes: Sequence[SceneFigures]) -> list[SceneFigures]:
    """Put the trees of one scene together, in the order of the builders."""
    found: dict[str, SceneFigures] = {}
    for scene in scenes:
        one = found.setdefault(scene.name, scene)
        trees = {**one.trees, **scene.trees}
        found[scene.name] = dataclasses.replace(
            one, trees={name: trees[name] for name in names() if name in trees}
        )
    return list(found.values())


@dataclasses.dataclass
class Given:
    """A scene, its rays, and the folder where its trees may be."""

    name: str
    scene: mibvh.Scene
    rays: mibvh.RaySet
    folder: Path | None

    @classmethod
    def of(cls, source: str, folder: Path | None, ray_file: str) -> Given:
        """Load a scene and its rays, or make them."""
        scene = mibvh.load(source)
        path = Path(source)
        name = path.parent.name if path.name == "scene.xml" else path.stem
        kept = folder / name if folder else None
        rays = _kept(kept, ray_file, mibvh.RaySet.load) or mibvh.diffuse_rays(
            scene, width=160, height=120, samples=1
        )
        return cls(name, scene, rays, kept)

    def tree(self, builder: str) -> mibvh.Tree:
        """Load a builder's tree, or build it."""
        return _kept(self.folder, builder, mibvh.Tree.load) or mibvh.build(self.scene, builder)


def measure(
    source: str, folder: Path | None, ray_file: str, builders: Sequence[str], only_figures: bool
) -> SceneFigures:
    """All trees of a scene at all widths."""
    given = Given.of(source, folder, ray_file)
    scene, rays = given.scene, given.rays
    result = SceneFigures(given.name, len(scene.triangles), len(rays), 0.0, {}, {}, {}, {}, {})
    for builder in builders:
        tree = given.tree(builder)
        figures = measure_figures(result, builder, tree, scene.triangles, rays)
        if not only_figures:
            _measure_tree(result, builder, tree, figures, scene.triangles, rays)
    return result


def read(file: Path) -> SceneFigures:
    """Figures that ``--save`` wrote; JSON has no numbers for keys."""
    found = from_json(SceneFigures, json.loads(file.read_text()))
    by_width = {b: {int(w): f for w, f in of.items()} for b, of in found.trees.items()}
    return dataclasses.replace(found, trees=by_width)


def _kept(folder: Path | None, name: str, load: Callable[[Path], Kept]) -> Kept | None:
    file = folder / f"{name}.npz" if folder else None
    return load(file) if file and file.exists() else None


def _traced(
    wide: mibvh.WideTree, triangles: mibvh.Triangles, rays: mibvh.RaySet, any_hit: bool = False
) -> mibvh.Hits:
    return mibvh.trace(wide, triangles, rays, style="wide", any_hit=any_hit, repeats=1)


def measure_figures(
    result: SceneFigures,
    builder: str,
    tree: mibvh.Tree,
    triangles: mibvh.Triangles,
    rays: mibvh.RaySet,
) -> mibvh.WideTree:
    """A tree at all widths; returns the widest."""
    fraction = overlap(tree, triangles).fraction
    starts = ray_starts(triangles, rays)
    result.trees[builder] = {}
    for width in WIDTHS:
        wide = collapse(tree, width)
        hits = _traced(wide, triangles, rays)
        if width == 2 and not result.ratio:
            result.ratio = path_length_ratio(triangles, rays, hits)
        query = point_costs(wide, triangles, starts.points, starts.triangle)
        result.trees[builder][width] = Figures(
            sah=mibvh.sah(wide),
            epo=float(node_costs(wide) @ fraction[binary_nodes(wide, tree)]),
            query=float(query.sum(axis=1).mean()),
            cost=hits.counted_cost(),
            lcv=hits.lcv,
            inner=float(hits.inner.mean()),
            boxes=float(hits.boxes.mean()),
            tests=float(hits.tests.mean()),
        )
    return wide


def _measure_tree(
    result: SceneFigures,
    builder: str,
    tree: mibvh.Tree,
    wide: mibvh.WideTree,
    triangles: mibvh.Triangles,
    rays: mibvh.RaySet,
) -> None:
    """Other ways to collapse a tree, and orders of its children."""
    base = result.trees[builder][8].cost
    hits = _traced(as_wide(tree, triangles), triangles, rays)
    result.trial[builder] = hits.counted_cost(TRIAL_NODE, TRIAL_TRIANGLE, 0.0)
    single = unfold(tree, triangles)
    choices = {
        "greedy": collapse(tree, 8, method="greedy"),
        "8-bit boxes": quantised(wide),
        "one triangle per leaf": collapse(single, 8),
        "one triangle per leaf, leaves of up to 8 where cheaper": collapse(single, 8, max_leaf=8),
        "nodes of least area (no cost per box)": collapse(tree, 8, c_box=0.0),
    }
    result.choices[builder] = {
        name: _traced(choice, triangles, rays).counted_cost() / base
        for name, choice in choices.items()
    }
    _measure_orders(result, builder, wide, triangles, rays)
    result.by_visits[builder] = by_visits(tree, wide, triangles, rays)


def by_visits(
    tree: mibvh.Tree, wide: mibvh.WideTree, triangles: mibvh.Triangles, rays: mibvh.RaySet
) -> dict[str, float]:
    """Collapse by the visits of every other ray, then of every other camera's."""
    found = {}
    for name, half in (
        ("rays", np.arange(len(rays)) % 2 == 0),
        ("cameras", rays.viewpoint % 2 == 0),
    ):
        if half.all():
            continue  # of one camera there are no others
        weights = node_visits(tree, triangles, rays.select(half))
        # Where no ray came by, areas decide.
        weights += 1e-3 * tree.half_areas / max(tree.half_areas[0], 1e-300)
        chosen, first = (
            mibvh.trace(t, triangles, rays.select(~half), style="wide", repeats=1)
            for t in (collapse(tree, 8, weights=weights), wide)
        )
        found[name] = chosen.counted_cost() / first.counted_cost()
    return found


def _measure_orders(
    result: SceneFigures,
    builder: str,
    wide: mibvh.WideTree,
    triangles: mibvh.Triangles,
    rays: mibvh.RaySet,
) -> None:
    """Any-hit rays of no end, and of a tenth of the scene's diagonal."""
    result.any_hit[builder] = {}
    for reach, name in ((np.inf, "unlimited"), (0.1 * triangles.diagonal, "short")):
        limited = dataclasses.replace(rays, tmax=np.full(len(rays), reach, np.float32))

        def traced(tree: mibvh.WideTree, limited: mibvh.RaySet = limited) -> mibvh.Hits:
            return mibvh.trace(tree, triangles, limited, style="wide", any_hit=True, repeats=1)

        near = traced(wide)
        result.any_hit[builder][f"{name} occluded"] = float(np.isfinite(near.t).mean())
        for order in get_args(ChildOrder):
            hits = traced(wide.ordered(child_priority(wide, triangles, order)))
            over = hits.counted_cost() / near.counted_cost()
            result.any_hit[builder][f"{name} {order}"] = over


# ------------------------------------------------------------ tables


def tables(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """Lines of Markdown."""
    yield f"mibvh {mibvh.__version__}; {len(scenes)} scenes; costs are counted, not timed."
    yield ""
    yield from _predictors([scene for scene in scenes if len(scene.trees) >= FEWEST_TREES])
    most = max(len(scene.trees) for scene in scenes)
    complete = [scene for scene in scenes if len(scene.trees) == most]
    for scene in scenes:
        if len(scene.trees) < most:
            yield from _some_trees(scene)
    yield from _builders(complete)
    yield from _before_and_after(complete)
    if whole := [scene for scene in scenes if scene.trial]:
        yield f"Of {len(whole)} scenes:"
        yield ""
        yield from _trial(whole)
        yield from _choices(whole)
        yield from _visits(whole)
        yield from _orders(whole)


def fitted(sah: np.ndarray, epo: np.ndarray, cost: np.ndarray) -> tuple[float, float]:
    """Alpha fitted to a cost, and r of the predictor with it."""
    alpha = fit_alpha(sah, epo, cost)
    return alpha, pearson(predict(sah, epo, alpha), cost)


def _r(value: float) -> str:
    return f"{value:.3f}"


def _means(rows: Sequence[Sequence[float]], form: Callable[[float], str]) -> list[str]:
    return ["mean", *(form(float(np.mean(column))) for column in zip(*rows, strict=True))]


def _trial(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """The trial of the issue: binary SAH and EPO against binary and eight-wide cost."""
    values = []
    for scene in scenes:
        sah, epo, binary = (scene.column(2, name) for name in ("sah", "epo", "cost"))
        wide = np.array(list(scene.trial.values()))
        alphas, r = zip(*(fitted(sah, epo, cost) for cost in (binary, wide)), strict=True)
        values.append(
            (pearson(sah, binary), pearson(sah, wide), *r, *alphas, pearson(binary, wide))
        )
    heads = (
        "scene",
        "r of SAH: binary cost",
        "wide",
        "r of SAH + EPO: binary",
        "wide",
        "alpha: binary",
        "wide",
        "r of binary with wide cost",
    )
    rows = [[s.name, *map(_r, row)] for s, row in zip(scenes, values, strict=True)]
    title = (
        'Binary SAH and EPO against the cost of `style="wide"` '
        f"({TRIAL_NODE} per node of eight, {TRIAL_TRIANGLE} per triangle)"
    )
    yield from table(title, heads, [*rows, _means(values, _r)])


def _predictors(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """Every width's own SAH, EPO and point queries against its own cost."""
    values = []
    for scene in scenes:
        row: list[float] = []
        per_width = []
        for width in WIDTHS:
            sah, epo, query, cost = (
                scene.column(width, name) for name in ("sah", "epo", "query", "cost")
            )
            alpha, r = fitted(sah, epo, cost)
            finite = finite_ray_cost(sah, query, scene.ratio)
            per_width.append((pearson(sah, cost), r, pearson(finite, cost), alpha))
        for quantity in zip(*per_width, strict=True):
            row += quantity
        row += [pearson(scene.column(2, "cost"), scene.column(w, "cost")) for w in (4, 8)]
        values.append(row)
    heads = [
        "scene",
        *(f"{name}, {w}" for name in ("SAH", "SAH + EPO", "finite rays", "alpha") for w in WIDTHS),
        "binary cost, 4",
        "8",
    ]
    rows = [
        [f"{s.name} ({len(s.trees)} trees)", *map(_r, row)]
        for s, row in zip(scenes, values, strict=True)
    ]
    yield from table(
        "r with counted cost, each width's own figures and cost; the fitted alpha; r of the binary "
        "tree's cost with the wide one's",
        heads,
        [*rows, _means(values, _r)],
    )


def _some_trees(scene: SceneFigures) -> Iterable[str]:
    """The figures of a scene of which not all trees were measured."""
    quantities = {"SAH": "sah", "EPO": "epo", "LCV": "lcv", "counted cost": "cost"}
    rows = [
        [builder, *(f"{getattr(of[w], q):.2f}" for q in quantities.values() for w in WIDTHS)]
        for builder, of in scene.trees.items()
    ]
    heads = ["builder", *(f"{name}, {w}" for name in quantities for w in WIDTHS)]
    yield from table(f"{scene.name}, {scene.triangles:,} triangles", heads, rows)


def geometric_mean(values: Iterable[float]) -> float:
    """Mean of ratios."""
    return float(np.exp(np.mean(np.log(list(values)))))


def _builders(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """Cost of each builder's tree over the best of the scene, at every width."""
    rows = []
    for builder in scenes[0].trees:
        row = [builder]
        for width in WIDTHS:
            over = [s.trees[builder][width].cost / s.column(width, "cost").min() for s in scenes]
            row += [f"{geometric_mean(over):.3f}", str(sum(x == 1 for x in over))]
        whole = [s.trees[builder][8].cost / s.trees[builder][2].cost for s in scenes]
        rows.append([*row, f"{geometric_mean(whole):.3f}"])
    heads = [
        "builder",
        *(h for w in WIDTHS for h in (f"cost at width {w}", "best on")),
        "width 8 over 2",
    ]
    yield from table(
        "Counted cost over that of the scene's best tree of the width (geometric mean), and on how "
        "many scenes it is the best",
        heads,
        rows,
    )


def _before_and_after(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """What an optimiser gains in binary SAH, and what is left of it after the collapse."""
    rows = []
    for builder, start in STARTS.items():
        if not all({builder, start} <= set(s.trees) for s in scenes):
            continue
        cells = [builder, start]
        for quantity in ("sah", "epo", "cost"):
            for width in (2, 8):
                over = [
                    getattr(s.trees[builder][width], quantity)
                    / getattr(s.trees[start][width], quantity)
                    for s in scenes
                ]
                cells.append(f"{geometric_mean(over):.3f}")
        rows.append(cells)
    heads = ["optimiser", "start", "SAH, 2", "SAH, 8", "EPO, 2", "EPO, 8", "cost, 2", "cost, 8"]
    yield from table("Optimised over start (geometric means)", heads, rows)
    values = []
    for s in scenes:
        values.append(
            [
                pearson(s.column(2, "sah"), s.column(8, "sah")),
                pearson(s.column(2, "epo"), s.column(8, "epo")),
                pearson(s.column(2, "sah"), s.column(8, "cost")),
                pearson(s.column(8, "sah"), s.column(8, "cost")),
            ]
        )
    heads = [
        "scene",
        "SAH before, after",
        "EPO before, after",
        "SAH before, cost after",
        "SAH after, cost after",
    ]
    rows = [[s.name, *map(_r, row)] for s, row in zip(scenes, values, strict=True)]
    yield from table(
        "r between figures before the collapse to eight children and after it",
        heads,
        [*rows, _means(values, _r)],
    )


def _choices(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """Other ways to collapse."""
    some = next(iter(scenes[0].choices.values()))
    rows = []
    for choice in some:
        over = [c[choice] for s in scenes for c in s.choices.values()]
        rows.append([choice, f"{geometric_mean(over):.3f}", f"{min(over):.3f}", f"{max(over):.3f}"])
    yield from table(
        "Eight children: counted cost over that of the cheapest SAH (all trees of all scenes)",
        ["collapse", "geometric mean", "least", "most"],
        rows,
    )


def _visits(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """Collapsed by how often rays come by."""
    rows, values = [], []
    for scene in scenes:
        each = scene.by_visits.values()
        cells = []
        for kind in ("rays", "cameras"):
            over = [tree.get(kind, np.nan) for tree in each]
            cells += [geometric_mean(over), min(over), max(over)]
        values.append(cells)
        rows.append([scene.name, *(f"{x:.3f}" for x in cells)])
    heads = ["scene", "other rays", "least", "most", "other cameras", "least", "most"]
    last = ["mean", *(f"{x:.3f}" for x in np.nanmean(values, axis=0))]
    yield from table(
        "Eight children chosen by the visits of half of the rays: counted cost for the other half "
        "over that of the cheapest SAH (geometric mean, least and most over the trees)",
        heads,
        [*rows, last],
    )


def _orders(scenes: Sequence[SceneFigures]) -> Iterable[str]:
    """Orders of children for any-hit rays."""
    rows, values = [], []
    for scene in scenes:
        cells = []
        for name in ("unlimited", "short"):
            kinds = [f"{name} {order}" for order in ("larger", "blocking", "worth")]
            each = scene.any_hit.values()
            cells.append(float(np.mean([tree[f"{name} occluded"] for tree in each])))
            cells += [geometric_mean(tree[kind] for tree in each) for kind in kinds]
        values.append(cells)
        rows.append([scene.name, *(f"{x:.2f}" for x in cells)])
    heads = [
        "scene",
        "occluded",
        "larger",
        "blocking",
        "worth",
        "occluded",
        "larger",
        "blocking",
        "worth",
    ]
    last = ["mean", *(f"{x:.2f}" for x in np.mean(values, axis=0))]
    yield from table(
        "Any-hit rays, eight children: counted cost over that of near first (mean over the trees); "
        "rays without end, then of a tenth of the diagonal",
        heads,
        [*rows, last],
    )


if __name__ == "__main__":
    main()
