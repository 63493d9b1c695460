"""On a GPU: every style in a process of its own, against the simulation, which needs none.

Scenes and rays come from NumPy: the machine may have neither LLVM nor OptiX.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from cuts import cut

import mibvh
from mibvh.loading import read_mesh
from mibvh.traversal.styles import STYLES
from mibvh.traversal.warp import simulate

pytestmark = pytest.mark.cuda
VARIANT = "cuda_ad_rgb"
LANES = 32

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


def rays_within(triangles, count=4099):
    """Rays from anywhere in the box to anywhere; as many as fill no packet."""
    rng = np.random.default_rng(5)
    lower, upper = triangles.bounds.astype(np.float64)
    o, to = (lower + (upper - lower) * rng.random((count, 3)) for _ in range(2))
    return mibvh.RaySet(o, to - o, meta={"digest": triangles.digest})


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("builder", ["bbvh", "sbvh, all splits"])
@pytest.mark.parametrize("name", ["pipes", "needles"])
def test_hits_and_counts_are_those_of_the_simulation(tmp_path, name, builder, style):
    scene, tree = cut(name, "sbvh, all splits")
    if builder == "bbvh":
        tree = mibvh.build(scene, "bbvh")
    rays = rays_within(scene)
    np.save(tmp_path / "corners.npy", scene.corners)
    tree.save(tmp_path / "tree.npz")
    rays.save(tmp_path / "rays.npz")
    child = subprocess.run(
        [sys.executable, "-c", _CHILD, str(tmp_path), style],
        capture_output=True,
        text=True,
        env=os.environ | {"MIBVH_VARIANT": VARIANT},
        check=True,
    )
    told = json.loads(child.stdout.splitlines()[-1])
    assert told["lanes"] == LANES
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


def test_a_study_of_given_rays(tmp_path):
    scene, _ = cut("pipes", "sbvh")
    mesh = tmp_path / "pipes.ply"
    faces = np.arange(3 * len(scene)).reshape(-1, 3)
    trimesh.Trimesh(scene.corners.reshape(-1, 3), faces, process=False).export(mesh)
    rays_within(read_mesh(mesh)[0], 400_000).save(tmp_path / "rays.npz")
    told = subprocess.run(
        [
            sys.executable,
            "-m",
            "mibvh",
            "study",
            str(mesh),
            "-o",
            str(tmp_path / "out"),
            "--rays",
            str(tmp_path / "rays.npz"),
            "--builders",
            "bbvh,sbvh",
            "--seconds",
            "1",
            "--variant",
            VARIANT,
            "--json",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    result = json.loads(told.stdout.splitlines()[-1])
    assert result["audit_failures"] == []
    machine = json.loads((tmp_path / "out" / "environment.json").read_text())
    assert machine["variant"] == VARIANT
    assert machine["lane_width"] == LANES
    for tree in result["trees"]:
        # One lane of a packet does the work of all: that takes longer, and not as many times.
        assert 1 < tree["scalar_ns"] / tree["simd_ns"] < LANES
