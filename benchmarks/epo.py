"""What exact EPO costs in time, on one thread and on all.

    python benchmarks/epo.py [SCENE ...] [--builder bbvh] [--repeats 5]

SCENE is whatever `mibvh build` takes, or an .npy file of (N, 3, 3) triangles.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import mibvh
from mibvh.environment import cpu_model
from mibvh.metrics.epo import overlap
from mibvh.metrics.sah import node_costs
from mibvh.parallel import thread_count


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["sculpture", "city_italian", "hairball"])
    parser.add_argument("--builder", default="bbvh")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    print(f"mibvh {mibvh.__version__}, {cpu_model()}; medians of {arguments.repeats}\n")
    print(
        "| scene | triangles | EPO | seconds, 1 thread | µs per triangle "
        f"| seconds, {thread_count()} threads | pairs per triangle | boxes | clips |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for scene in arguments.scenes:
        mesh = scene.endswith(".npy")
        triangles = mibvh.Triangles(np.load(scene)) if mesh else mibvh.load(scene).triangles
        tree = mibvh.build(triangles, arguments.builder)
        found = overlap(tree, triangles)  # compiled, and all that is cached on the way is there
        seconds = {}
        for threads in (1, thread_count()):
            times = []
            for _ in range(arguments.repeats):
                started = time.perf_counter()
                overlap(tree, triangles, threads=threads)
                times.append(time.perf_counter() - started)
            seconds[threads] = float(np.median(times))
        n = len(triangles)
        print(
            f"| {Path(scene).stem} | {n:,} | {(node_costs(tree) * found.fraction).sum():.4f} "
            f"| {seconds[1]:.3f} | {seconds[1] / n * 1e6:.2f} | {seconds[thread_count()]:.3f} "
            f"| {found.pairs / n:.1f} | {found.visits / n:.1f} | {found.clips / n:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
