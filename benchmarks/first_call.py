"""From the first call to the first hits: with an empty kernel cache, and in a new process with it.

python benchmarks/first_call.py [--style single ...] [--rays 100000] [--runs 3]
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def first_call(style: str, rays: int) -> float:
    """Seconds of the first :func:`mibvh.trace` in this process."""
    import mibvh

    scene = mibvh.load("livingroom@20000")
    triangles = scene.triangles
    some = mibvh.diffuse_rays(scene, width=320, height=240, samples=2)
    tree = mibvh.build(triangles, "bbvh")
    begin = time.perf_counter()
    hits = mibvh.trace(tree, triangles, some.select(slice(rays)), style=style, repeats=1)
    assert (hits.triangle >= 0).any()
    return time.perf_counter() - begin


def in_new_process(style: str, rays: int, home: Path) -> float:
    """The same, with Dr.Jit's kernel cache (``~/.drjit``) in a folder."""
    child = [sys.executable, __file__, "--style", style, "--rays", str(rays), "--child"]
    environ = os.environ | {"HOME": str(home)}
    output = subprocess.run(child, env=environ, capture_output=True, text=True, check=True).stdout
    return float(output.split()[-1])


def main() -> None:
    """Measure every style."""
    from mibvh.traversal.styles import STYLES

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--style", nargs="+", default=list(STYLES))
    parser.add_argument("--rays", type=int, default=100_000)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        print(first_call(arguments.style[0], arguments.rays))
        return
    print("| style | empty kernel cache, s | new process, s |", "|---|---:|---:|", sep="\n")
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for style in arguments.style:
            in_new_process(style, arguments.rays, home)  # Numba compiles; not measured here
            empty, cached = [], []
            for _ in range(arguments.runs):
                shutil.rmtree(home / ".drjit")
                empty.append(in_new_process(style, arguments.rays, home))
                cached.append(in_new_process(style, arguments.rays, home))
            medians = statistics.median(empty), statistics.median(cached)
            print(f"| {style} | {medians[0]:.2f} | {medians[1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
