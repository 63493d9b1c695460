"""The best tree for a scene and its cameras, and what it saves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from mibvh.builders import build
from mibvh.rays import diffuse_rays
from mibvh.scene import load
from mibvh.traversal.trace import trace
from mibvh.tree import Tree

#: What a tree for the rays has to beat: what renders by default, and the best that knows no rays.
OTHERS = ("sbvh", "bittner_sbvh")
#: Pixels of each view that the saving is measured with.
_WIDTH, _HEIGHT = 120, 90
#: Of the rays that the saving is measured with; the builder's have another.
_SEED = 1


@dataclasses.dataclass(frozen=True, eq=False)
class Optimised:
    """A tree, and the cost of rays that it was not built for.

    Attributes
    ----------
    tree : Tree
        The cheapest of all; as a rule, that of `finite`.
    costs : dict
        Counted cost per ray, 1.2 for each inner node and 1.0 for each triangle, by builder.
    rays : int
        How many rays these are means over.
    """

    tree: Tree
    costs: dict[str, float]
    rays: int

    def sentence(self) -> str:
        """Say what the tree saves."""
        own = self.costs[self.tree.meta["builder"]]
        others = {name: self.costs[name] for name in OTHERS if name != self.tree.meta["builder"]}
        saved = " and ".join(
            f"{1 - own / cost:.0%} of what they cost in {name} ({cost:.1f})"
            for name, cost in others.items()
        )
        return (
            f"diffuse rays of these cameras cost {own:.1f} in this tree: it saves {saved}; "
            f"counted on {self.rays} rays that it was not built for"
        )


def optimize(
    scene: Any, *, progress: Callable[[str, float], None] | None = None, **options: Any
) -> Optimised:
    """Build the best tree for a scene and its cameras.

    Parameters
    ----------
    scene : Scene, or what :func:`mibvh.load` takes
    progress : callable, optional
        Called as ``progress(stage, done)`` with ``done`` from 0 to 1.
    **options
        Of the builder `finite`; ``unseen=True`` for other cameras in the same scene.

    Returns
    -------
    Optimised

    Raises
    ------
    MibvhError
        For an impossible option, or where no camera sees anything.
    """
    scene = load(scene)
    trees = {"finite": build(scene, "finite", progress=progress, **options)}
    trees |= {name: build(scene, name, progress=progress) for name in OTHERS}
    rays = diffuse_rays(scene, width=_WIDTH, height=_HEIGHT, samples=1, seed=_SEED)
    costs = {
        name: trace(tree, scene, rays, repeats=1).counted_cost() for name, tree in trees.items()
    }
    return Optimised(trees[min(costs, key=costs.__getitem__)], costs, len(rays))
