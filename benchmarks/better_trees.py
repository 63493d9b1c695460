"""What trees for traced rays gain in counted cost, and what each part of them is worth.

    python benchmarks/better_trees.py SCENE... [--table gains|ablations|unseen|vain|anyhit
                                              |later|wide|times|speed]
                                      [--trees DIR] [--size 160x120] [--kept DIR] [-o TABLE.md]

SCENE is whatever `mibvh build` takes. Trees are measured on rays that no builder saw: of another
seed, and, for `unseen`, of other cameras. Cost is counted, 1.2 for each inner node and 1.0 for each
triangle test of the paper's kernel, and given relative to the best of the paper's nine builders.
With --trees DIR, those nine are read from DIR/SCENE/BUILDER.npz where they are there. With
--kept DIR, each scene's row is written to DIR/TABLE-SCENE.json, and not measured again if it is
there and the version, SCENE and --size are the same.

- gains: the best combination that knows no rays (`bittner` from `sbvh`), and `finite`; with and
  without re-testing popped nodes; references per triangle.
- ablations: `finite` with each part left out or exchanged.
- unseen: built for every other camera, measured on those left out, and the other way round.
- vain: segments prolonged beyond their hits, as the traversal visits nodes there in vain.
- anyhit: shadow and ambient-occlusion rays, in trees for diffuse rays and for rays of their kind,
  relative to `bittner` from `sbvh` by area; binary, wide, and wide with children by `worth`.
- later: the builders that came after the paper.
- wide: nodes of eight children, collapsed by area and by the rays' measure; relative to `sbvh`
  collapsed by area.
- times: the same trees' kernel speed as a share of Embree's (Mitsuba's own intersection), all
  interleaved. For a quiet machine.
- speed: CPU time of building, of one process on all its threads, relative to `bittner` from `sbvh`,
  interleaved. Best with MIBVH_THREADS=1.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

import mibvh
from mibvh.builders import later_names, names
from mibvh.measures import Area, Flux, Segments
from mibvh.measures.walk import cut_at_hits
from mibvh.traversal.wide_rows import as_wide
from mibvh.tree import Tree
from mibvh.wide_tree import WideTree

#: Of the rays that are measured; those of training have another.
SEED = 0
#: Interleaved rounds of the times.
_ROUNDS = 15
#: Interleaved builds of the speed.
_BUILDS = 5


@dataclasses.dataclass
class Bench:
    """A scene, its held-out rays, and the cost that everything is relative to."""

    name: str
    scene: Any
    rays: Any
    best: float
    sbvh: Tree

    def cost(self, tree: Tree, rays: Any = None, cull: bool = False) -> float:
        """Counted cost relative to the best of the nine."""
        found = mibvh.trace(tree, self.scene, rays or self.rays, cull=cull, repeats=1)
        return found.counted_cost() / self.best

    def segments(self, seed: int = 1, count: int = 30_000) -> Segments:
        """Training rays, cut where they hit."""
        rays = self.scene.few_rays(count, seed)
        return cut_at_hits(
            self.sbvh, self.scene.triangles, rays.o, rays.d, rays.tmax, rays.viewpoint
        )


def prepare(source: str, folder: Path | None, width: int, height: int, relative: bool) -> Bench:
    """Load a scene, and find the best of the paper's nine builders on its held-out rays.

    Unless costs are not to be ``relative`` to it.
    """
    scene = mibvh.load(source)
    rays = mibvh.diffuse_rays(scene, width=width, height=height, samples=1, seed=SEED)
    bench = Bench(
        scene.name,
        scene,
        rays,
        1.0,
        Tree.load(_tree_file(folder, scene.name, "sbvh"))
        if _has(folder, scene.name, "sbvh")
        else mibvh.build(scene, "sbvh"),
    )
    if not relative:
        return bench
    costs = {}
    for builder in names():
        if _has(folder, scene.name, builder):
            tree = Tree.load(_tree_file(folder, scene.name, builder))
        else:
            tree = mibvh.build(scene, builder)
        costs[builder] = bench.cost(tree)
    bench.best = min(costs.values())
    return bench


def _tree_file(folder: Path | None, scene: str, builder: str) -> Path:
    return (folder or Path()) / scene / f"{builder}.npz"


def _has(folder: Path | None, scene: str, builder: str) -> bool:
    return folder is not None and _tree_file(folder, scene, builder).exists()


def _references(tree: Tree, bench: Bench) -> str:
    return f"{len(tree.references) / len(bench.scene.triangles):.2f}"


# ------------------------------------------------------------------ tables

Row = dict[str, Any]


def gains(bench: Bench) -> Row:
    """The best combination without rays, and `finite`."""
    area = mibvh.build(bench.scene, "bittner", start="sbvh")
    finite = mibvh.build(bench.scene, "finite")
    return {
        "area combination": bench.cost(area),
        "finite": bench.cost(finite),
        "references": _references(finite, bench),
        "re-testing: area": bench.cost(area, cull=True),
        "re-testing: finite": bench.cost(finite, cull=True),
        "start": finite.meta["report"]["start"],
    }


def ablations(bench: Bench) -> Row:
    """`finite` with its parts left out, or exchanged."""
    flux = Flux(bench.segments(), area_weight=0.1)

    def finite(**options: Any) -> Callable[[], Tree]:
        return lambda: mibvh.build(bench.scene, "finite", **options)

    def by(measure: Any, builder: str, **options: Any) -> Callable[[], Tree]:
        return lambda: mibvh.build(bench.scene, builder, measure=measure, **options)

    variants: dict[str, Callable[[], Tree]] = {
        "finite": finite(),
        "area: bittner(sbvh)": by(Area(), "bittner", start="sbvh"),
        "flux sbvh alone": by(flux, "sbvh"),
        "flux bittner(bbvh), no splits": by(flux, "bittner", start="bbvh"),
        "flux treelet(sbvh)": by(flux, "treelet", start="sbvh"),
        "one start, no later splits": finite(effort=1),
        "no later splits": finite(budget=0.0),
        "three passes": finite(effort=3),
        "1,000 rays": finite(count=1000),
        "10,000 rays": finite(count=10_000),
        "100,000 rays": finite(count=100_000),
        "16 planes": finite(planes=16),
        "128 planes": finite(planes=128),
        "area weight 0": finite(area_weight=0.0),
        "area weight 0.6": finite(area_weight=0.6),
        "area weight 3": finite(area_weight=3.0),
        "rays between surfaces": lambda: mibvh.build(bench.scene.triangles, "finite"),
    }
    return {label: bench.cost(make()) for label, make in variants.items()}


def unseen(bench: Bench) -> Row:
    """Built for every other camera, measured on the others, and the other way round."""
    sensors = bench.scene.sensors
    if len(sensors) < 4:
        return {}
    halves = [_half_unseen(bench, first) for first in (0, 1)]
    row: Row = {
        label: float(np.exp(np.mean([np.log(half[label]) for half in halves])))
        for label in halves[0]
        if label != "chosen"
    }
    row["unseen=true, worse half"] = max(half["unseen=true"] for half in halves)
    return {**row, "chosen": " and ".join(str(half["chosen"]) for half in halves)}


def _half_unseen(bench: Bench, first: int) -> Row:
    sensors = bench.scene.sensors
    seen = dataclasses.replace(bench.scene, sensors=sensors[first::2])
    odd = np.arange(len(sensors))[1 - first :: 2]
    rays = bench.rays.select(np.isin(bench.rays.viewpoint, odd))
    variants: dict[str, Callable[[], Tree]] = {
        "area combination": lambda: mibvh.build(seen, "bittner", start="sbvh"),
        "weight 0.1": lambda: mibvh.build(seen, "finite"),
        "weight 0.6": lambda: mibvh.build(seen, "finite", area_weight=0.6),
        "unseen=true": lambda: mibvh.build(seen, "finite", unseen=True),
        "all cameras known": lambda: mibvh.build(bench.scene, "finite"),
    }
    trees = {label: make() for label, make in variants.items()}
    # Relative to the area combination: the nine were not measured on these rays alone.
    costs = {label: bench.cost(tree, rays) for label, tree in trees.items()}
    row: Row = {label: cost / costs["area combination"] for label, cost in costs.items()}
    del row["area combination"]
    return {**row, "chosen": trees["unseen=true"].meta["report"]["area_weight"]}


def vain(bench: Bench) -> Row:
    """Insertion by flux, of segments that are prolonged beyond their hits in several ways."""
    cut = bench.segments()
    along = cut.end.astype(np.float64) - cut.start
    length = np.linalg.norm(along, axis=1, keepdims=True)
    step = along / np.maximum(length, 1e-30) * bench.scene.triangles.diagonal
    whole = np.random.default_rng(0).random((len(cut), 1))
    low, high = bench.scene.triangles.bounds.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(along != 0, (np.where(along > 0, high, low) - cut.end) / along, np.inf)
    beyond = along * np.clip(left.min(axis=1, keepdims=True), 0, 1e6)
    longer: dict[str, Any] = {
        "as they are": 0 * along,
        "by 3%": 0.03 * along,
        "by 10%": 0.1 * along,
        "by 1e-3 of the diagonal": 1e-3 * step,
        "by 1e-2 of the diagonal": 1e-2 * step,
        # To the end of the scene: a line that nothing stops.
        "a tenth not cut": np.where(whole < 0.1, beyond, 0.0),
        "two fifths not cut": np.where(whole < 0.4, beyond, 0.0),
    }
    row: Row = {}
    for label, more in longer.items():
        rays = Segments(cut.start, (cut.end + more).astype(np.float32), cut.viewpoint)
        tree = mibvh.build(bench.scene, "bittner", start="sbvh", measure=Flux(rays))
        row[label] = bench.cost(tree)
    return row


def anyhit(bench: Bench) -> Row:
    """Rays that any hit ends, in trees by area, for diffuse rays and for rays of their kind."""
    trees: dict[str, Tree] = {
        "area": mibvh.build(bench.scene, "bittner", start="sbvh"),
        "diffuse": mibvh.build(bench.scene, "finite"),
    }
    row: Row = {}
    for kind in ("shadow", "ao"):
        size = {"width": bench.rays.meta["width"], "height": bench.rays.meta["height"]}
        rays = mibvh.make_rays(bench.scene, kind, **size, samples=1, seed=SEED)
        trees["its kind"] = mibvh.build(bench.scene, "finite", kind=kind)
        found = {label: _any_hit_costs(bench, tree, rays) for label, tree in trees.items()}
        # All in terms of the binary area tree, and of the wide one, near first.
        for label, (single, near, worth) in found.items():
            whole, wide = found["area"][:2]
            if label != "area":
                row[f"{kind}: {label}"] = single / whole
                row[f"{kind}, wide: {label}"] = near / wide
            row[f"{kind}, wide, worth: {label}"] = worth / wide
    return row


def _any_hit_costs(bench: Bench, tree: Tree, rays: Any) -> tuple[float, float, float]:
    """Counted cost: binary, wide near first, and wide in the order of worth."""
    scene = bench.scene
    return (
        mibvh.trace(tree, scene, rays, repeats=1).counted_cost(),
        mibvh.trace(tree, scene, rays, style="wide", repeats=1).counted_cost(),
        mibvh.trace(tree, scene, rays, child_order="worth", repeats=1).counted_cost(),
    )


def later(bench: Bench) -> Row:
    """The builders that came after the paper."""
    return {name: bench.cost(mibvh.build(bench.scene, name)) for name in later_names()}


def _wide_trees(bench: Bench) -> dict[str, WideTree]:
    measure = Flux(bench.segments(), area_weight=0.1)
    finite = mibvh.build(bench.scene, "finite")
    triangles = bench.scene.triangles
    return {
        f"{name}, by {by}": as_wide(tree, triangles, chosen)
        for name, tree in (("sbvh", bench.sbvh), ("finite", finite))
        for by, chosen in (("area", None), ("flux", measure))
    }


def wide(bench: Bench) -> Row:
    """Counted cost of wide trees, collapsed by area and by flux."""
    costs = {
        label: mibvh.trace(tree, bench.scene, bench.rays, style="wide", repeats=1).counted_cost()
        for label, tree in _wide_trees(bench).items()
    }
    first = next(iter(costs.values()))
    return {label: cost / first for label, cost in costs.items()}


def times(bench: Bench) -> Row:
    """Kernel speed of the same trees as a share of Embree's; median over rounds of the ratio."""
    from traversal import mitsuba_seconds

    from mibvh.traversal.records import make_records, unit_scale
    from mibvh.traversal.trace import Tracer
    from mibvh.variant import mitsuba

    mi = mitsuba()
    triangles, rays = bench.scene.triangles, bench.rays
    tracer = Tracer(rays, float(unit_scale(triangles)), style="wide")
    trees = _wide_trees(bench)
    records = [make_records(tree, triangles, "wide") for tree in trees.values()]
    ray = mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T), mi.Float(rays.tmax), 0, [])
    rounds = np.array(
        [
            [tracer.run(tree)[1].kernel for tree in records] + [mitsuba_seconds(bench.scene, ray)]
            for _ in range(_ROUNDS + 1)
        ]
    )[1:]  # the first round warms up
    shares = np.median(rounds[:, -1:] / rounds[:, :-1], axis=0)
    return {label: float(share) for label, share in zip(trees, shares, strict=True)}


