"""Whether all ways to trace a ray set give the same: hits, and what is counted."""

from __future__ import annotations

from typing import Any

import numpy as np

from mibvh.rays.rayset import RaySet
from mibvh.traversal.trace import Hits, trace
from mibvh.traversal.warp import Warps, simulate
from mibvh.traversal.wide_walk import Walk, walk_wide_tree
from mibvh.tree import Tree
from mibvh.wide_tree import WideTree

_COLUMNS = ("t", "triangle", "inner", "leaves", "tests")


def lane_faults(
    tree: Tree | WideTree,
    triangles: Any,
    rays: RaySet,
    *,
    simd: Hits | None = None,
    rays_checked: int = 4096,
) -> list[str]:
    """Trace rays in SIMD lanes, in scalar lanes, and without Dr.Jit, and compare.

    The third is compiled by Numba and shares no code with the kernels: the simulation of warps of
    one lane (:mod:`mibvh.traversal.warp`), of a wide tree the walk of
    :mod:`mibvh.traversal.wide_walk`. All of ``t``, ``triangle``, ``inner``, ``leaves`` and
    ``tests``, of a wide tree ``boxes`` too, must be equal to the last bit. (On a GPU the third is
    left out: its arithmetic may contract products and sums.)

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles, Scene or (N, 3, 3) array
        What the tree was built for.
    rays : RaySet
    simd : Hits, optional
        What SIMD lanes gave for all of the rays with the ``single`` style, popped nodes not
        re-tested, or with the ``wide`` style of a wide tree; traced anew by default.
    rays_checked : int
        At most so many rays, evenly spread over the set.

    Returns
    -------
    list of str
        A sentence for each fault; empty if all agree.

    Raises
    ------
    MibvhError
        If the tree or the rays belong to another geometry.
    """
    from mibvh.variant import backend

    chosen = np.unique(np.linspace(0, len(rays) - 1, min(rays_checked, len(rays))).astype(np.int64))
    some = rays.select(chosen)
    if simd is None:
        simd, chosen = trace(tree, triangles, some, repeats=1), np.arange(len(some))
    others: dict[str, Hits | Warps | Walk] = {
        "scalar lanes": trace(tree, triangles, some, "scalar", repeats=1)
    }
    if backend() == "llvm":
        others["the simulation"] = (
            walk_wide_tree(tree, triangles, some, any_hit=some.occlusion)
            if isinstance(tree, WideTree)
            else simulate(tree, triangles, some, 1, "single")
        )
    found = []
    for name, other in others.items():
        for column in (*_COLUMNS, "boxes") if isinstance(tree, WideTree) else _COLUMNS:
            ours, theirs = getattr(simd, column)[chosen], getattr(other, column)
            differ = np.flatnonzero(ours != theirs)
            if len(differ):
                found.append(
                    f"{column}: SIMD lanes and {name} differ for {len(differ)} of {len(some)} "
                    f"rays, first for ray {chosen[differ[0]]}: {ours[differ[0]]} and "
                    f"{theirs[differ[0]]}"
                )
    return found
