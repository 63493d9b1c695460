"""What is known of a tree, declared once; and the registry of tree statistics.

A :class:`Quantity` says what one number of a tree is: its unit, the rays it is of, and how a table
shows it. A :class:`Metric` computes some quantities from a tree alone. A new metric is one file
with a ``METRIC`` and one line in :data:`_BUNDLED`; a user's own is passed to :func:`add_metric`.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from mibvh.errors import MibvhError
from mibvh.metrics.epo import OverlapResult, overlap
from mibvh.metrics.sah import node_costs, sah_per_node
from mibvh.tree import Tree
from mibvh.triangles import F64, Triangles

#: Populations of rays: none, all of the ray set, those whose lines are followed, those timed, those
#: that warps are simulated with.
Population = Literal["", "all", "lines", "scalar", "simd", "warp"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of a tree.

    Attributes
    ----------
    name, unit : str
        The name is that of ``measurement`` in ``results.parquet``.
    rays : str
        The rays that it is of; empty for what takes none.
    heading : str
        Of its column in tables for people; empty for what stands in files alone.
    format : str
        How its values are written there.
    help : str
        What it is, in a few words.
    smaller_is_better : bool
        Whether the least value of a table is marked as the best.
    main : bool
        Whether it stands in the table of all scenes' trees as well as in the scene's own.
    target : bool
        Whether predictors are held against it.
    figure, caption : str
        Of a target: the name of its figure's file after the scene's, and what is said below it.
    error : str
        Name of the quantity that is its relative standard error; empty where it has no noise.
    per_tree : bool
        Whether every tree of a study has one; if not, only rows of an experiment do.
    place : int
        Where its column stands: columns of smaller places come first.
    """

    name: str
    unit: str
    rays: Population = ""
    heading: str = ""
    format: str = "g"
    help: str = ""
    smaller_is_better: bool = False
    main: bool = False
    target: bool = False
    figure: str = ""
    caption: str = ""
    error: str = ""
    per_tree: bool = True
    place: int = 50


class Subject:
    """A tree that is judged; what several metrics need is computed once.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
        That it was built for.
    """

    def __init__(self, tree: Tree, triangles: Triangles) -> None:
        self.tree, self.triangles = tree, triangles

    @functools.cached_property
    def overlap(self) -> OverlapResult:
        """Foreign surface inside each node."""
        return overlap(self.tree, self.triangles)

    @functools.cached_property
    def sah_shares(self) -> F64:
        """(M,) float64: what each node adds to SAH."""
        return sah_per_node(self.tree)

    @functools.cached_property
    def epo_shares(self) -> F64:
        """(M,) float64: what each node adds to EPO."""
        return np.asarray(node_costs(self.tree) * self.overlap.fraction)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Metric:
    """A statistic of a tree, or several that are computed together.

    Attributes
    ----------
    name : str
    quantities : tuple of Quantity
        What it computes.
    compute : callable
        ``compute(subject)`` returns a value for the name of each quantity.
    """

    name: str
    quantities: tuple[Quantity, ...]
    compute: Callable[[Subject], Mapping[str, float]]

    def __call__(self, subject: Subject) -> dict[str, float]:
        """Compute the quantities of a tree.

        Raises
        ------
        MibvhError
            If not exactly the declared quantities come back.
        """
        values = dict(self.compute(subject))
        declared = {quantity.name for quantity in self.quantities}
        if wrong := sorted(declared ^ set(values)):
            raise MibvhError(
                f"metric {self.name} declares {', '.join(sorted(declared))}; {wrong[0]} is "
                f"{'missing' if wrong[0] in declared else 'not among them'}"
            )
        return values


#: Modules with a ``METRIC``, in the order of their columns in files.
_BUNDLED = ("mibvh.metrics.cost", "mibvh.metrics.shape")
_added: dict[str, Metric] = {}


def add_metric(metric: Metric) -> Metric:
    """Register a tree statistic: every study computes and shows it from here on."""
    _added[metric.name] = metric
    return metric


def metrics() -> tuple[Metric, ...]:
    """Return all metrics: the bundled ones, then the user's own in the order they were added."""
    bundled = (importlib.import_module(name).METRIC for name in _BUNDLED)
    return (*bundled, *_added.values())
