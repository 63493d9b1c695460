"""The trees of a scene: build them, compute their metrics and count rays in them."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from mibvh.audit.record import Check
from mibvh.builders import Options, build, get
from mibvh.builders.chosen import Chosen, parse_all
from mibvh.builders.sharing import shared_drafts
from mibvh.errors import MibvhError, TreeFailed, of_one_tree
from mibvh.metrics.registry import Metric, Subject, added_metrics, bundled_metrics
from mibvh.nodes import PAPER_COSTS
from mibvh.scene import Scene
from mibvh.studies.measure.audit import Auditor, Checks
from mibvh.studies.measure.cameras import cameras
from mibvh.studies.measure.counts import LINES, Counts, RayCounter
from mibvh.studies.measure.given import check_given
from mibvh.studies.measure.scene_digest import scene_digest
from mibvh.studies.measure.shelf import Shelf
from mibvh.studies.measure.store import Store, key_of
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import TreeRow
from mibvh.tree import Tree
from mibvh.triangles import Triangles
from mibvh.variant import backend


@dataclasses.dataclass(frozen=True, eq=False)
class TreeSource:
    """Where a tree of a study comes from: a builder, or the user.

    Attributes
    ----------
    name : str
        Name of the tree in tables.
    chosen : Chosen or None
        The registered builder that makes it, with its options; None for a given tree.
    given : callable or None
        Returns a finished tree, which is used unchanged; None for a builder's tree.
    """

    name: str
    chosen: Chosen | None = None
    given: Callable[[], Tree] | None = None

    @classmethod
    def of(cls, chosen: Chosen) -> TreeSource:
        """Return the source for a builder with its options."""
        return cls(chosen.name, chosen)

    def starts(self) -> frozenset[tuple[str, Options]]:
        """Return the builders, with options, of the trees that this one starts from."""
        return self.chosen.starts() if self.chosen else frozenset()

    def key(self, scene: Scene) -> str | None:
        """Return the cache key of its tree of this scene; None if the tree cannot be cached."""
        if self.chosen is None:
            return None
        # The code of a user's builder cannot be followed; it may also be one of the starts.
        made_by = [self.chosen.builder, *sorted(name for name, _ in self.starts())]
        code = [get(name).code() for name in made_by]
        if None in code:
            return None
        asks = self.chosen.asks_scene
        return key_of(
            *(["mibvh.rays.diffuse"] if asks else []),
            digest=scene.triangles.digest,
            builder=self.chosen.builder,
            options=dict(self.chosen.options),
            of_builder=code,
            files=self._files(),
            cameras=cameras(scene) if asks else None,
            # Shadow rays go to the lights.
            scene=scene_digest(scene) if asks else None,
        )

    def _files(self) -> dict[str, str]:
        """Return the SHA-256 of each file that an option names."""
        options = dict(self.chosen.options) if self.chosen else {}
        named = {k: Path(v) for k, v in options.items() if isinstance(v, str)}
        return {
            name: hashlib.sha256(path.read_bytes()).hexdigest()
            for name, path in named.items()
            if path.is_file()
        }

    def make(self, scene: Scene, report: Reporter) -> Tree:
        """Build the tree. Of the builder's stages only compilation is reported.

        The builder gets the scene, so it can ask for rays of the scene's cameras.

        Raises
        ------
        TreeFailed
            If the builder refuses this scene, or is the user's own and fails. Other exceptions
            of bundled builders are bugs, and pass unchanged.
        """
        assert self.chosen is not None, "a tree that was given is not built"

        def progress(stage: str, done: float) -> None:
            report("compiling" if stage == "compiling" else "build", 0.0)

        options = dict(self.chosen.options)
        with of_one_tree():
            return build(scene, self.chosen.builder, progress=progress, **options)


def sources_of(builders: Sequence[str], trees: Mapping[str, Tree]) -> dict[str, TreeSource]:
    """Return the sources of a scene's trees by name: builders first, then given trees."""
    made = [TreeSource.of(chosen) for chosen in parse_all(builders)]
    given = [TreeSource(n, given=functools.partial(trees.__getitem__, n)) for n in trees]
    return {source.name: source for source in (*made, *given)}


def bundled_drafts(builders: Sequence[str]) -> frozenset[tuple[str, Options]]:
    """Return those of the builders, with options, that are this package's own.

    For them a second build would give the same draft.
    """
    entries = [(get(one.builder), dict(one.options)) for one in parse_all(builders)]
    return frozenset((e.name, e.options(**chosen)) for e, chosen in entries if e.bundled)


def with_paper_costs(tree: Tree) -> Tree:
    """Return a tree with the paper's cost constants, whatever it was built with.

    With other constants its metrics would have other units than those of the other trees.
    """
    if all(tree.meta.get(name) == value for name, value in PAPER_COSTS.items()):
        return tree
    return tree.replace(meta={**tree.meta, **PAPER_COSTS})


@dataclasses.dataclass(frozen=True)
class TreeMetrics:
    """Metrics of a tree that need no rays."""

    values: dict[str, float]
    sah_by_depth: list[float]
    epo_by_depth: list[float]


