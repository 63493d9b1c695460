"""The Experiment class and the registry of experiments.

An experiment measures more of a scene than the base study does, and declares the tables, claims and
figures that show it. A new one is one file with an :class:`Experiment`, and one line in
:mod:`mibvh.studies.experiments`; a user's own is passed to :func:`add_experiment`.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from mibvh.audit.record import Check
from mibvh.errors import guard, is_bundled, of_one_tree
from mibvh.metrics.registry import Quantity
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.options import EXPERIMENTS
from mibvh.studies.record.scene import Records, Result, SceneRecord
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.studies.record.sheet import Sheet


@dataclasses.dataclass(frozen=True)
class TidyRow:
    """Values of one tree for ``results.parquet``, and the columns that identify them.

    Attributes
    ----------
    place : int
        Index of the tree among the scene's trees.
    values : mapping of str to float
        Values by the names of quantities; undeclared names are left out.
    of : mapping of str to value
        Columns that differ from those of the base study's rows: ``experiment``,
        ``rotation``, ``max_leaf``, ``bounce``, ``viewpoint``, ``cut_depth``, ``splits``,
        ``width``, ``kind``, ``digest``.
    rays : mapping of str to int
        Sizes of the ray populations that differ from those of the base study.
    """

    place: int
    values: Mapping[str, float]
    of: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    rays: Mapping[str, int] = dataclasses.field(default_factory=dict)


def _nothing(*_: object) -> Iterator[Any]:
    return iter(())


@dataclasses.dataclass(frozen=True, kw_only=True)
class Experiment:
    """An experiment: its measurement, and how its results are shown.

    Attributes
    ----------
    name, summary : str
    measure : callable
        ``measure(setting, report)`` returns the experiment's :class:`Result`; see
        ``mibvh/studies/measure/setting.py`` and :class:`~mibvh.studies.record.progress.Reporter`.
        None if it measures no more than every study does.
    weight : float
        Its duration relative to the base study, for the progress bar.
    drafts : bool
        Whether it makes other trees of the builders' drafts, which are kept for it then.
    quantities : tuple of Quantity
        Quantities of its rows in ``results.parquet``, besides those of the base study.
    rows : callable
        ``rows(record)`` yields a :class:`TidyRow` per tree and case.
    sheets : callable
        ``sheets(records)`` returns its tables for people; none if it was not run.
    claims : callable
        ``claims(records, correlations)`` yields the paper's claims that it can judge.
    figures : callable
        ``figures(record)`` yields tuples of a file name, a caption and the figure.
    audits : callable
        ``audits(record)`` yields pairs of a name and the checks of further audits.
    """

    name: str
    summary: str
    measure: Callable[..., Result] | None = None
    weight: float = 0.0
    drafts: bool = False
    quantities: tuple[Quantity, ...] = ()
    rows: Callable[[SceneRecord], Iterable[TidyRow]] = _nothing
    sheets: Callable[[Records], Iterable[Sheet]] = _nothing
    claims: Callable[[Records, pd.DataFrame], Iterable[Claim]] = _nothing
    figures: Callable[[SceneRecord], Iterable[tuple[str, str, Any]]] = _nothing
    audits: Callable[[SceneRecord], Iterable[tuple[str, Sequence[Check]]]] = _nothing

    def found(self, setting: Any, report: Callable[..., None]) -> Result:
        """Measure a scene.

        Raises
        ------
        TreeFailed
            If one of the user's own fails, or returns what cannot be kept as its result.
        """
        assert self.measure is not None
        if is_bundled(self.measure):
            return self.measure(setting, report)
        with of_one_tree(), guard(f"experiment {self.name}", self.measure):
            result = self.measure(setting, report)
            kind = Result.kinds.get(self.name)
            if kind is None or not isinstance(result, kind):
                raise TypeError(
                    f"it returns a {type(result).__name__}, and no dataclass that inherits from "
                    f"Result with experiment={self.name!r}"
                )
            from_json(kind, json.loads(json.dumps(to_json(result))))  # as it will be kept
        return result

    def shown(self, part: str, *of: Any) -> list[Any]:
        """Return all that one of the functions yields, such as ``sheets``.

        Raises
        ------
        MibvhError
            If one of the user's own fails.
        """
        function = getattr(self, part)
        with guard(f"experiment {self.name}: {part}", function):
            return list(function(*of))


_experiments: dict[str, Experiment] = {}


def add_experiment(experiment: Experiment) -> Experiment:
    """Register an experiment, so that ``mibvh study --experiments NAME`` can run it."""
    _experiments[experiment.name] = experiment
    EXPERIMENTS[experiment.name] = experiment.summary
    return experiment


def experiments() -> tuple[Experiment, ...]:
    """Return all experiments; the first is the base study, which always runs."""
    return tuple(_experiments.values())


def chosen(names: Sequence[str]) -> list[Experiment]:
    """Return the experiments of these names that measure something."""
    return [e for e in experiments() if e.name in names and e.measure is not None]
