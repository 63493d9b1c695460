"""Figures that others have published, beside exact metrics and counted cost of our trees.

    python benchmarks/published.py SCENE... [--trees DIR] [--size 160x120] [-o TABLE.md]

SCENE is whatever `mibvh build` takes. With --trees DIR, trees are read from DIR/SCENE/BUILDER.npz
where they are there. Scenes and versions of models differ from the published ones, so figures are
relative: to the sweep's tree (`bbvh`) of the same scene.

- SAH and EPO of the sweep, with triangles split up front, and of `sbvh`; costs 1 and 1, and
  (1 - 0.71) SAH + 0.71 EPO, as tinybvh prints them.
- Ray performance (one over the counted cost of diffuse rays) of restructured treelets with splits
  relative to `sbvh` (Karras and Aila 2013: "over 90%"), and of the best trees without and with
  spatial splits relative to `bbvh` and `sbvh` (Wodniok and Goesele 2017: at best 32% and 15%
  faster).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markdown_tables import printed

import mibvh

#: The share of EPO that tinybvh is compiled with.
_ALPHA = 0.71
_PRESPLIT = "bbvh, presplit 0.3"
_OBJECT = ("agglo", "hill", "anneal", "bittner", "treelet")
_SPATIAL = ("sbvh", "streelet", "bittner_sbvh", "bittner_streelet")
_BUILDS: dict[str, Callable[[Any], mibvh.Tree]] = {
    _PRESPLIT: lambda scene: mibvh.build(scene, "bbvh", presplit=0.3)
}


class Figures(NamedTuple):
    """What a tree is, and what rays cost in it."""

    sah: float
    epo: float
    cost: float

    @property
    def blended(self) -> float:
        """Return the one number that tinybvh calls EPO."""
        return (1 - _ALPHA) * self.sah + _ALPHA * self.epo


def figures_of(scene: Any, rays: Any, name: str, folder: Path | None) -> Figures:
    """Build or load a tree, and judge it."""
    file = None if folder is None else folder / scene.name / f"{name}.npz"
    if file is not None and file.exists():
        tree = mibvh.Tree.load(file)
    else:
        tree = _BUILDS.get(name, lambda scene: mibvh.build(scene, name))(scene)
    even = tree.replace(meta={**tree.meta, "c_inner": 1.0, "c_tri": 1.0})
    return Figures(
        mibvh.sah(even),
        mibvh.epo(even, scene.triangles),
        mibvh.trace(tree, scene, rays, repeats=1).counted_cost(),
    )


def predicted(found: dict[str, dict[str, Figures]]) -> list[str]:
    """Return the table of SAH, EPO and cost relative to the sweep's."""
    lines = [
        "| scene | tree | SAH | EPO | blended | relative to the sweep: SAH | EPO | blended "
        "| counted cost |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for scene, trees in found.items():
        sweep = trees["bbvh"]
        for name in ("bbvh", _PRESPLIT, "sbvh"):
            f = trees[name]
            shares = (f.sah / sweep.sah, f.epo / sweep.epo, f.blended / sweep.blended)
            lines.append(
                f"| {scene} | {name} | {f.sah:.2f} | {f.epo:.2f} | {f.blended:.2f} | "
                + " | ".join(f"{share:.3f}" for share in (*shares, f.cost / sweep.cost))
                + " |"
            )
    return lines


def performance(found: dict[str, dict[str, Figures]]) -> list[str]:
    """Return the table of speeds relative to `bbvh` and `sbvh`."""
    rows = {}
    for scene, trees in found.items():
        sweep, split = trees["bbvh"].cost, trees["sbvh"].cost
        rows[scene] = (
            split / trees["streelet"].cost,
            sweep / min(trees[name].cost for name in _OBJECT),
            sweep / min(trees[name].cost for name in _SPATIAL),
            split / min(trees[name].cost for name in _SPATIAL),
        )
    rows["geometric mean"] = tuple(np.exp(np.log(list(rows.values())).mean(axis=0)))
    return [
        "| scene | `streelet` / `sbvh` | best without splits / `bbvh` "
        "| best with splits / `bbvh` | best with splits / `sbvh` |",
        "|---|---:|---:|---:|---:|",
        *(
            f"| {scene} | " + " | ".join(f"{value:.3f}" for value in values) + " |"
            for scene, values in rows.items()
        ),
    ]


def main() -> None:
    """Print both tables, and write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--trees", type=Path)
    parser.add_argument("--size", default="160x120")
    parser.add_argument("-o", "--output", type=Path)
    chosen = parser.parse_args()
    width, height = map(int, chosen.size.split("x"))
    found: dict[str, dict[str, Figures]] = {}
    for source in chosen.scenes:
        scene = mibvh.load(source)
        rays = mibvh.diffuse_rays(scene, width=width, height=height, samples=1)
        names = ("bbvh", _PRESPLIT, *_OBJECT, *_SPATIAL)
        found[scene.name] = {name: figures_of(scene, rays, name, chosen.trees) for name in names}
        print(f"{scene.name}: done", flush=True)
    printed([*predicted(found), "", *performance(found)], chosen.output)


if __name__ == "__main__":
    main()
