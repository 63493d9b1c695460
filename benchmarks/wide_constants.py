"""What a node, a child box and a triangle cost in wide trees, fitted to times.

    python benchmarks/wide_constants.py [SCENE ...] [--trees FOLDER] [--lanes simd,scalar]
        [--rounds 15] [-o TABLES.md]

The nine trees of each scene are collapsed to two, four and eight children, each as it is, with
single triangles for leaves, and with larger leaves, so that nodes and triangles do not go hand in
hand. All are traced in turn, round by round; a tree's time is the median over the rounds of its
time over the round's mean. Then, by least squares of relative errors,

    time per ray = base + sum over widths (a_width nodes) + b (child boxes beyond two per node)
                   + c triangles

Costs are stated per triangle (a / c, b / c), beside a fit without b, as the kernel tests all boxes
of a node at once. Intervals are 95%, of a bootstrap over the trees.

Times are the process's CPU time while the kernel ran, or its wall time with --clock kernel. With
--trees, FOLDER/SCENE/BUILDER.npz and FOLDER/SCENE/rays160.npz are read where they are there.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

import mibvh
from mibvh.builders import names
from mibvh.collapsing import collapse, unfold
from mibvh.files import write_text
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.trace import Tracer

WIDTHS = (2, 4, 8)


@dataclasses.dataclass
class Timed:
    """One wide tree: what its rays visit on average, and the time of one ray in nanoseconds."""

    width: int
    inner: float
    boxes: float
    tests: float
    ns: float


def main() -> None:
    """Measure the scenes and print the fits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["livingroom@20000", "city_italian@20000"])
    parser.add_argument("--trees", type=Path, help="folder of trees and ray sets")
    parser.add_argument("--lanes", default="simd,scalar")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--clock", choices=("process", "kernel"), default="process")
    parser.add_argument("-o", "--output", type=Path, help="also write the tables here")
    asked = parser.parse_args()
    lines = [f"mibvh {mibvh.__version__}; {os.cpu_count()} CPUs, load {os.getloadavg()[0]:.1f}"]
    lines += [
        "",
        "| scene | lanes | trees | fit | node of 2 | of 4 | of 8 | box beyond two | "
        "ns per triangle | r | error |",
        f"|---|---|---:|---|{'---:|' * 7}",
    ]
    for source in asked.scenes:
        for lanes in asked.lanes.split(","):
            timed = measure(source, asked.trees, lanes, asked.rounds, asked.clock)
            for name, boxes in (("boxes", True), ("nodes alone", False)):
                cells = fitted(timed, boxes)
                row = [_name(source), lanes, str(len(timed)), name, *cells]
                lines.append(f"| {' | '.join(row)} |")
                print(lines[-1], flush=True)
    text = "\n".join(lines)
    print(f"\n{text}")
    if asked.output:
        write_text(asked.output, text + "\n")


def _name(source: str) -> str:
    path = Path(source)
    return path.parent.name if path.name == "scene.xml" else path.stem


# ------------------------------------------------------------ times


def measure(source: str, folder: Path | None, lanes: str, rounds: int, clock: str) -> list[Timed]:
    """Time all wide trees of a scene in turn."""
    scene = mibvh.load(source)
    kept = folder / _name(source) if folder else Path("none")
    file = kept / "rays160.npz"
    rays = (
        mibvh.RaySet.load(file)
        if file.exists()
        else mibvh.diffuse_rays(scene, width=160, height=120, samples=1)
    )
    if lanes == "scalar":  # as many times dearer
        rays = rays.select(slice(None, None, 8))
    scale = float(unit_scale(scene.triangles))
    tracer = Tracer(rays, scale, lanes, style="wide")  # type: ignore[arg-type]
    trees = list(_wide_trees(scene, kept))
    records = [make_records(tree, scene.triangles, "wide") for tree in trees]
    hits = [tracer.hits(record) for record in records]  # compiles, too
    for record in records:
        tracer.run(record)
    seconds = np.array([[getattr(tracer.run(r)[1], clock) for r in records] for _ in range(rounds)])
    relative = np.median(seconds / seconds.mean(axis=1, keepdims=True), axis=0)
    ns = relative * np.median(seconds.mean(axis=1)) / len(rays) * 1e9
    return [
        Timed(
            tree.width,
            float(hit.inner.mean()),
            float(hit.boxes.mean()),
            float(hit.tests.mean()),
            float(time),
        )
        for tree, hit, time in zip(trees, hits, ns, strict=True)
    ]


def _wide_trees(scene: mibvh.Scene, folder: Path) -> Iterator[mibvh.WideTree]:
    for builder in names():
        file = folder / f"{builder}.npz"
        tree = mibvh.Tree.load(file) if file.exists() else mibvh.build(scene, builder)
        single = unfold(tree, scene.triangles)
        for width in WIDTHS:
            yield collapse(tree, width)
            yield collapse(single, width)
            yield collapse(single, width, max_leaf=8, c_inner=4.0)


# ------------------------------------------------------------ fits


def _columns(timed: Sequence[Timed], boxes: bool) -> np.ndarray:
    """(K, P) float64: base, nodes by width, child boxes beyond two per node, triangles."""
    parts = [[1.0] * len(timed)]
    parts += [[t.inner if t.width == width else 0.0 for t in timed] for width in WIDTHS]
    if boxes:
        parts.append([t.boxes - 2 * t.inner for t in timed])
    parts.append([t.tests for t in timed])
    return np.array(parts).T


def _solve(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Weights of least relative errors."""
    return np.asarray(np.linalg.lstsq(x / y[:, None], np.ones(len(y)), rcond=None)[0])


def fitted(timed: Sequence[Timed], boxes: bool, draws: int = 1000) -> Iterable[str]:
    """Cells of a row: costs per triangle with their intervals, r, and the worst relative error."""
    x, y = _columns(timed, boxes), np.array([t.ns for t in timed])
    found = _solve(x, y)
    rng = np.random.default_rng(0)
    # The three collapses of one builder's tree at one width are not independent: drawn together.
    groups = np.arange(len(y)).reshape(-1, 3)
    drawn = []
    for _ in range(draws):
        chosen = groups[rng.integers(0, len(groups), len(groups))].ravel()
        drawn.append(_solve(x[chosen], y[chosen]))
    samples = np.array(drawn)
    costs, spread = found[1:-1] / found[-1], samples[:, 1:-1] / samples[:, -1:]
    low, high = np.percentile(spread, [2.5, 97.5], axis=0)
    cells = [f"{c:.2f} ({a:.2f} to {b:.2f})" for c, a, b in zip(costs, low, high, strict=True)]
    if not boxes:
        cells.append("–")
    a, b = np.percentile(samples[:, -1], [2.5, 97.5])
    predicted = x @ found
    return [
        *cells,
        f"{found[-1]:.2f} ({a:.2f} to {b:.2f})",
        f"{np.corrcoef(predicted, y)[0, 1]:.3f}",
        f"{np.abs(predicted / y - 1).max():.0%}",
    ]


if __name__ == "__main__":
    main()
