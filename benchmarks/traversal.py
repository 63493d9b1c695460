"""The kernel beside Mitsuba's own intersection (Embree): the same rays, interleaved, kernel times.

python benchmarks/traversal.py [SCENE ...] [--builder sbvh] [--rounds 9] [-o TABLE.md]
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path
from typing import Any

import numpy as np

DEFAULT_SCENES = ["livingroom", "city_italian", "sculpture", "hairball", "powerplant", "vegetation"]


def embree_seconds(scene: Any, ray: Any) -> float:
    """Kernel time of one launch of Mitsuba's own intersection."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        hit = scene.geometry.ray_intersect_preliminary(ray, coherent=False)
        dr.eval(hit.t, hit.prim_index)
        dr.sync_thread()
        return sum(k["execution_time"] for k in dr.kernel_history([dr.KernelType.JIT])) / 1e3


def row(source: str, builder: str, rounds: int) -> tuple[str, float]:
    """Measure one scene; returns a row of the table and the ratio of speeds."""
    import mibvh
    from mibvh.traversal.records import make_records, unit_scale
    from mibvh.traversal.trace import Tracer
    from mibvh.variant import mitsuba

    mi = mitsuba()
    scene = mibvh.load(source)
    rays = mibvh.diffuse_rays(scene)
    tree = mibvh.build(scene.triangles, builder)
    records = make_records(tree, scene.triangles)
    tracer = Tracer(rays, float(unit_scale(scene.triangles)))
    hits = mibvh.trace(tree, scene.triangles, rays, repeats=1)
    ray = mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T))
    theirs = scene.geometry.ray_intersect_preliminary(ray, coherent=False)
    t = np.array(theirs.t)
    both = np.isfinite(t) & np.isfinite(hits.t)
    differ = np.isinf(t) != np.isinf(hits.t)
    differ[both] |= (
        np.abs(t[both] - hits.t[both]) > 1e-3 * t[both] + 1e-6 * scene.triangles.diagonal
    )
    times = np.array(
        [(tracer.run(records)[1], embree_seconds(scene, ray)) for _ in range(rounds + 1)]
    )[1:]
    ours, embree = len(rays) / np.median(times, axis=0) / 1e6
    ratio = np.median(times[:, 1] / times[:, 0])
    return (
        f"| {scene.name} | {len(scene.triangles):,} | {len(rays):,} | {ours:.2f} | {embree:.2f} "
        f"| {ratio:.2f} | {hits.lane_utilisation:.2f} | {hits.inner.mean():.1f} "
        f"| {hits.tests.mean():.1f} | {int(differ.sum())} |"
    ), ratio


def main() -> None:
    """Make the table."""
    from mibvh.environment import environment

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=DEFAULT_SCENES)
    parser.add_argument("--builder", default="sbvh")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    here = environment()
    lines = [
        f"mibvh {here['mibvh']}, `{arguments.builder}` trees, {here['cpu']}, {here['threads']} "
        f"threads, LLVM {here['llvm']}, {here['lane_width']} lanes, "
        f"{datetime.date.today().isoformat()}; medians of {arguments.rounds} interleaved rounds",
        "",
        "| scene | triangles | rays | mibvh Mrays/s | Embree Mrays/s | ratio | lanes busy "
        "| inner per ray | triangles per ray | different hits |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    ratios = []
    for source in arguments.scenes:
        line, ratio = row(source, arguments.builder, arguments.rounds)
        lines.append(line)
        ratios.append(ratio)
        print(line, flush=True)
    lines += ["", f"Geometric mean of the ratios: {np.exp(np.mean(np.log(ratios))):.2f}"]
    print(lines[-1])
    if arguments.output:
        arguments.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
