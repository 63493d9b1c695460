"""How many diffuse rays hit the triangle they leave, in scenes moved away from the origin.

    python benchmarks/self_hits.py sponza conference --folder FOLDER

Scenes are FOLDER/SCENE/scene.xml, or what ``mibvh.load`` takes. Moved by so many diagonals of their
box, with their cameras; one line each: the shares by mibvh's kernel and by Mitsuba's intersection.
Uses public functions only, so that it runs with older versions too.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import mibvh

mi.set_variant("llvm_ad_rgb")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--by", type=float, nargs="+", default=[0, 500, 2000])
    asked = parser.parse_args()
    print("scene moved rays | own triangle hit, by mibvh, by Mitsuba | counted cost of lbvh")
    for name in asked.scenes:
        scene = mibvh.load(asked.folder / name / "scene.xml" if asked.folder else name)
        for by in asked.by:
            moved = _moved(scene, by * scene.triangles.diagonal * np.array([0.7, 0.1, 0.7]))
            print(f"{name:12} {by:6g} {_shares(moved)}", flush=True)


def _moved(scene: mibvh.Scene, way: np.ndarray) -> mibvh.Scene:
    triangles = mibvh.Triangles(
        (scene.triangles.corners + way).astype(np.float32), scene.triangles.name
    )
    return mibvh.Scene(scene.name, triangles, [_camera(s, way, scene) for s in scene.sensors])


def _camera(sensor: Any, way: np.ndarray, scene: mibvh.Scene) -> Any:
    matrix = np.array(sensor.world_transform().matrix, dtype=float).reshape(4, 4)
    matrix[:3, 3] += way
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.ravel(mi.traverse(sensor)["x_fov"])[0]),
            "near_clip": 1e-4 * scene.triangles.diagonal,
            "far_clip": 1e6,
            "to_world": mi.ScalarTransform4f(matrix),
            "film": {"type": "hdrfilm", "width": 160, "height": 120},
        }
    )


def _shares(scene: mibvh.Scene) -> str:
    try:
        rays = mibvh.diffuse_rays(scene, width=160, height=120, samples=1)
    except mibvh.MibvhError as error:
        return str(error)
    hits = mibvh.trace(mibvh.build(scene, "lbvh"), scene, rays, repeats=1)
    ray = mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T))
    theirs = scene.geometry.ray_intersect_preliminary(ray, coherent=False)
    by_mitsuba = np.array(theirs.is_valid()) & (np.array(theirs.prim_index) == rays.source)
    ours = (hits.triangle == rays.source).mean()
    return f"{len(rays):7} | {ours:.3%} {by_mitsuba.mean():.3%} | {hits.counted_cost():.2f}"


if __name__ == "__main__":
    main()
