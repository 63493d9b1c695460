"""The cost of rays in simulated warps, which is free of noise and the same on every machine."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import numpy.typing as npt

from mibvh.rays import RaySet
from mibvh.studies.measure.store import Store, key_of
from mibvh.traversal.warp import simulate
from mibvh.tree import Tree
from mibvh.triangles import Triangles

#: Rays that warps are simulated with, at most: a fifth of a second per tree and thread.
MOST_RAYS = 100_000


@dataclasses.dataclass(frozen=True)
class WarpRules:
    """Width and style of the warps; see :func:`mibvh.traversal.warp.simulate`."""

    width: int = 32
    style: str = "persistent"


@dataclasses.dataclass(frozen=True)
class WarpCosts:
    """Costs of the warps in one tree, by the names of quantities."""

    values: dict[str, float]


def simulated_rays(count: int, width: int) -> npt.NDArray[np.int64]:
    """Return the indices of the rays to simulate: every k-th group of ``width`` rays.

    Rays that stand side by side stay together, as they would share a warp; runs are spread
    evenly over the set.

    Parameters
    ----------
    count : int
        Size of the ray set.
    width : int
        Lanes of a warp.

    Returns
    -------
    (S,) int64
        All of them where there are no more than :data:`MOST_RAYS`.
    """
    run = np.arange(count) // width
    every = max(1, -(-count // MOST_RAYS))
    return np.flatnonzero(run % every == 0)


class WarpCounter:
    """Simulates warps of a scene's rays in its trees.

    Parameters
    ----------
    triangles : Triangles
    rays : RaySet
        In the order in which they are dealt.
    rules : WarpRules
    """

    def __init__(self, triangles: Triangles, rays: RaySet, rules: WarpRules) -> None:
        self.triangles, self.all_rays, self.rules = triangles, rays, rules

    @functools.cached_property
    def places(self) -> npt.NDArray[np.int64]:
        """(S,) int64: the rays that are simulated."""
        return simulated_rays(len(self.all_rays), self.rules.width)

    @functools.cached_property
    def rays(self) -> RaySet:
        """The rays that are simulated."""
        whole = len(self.places) == len(self.all_rays)
        return self.all_rays if whole else self.all_rays.select(self.places)

    def kept(self, tree: Tree, store: Store) -> dict[str, float]:
        """Return the costs of the warps in a tree: from the store, or simulated and kept."""
        key = key_of(
            __name__,
            "mibvh.traversal.warp",
            tree=tree.digest,
            digest=self.triangles.digest,
            rays=self.all_rays.digest,
            rules=dataclasses.asdict(self.rules),
            most=MOST_RAYS,
        )
        return store.record(f"warps-{key}", WarpCosts, functools.partial(self, tree)).values

    def __call__(self, tree: Tree) -> WarpCosts:
        """Simulate the warps, and the same rays in warps of one lane."""
        costs = _costs(tree)
        warps = simulate(tree, self.triangles, self.rays, self.rules.width, self.rules.style)
        scalar = simulate(tree, self.triangles, self.rays, 1, "single")
        cost, alone = warps.cost(*costs), scalar.cost(*costs)
        return WarpCosts(
            {
                "warp_cost": cost,
                "warp_scalar_cost": alone,
                "warp_overhead": cost / alone if alone else float("nan"),
                "warp_utilisation": warps.utilisation(*costs),
            }
        )


def _costs(tree: Tree) -> tuple[float, float]:
    return tree.meta["c_inner"], tree.meta["c_tri"]
