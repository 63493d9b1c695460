"""Exact EPO against an estimate from points, which shares no geometry with it.

    python benchmarks/epo_check.py SCENE ... [--builders bbvh,sbvh] [--points 400000]

SCENE is whatever `mibvh build` takes, or an .npy file of (N, 3, 3) triangles. With
``--trees "DIR/{scene}/{builder}.npz"`` trees are loaded instead of built; the scene is the stem of
its file, or its folder's name where the file is a scene.xml. Ends with exit code 1 if any tree is
further off than ``--errors`` standard errors.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import mibvh

_NINE = "bbvh,sbvh,agglo,lbvh,hill,anneal,bittner,treelet,streelet"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--builders", default=_NINE)
    parser.add_argument("--points", type=int, default=400_000)
    parser.add_argument("--errors", type=float, default=3.0)
    parser.add_argument("--trees")
    arguments = parser.parse_args()
    print("| scene | tree | references per triangle | exact | from points | off by errors |")
    print("|---|---|---:|---:|---:|---:|")
    worst = 0.0
    for scene in arguments.scenes:
        path = Path(scene)
        name = path.parent.name if path.name == "scene.xml" else path.stem
        mesh = path.suffix == ".npy"
        triangles = mibvh.Triangles(np.load(path)) if mesh else mibvh.load(scene).triangles
        for builder in arguments.builders.split(","):
            if arguments.trees:
                tree = mibvh.Tree.load(arguments.trees.format(scene=name, builder=builder))
            else:
                tree = mibvh.build(triangles, builder)
            exact = mibvh.epo(tree, triangles)
            estimate = mibvh.estimate_epo(tree, triangles, arguments.points)
            off = (exact - estimate.value) / max(estimate.standard_error, 1e-12)
            worst = max(worst, abs(off))
            print(
                f"| {name} | {builder} | {len(tree.references) / len(triangles):.3f} "
                f"| {exact:.4f} | {estimate.value:.4f} ±{estimate.standard_error:.4f} "
                f"| {off:+.2f} |",
                flush=True,
            )
    print(f"\nworst: {worst:.2f} standard errors of {arguments.points:,} points")
    sys.exit(worst > arguments.errors)


if __name__ == "__main__":
    main()
