"""Size, shape and build time of a tree, as a study records them."""

from __future__ import annotations

import math

from mibvh.metrics.registry import Metric, Quantity, Subject


def _shape(subject: Subject) -> dict[str, float]:
    stats = subject.tree.stats()
    names = ("references", "nodes", "leaves", "depth", "mean_leaf_size")
    return {name: stats[name] for name in names} | {
        "build_seconds": subject.tree.meta.get("build_seconds", math.nan)
    }


METRIC = Metric(
    name="shape",
    compute=_shape,
    quantities=(
        Quantity(
            name="references",
            unit="count",
            heading="references",
            format=",",
            help="entries of the leaves",
            place=61,
        ),
        Quantity(
            name="nodes",
            unit="count",
            heading="nodes",
            format=",",
            help="inner nodes and leaves",
            place=60,
        ),
        Quantity(name="leaves", unit="count"),
        Quantity(name="depth", unit="levels", heading="depth", format="", help="levels", place=62),
        Quantity(
            name="mean_leaf_size",
            unit="references",
            heading="leaf size",
            format=".2f",
            help="references per leaf",
            place=63,
        ),
        Quantity(
            name="build_seconds",
            unit="s",
            heading="build s",
            format=".2f",
            help="seconds to build",
            main=True,
            place=90,
        ),
    ),
)
