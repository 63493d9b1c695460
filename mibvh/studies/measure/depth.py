"""What top-down builders optimise: the worst case that remains as a tree goes down.

A top-down sweep minimises ``T_left A_left / A_root + T_right A_right / A_root``: what the triangles
would cost if both sides became leaves (slides, "What do top-down builders optimize?"). Cutting a
finished tree, with what is below the cut taken as leaves, shows how soon it gets there.
"""

from __future__ import annotations

import dataclasses
import functools
import heapq

import numpy as np

from mibvh.metrics.sah import sah_per_node
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import key_of
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Result
from mibvh.tree import Tree
from mibvh.triangles import F64

#: Numbers of splits after which the worst case is taken: complete trees of 1, 2, ... levels.
SPLITS = tuple(2**level - 1 for level in range(13))


@dataclasses.dataclass(frozen=True)
class Cuts:
    """A tree cut at each depth, and after some numbers of splits.

    Attributes
    ----------
    nodes_by_depth : list of int
    spent_by_depth, remaining_by_depth : list of float
        See :func:`remaining_by_depth`.
    remaining_after_splits : list of float
        See :func:`remaining_after_splits`.
    """

    nodes_by_depth: list[int]
    spent_by_depth: list[float]
    remaining_by_depth: list[float]
    remaining_after_splits: list[float | None]


@dataclasses.dataclass(frozen=True)
class DepthResult(Result, experiment="depth"):
    """The cuts of a scene's trees."""

    trees: list[Cuts]


def worst_cases(tree: Tree) -> F64:
    """Return ``C_tri T_n A_n / A_root`` of each node: its cost if it were a leaf.

    Returns
    -------
    (M,) float64
        ``T_n`` are the references below the node.
    """
    areas = tree.half_areas
    ratio = areas / areas[0] if areas[0] > 0 else np.ones_like(areas)
    return np.asarray(tree.meta["c_tri"] * tree.count * ratio)


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
    remaining: list[float | None] = []
    for asked in splits:
        while done < asked and frontier:
            _, node = heapq.heappop(frontier)
            child = int(tree.left[node])
            total += float(worst[child] + worst[child + 1] - worst[node])
            for c in (child, child + 1):
                if tree.left[c] >= 0:
                    heapq.heappush(frontier, (-worst[c], c))
            done += 1
        remaining.append(total if done == asked else None)
    return remaining


def cuts(tree: Tree) -> Cuts:
    """Cut a tree at every depth, and after each number of splits."""
    spent, remaining = remaining_by_depth(tree)
    return Cuts(
        nodes_by_depth=np.bincount(tree.depths).tolist(),
        spent_by_depth=spent.tolist(),
        remaining_by_depth=remaining.tolist(),
        remaining_after_splits=remaining_after_splits(tree),
    )


def depth_experiment(setting: Setting, report: Reporter) -> DepthResult:
    """Cut the trees of a scene."""
    share = 1 / len(setting.trees)
    found = []
    for i, name in enumerate(setting.trees):
        report.part(share * i, share, name)("depth", 0.0)
        piece = f"depth-{key_of(__name__, tree=setting.trees.digest(name))}"
        make = functools.partial(_cuts_of, setting, name)
        found.append(setting.store.record(piece, Cuts, make))
    return DepthResult(found)


def _cuts_of(setting: Setting, name: str) -> Cuts:
    return cuts(setting.trees[name])
