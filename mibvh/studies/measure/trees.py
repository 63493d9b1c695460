"""The trees of a scene: built, judged and counted, each step kept when it is finished."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from mibvh.builders import build, get
from mibvh.metrics.registry import Subject, metrics
from mibvh.studies.measure.audit import Auditor, Checks
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

    def key(self, triangles: Triangles) -> str | None:
        """Return what its tree of these triangles is kept under; None if it cannot be kept."""
        code = get(self.builder).code()
        if code is None:
            return None
        return key_of(digest=triangles.digest, builder=self.builder, of_builder=code)

    def make(self, triangles: Triangles, report: Reporter) -> Tree:
        """Build the tree. Stages of a builder are not reported, but that it has to be compiled."""

        def progress(stage: str, done: float) -> None:
            report("compiling" if stage == "compiling" else "build", 0.0)

        return build(triangles, self.builder, progress=progress)


@dataclasses.dataclass(frozen=True)
class TreeFigures:
    """What is known of a tree without any ray."""

    values: dict[str, float]
    sah_by_depth: list[float]
    epo_by_depth: list[float]


def study_tree(
    source: TreeSource,
    counter: RayCounter,
    auditor: Auditor,
    store: Store,
    report: Reporter,
) -> tuple[Tree, TreeRow]:
    """Build, judge, count and audit one tree.

    Returns
    -------
    tree : Tree
    row : TreeRow
        Without times.
    """
    triangles = counter.triangles
    key = source.key(triangles)
    report("cached tree" if store.has(Tree, key) else "build", 0.0)
    tree = store.array(Tree, key, functools.partial(source.make, triangles, report))
    report("metrics", 0.5)
    judge = functools.partial(judge_tree, tree, triangles)
    # What is computed from the tree goes by its bytes; what its builder said of it is not kept.
    of = {"tree": tree.digest, "digest": triangles.digest}
    metrics_key = key_of(__name__, "mibvh.metrics.registry", **of)
    judged = kept(store, f"metrics-{metrics_key}", TreeFigures, judge)
    report("count", 0.8)
    counts_key = key_of(
        "mibvh.studies.measure.counts",
        **of,
        rays=counter.rays.digest,
        cull=counter.cull,
        lines=LINES,
    )
    count = functools.partial(counter, tree)
    counts = kept(store, f"counts-{counts_key}", Counts, count)
    report("warps", 0.9)
    values = {**judged.values, **counts.values, **counter.warps.kept(tree, store)}
    report("audit", 0.95)
    audited = {name: values[name] for name in ("sah", "epo", "counted_cost", "warp_scalar_cost")}
    audit_key = key_of(
        "mibvh.studies.measure.audit",
        **of,
        rays=counter.rays.digest,
        cull=counter.cull,
        warps=counter.warps.rules.width,
        **audited,
    )
    audit = functools.partial(auditor, tree, values)
    row = TreeRow(
        builder=source.name,
        options=tree.meta["options"],
        values=values | {"build_seconds": tree.meta["build_seconds"]},
        sah_by_depth=judged.sah_by_depth,
        epo_by_depth=judged.epo_by_depth,
        cost_groups=counts.cost_groups,
        costs_by_origin=counts.costs_by_origin,
        leaf_distribution=counts.leaf_distribution,
        build_report=tree.meta["report"],
        audit=kept(store, f"audit-{audit_key}", Checks, audit).checks,
    )
    return tree, row


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
    )
