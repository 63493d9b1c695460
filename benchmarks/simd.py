"""What a warp in lockstep costs, and what explains how far that is from scalar cost.

    python benchmarks/simd.py SCENE ... --keep simd.json [--trees FOLDER] [--figure simd.svg]

SCENE is whatever `mibvh study` takes. Trees of the nine builders are built, or read from
`FOLDER/SCENE/BUILDER.npz`; rays are made, or read from `FOLDER/SCENE/rays160.npz`. What is
measured is kept in a file: a second run goes on where the first was, and with no scene at all
only the tables are printed. No clock is read: all figures are counts, the same on any machine.

    python benchmarks/simd.py --keep simd.json --timed results.csv

holds them against the times of a study of the same scenes, on any machine and in any variant.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from simd_measured import RUNS, WIDTHS, Row, measure_all, tree_of
from simd_statistics import (
    EQUATIONS,
    F64,
    Scenes,
    centred,
    explained,
    interval,
    pooled_r,
    resampled,
    share,
    slope,
    together,
)

#: The kernels whose deviation from scalar cost is to be explained.
KERNELS = (
    "persistent 32",
    "persistent 32, random",
    "speculative 32",
    "speculative 32, random",
    "single 16",
)
#: What might explain it, each but for a factor that the trees of a scene share.
QUANTITIES = {
    "lcv": "LCV",
    "lcv_mean": "LCV / mean leaves",
    "cost_cv": "std of cost / mean",
    "cost_within": "the same within warps",
    "leaves_within": "std of leaves within warps / mean",
    "leaves_most": "most leaves in a random warp / mean",
    "cost_most": "greatest cost in a random warp / mean",
    "cost_most_real": "greatest cost in a warp as stored / mean",
    "rounds_fetch": "rounds model, fetching",
    "rounds_wait": "rounds model, waiting",
    "rounds_real": "rounds model, waiting, warps as stored",
}
#: Those that are estimates of the deviation itself: nothing is fitted.
ESTIMATES = ("cost_most", "cost_most_real", "rounds_fetch", "rounds_wait", "rounds_real")


def check(source: str, folder: Path | None) -> None:
    """Whether the order of rays, their number, or how warps share them matters: a table."""
    import mibvh
    from mibvh.builders import names
    from mibvh.studies.measure.warps import simulated_rays
    from mibvh.traversal.order import ray_order
    from mibvh.traversal.warp import simulate

    scene = mibvh.load(source)
    rays = mibvh.diffuse_rays(scene, width=160, height=120, samples=4, sort=False)
    sorted_rays = rays.select(ray_order(rays, scene.triangles.bounds, "morton", 0))
    some = sorted_rays.select(simulated_rays(len(rays), 32))
    ways: dict[str, dict[str, Any]] = {
        "as paths are made": {"order": "path"},
        "Morton order": {"order": "morton"},
        "random order": {"order": "random"},
        "Morton order, queues of 16 rays per lane": {"order": "morton", "rays_per_lane": 16},
        "Morton order, one queue for 720 warps": {
            "order": "morton",
            "warps": 720,
            "rays_per_lane": len(rays),
        },
    }
    fewer = f"Morton order, {len(some):,} of the rays, as a study takes them"
    ratios: dict[str, list[float]] = {way: [] for way in (*ways, fewer)}
    for builder in names():
        tree = tree_of(scene, builder, folder)
        alone = simulate(tree, scene, rays, 1, "single").cost()
        for way, options in ways.items():
            ratios[way].append(simulate(tree, scene, rays, 32, **options).cost() / alone)
        single, warps = (
            simulate(tree, scene, some, width, style).cost()
            for width, style in ((1, "single"), (32, "persistent"))
        )
        ratios[fewer].append(warps / single)
    print(f"\n## {scene.name}, {len(rays):,} rays, `persistent 32`: deviation in per cent")
    table(
        ["rays", *names(), "mean utilisation"],
        [
            [way, *(f"{100 * d:+.1f}" for d in centred(r)), f"{np.mean(1 / np.array(r)):.2f}"]
            for way, r in ratios.items()
        ],
    )


def table(headings: list[str], lines: list[list[str]]) -> None:
    """Print a Markdown table."""
    print("\n| " + " | ".join(headings) + " |")
    print("|---|" + "---:|" * (len(headings) - 1))
    for line in lines:
        print("| " + " | ".join(line) + " |")


def deviations(scenes: Scenes) -> None:
    """How far SIMD cost is from scalar, scene by scene."""
    print("\n## Deviation of SIMD from scalar cost\n")
    print("Mean / largest |log(SIMD / scalar) - the scene's mean| over the trees, per cent.")
    lines = []
    for i, name in enumerate(scenes.names):
        cells = [name]
        for kernel in KERNELS:
            d = 100 * np.abs(scenes.deviation(kernel)[i])
            cells.append(f"{d.mean():.1f} / {d.max():.1f}")
        lines.append(cells)
    means = ["**mean**"]
    for kernel in KERNELS:
        every = [100 * np.abs(values) for values in scenes.deviation(kernel)]
        mean, largest = (np.mean([f(v) for v in every]) for f in (np.mean, np.max))
        means.append(f"{mean:.1f} / {largest:.1f}")
    table(["scene", *KERNELS], [*lines, means])


def by_builder(scenes: Scenes) -> None:
    """Mean over the scenes, builder by builder."""
    print("\n## Builders\n")
    print("Mean over the scenes: deviation in per cent; LCV and others as shares of lbvh's.")
    builders = [row.builder for row in scenes.rows[scenes.names[0]]]
    lines = []
    for k, builder in enumerate(builders):
        rows = [scenes.rows[name] for name in scenes.names]
        cells = [builder]
        for kernel in KERNELS:
            cells.append(f"{100 * np.mean([d[k] for d in scenes.deviation(kernel)]):+.1f}")
        lbvh = builders.index("lbvh")
        for quantity in ("lcv", "lcv_mean", "cost_cv", "rounds_fetch"):
            ratios = [r[k].quantities[quantity] / r[lbvh].quantities[quantity] for r in rows]
            cells.append(f"{np.exp(np.mean(np.log(ratios))):.2f}")
        lowest = sum(r[k].lcv == min(row.lcv for row in r) for r in rows)
        cells.append(str(lowest))
        lines.append(cells)
    table(
        [
            "builder",
            *KERNELS,
            "LCV",
            "LCV / mean",
            "cost std / mean",
            "rounds, fetching",
            "scenes with lowest LCV",
        ],
        lines,
    )


def explanations(scenes: Scenes) -> None:
    """Which quantity explains the deviation of which kernel."""
    for kernel in KERNELS:
        y = scenes.deviation(kernel)
        lines = []
        for name, heading in QUANTITIES.items():
            x = scenes.quantity(name)
            raw = explained(x, y, fitted=False) if name in ESTIMATES else None
            lines.append([heading, *_judged(scenes, y, x, explained(x, y), raw)])
        both = together([scenes.quantity("cost_cv"), scenes.quantity("lcv")], y)
        held = explained(both, y, fitted=False)
        lines.append(["std of cost / mean, and LCV", *_judged(scenes, y, both, held, None)])
        for name in EQUATIONS:
            x = scenes.equation(name)
            raw = explained(x, y, fitted=False)
            lines.append([name, *_judged(scenes, y, x, None, raw)])
        print(f"\n## What explains the deviation of `{kernel}`")
        table(
            [
                "quantity",
                "r pooled",
                "95% over scenes",
                "explained, held out",
                "explained as it is",
                "more than LCV held out, 95%",
            ],
            lines,
        )


def slopes(scenes: Scenes) -> None:
    """Exponents of the equations before they are rounded, whichever scene is left out."""
    spread, lcv = scenes.quantity("cost_cv"), scenes.quantity("lcv")
    lines = []
    for kernel in KERNELS:
        y = scenes.deviation(kernel)
        found = [
            (*slope([spread], y, i), *slope([spread, lcv], y, i)) for i in range(len(scenes.names))
        ]
        low, high = np.min(found, axis=0), np.max(found, axis=0)
        lines.append([kernel, *(f"{a:.2f} to {b:.2f}" for a, b in zip(low, high, strict=True))])
    print("\n## Slopes\n\nLeast and greatest, with one scene left out after the other.")
    table(
        ["kernel", "std of cost / mean, alone", "std of cost / mean, with LCV", "LCV"],
        lines,
    )


def _judged(
    scenes: Scenes, y: list[F64], x: list[F64], held: F64 | None, raw: F64 | None
) -> list[str]:
    """Cells of a quantity: r, what it explains, and how much more that is than LCV explains."""
    lcv = explained(scenes.quantity("lcv"), y)
    best = raw if held is None else held
    draws = resampled(len(y))
    rs = [pooled_r([x[i] for i in draw], [y[i] for i in draw]) for draw in draws]
    gains = [] if best is None else [share(best[draw]) - share(lcv[draw]) for draw in draws]
    shares = ["" if squares is None else f"{share(squares):.2f}" for squares in (held, raw)]
    return [f"{pooled_r(x, y):.2f}", interval(rs), *shares, interval(gains)]


def predictions(scenes: Scenes) -> None:
    """How well SAH, EPO and a quantity predict scalar and SIMD cost."""
    for kernel in KERNELS:
        factors = {"": [np.zeros(len(rows)) for rows in scenes.rows.values()]}
        y = scenes.deviation(kernel)
        for quantity in ("lcv", "lcv_mean", "cost_cv", "rounds_fetch", "rounds_wait"):
            x = scenes.quantity(quantity)
            factors[f" x ({QUANTITIES[quantity]})^b, b of the others"] = together([x], y)
        for name in EQUATIONS:
            factors[f" x {name}"] = scenes.equation(name)
        found: dict[str, list[float]] = {}
        for i, name in enumerate(scenes.names):
            for key, value in _correlations(
                scenes.rows[name], kernel, {key: np.exp(f[i]) for key, f in factors.items()}
            ).items():
                found.setdefault(key, []).append(value)
        print(f"\n## r with the cost of `{kernel}`")
        lines = [[key, f"{np.mean(v):.3f}", f"{np.min(v):.3f}"] for key, v in found.items()]
        table(["predictor", "mean r", "least"], lines)


def _correlations(rows: list[Row], kernel: str, factors: dict[str, F64]) -> dict[str, float]:
    """Correlations over the trees of a scene, predictor by predictor."""
    from mibvh.metrics.predictor import fit_alpha, fitted_combination, pearson, predict

    sah, epo, lcv, scalar = (
        np.array([getattr(row, name) for row in rows]) for name in ("sah", "epo", "lcv", "scalar")
    )
    simd = np.array([row.costs[kernel] for row in rows])
    found = {
        "scalar: SAH + EPO": pearson(predict(sah, epo, fit_alpha(sah, epo, scalar)), scalar),
        "SIMD: SAH + EPO + LCV, all weights fitted": pearson(
            fitted_combination([sah, epo, lcv], simd), simd
        ),
    }
    for key, factor in factors.items():
        alpha = fit_alpha(sah, epo, simd / factor)
        found[f"SIMD: (SAH + EPO){key}"] = pearson(predict(sah, epo, alpha) * factor, simd)
    for key, factor in factors.items():
        found[f"SIMD: scalar cost{key}"] = pearson(scalar * factor, simd)
    return found


def widths(scenes: Scenes) -> None:
    """Deviation and utilisation against width."""
    print("\n## Width\n\nBuilders over width: mean deviation in per cent / mean utilisation.")
    builders = [row.builder for row in scenes.rows[scenes.names[0]]]
    lines = []
    for k, builder in enumerate(builders):
        cells = [builder]
        for width in WIDTHS:
            kernel = f"persistent {width}"
            d = 100 * np.mean([values[k] for values in scenes.deviation(kernel)])
            busy = np.mean([scenes.rows[name][k].utilisation[kernel] for name in scenes.names])
            cells.append(f"{d:+.1f} / {busy:.2f}")
        lines.append(cells)
    table(["builder", *map(str, WIDTHS)], lines)


def timed(rows: list[Row], file: Path) -> None:
    """How well simulated cost foretells the SIMD times of a study, and what else does."""
    import pandas as pd

    trees = pd.DataFrame({"scene": [r.scene for r in rows], "builder": [r.builder for r in rows]})
    times = pd.read_csv(file)[["scene", "builder", "scalar_ns", "simd_ns"]].dropna()
    found = trees.reset_index().merge(times, on=["scene", "builder"])
    if found.empty:
        raise SystemExit(f"{file}: no time of a tree that is measured here")
    parts = [part for _, part in found.groupby("scene", sort=False)]
    y = [centred(list(part.simd_ns / part.scalar_ns)) for part in parts]
    print(f"\n## Against the SIMD times of {file}: {len(parts)} scenes, {len(found)} trees\n")
    sizes = [100 * np.abs(d) for d in y]
    mean, largest = (np.mean([f(d) for d in sizes]) for f in (np.mean, np.max))
    print(f"Mean / largest timed deviation of a scene, per cent: {mean:.1f} / {largest:.1f}")
    kernels = ("counted", *(name for name in RUNS if name != "persistent 1"))
    lines, of_scenes = [], {}
    for kernel in kernels:
        costs = [[_cost(rows[i], kernel) for i in part["index"]] for part in parts]
        scalar = [[rows[i].scalar for i in part["index"]] for part in parts]
        x = [centred(list(np.divide(c, s))) for c, s in zip(costs, scalar, strict=True)]
        rs = [np.corrcoef(c, part.simd_ns)[0, 1] for c, part in zip(costs, parts, strict=True)]
        r = "" if kernel == "counted" else f"{pooled_r(x, y):.3f}"
        lines.append([kernel, f"{np.mean(rs):.4f}", f"{np.min(rs):.4f}", r])
        of_scenes[kernel] = rs
    table(["simulated cost", "r with SIMD ns, mean", "least", "r of the deviations, pooled"], lines)
    shown = ("counted", "persistent 32", "single 16", "single 32")
    table(
        ["scene", "SIMD ns/ray", "deviation, mean / largest", *(f"r of {name}" for name in shown)],
        [
            [
                part.scene.iloc[0],
                f"{part.simd_ns.min():.4g} to {part.simd_ns.max():.4g}",
                f"{d.mean():.1f} / {d.max():.1f}",
                *(f"{of_scenes[name][i]:.4f}" for name in shown),
            ]
            for i, (part, d) in enumerate(zip(parts, sizes, strict=True))
        ],
    )
    lines = []
    for quantity, heading in QUANTITIES.items():
        x = [centred([rows[i].quantities[quantity] for i in part["index"]]) for part in parts]
        lines.append([heading, f"{pooled_r(x, y):.3f}", f"{share(explained(x, y)):.2f}"])
    table(["quantity", "r with the timed deviation, pooled", "explained, held out"], lines)


def _cost(row: Row, kernel: str) -> float:
    return row.scalar if kernel == "counted" else row.costs[kernel]


def draw(scenes: Scenes, path: Path) -> None:
    """Deviation and utilisation against width, a curve per builder."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), constrained_layout=True)
    builders = [row.builder for row in scenes.rows[scenes.names[0]]]
    for k, builder in enumerate(builders):
        kernels = [f"persistent {width}" for width in WIDTHS]
        d = [100 * np.mean([v[k] for v in scenes.deviation(kernel)]) for kernel in kernels]
        busy = [
            np.mean([scenes.rows[name][k].utilisation[kernel] for name in scenes.names])
            for kernel in kernels
        ]
        style = "-" if builder in ("bbvh", "sbvh") else "--"
        axes[0].plot(WIDTHS, d, style, marker="o", markersize=3, label=builder)
        axes[1].plot(WIDTHS, busy, style, marker="o", markersize=3)
    for axis, label in zip(axes, ["deviation from scalar cost, %", "utilisation"], strict=True):
        axis.set_xscale("log", base=2)
        axis.set_xticks(WIDTHS, [str(width) for width in WIDTHS])
        axis.set_xlabel("lanes of a warp")
        axis.set_ylabel(label)
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def main() -> None:
    """Measure, and print the tables."""
    from mibvh.builders import names

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--keep", type=Path, default=Path("simd.json"), help="measured so far")
    parser.add_argument("--trees", type=Path, help="folder of trees and rays made before")
    parser.add_argument("--builders", help="comma-separated; the paper's nine by default")
    parser.add_argument("--check", metavar="SCENE", help="only see whether order and queue matter")
    parser.add_argument("--width", type=int, default=160, help="pixels per viewpoint, across")
    parser.add_argument("--timed", type=Path, help="results.csv of a study of the same scenes")
    parser.add_argument("--figure", type=Path, help="where to draw the curves over width")
    arguments = parser.parse_args()
    if arguments.check:
        check(arguments.check, arguments.trees)
        return
    builders = arguments.builders.split(",") if arguments.builders else names()
    rows = measure_all(arguments.scenes, builders, arguments.keep, arguments.trees, arguments.width)
    if arguments.timed:
        timed(rows, arguments.timed)
        return
    scenes = Scenes(rows)
    if not scenes.names:
        raise SystemExit(f"nothing is measured in {arguments.keep}: name scenes")
    if all(row.builder != "lbvh" for row in scenes.rows[scenes.names[0]]):
        raise SystemExit("the tables are relative to lbvh: measure it, too")
    print(f"{len(scenes.names)} scenes, {sum(map(len, scenes.rows.values()))} trees")
    deviations(scenes)
    by_builder(scenes)
    if len(scenes.names) > 1:
        explanations(scenes)
        slopes(scenes)
        predictions(scenes)
    widths(scenes)
    if arguments.figure:
        draw(scenes, arguments.figure)


if __name__ == "__main__":
    main()
