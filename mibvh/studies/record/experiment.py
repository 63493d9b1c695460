"""What an experiment is, and the registry of experiments.

An experiment measures something of a scene beside the prediction that every study makes, and says
how that is shown. A new one is one file with an :class:`Experiment`, and one line in
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
    """Values of one tree for ``results.parquet``, and what they are of.

    Attributes
    ----------
    place : int
        Of the tree among the scene's.
    values : mapping of str to float
        Quantities by name; what is not declared is left out.
    of : mapping of str to value
        Columns that are other than in the rows of the study itself: ``experiment``,
        ``rotation``, ``max_leaf``, ``bounce``, ``viewpoint``, ``cut_depth``, ``splits``,
        ``width``, ``kind``, ``digest``.
    rays : mapping of str to int
        Sizes of the populations of rays where they are other than the study's.
    """

    place: int
    values: Mapping[str, float]
    of: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    rays: Mapping[str, int] = dataclasses.field(default_factory=dict)


def _nothing(*_: object) -> Iterator[Any]:
    return iter(())


@dataclasses.dataclass(frozen=True, kw_only=True)
class Experiment:
    """An experiment.

    Attributes
    ----------
    name, summary : str
    measure : callable
        ``measure(setting, report)`` returns the experiment's :class:`Result`; see
        ``mibvh/studies/measure/setting.py`` and :class:`~mibvh.studies.record.progress.Reporter`.
        None where nothing is measured beside what every study measures.
    weight : float
        How long it takes, as a share of the prediction's time, for the progress.
    quantities : tuple of Quantity
        What its rows of ``results.parquet`` hold beside the study's own quantities.
    rows : callable
        ``rows(record)`` yields a :class:`TidyRow` per tree and case.
    sheets : callable
        ``sheets(records)`` returns its tables for people; nothing where it was not run.
    claims : callable
        ``claims(records, correlations)`` yields the paper's claims that it can judge.
    figures : callable
        ``figures(record)`` yields the name of a figure's file, what is said below it, and the
        figure.
    audits : callable
        ``audits(record)`` yields what else was audited: its name, and the checks.
    """

    name: str
    summary: str
    measure: Callable[..., Result] | None = None
    weight: float = 0.0
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
    """Register an experiment: ``mibvh study --experiments NAME`` runs it from here on."""
    _experiments[experiment.name] = experiment
    EXPERIMENTS[experiment.name] = experiment.summary
    return experiment


def experiments() -> tuple[Experiment, ...]:
    """Return all experiments; the first is the base of all others and always made."""
    return tuple(_experiments.values())


def chosen(names: Sequence[str]) -> list[Experiment]:
    """Return those experiments that measure something, of the given names."""
    return [e for e in experiments() if e.name in names and e.measure is not None]