def speed(bench: Bench) -> Row:
    """CPU time of building relative to `bittner` from `sbvh`; median over interleaved rounds."""
    builds: dict[str, Callable[[], Tree]] = {
        "area combination": lambda: mibvh.build(bench.scene, "bittner", start="sbvh"),
        "finite": lambda: mibvh.build(bench.scene, "finite"),
        "effort=1": lambda: mibvh.build(bench.scene, "finite", effort=1),
    }
    rounds = []
    for _ in range(_BUILDS + 1):
        seconds = []
        for build in builds.values():
            begin = time.process_time()
            build()
            seconds.append(time.process_time() - begin)
        rounds.append(seconds)
    # The first round compiles.
    found = np.array(rounds[1:])
    ratios = np.median(found[:, 1:] / found[:, :1], axis=0).tolist()
    row: Row = {"seconds": float(np.median(found[:, 0]))}
    return row | dict(zip(list(builds)[1:], ratios, strict=True))


TABLES: dict[str, Callable[[Bench], Row]] = {
    function.__name__: function
    for function in (gains, ablations, unseen, vain, anyhit, later, wide, times, speed)
}
#: Tables that are relative to the best of the nine builders.
_RELATIVE = ("gains", "ablations", "vain", "later")


def lay_out(rows: dict[str, Row]) -> Iterable[str]:
    """Lines of a Markdown table, with the geometric means of what is a number."""
    columns = list(next(iter(rows.values())))
    yield f"| scene | {' | '.join(columns)} |"
    yield "|---|" + "---:|" * len(columns)
    for scene, row in rows.items():
        cells = [f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()]
        yield f"| {scene} | {' | '.join(cells)} |"
    means = []
    for column in columns:
        values = [row[column] for row in rows.values()]
        numbers = all(isinstance(v, float) for v in values)
        means.append(f"{np.exp(np.mean(np.log(values))):.3f}" if numbers else "")
    yield f"| geometric mean | {' | '.join(means)} |"