def study_trees(
    sources: Mapping[str, TreeSource], counter: RayCounter, store: Store, report: Reporter
) -> tuple[Shelf, list[TreeRow]]:
    """Build the trees of a scene, compute their metrics, count rays in them and audit them.

    A tree that several builders start from is built once. A tree that fails is reported as
    missing, and the study continues with the others.

    Returns
    -------
    trees : Shelf
    rows : list of TreeRow
        One for each tree that did not fail, still without times.
    """
    auditor = Auditor(counter)
    trees = Shelf()
    rows: list[TreeRow] = []
    share = 0.5 / max(len(sources), 1)
    waiting = [source.starts() for source in sources.values()]
    with shared_drafts(counter.triangles.digest, store.folder) as drafts:
        for i, (name, source) in enumerate(sources.items()):
            part = report.part(0.02 + share * i, share, name)
            drafts.want(frozenset().union(*waiting[i:]))
            trees.tidy()
            try:
                _shelve(source, counter.scene, trees, store, part)
            except TreeFailed as error:
                part.missing(f"tree {name}", error, tree=name)
                continue
            rows.append(study_tree(source, trees[name], counter, auditor, store, part))
            if len(rows) == 1:
                auditor.compare_with(functools.partial(trees.__getitem__, name))
    return trees, rows


def _shelve(source: TreeSource, scene: Scene, trees: Shelf, store: Store, report: Reporter) -> None:
    """Put a tree on the shelf: a given one, one from the store, or a new one."""
    key = source.key(scene)
    report(_first_stage(source, store, key), 0.0)
    if source.given is not None:
        again = source.given
        tree = again()
        with of_one_tree():
            check_given(source.name, tree, scene.triangles)
    else:
        tree = store.array(Tree, key, functools.partial(source.make, scene, report))
        again = store.again(Tree, key or key_of(tree=tree.digest), tree)
    trees.put(source.name, with_paper_costs(tree), lambda: with_paper_costs(again()))


def study_tree(
    source: TreeSource,
    tree: Tree,
    counter: RayCounter,
    auditor: Auditor,
    store: Store,
    report: Reporter,
) -> TreeRow:
    """Compute the metrics of one tree, count rays in it and audit it.

    Returns
    -------
    TreeRow
        Still without times.
    """
    triangles = counter.triangles
    report("metrics", 0.5)
    metrics = kept_metrics(tree, triangles, store)
    report("count", 0.8)
    counts = kept_counts(tree, counter, store)
    report("warps", 0.9)
    values = {**metrics.values, **counts.values, **counter.warps.kept(tree, store)}
    # Not kept: nothing tells whether the code of a user's metric is still the same.
    for metric in added_metrics():
        values |= _own_metric(metric, source.name, Subject(tree, triangles), report)
    report("audit", 0.95)
    checks = _kept_audit(tree, values, counter, auditor, store)
    return TreeRow(
        builder=source.name,
        options=tree.meta.get("options", {}),
        values=values | {"build_seconds": tree.meta.get("build_seconds", math.nan)},
        sah_by_depth=metrics.sah_by_depth,
        epo_by_depth=metrics.epo_by_depth,
        cost_groups=counts.cost_groups,
        costs_by_origin=counts.costs_by_origin,
        leaf_distribution=counts.leaf_distribution,
        build_report=tree.meta.get("report", {}),
        audit=checks,
    )


def _kept_audit(
    tree: Tree,
    values: dict[str, float],
    counter: RayCounter,
    auditor: Auditor,
    store: Store,
) -> list[Check]:
    """Return the checks of a tree: from the store, or made and kept."""
    audited = {name: values[name] for name in ("sah", "epo", "counted_cost", "warp_scalar_cost")}
    key = key_of(
        "mibvh.studies.measure.audit",
        tree=tree.digest,
        digest=counter.triangles.digest,
        rays=counter.rays.digest,
        cull=counter.cull,
        backend=backend(),
        warps=counter.warps.rules.width,
        **audited,
    )
    audit = functools.partial(auditor, tree, values)
    return store.record(f"audit-{key}", Checks, audit).checks


def _own_metric(
    metric: Metric, name: str, subject: Subject, report: Reporter
) -> Mapping[str, float]:
    """Compute a user's metric of a tree. If it fails, report that and return NaN."""
    try:
        return metric(subject)
    except MibvhError as error:
        report.missing(f"metric {metric.name} of tree {name}", error)
        return {quantity.name: math.nan for quantity in metric.quantities}


def kept_metrics(tree: Tree, triangles: Triangles, store: Store) -> TreeMetrics:
    """Return a tree's metrics that need no rays: from the store, or computed and kept.

    The key is the tree's bytes, so values that its builder reports are not part of this.
    """
    of = {"tree": tree.digest, "digest": triangles.digest}
    key = key_of(__name__, "mibvh.metrics.registry", **of)
    make = functools.partial(compute_metrics, tree, triangles)
    return store.record(f"metrics-{key}", TreeMetrics, make)


def kept_counts(tree: Tree, counter: RayCounter, store: Store) -> Counts:
    """Return the counts of the rays in a tree: from the store, or counted and kept."""
    key = key_of(
        "mibvh.studies.measure.counts",
        tree=tree.digest,
        digest=counter.triangles.digest,
        rays=counter.rays.digest,
        cull=counter.cull,
        backend=backend(),
        lines=LINES,
    )
    return store.record(f"counts-{key}", Counts, functools.partial(counter, tree))


def _first_stage(source: TreeSource, store: Store, key: str | None) -> str:
    if source.given is not None:
        return "given tree"
    return "cached tree" if store.has(Tree, key) else "build"


def compute_metrics(tree: Tree, triangles: Triangles) -> TreeMetrics:
    """Compute this package's metrics of a tree, and SAH and EPO by depth."""
    subject = Subject(tree, triangles)
    levels = tree.depth + 1
    values: dict[str, float] = {}
    for metric in bundled_metrics():
        values |= metric(subject)
    return TreeMetrics(
        values=values,
        sah_by_depth=np.bincount(tree.depths, subject.sah_shares, levels).tolist(),
        epo_by_depth=np.bincount(tree.depths, subject.epo_shares, levels).tolist(),
    )
