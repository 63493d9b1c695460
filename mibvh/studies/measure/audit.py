"""The audit of a scene's trees: independent code checks each number."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

from mibvh.audit.record import Check
from mibvh.audit.run import audit_figures, audit_hits, check_tree
from mibvh.studies.measure.counts import RayCounter
from mibvh.traversal.trace import Hits, release_records
from mibvh.tree import Tree
from mibvh.variant import backend, release_memory
from mibvh.wide_tree import WideTree


@dataclasses.dataclass(frozen=True)
class Checks:
    """The checks of one tree."""

    checks: list[Check]


class Auditor:
    """Audits the trees of a scene, and compares their hits with each other.

    Parameters
    ----------
    counter : RayCounter
        Of the scene's rays.
    """

    def __init__(self, counter: RayCounter) -> None:
        self._counter = counter
        self._first: Hits | None = None
        self._earlier: Callable[[], Tree] | None = None

    def compare_with(self, tree: Callable[[], Tree]) -> None:
        """Set the tree whose hits those of later trees are compared with.

        It is traced only if there are later trees to check: its own checks may be kept ones.
        """
        self._earlier = tree

    def __call__(self, tree: Tree | WideTree, values: dict[str, float]) -> Checks:
        """Check a tree, and its SAH, EPO and counted cost.

        Of a binary tree, also the cost of simulated warps of one lane.

        The values may be kept ones of earlier runs: what the tree is traced for here is new.
        """
        scene, rays = self._counter.scene, self._counter.rays
        sound = check_tree(tree, scene.triangles)
        if not sound.passed:
            return Checks([sound])
        if self._first is None and self._earlier is not None:
            self._first = self._counter.hits(self._earlier())
        hits = self._counter.hits(tree)
        figures = audit_figures(tree, scene.triangles, values["sah"], values["epo"])
        traced = audit_hits(
            scene, tree, rays, hits, counted_cost=values["counted_cost"], others=self._first
        )
        self._first = self._first or hits
        warps = [] if isinstance(tree, WideTree) else self._warps(tree, hits, values)
        found = Checks([sound, *figures, *traced, *warps])
        release_records()  # the next tree is another
        release_memory()
        return found

    def _warps(self, tree: Tree, hits: Hits, values: dict[str, float]) -> Iterator[Check]:
        """Check that warps of one lane cost as much as the kernel counts for the same rays.

        The simulation does not re-test popped nodes, and a GPU may contract products and sums.
        """
        if self._counter.cull or backend() != "llvm":
            return
        costs = tree.meta["c_inner"] * hits.inner + tree.meta["c_tri"] * hits.tests
        counted = float(costs[self._counter.warps.places].mean())
        simulated = values["warp_scalar_cost"]
        yield Check.of("warps", simulated, counted, 1e-9 * counted, "of one lane: counted cost")
