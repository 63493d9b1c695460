"""How fast the builders are, and how good their trees: one table, with the machine it is from.

    python benchmarks/builders.py [SCENE ...] [--builders a,b] [--repeats 5] [-o TABLE.md]

SCENE is whatever `mibvh build` takes, or an .npy file of (N, 3, 3) triangles. Every scene and
builder gets a process of its own, so that its peak memory is known; build times are of the
compiled code, medians over the repeats, with one Numba thread and with all of them.
"""

from __future__ import annotations

import argparse
import datetime
import json
import subprocess
import sys
from pathlib import Path

DEFAULT_SCENES = ["sculpture@70000", "city_italian@270000", "powerplant@1000000"]


def one(scene: str, name: str, repeats: int) -> dict[str, float]:
    """Build one scene with one builder; run in a process of its own."""
    import resource

    import numba
    import numpy as np

    import mibvh

    mesh = scene.endswith(".npy")
    triangles = mibvh.Triangles(np.load(scene)) if mesh else mibvh.load(scene).triangles
    assert triangles.digest  # hashed once, before the clock runs
    seconds = {}
    for threads in (1, numba.config.NUMBA_NUM_THREADS):
        numba.set_num_threads(threads)
        trees = [mibvh.build(triangles, name) for _ in range(repeats)]
        seconds[threads] = float(np.median([tree.meta["build_seconds"] for tree in trees]))
    return {
        "triangles": len(triangles),
        "one": seconds[1],
        "all": seconds[numba.config.NUMBA_NUM_THREADS],
        "threads": numba.config.NUMBA_NUM_THREADS,
        "sah": mibvh.sah(trees[0]),
        "references": len(trees[0].references),
        "depth": trees[0].depth,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=DEFAULT_SCENES)
    parser.add_argument("--builders", default="")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--one", nargs=2, metavar=("SCENE", "BUILDER"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(one(*arguments.one, arguments.repeats)))
        return
    from mibvh.builders import names
    from mibvh.environment import cpu_model
    from mibvh.version import __version__

    builders = [name for name in arguments.builders.split(",") if name] or names()
    lines = [
        f"mibvh {__version__}, {cpu_model()}, {datetime.date.today().isoformat()}; "
        f"medians of {arguments.repeats}",
        "",
        "| scene | triangles | builder | seconds, 1 thread | M triangles/s | all threads "
        "| speed-up | SAH | references | depth | peak GB |",
        "|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for scene in arguments.scenes:
        for name in builders:
            command = [sys.executable, __file__, "--one", scene, name]
            ran = subprocess.run(
                [*command, "--repeats", str(arguments.repeats)], capture_output=True, text=True
            )
            if ran.returncode:
                raise SystemExit(f"{scene}, {name}: {ran.stderr.strip().splitlines()[-1]}")
            r = json.loads(ran.stdout)
            lines.append(
                f"| {Path(scene).stem} | {r['triangles']:,} | {name} | {r['one']:.3f} "
                f"| {r['triangles'] / r['one'] / 1e6:.3g} | {r['all']:.3f} "
                f"| {r['one'] / r['all']:.2f} | {r['sah']:.2f} "
                f"| {r['references'] / r['triangles']:.3f} | {r['depth']} | {r['gigabytes']:.2f} |"
            )
            print(lines[-1], file=sys.stderr, flush=True)
    text = "\n".join(lines) + "\n"
    if arguments.output:
        arguments.output.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
