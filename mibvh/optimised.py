"""The best tree for a scene and its cameras, and how much cost it saves."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

from mibvh.builders import build
from mibvh.builders.finite import FiniteOptions
from mibvh.rays import RaySet, make_rays
from mibvh.scene import Scene, load
from mibvh.traversal.trace import trace
from mibvh.tree import Tree

#: What a tree for the rays has to beat: what renders by default, and the best that know no rays,
#: with and without splits. In soups of random triangles the last may be the cheapest of all.
OTHERS = ("sbvh", "bittner_sbvh", "bittner")
#: Pixels of each view that the saving is measured with.
_WIDTH, _HEIGHT = 120, 90
#: Where these make fewer rays, as many more are traced as it takes, up to so many times as many.
_FEWEST, _TIMES = 5_000, 100
#: Of the rays that the saving is measured with; the second where the builder's rays have the first.
_SEEDS = (1, 2)


@dataclasses.dataclass(frozen=True, eq=False)
class Optimised:
    """A tree, and the cost of test rays that it was not built for.

    Attributes
    ----------
    tree : Tree
        The cheapest of all; as a rule, that of `finite`.
    costs : dict
        Counted cost per ray, 1.2 for each inner node and 1.0 for each triangle, by builder.
    rays : int
        How many rays these are means over.
    kind : str
        Of what kind they are; see :func:`mibvh.make_rays`.
    """

    tree: Tree
    costs: dict[str, float]
    rays: int
    kind: str = "diffuse"

    def sentence(self) -> str:
        """Return a sentence on how much the tree saves."""
        own = self.costs[self.tree.meta["builder"]]
        others = {name: self.costs[name] for name in OTHERS if name != self.tree.meta["builder"]}
        *rest, last = (
            f"{1 - own / cost:.0%} of what they cost in {name} ({cost:.1f})"
            for name, cost in others.items()
        )
        saved = f"{', '.join(rest)} and {last}"
        return (
            f"{self.kind} rays of these cameras cost {own:.1f} in this tree: it saves {saved}; "
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
        Of the builder `finite`; ``unseen=True`` for other cameras in the same scene. Rays of its
        ``kind`` decide which tree is the cheapest, and say what is saved.

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
    chosen = FiniteOptions(**options)
    rays = _measuring_rays(scene, chosen)
    costs = {
        name: trace(tree, scene, rays, repeats=1).counted_cost() for name, tree in trees.items()
    }
    return Optimised(trees[min(costs, key=costs.__getitem__)], costs, len(rays), chosen.kind)


def _measuring_rays(scene: Scene, options: FiniteOptions) -> RaySet:
    """Rays that the tree is not built for; a few would choose between trees by chance."""
    seed = _SEEDS[_seed_of_training(options) == _SEEDS[0]]
    make = functools.partial(
        make_rays, scene, options.kind, width=_WIDTH, height=_HEIGHT, seed=seed
    )
    rays = make(samples=1)
    times = min(-(-_FEWEST // len(rays)), _TIMES)
    return rays if times == 1 else make(samples=times)


def _seed_of_training(options: FiniteOptions) -> Any:
    """Seed of the rays that the tree is built for; None for rays of unknown seed."""
    if not options.rays:
        return options.seed
    return RaySet.load(options.rays).meta.get("seed")