def measured(source: str, arguments: argparse.Namespace) -> tuple[str, Row]:
    """Return a scene's name and row: the kept one if it is of this source, these options."""
    width, height = (int(n) for n in arguments.size.split("x"))
    key = {"version": mibvh.__version__, "source": source, "size": arguments.size}
    stem = Path(source).parent.name if Path(source).suffix else source
    kept = arguments.kept and arguments.kept / f"{arguments.table}-{stem}.json"
    if kept and kept.exists():
        found = json.loads(kept.read_text(encoding="utf-8"))
        if found["key"] == key:
            return found["name"], found["row"]
    bench = prepare(source, arguments.trees, width, height, arguments.table in _RELATIVE)
    row = TABLES[arguments.table](bench)
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"key": key, "name": bench.name, "row": row}, indent=1)
        kept.write_text(text, encoding="utf-8")
    return bench.name, row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--table", choices=TABLES, default="gains")
    parser.add_argument("--trees", type=Path, help="folder of trees: DIR/SCENE/BUILDER.npz")
    parser.add_argument("--size", default="160x120", help="of the measured views, in pixels")
    parser.add_argument("--kept", type=Path, help="folder of rows that are measured once")
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    rows: dict[str, Row] = {}
    for source in arguments.scenes:
        name, row = measured(source, arguments)
        if row:
            rows[name] = row
            print(f"{name}: {row}", flush=True)
    text = "\n".join(lay_out(rows)) + "\n"
    print(text)
    if arguments.output:
        arguments.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
