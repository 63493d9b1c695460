"""The experiment ``width``: the same trees collapsed to more children per node.

Everything here is by counted cost: rays are traced by the wide kernel, once. At width two a tree is
itself, and its figures are those of the study.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence

import numpy as np

from mibvh.audit.record import Check
from mibvh.collapsing import binary_nodes, collapse
from mibvh.metrics.epo import overlap
from mibvh.metrics.sah import node_costs, sah
from mibvh.studies.measure.audit import Auditor, Checks
from mibvh.studies.measure.counts import LINES, RayCounter
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import Store, key_of
from mibvh.studies.measure.trees import kept_counts, kept_metrics
from mibvh.studies.record.options import WIDTHS
from mibvh.studies.record.progress import Reporter
from mibvh.studies.record.scene import Result
from mibvh.tree import Tree
from mibvh.triangles import F64
from mibvh.variant import backend
from mibvh.wide_tree import WideTree


@dataclasses.dataclass(frozen=True)
class WideRow:
    """A tree at one width.

    Attributes
    ----------
    values : dict of str to float
        Quantities by name, as a tree's row has them, and ``mean_children``.
    audit : list of Check
        The checks of the wide tree and of its figures; none at width two, where they are those
        of the tree itself.
    """

    values: dict[str, float]
    audit: list[Check]


@dataclasses.dataclass(frozen=True)
class WidthResult(Result, experiment="width"):
    """The trees of a scene at some widths.

    Attributes
    ----------
    widths : list of int
        In order; the first is 2, whatever was asked for.
    trees : list of list of WideRow
        Of each tree one per width.
    """

    widths: list[int]
    trees: list[list[WideRow]]


@dataclasses.dataclass(frozen=True)
class _Values:
    values: dict[str, float]


class _Collapsed:
    """A binary tree and its wide trees, which are made on first use."""

    def __init__(self, tree: Tree, counter: RayCounter) -> None:
        self.tree, self.counter = tree, counter
        self._wide: dict[int, WideTree] = {}

    def wide(self, width: int) -> WideTree:
        """Return the wide tree of lowest SAH."""
        if width not in self._wide:
            self._wide[width] = collapse(self.tree, width)
        return self._wide[width]

    @functools.cached_property
    def fraction(self) -> F64:
        """(M,) float64: share of the surfaces in each binary node; wide nodes are some of them."""
        return overlap(self.tree, self.counter.triangles).fraction

    def figures(self, width: int) -> _Values:
        """Compute the metrics of the wide tree and count the rays in it."""
        wide = self.wide(width)
        counts = self.counter(wide)
        return _Values(
            {
                "sah": sah(wide),
                "epo": float(node_costs(wide) @ self.fraction[binary_nodes(wide, self.tree)]),
                "mean_children": wide.stats()["mean_children"],
                **counts.values,
            }
        )


def width_experiment(setting: Setting, report: Reporter) -> WidthResult:
    """Collapse the trees of a scene; compute metrics, counts and audits at every width."""
    widths = sorted({2, *(setting.options.widths or WIDTHS)})
    # The wide kernel does not re-test popped nodes, so that trees of two children must not, either.
    counter = RayCounter(setting.scene, setting.rays, cull=False)
    audited = Auditor(counter)
    share = 1 / len(setting.trees)
    found = []
    for i, name in enumerate(setting.trees):
        part = report.part(share * i, share, name)
        found.append(_rows(setting.trees[name], widths, counter, audited, setting.store, part))
    return WidthResult(widths, found)


def _rows(
    tree: Tree,
    widths: Sequence[int],
    counter: RayCounter,
    audited: Auditor,
    store: Store,
    report: Reporter,
) -> list[WideRow]:
    """A tree at every width."""
    report("metrics", 0.0)
    of = _Collapsed(tree, counter)
    rows = [_binary(tree, counter, store)]
    for place, width in enumerate(widths[1:]):
        report("count", place / len(widths))
        rows.append(_row(of, width, audited, store))
    return rows


def _binary(tree: Tree, counter: RayCounter, store: Store) -> WideRow:
    """Return the row of the binary tree, from the results of the base study."""
    metrics = kept_metrics(tree, counter.triangles, store)
    counts = kept_counts(tree, counter, store)
    of_tree = {name: metrics.values[name] for name in ("sah", "epo")}
    return WideRow({**of_tree, "mean_children": 2.0, **counts.values}, [])


def _row(of: _Collapsed, width: int, audited: Auditor, store: Store) -> WideRow:
    """Return the row of a wide tree: from the store, or computed and kept."""
    made_of = {
        "tree": of.tree.digest,
        "digest": of.counter.triangles.digest,
        "rays": of.counter.rays.digest,
        "width": width,
        "backend": backend(),
    }
    key = key_of(__name__, "mibvh.studies.measure.counts", **made_of, lines=LINES)
    values = store.record(f"wide-{key}", _Values, functools.partial(of.figures, width)).values
    held = {name: values[name] for name in ("sah", "epo", "counted_cost")}
    key = key_of(__name__, "mibvh.audit.run", **made_of, **held)
    checks = store.record(f"audit-{key}", Checks, lambda: audited(of.wide(width), values)).checks
    return WideRow(values, checks)


def at_width(found: WidthResult, width: int) -> Iterator[WideRow]:
    """Yield the trees of a scene at one of its widths."""
    place = found.widths.index(width)
    return (rows[place] for rows in found.trees)


def columns_at(found: WidthResult, width: int) -> dict[str, F64]:
    """Quantities of a scene's trees at one width, (K,) float64 each."""
    rows = list(at_width(found, width))
    names = set.intersection(*(set(row.values) for row in rows))
    return {n: np.array([row.values[n] for row in rows], np.float64) for n in sorted(names)}
