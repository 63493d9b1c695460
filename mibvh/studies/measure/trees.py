"""The trees of a scene: built, judged and counted, each step kept when it is finished."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from mibvh.builders import build, get
from mibvh.metrics.registry import Subject, metrics
from mibvh.scene import Scene
from mibvh.studies.measure.counts import LINES, Counts, RayCounter
from mibvh.studies.measure.pieces import kept
from mibvh.studies.measure.store import Store, key_of
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import TreeRow
from mibvh.tree import Tree
from mibvh.triangles import Triangles


@dataclasses.dataclass(frozen=True)
class TreeSource:
    """Where a tree of a study comes from.

    Attributes
    ----------
    name : str
        What the tree is called in tables.
    builder : str
        The registered builder that makes it.
    """

    name: str
    builder: str

    @classmethod
    def parse(cls, text: str) -> TreeSource:
        """Read a source as the options of a study name it.

        Raises
        ------
        MibvhError
            If there is no such builder.
        """
        return cls(text, get(text).name)

    def key(self, triangles: Triangles) -> str:
        """Return what its tree of these triangles is kept under."""
        code = get(self.builder).fingerprint()
        return key_of(digest=triangles.digest, builder=self.builder, code=code)

    def make(self, triangles: Triangles) -> Tree:
        """Build the tree."""
        return build(triangles, self.builder)


@dataclasses.dataclass(frozen=True)
class TreeFigures:
    """What is known of a tree without any ray."""

    values: dict[str, float]
    sah_by_depth: list[float]
    epo_by_depth: list[float]
    options: dict[str, Any]
    build_report: dict[str, Any]


def study_tree(
    source: TreeSource,
    scene: Scene,
    counter: RayCounter,
    rays_key: str,
    store: Store,
    report: Reporter,
) -> tuple[str, Tree, TreeRow]:
    """Build, judge and count one tree.

    Returns
    -------
    key : str
        What the tree is kept under.
    tree : Tree
    row : TreeRow
        Without times.
    """
    report("build", 0.0)
    key = source.key(scene.triangles)
    tree = store.array(Tree, key, functools.partial(source.make, scene.triangles))
    report("metrics", 0.5)
    judge = functools.partial(judge_tree, tree, scene.triangles)
    judged = kept(store, f"metrics-{key_of(tree=key, format=2)}", TreeFigures, judge)
    report("count", 0.8)
    counts_key = key_of(tree=key, rays=rays_key, cull=counter.cull, lines=LINES, format=4)
    count = functools.partial(counter, tree)
    counts = kept(store, f"counts-{counts_key}", Counts, count)
    row = TreeRow(
        builder=source.name,
        options=judged.options,
        values={**judged.values, **counts.values},
        sah_by_depth=judged.sah_by_depth,
        epo_by_depth=judged.epo_by_depth,
        cost_groups=counts.cost_groups,
        costs_by_origin=counts.costs_by_origin,
        leaf_distribution=counts.leaf_distribution,
        build_report=judged.build_report,
    )
    return key, tree, row


def judge_tree(tree: Tree, triangles: Triangles) -> TreeFigures:
    """Compute all registered metrics of a tree, and SAH and EPO by depth."""
    subject = Subject(tree, triangles)
    levels = tree.depth + 1
    values: dict[str, float] = {}
    for metric in metrics():
        values |= metric(subject)
    return TreeFigures(
        values=values,
        sah_by_depth=np.bincount(tree.depths, subject.sah_shares, levels).tolist(),
        epo_by_depth=np.bincount(tree.depths, subject.epo_shares, levels).tolist(),
        options=tree.meta["options"],
        build_report=tree.meta["report"],
    )
