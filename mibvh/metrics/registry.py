"""The quantities of a tree, and the registry of metrics.

A :class:`Quantity` declares one number of a tree: its unit, its rays, and how a table shows it.
A :class:`Metric` computes some quantities from a tree alone. A new metric is one file with a
``METRIC`` and one line in :data:`_BUNDLED`; a user's own is passed to :func:`add_metric`.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from mibvh.errors import MibvhError, guard
from mibvh.metrics.epo import OverlapResult, overlap
from mibvh.metrics.sah import node_costs, sah_per_node
from mibvh.tree import Tree
from mibvh.triangles import F64, Triangles

#: Format of values that span powers of ten, as times on a processor and on a GPU do: three
#: significant digits, never an exponent.
DIGITS = "digits"
#: Populations of rays: none, the whole ray set, rays whose lines are followed, rays timed in
#: either lane mode, and those of the simulated warps.
Population = Literal["", "all", "lines", "scalar", "simd", "warp"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of a tree.

    Attributes
    ----------
    name, unit : str
        The name is the value of ``measurement`` in ``results.parquet``.
    rays : str
        The population of rays behind it; empty if it needs none.
    heading : str
        Heading of its column in tables for people; empty if it is written to files only.
    format : str
        Format of its values in these tables, such as ``.3f``, or :data:`DIGITS`.
    help : str
        A short explanation.
    smaller_is_better : bool
        Whether the smallest value of a table is marked as the best.
    main : bool
        Whether the report's table of the trees of all scenes has it as a column. The table of
        each scene has a column for every quantity with a heading.
    target : bool
        Whether predictors are compared with it.
    figure, caption : str
        Of a target: suffix of its figure's file name, and the figure's caption.
    error : str
        Name of the quantity with its relative standard error; empty if it has no noise.
    per_tree : bool
        Whether every tree of a study has it; otherwise only rows of an experiment do.
    place : int
        Position of its column: smaller numbers come first.
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
    """A tree whose metrics are computed; it caches what several metrics need.

    Parameters
    ----------
    tree : Tree
    triangles : Triangles
        What it was built for.
    """

    def __init__(self, tree: Tree, triangles: Triangles) -> None:
        self.tree, self.triangles = tree, triangles

    @functools.cached_property
    def overlap(self) -> OverlapResult:
        """Area of the foreign surfaces inside each node; see :func:`mibvh.metrics.epo.overlap`."""
        return overlap(self.tree, self.triangles)

    @functools.cached_property
    def sah_shares(self) -> F64:
        """(M,) float64: contribution of each node to SAH."""
        return sah_per_node(self.tree)

    @functools.cached_property
    def epo_shares(self) -> F64:
        """(M,) float64: contribution of each node to EPO."""
        return np.asarray(node_costs(self.tree) * self.overlap.fraction)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric of a tree, or several that are computed together.

    Attributes
    ----------
    name : str
    quantities : tuple of Quantity
        The numbers that it computes.
    compute : callable
        ``compute(subject)`` returns a mapping with a value for each quantity's name.
    """

    name: str
    quantities: tuple[Quantity, ...]
    compute: Callable[[Subject], Mapping[str, float]]

    def __call__(self, subject: Subject) -> dict[str, float]:
        """Compute the quantities of a tree.

        Raises
        ------
        MibvhError
            If a user's metric fails, or the returned quantities are not the declared ones or not
            numbers.
        """
        with guard(f"metric {self.name}", self.compute):
            found = dict(self.compute(subject))
        values = {name: self._number(name, value) for name, value in found.items()}
        declared = {quantity.name for quantity in self.quantities}
        if wrong := sorted(declared ^ set(values)):
            raise MibvhError(
                f"metric {self.name} declares {', '.join(sorted(declared))}; {wrong[0]} is "
                f"{'missing' if wrong[0] in declared else 'not among them'}"
            )
        return values

    def _number(self, name: str, value: object) -> float:
        """Return a plain Python number, because records are written as JSON."""
        plain = value.item() if isinstance(value, np.generic) else value
        if isinstance(plain, int | float) and (isinstance(plain, float) or abs(plain) < 1 << 63):
            return plain
        raise MibvhError(f"metric {self.name}: {name} is {str(plain)[:40]!r}, not a number")


#: Modules with a ``METRIC``, in the order of their columns in files.
_BUNDLED = ("mibvh.metrics.cost", "mibvh.metrics.shape")
_added: dict[str, Metric] = {}


def add_metric(metric: Metric) -> Metric:
    """Register a metric. All later studies compute and show it."""
    _added[metric.name] = metric
    return metric


def bundled_metrics() -> tuple[Metric, ...]:
    """Return the metrics of this package."""
    return tuple(importlib.import_module(name).METRIC for name in _BUNDLED)


def added_metrics() -> tuple[Metric, ...]:
    """Return the user's own metrics, in the order they were added."""
    return tuple(_added.values())


def metrics() -> tuple[Metric, ...]:
    """Return all metrics: the bundled ones, then the user's own."""
    return (*bundled_metrics(), *added_metrics())
