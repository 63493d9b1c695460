"""SAH and EPO of a tree, as a study records them."""

from __future__ import annotations

import numpy as np

from mibvh.metrics.epo import overlap
from mibvh.metrics.registry import Metric, Quantity, Subject
from mibvh.metrics.sah import node_costs, sah_per_node


def _cost(subject: Subject) -> dict[str, float]:
    tree, found = subject.tree, subject.overlap
    inner, sizes = ~tree.is_leaf, tree.count * tree.is_leaf
    # Without the cost constants, so that others can be tried.
    area = sah_per_node(tree, 1.0, 1.0) / np.where(tree.is_leaf, tree.count, 1)
    fragments = found.fraction
    if tree.splits_triangles:
        fragments = overlap(tree, subject.triangles, fragments=True).fraction
    return {
        "sah": float(subject.sah_shares.sum()),
        "epo": float(subject.epo_shares.sum()),
        "sah_inner": float(area[inner].sum()),
        "sah_leaves": float((area * sizes).sum()),
        "epo_inner": float(found.fraction[inner].sum()),
        "epo_leaves": float((found.fraction * sizes).sum()),
        "epo_fragments": float((node_costs(tree) * fragments).sum()),
        "epo_pairs": found.pairs,
    }


METRIC = Metric(
    name="cost",
    compute=_cost,
    quantities=(
        Quantity(
            name="sah",
            unit="cost",
            heading="SAH",
            format=".2f",
            help="surface area heuristic",
            smaller_is_better=True,
            main=True,
            place=1,
        ),
        Quantity(
            name="epo",
            unit="cost",
            heading="EPO",
            format=".3f",
            help="end-point overlap",
            smaller_is_better=True,
            main=True,
            place=2,
        ),
        Quantity(name="sah_inner", unit="cost / C_inner"),
        Quantity(name="sah_leaves", unit="cost / C_tri"),
        Quantity(name="epo_inner", unit="cost / C_inner"),
        Quantity(name="epo_leaves", unit="cost / C_tri"),
        Quantity(name="epo_fragments", unit="cost"),
        Quantity(name="epo_pairs", unit="count"),
    ),
)
