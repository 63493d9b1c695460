"""The kernels beside Mitsuba's own intersection (Embree): the same rays, interleaved, kernel times.

python benchmarks/traversal.py [SCENE ...] [--style single,wide] [--builder sbvh] [-o TABLES.md]
    [--variant cuda_ad_rgb] [--rays FOLDER]

On a GPU, Mitsuba intersects by OptiX. Where that is missing, its column is empty, and rays have to
come from files, FOLDER/SCENE.npz (`mibvh rays`); scenes may be meshes then.
"""

from __future__ import annotations

import argparse
import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

DEFAULT_SCENES = ["livingroom", "city_italian", "sculpture", "hairball", "powerplant", "vegetation"]


def mitsuba_seconds(scene: Any, ray: Any) -> float:
    """Kernel time of one launch of Mitsuba's own intersection; NaN where it cannot be had."""
    import drjit as dr

    from mibvh.variant import mitsuba_traces

    if not mitsuba_traces():
        return float("nan")

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        hit = scene.geometry.ray_intersect_preliminary(ray, coherent=False)
        dr.eval(hit.t, hit.prim_index)
        dr.sync_thread()
        return sum(k["execution_time"] for k in dr.kernel_history([dr.KernelType.JIT])) / 1e3


def different(hits: Any, theirs: Any, diagonal: float) -> int:
    """Rays whose hits are not at the same distance, or that only one of the two hits."""
    both = np.isfinite(theirs) & np.isfinite(hits)
    differ = np.isinf(theirs) != np.isinf(hits)
    differ[both] |= np.abs(theirs[both] - hits[both]) > 1e-3 * theirs[both] + 1e-6 * diagonal
    return int(differ.sum())


def measure(
    source: str, styles: list[str], builder: str, rounds: int, folder: Path | None
) -> dict[str, Any]:
    """Measure one scene in all styles."""
    import mibvh
    from mibvh.traversal.records import make_records, unit_scale
    from mibvh.traversal.trace import Tracer
    from mibvh.variant import mitsuba, mitsuba_traces

    mi = mitsuba()
    scene = mibvh.load(source)
    triangles = scene.triangles
    rays = mibvh.read_rays(folder / f"{scene.name}.npz") if folder else mibvh.diffuse_rays(scene)
    tree = mibvh.build(triangles, builder)
    ray = mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T), mi.Float(rays.tmax), 0, [])
    theirs = None
    if mitsuba_traces():
        theirs = np.array(scene.geometry.ray_intersect_preliminary(ray, coherent=False).t)
    hits = {style: mibvh.trace(tree, triangles, rays, style=style, repeats=1) for style in styles}
    tracers = [Tracer(rays, float(unit_scale(triangles)), style=style) for style in styles]
    layouts = {tracer.layout for tracer in tracers}
    records = {layout: make_records(tree, triangles, layout) for layout in layouts}
    times = np.array(
        [
            [tracer.run(records[tracer.layout])[1].kernel for tracer in tracers]
            + [mitsuba_seconds(scene, ray)]
            for _ in range(rounds + 1)
        ]
    )[1:]  # the first round warms up
    return {
        "scene": scene.name,
        "triangles": len(triangles),
        "rays": len(rays),
        "hits": hits,
        "mrays": len(rays) / np.median(times, axis=0) / 1e6,
        "ratio": np.median(times[:, -1:] / times[:, :-1], axis=0),
        "different": ""
        if theirs is None
        else max(different(h.t, theirs, triangles.diagonal) for h in hits.values()),
    }


def table(
    found: list[dict[str, Any]], columns: list[str], cells: Callable[[dict[str, Any]], list[str]]
) -> list[str]:
    """Lines of a Markdown table with a row per scene."""
    lines = ["", f"| scene | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
    return lines + [f"| {scene['scene']} | {' | '.join(cells(scene))} |" for scene in found]


def tables(found: list[dict[str, Any]], styles: list[str], theirs: str) -> list[str]:
    """All tables: speed, and what explains it."""
    means = np.exp(np.log([scene["ratio"] for scene in found]).mean(axis=0))
    number = lambda value: f"{value:.2f}" if np.isfinite(value) else "–"  # noqa: E731
    return [
        "",
        f"Speed as a share of that of Mitsuba's own intersection ({theirs}):",
        *table(
            found,
            ["triangles", "rays", f"{theirs} Mrays/s", *styles, "different hits"],
            lambda s: [
                f"{s['triangles']:,}",
                f"{s['rays']:,}",
                number(s["mrays"][-1]),
                *(number(ratio) for ratio in s["ratio"]),
                str(s["different"]),
            ],
        ),
        f"| geometric mean | | | | {' | '.join(number(mean) for mean in means)} | |",
        "",
        "Million rays per second:",
        *table(found, styles, lambda s: [f"{speed:.2f}" for speed in s["mrays"][:-1]]),
        "",
        "Share of the issued lane-steps in which the lane had work:",
        *table(
            found,
            styles,
            lambda s: [f"{s['hits'][style].lane_utilisation:.2f}" for style in styles],
        ),
        "",
        "Inner nodes and triangles per ray:",
        *table(
            found,
            styles,
            lambda s: [
                f"{s['hits'][style].inner.mean():.1f} + {s['hits'][style].tests.mean():.1f}"
                for style in styles
            ],
        ),
    ]


def machine(here: dict[str, Any]) -> str:
    """What the kernels run on: the processor, or the graphics card."""
    if here["llvm"]:
        return f"{here['cpu']}, {here['threads']} threads, LLVM {here['llvm']}"
    return f"{here['gpu']}, {here['variant']}"


def main() -> None:
    """Make the tables."""
    from mibvh.environment import environment
    from mibvh.traversal.styles import STYLES
    from mibvh.variant import backend, use_variant

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=DEFAULT_SCENES)
    parser.add_argument("--style", default=",".join(STYLES), help="comma-separated")
    parser.add_argument("--builder", default="sbvh")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--variant", help="of Mitsuba: llvm_ad_rgb, cuda_ad_rgb, ...")
    parser.add_argument("--rays", type=Path, metavar="FOLDER", help="of files SCENE.npz")
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    if arguments.variant:
        use_variant(arguments.variant)
    styles, here, found = arguments.style.split(","), environment(), []
    for source in arguments.scenes:
        found.append(measure(source, styles, arguments.builder, arguments.rounds, arguments.rays))
        speeds = zip(styles, found[-1]["mrays"], strict=False)
        print(found[-1]["scene"], *(f"{style} {speed:.2f}" for style, speed in speeds), flush=True)
    lines = [
        f"mibvh {here['mibvh']}, `{arguments.builder}` trees, {machine(here)}, "
        f"{here['lane_width']} lanes, "
        f"{datetime.date.today().isoformat()}; medians of {arguments.rounds} interleaved rounds.",
        *tables(found, styles, "Embree" if backend() == "llvm" else "OptiX"),
    ]
    print("", *lines, sep="\n")
    if arguments.output:
        arguments.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
