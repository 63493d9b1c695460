"""The audit of a scene's trees: each figure of a row held against another path through the code."""

from __future__ import annotations

import dataclasses

from mibvh.audit.record import Check
from mibvh.audit.run import audit_figures, audit_hits, check_tree
from mibvh.studies.measure.counts import RayCounter
from mibvh.traversal.trace import Hits
from mibvh.tree import Tree


@dataclasses.dataclass(frozen=True)
class Checks:
    """The checks of one tree."""

    checks: list[Check]


class Auditor:
    """Audits the trees of a scene; their hits are held against each other's, too.

    Parameters
    ----------
    counter : RayCounter
        Of the scene's rays.
    """

    def __init__(self, counter: RayCounter) -> None:
        self._counter = counter
        self._first: Hits | None = None

    def __call__(self, tree: Tree, values: dict[str, float]) -> Checks:
        """Check a tree and what its row says of SAH, EPO and counted cost.

        The values may be kept ones of earlier runs: what the tree is traced for here is new.
        """
        scene, rays = self._counter.scene, self._counter.rays
        sound = check_tree(tree, scene.triangles)
        if not sound.passed:
            return Checks([sound])
        hits = self._counter.hits(tree)
        figures = audit_figures(tree, scene.triangles, values["sah"], values["epo"])
        traced = audit_hits(
            scene, tree, rays, hits, counted_cost=values["counted_cost"], others=self._first
        )
        self._first = self._first or hits
        return Checks([sound, *figures, *traced])
