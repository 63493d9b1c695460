"""On a GPU: every style in a process of its own, against the simulation, which needs none."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import mibvh
from mibvh.traversal.styles import STYLES
from mibvh.traversal.warp import simulate

pytestmark = pytest.mark.cuda

_CHILD = """
import json, sys
import mibvh
from mibvh.variant import lane_width

folder, style = sys.argv[1:]
scene = mibvh.Triangles(__import__("numpy").load(folder + "/corners.npy"))
tree, rays = mibvh.Tree.load(folder + "/tree.npz"), mibvh.RaySet.load(folder + "/rays.npz")
for lanes in ("simd", "scalar"):
    hits = mibvh.trace(tree, scene, rays, lanes, style=style, repeats=3)
    hits.save(f"{folder}/{lanes}.npz")
print(json.dumps({"lanes": lane_width(), "seconds": hits.seconds.tolist()}))
"""


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("builder", ["bbvh", "sbvh"])
def test_hits_and_counts_are_those_of_the_simulation(tmp_path, builder, style):
    scene = mibvh.load("livingroom@3000")
    tree = mibvh.build(scene, builder)
    rays = mibvh.diffuse_rays(scene, width=64, height=48)
    np.save(tmp_path / "corners.npy", scene.triangles.corners)
    tree.save(tmp_path / "tree.npz")
    rays.save(tmp_path / "rays.npz")
    child = subprocess.run(
        [sys.executable, "-c", _CHILD, str(tmp_path), style],
        capture_output=True,
        text=True,
        env=os.environ | {"MIBVH_VARIANT": "cuda_ad_rgb"},
        check=True,
    )
    told = json.loads(child.stdout.splitlines()[-1])
    assert told["lanes"] == 32
    assert min(told["seconds"]) > 0
    alike = "drjit-speculative" if style == "speculative" else "single"
    expected = simulate(tree, scene, rays, 1, alike)
    simd, scalar = (np.load(tmp_path / f"{lanes}.npz") for lanes in ("simd", "scalar"))
    for name in ("t", "triangle", "inner", "leaves", "tests"):
        np.testing.assert_array_equal(simd[name], scalar[name])
    # A GPU may contract a product and a sum: a box, or an edge, grazed within a rounding.
    assert (simd["triangle"] == expected.triangle).mean() > 0.999
    if style != "wide":
        for name in ("inner", "leaves", "tests"):
            assert (simd[name] == getattr(expected, name)).mean() > 0.99
