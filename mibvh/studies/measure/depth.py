"""What top-down builders optimise: the worst case that remains as a tree goes down.

A top-down sweep minimises ``T_left A_left / A_root + T_right A_right / A_root``: what the triangles
would cost if both sides became leaves (slides, "What do top-down builders optimize?"). Cutting a
finished tree, with what is below the cut taken as leaves, shows how soon it gets there.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
import pandas as pd

from mibvh.metrics.sah import sah_per_node
from mibvh.tree import Tree
from mibvh.triangles import F64

#: Numbers of splits after which the worst case is taken: complete trees of 1, 2, ... levels.
SPLITS = tuple(2**level - 1 for level in range(13))


def worst_cases(tree: Tree) -> F64:
    """``C_tri T_n A_n / A_root`` of each node: what it would cost as a leaf.

    Returns
    -------
    (M,) float64
        ``T_n`` are the references below the node.
    """
    areas = tree.half_areas
    ratio = areas / areas[0] if areas[0] > 0 else np.ones_like(areas)
    return tree.meta["c_tri"] * tree.count * ratio


def remaining_by_depth(tree: Tree) -> tuple[F64, F64]:
    """Cut a tree at each depth.

    Returns
    -------
    spent : (depth + 1,) float64
        SAH of the inner nodes above the cut.
    remaining : (depth + 1,) float64
        Worst-case triangle cost of the nodes on the cut. At the last depth the two add up to the
        tree's SAH.
    """
    levels = tree.depth + 1
    inner = ~tree.is_leaf
    cost = np.bincount(tree.depths[inner] + 1, sah_per_node(tree)[inner], levels).astype(np.float64)
    worst = worst_cases(tree)
    at_depth = np.bincount(tree.depths, worst, levels).astype(np.float64)
    leaves_above = np.bincount(tree.depths[~inner] + 1, worst[~inner], levels + 1)[:levels]
    return np.cumsum(cost), at_depth + np.cumsum(leaves_above)


def remaining_after_splits(tree: Tree, splits: tuple[int, ...] = SPLITS) -> list[float | None]:
    """Worst-case triangle cost that remains after so many splits, the largest part first.

    Unlike a cut at a depth this compares trees of different balance at the same number of inner
    nodes.

    Returns
    -------
    list of float
        None where the tree has fewer inner nodes.
    """
    worst = worst_cases(tree)
    total = float(worst[0])
    frontier = [(-worst[0], 0)] if tree.left[0] >= 0 else []
    done = 0
    found: list[float | None] = []
    for asked in splits:
        while done < asked and frontier:
            _, node = heapq.heappop(frontier)
            child = int(tree.left[node])
            total += float(worst[child] + worst[child + 1] - worst[node])
            for c in (child, child + 1):
                if tree.left[c] >= 0:
                    heapq.heappush(frontier, (-worst[c], c))
            done += 1
        found.append(total if done == asked else None)
    return found


def depth_experiment(tree: Tree) -> dict[str, Any]:
    """Return the figures of one tree as JSON-able values."""
    spent, remaining = remaining_by_depth(tree)
    return {
        "nodes_by_depth": np.bincount(tree.depths).tolist(),
        "spent_by_depth": spent.tolist(),
        "remaining_by_depth": remaining.tolist(),
        "remaining_after_splits": remaining_after_splits(tree),
    }


# ------------------------------------------------------------------ answers


def depth_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Where in the trees cost and overlap sit.

    Returns
    -------
    DataFrame
        One row per scene, builder and depth: ``scene, builder, depth, sah, epo`` (shares of the
        nodes at that depth), ``spent, remaining`` (see :func:`remaining_by_depth`).
    """
    rows = [
        {"scene": r["scene"], "builder": t["builder"], "depth": depth, "sah": values[0],
         "epo": values[1], "spent": values[2], "remaining": values[3]}
        for r in records
        for t in r["trees"]
        if "remaining_by_depth" in t
        for depth, values in enumerate(zip(
            *(t[n] for n in ("sah_by_depth", "epo_by_depth", "spent_by_depth",
                             "remaining_by_depth")), strict=True))
    ]  # fmt: skip
    return pd.DataFrame(
        rows, columns=["scene", "builder", "depth", "sah", "epo", "spent", "remaining"]
    )


def remaining_relative(records: list[dict[str, Any]], base: str = "bbvh") -> pd.DataFrame:
    """Worst-case triangle cost that remains, relative to the sweep's, mean over the scenes.

    Returns
    -------
    DataFrame
        Index ``builder``, a column per number of splits; empty without the base builder.
    """
    rows = []
    for record in records:
        trees = {t["builder"]: t for t in record["trees"] if "remaining_after_splits" in t}
        if base not in trees:
            continue
        of_base = np.array(trees[base]["remaining_after_splits"], dtype=np.float64)
        for name, tree in trees.items():
            ratio = np.array(tree["remaining_after_splits"], dtype=np.float64) / of_base
            rows.append({"builder": name, **dict(zip(SPLITS, ratio, strict=True))})
    if not rows:
        return pd.DataFrame()
    return pd.DataFrame(rows).groupby("builder", sort=False).mean()


def relative_to_best(
    records: list[dict[str, Any]], name: str = "sah", without: tuple[str, ...] = ()
) -> pd.DataFrame:
    """How far each builder's trees are above the best tree found for the scene.

    Parameters
    ----------
    records : list of dict
    name : str
        A metric.
    without : tuple of str
        Builders that are left out.

    Returns
    -------
    DataFrame
        Index ``builder``; ``mean`` and ``max`` over the scenes of the metric over the least of
        the scene's trees, and ``scene``: where the greatest is.
    """
    rows = []
    for record in records:
        trees = [t for t in record["trees"] if t["builder"] not in without]
        least = min((t[name] for t in trees), default=0.0)
        if least > 0:
            rows += [
                {"builder": t["builder"], "scene": record["scene"], "ratio": t[name] / least}
                for t in trees
            ]
    table = pd.DataFrame(rows, columns=["builder", "scene", "ratio"])
    groups = table.groupby("builder", sort=False)["ratio"]
    found = pd.DataFrame({"mean": groups.mean(), "max": groups.max()})
    found["scene"] = table.loc[groups.idxmax(), "scene"].to_numpy() if len(table) else []
    return found
