"""Simulated executions of trees, kept in a file: what `simd.py` prints tables of."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

WIDTHS = (1, 4, 8, 16, 32, 64)
#: Simulated executions: style, width, order of the rays.
RUNS: dict[str, tuple[str, int, str]] = {
    **{f"persistent {w}": ("persistent", w, "stored") for w in WIDTHS},
    "persistent 32, random": ("persistent", 32, "random"),
    "speculative 32": ("speculative", 32, "stored"),
    "speculative 32, random": ("speculative", 32, "random"),
    "while-while 32": ("while-while", 32, "stored"),
    "single 32": ("single", 32, "stored"),
    "single 16": ("single", 16, "stored"),
}


@dataclasses.dataclass
class Row:
    """One tree of one scene."""

    scene: str
    builder: str
    triangles: int
    rays: int
    sah: float
    epo: float
    lcv: float
    scalar: float
    costs: dict[str, float]
    utilisation: dict[str, float]
    quantities: dict[str, float]


def measure(scene: Any, builder: str, rays: Any, folder: Path | None) -> Row:
    """Simulate all executions of one tree."""
    import mibvh
    from mibvh.metrics.points import estimate_epo
    from mibvh.traversal import divergence
    from mibvh.traversal.warp import ray_rounds, simulate

    tree = tree_of(scene, builder, folder)
    alone = simulate(tree, scene, rays, 1, "single")
    cost = 1.2 * alone.inner + alone.tests
    rounds = ray_rounds(tree, scene, rays)
    stored = np.arange(len(rays), dtype=np.int32)
    mean_leaves = float(alone.leaves.mean())
    runs = {
        name: simulate(tree, scene, rays, width, style, order=order)  # type: ignore[arg-type]
        for name, (style, width, order) in RUNS.items()
    }
    for name, run in runs.items():
        if (run.t != alone.t).any() or (run.triangle != alone.triangle).any():
            raise SystemExit(f"{scene.name}, {builder}, {name}: hits differ from scalar ones")
    return Row(
        scene.name,
        builder,
        len(scene.triangles),
        len(rays),
        mibvh.sah(tree),
        # From points: of trees that split triangles, too.
        estimate_epo(tree, scene, 200_000).value,
        alone.lcv,
        alone.cost(),
        {name: run.cost() for name, run in runs.items()},
        {name: run.utilisation() for name, run in runs.items()},
        {
            "lcv": alone.lcv,
            "lcv_mean": alone.lcv / mean_leaves,
            "cost_cv": divergence.relative_deviation(cost),
            "cost_within": divergence.within_packets(cost, 32),
            "leaves_within": divergence.within_packets(alone.leaves, 32),
            "leaves_most": divergence.expected_maximum(alone.leaves, 32),
            "cost_most": divergence.expected_maximum(cost, 32),
            "cost_most_real": divergence.packet_maximum(cost, 32),
            "rounds_fetch": divergence.rounds_cost(rounds, 32, fetch=True) / alone.cost(),
            "rounds_wait": divergence.rounds_cost(rounds, 32, fetch=False) / alone.cost(),
            "rounds_real": divergence.rounds_cost(rounds, 32, fetch=False, dealt=stored)
            / alone.cost(),
        },
    )


def tree_of(scene: Any, builder: str, folder: Path | None) -> Any:
    """Tree that was built before, or a new one."""
    import mibvh

    file = folder / scene.name / f"{builder}.npz" if folder else None
    return mibvh.Tree.load(file) if file and file.exists() else mibvh.build(scene, builder)


def rays_of(scene: Any, folder: Path | None, width: int) -> Any:
    """Rays that were made before, or new ones."""
    import mibvh

    file = folder / scene.name / "rays160.npz" if folder else None
    if file and file.exists():
        return mibvh.RaySet.load(file)
    return mibvh.diffuse_rays(scene, width=width, height=3 * width // 4, samples=1)


def measure_all(
    sources: list[str], builders: list[str], keep: Path, folder: Path | None, width: int
) -> list[Row]:
    """Measure the trees that are not in the file yet, and keep them."""
    import mibvh
    from mibvh.files import atomic_path

    rows = [Row(**row) for row in json.loads(keep.read_text())] if keep.exists() else []
    for source in sources:
        scene, rays = mibvh.load(source), None
        for builder in builders:
            if any((row.scene, row.builder) == (scene.name, builder) for row in rows):
                continue
            rays = rays or rays_of(scene, folder, width)
            rows.append(measure(scene, builder, rays, folder))
            print(scene.name, builder, f"{rows[-1].costs['persistent 32']:.2f}", flush=True)
            with atomic_path(keep) as temporary:
                temporary.write_text(json.dumps([dataclasses.asdict(row) for row in rows]))
    return rows
