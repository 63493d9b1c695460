"""How many rays are enough for EPO at ray ends and for SAH of the rays' lines.

    python benchmarks/few_rays.py [SCENE ...] [--rays 100000] [--repeats 20]

Random subsets of a scene's ray set against all of it: the root mean square relative error, over
the subsets and the nine trees, and the lowest Pearson r with counted cost of any subset.
"""

from __future__ import annotations

import argparse

import numpy as np

import mibvh
from mibvh.builders import names
from mibvh.metrics.lines import line_costs
from mibvh.metrics.points import point_costs
from mibvh.metrics.predictor import fit_alpha, pearson, predict


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", default=["livingroom@20000", "city_italian@20000", "stadium@20000"]
    )
    parser.add_argument("--rays", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=20)
    arguments = parser.parse_args()
    print(
        "| scene | rays | EPO at starts | EPO by density | SAH of lines "
        "| lowest r, ray ends | lowest r, finite by lines |\n|---|---:|---:|---:|---:|---:|---:|"
    )
    for name in arguments.scenes:
        measure(mibvh.load(name), arguments.rays, arguments.repeats)


def measure(scene: mibvh.Scene, count: int, repeats: int) -> None:
    """Print the rows of one scene."""
    triangles = scene.triangles
    rays = mibvh.diffuse_rays(scene, width=160, height=120)
    rng = np.random.default_rng(0)
    rays = rays.select(rng.permutation(len(rays))[:count])
    trees = [mibvh.build(triangles, builder) for builder in names()]
    sah = [mibvh.sah(tree) for tree in trees]
    cost, at_starts, at_lines, query = [], [], [], []
    for tree in trees:
        hits = mibvh.trace(tree, triangles, rays, repeats=1)
        starts, _ = mibvh.ray_ends(triangles, rays, hits)
        lines = mibvh.ray_lines(triangles, rays, hits)
        found = point_costs(tree, triangles, starts.points, starts.triangle)
        cost.append(hits.counted_cost())
        at_starts.append(found[:, 0])
        query.append(found.sum(axis=1))
        at_lines.append(line_costs(tree, lines))
    starts_all, lines_all, queries = np.array(at_starts), np.array(at_lines), np.array(query)
    share = lines.share
    even = lines_all @ share / share.sum()
    weighed = mibvh.epo(trees[0], triangles, weights=starts.density(triangles))
    for k in (100, 1_000, 10_000):
        errors, by_density, of_lines, r_ends, r_lines = [], [], [], [], []
        for repeat in range(repeats):
            chosen = rng.choice(len(rays), k, replace=False)
            epo = starts_all[:, chosen].mean(axis=1)
            along = lines_all[:, chosen] @ share[chosen]
            errors.append(epo / starts_all.mean(axis=1) - 1)
            of_lines.append(along / share[chosen].sum() / even - 1)
            r_ends.append(pearson(predict(sah, epo, fit_alpha(sah, epo, cost)), cost))
            r_lines.append(pearson(along / k + queries[:, chosen].mean(axis=1), cost))
            if repeat < 5:
                few = mibvh.RayEnds(starts.points[chosen], starts.triangle[chosen], k)
                density = few.density(triangles)
                by_density.append(mibvh.epo(trees[0], triangles, weights=density) / weighed - 1)
        rms = [float(np.sqrt(np.mean(np.square(e)))) for e in (errors, by_density, of_lines)]
        print(
            f"| {scene.name} | {k:,} | "
            + " | ".join(f"{e:.1%}" for e in rms)
            + f" | {min(r_ends):.3f} | {min(r_lines):.3f} |",
            flush=True,
        )
    epo = starts_all.mean(axis=1)
    ends_r = pearson(predict(sah, epo, fit_alpha(sah, epo, cost)), cost)
    lines_r = pearson(lines_all @ share / len(rays) + queries.mean(axis=1), cost)
    print(f"| {scene.name} | {len(rays):,} | – | – | – | {ends_r:.3f} | {lines_r:.3f} |")


if __name__ == "__main__":
    main()
