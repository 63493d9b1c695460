"""The results of a study for one scene, as typed records.

The numbers of a tree are in :attr:`TreeRow.values`, by the names of the quantities that are
declared in :mod:`mibvh.studies.record.quantities`. Everything else has a field of its own.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np

from mibvh.audit.record import Check
from mibvh.errors import MibvhError
from mibvh.files import plain
from mibvh.metrics.predictors import Sample
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.triangles import F64

#: Increase this with every change of the fields below.
FORMAT = 11


@dataclasses.dataclass(frozen=True)
class OriginCost:
    """Mean counted cost of the rays of one bounce from one viewpoint."""

    bounce: int
    viewpoint: int
    rays: int
    cost: float


@dataclasses.dataclass(frozen=True)
class TreeRow:
    """The results for one tree of a scene.

    Attributes
    ----------
    builder : str
        Name of the tree in tables: its builder with options, or the name of a given tree.
    options : dict
        All options of the builder, seeds included.
    values : dict of str to float
        Values by the names of quantities.
    sah_by_depth, epo_by_depth : list of float
        Contribution of the nodes at each depth, root first.
    cost_groups : list of float
        Mean counted cost of each of several groups of rays, for the bootstrap.
    costs_by_origin : list of OriginCost
    leaf_distribution : list of int
        Number of rays that visited 0, 1, 2, ... leaves.
    build_report : dict
        What the builder reported.
    audit : list of Check
        The checks of the tree and of its numbers.
    """

    builder: str
    options: dict[str, Any]
    values: dict[str, float]
    sah_by_depth: list[float]
    epo_by_depth: list[float]
    cost_groups: list[float]
    costs_by_origin: list[OriginCost]
    leaf_distribution: list[int]
    build_report: dict[str, Any]
    audit: list[Check] = dataclasses.field(default_factory=list)

    @property
    def failures(self) -> list[Check]:
        """The checks that did not pass."""
        return [check for check in self.audit if not check.passed]

    def __post_init__(self) -> None:
        object.__setattr__(self, "builder", plain(self.builder))

    def __getitem__(self, name: str) -> float:
        if name not in self.values:
            raise MibvhError(
                f"the record of tree {self.builder} has no {name!r}: it is of a study without the "
                "plugin that declares that; study the scene again with it"
            )
        return self.values[name]

    def with_values(self, **values: float) -> TreeRow:
        """Return the row with more quantities."""
        return dataclasses.replace(self, values={**self.values, **values})


@dataclasses.dataclass(frozen=True)
class Timing:
    """How the trees of a scene were timed in one lane mode.

    Attributes
    ----------
    rounds : int
        Number of rounds; in each, every tree was timed once.
    complete : bool
        Whether the requested error was reached within the time budget.
    rays, portions : int
        Number of rays timed, and number of portions that they were timed in; 0 portions if the
        rays are too few to be timed.
    copies : int
        How often the rays were repeated to fill a launch.
    clock : str
        The clock that trees are compared by: ``kernel`` (wall time of the kernel) or ``process``
        (CPU time of the process).
    repeat_difference : float
        Relative difference between two timings of the first tree, entered under two names; NaN
        if no tree was timed twice.
    """

    rounds: int
    complete: bool
    rays: int
    portions: int
    copies: int = 1
    clock: str = "kernel"
    repeat_difference: float = float("nan")


@dataclasses.dataclass(frozen=True)
class Missing:
    """A result that a study failed to get, while it continued with the rest.

    Attributes
    ----------
    what : str
        Such as ``tree mine``, or ``metric hops of tree bbvh``.
    why : str
        One sentence.
    tree : str
        Name of the tree, if a whole tree is missing; otherwise empty.
    """

    what: str
    why: str
    tree: str = ""

    def __post_init__(self) -> None:
        for name in ("what", "why", "tree"):
            object.__setattr__(self, name, plain(getattr(self, name)))

    def __str__(self) -> str:
        return f"{self.what} is missing: {self.why}"


@dataclasses.dataclass(frozen=True)
class RayFacts:
    """A scene's ray set: how many rays, their hash, how they were made."""

    count: int
    digest: str
    viewpoints: int
    seed: int
    meta: dict[str, Any]


class Result:
    """Base class for the result of an experiment: each experiment has a dataclass of its own.

    >>> class Twice(Result, experiment="twice"):
    ...     pass
    >>> Result.kinds.pop("twice").experiment
    'twice'
    """

    #: The experiment that it is of.
    experiment: ClassVar[str]
    #: All of them, by the name of the experiment.
    kinds: ClassVar[dict[str, type[Result]]] = {}

    def __init_subclass__(cls, *, experiment: str) -> None:
        cls.experiment = experiment
        Result.kinds[experiment] = cls


R = TypeVar("R", bound=Result)


@dataclasses.dataclass(frozen=True)
class SceneRecord:
    """All results of a study for one scene.

    Attributes
    ----------
    scene : str
        Its name.
    triangles : int
    digest : str
        Hash of the triangles.
    notes : list of str
        Sentences for the reader of the report.
    rays : RayFacts
    timing : dict of str to Timing
        By lane mode, ``scalar`` and ``simd``.
    trees : list of TreeRow
    options : StudyOptions
    environment : dict
        Hardware and software; see :func:`mibvh.environment.environment`.
    picture : str
        A PNG, base64-encoded; empty if there is none.
    seconds : dict of str to float
        Seconds of each stage, summed over the runs in which its pieces were made.
    reused : dict of str to int
        Number of pieces of each stage that the last run found in the study's folder.
    code : str
        Hash of the code that measured the scene.
    memory : dict of str to float
        Peak memory of the process in bytes, by stage, in the last run; ``predicted`` is the
        predicted peak of the whole study.
    results : dict of str to Result
        Results of the other experiments that were run, by name.
    missing : list of Missing
        Trees, metrics and the like that failed; the next run tries them again.
    """

    scene: str
    triangles: int
    digest: str
    notes: list[str]
    rays: RayFacts
    timing: dict[str, Timing]
    trees: list[TreeRow]
    options: StudyOptions
    environment: dict[str, Any]
    picture: str
    seconds: dict[str, float]
    reused: dict[str, int]
    code: str
    memory: dict[str, float] = dataclasses.field(default_factory=dict)
    results: dict[str, Any] = dataclasses.field(default_factory=dict)
    missing: list[Missing] = dataclasses.field(default_factory=list)

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", plain(self.scene))  # a file may have any name

    def __getitem__(self, name: str) -> Any:
        """Return a field or an experiment's result by name, as when records were dicts."""
        warnings.warn(
            f'record["{name}"] is deprecated: a scene\'s record has fields, such as record.trees',
            DeprecationWarning,
            stacklevel=2,
        )
        return self.results[name] if name in self.results else getattr(self, name)

    def column(self, name: str) -> F64:
        """(K,) float64: a quantity of each tree."""
        return np.array([tree[name] for tree in self.trees], dtype=np.float64)

    def knows(self, name: str) -> bool:
        """Whether all trees have a value of a quantity; times are missing if rays are too few."""
        return bool(np.isfinite(self.column(name)).all())

    @property
    def over(self) -> str:
        """Such as ``8 of 9 trees``, if some trees are missing; otherwise empty."""
        count, without = len(self.trees), [one.tree for one in self.missing if one.tree]
        return f"{count} of {count + len(without)} trees" if without else ""

    def splits_triangles(self, tree: TreeRow) -> bool:
        """Whether a tree has several references to some triangle."""
        return tree["references"] > self.triangles

    def result(self, kind: type[R]) -> R | None:
        """Return the result of an experiment, or None if it was not run."""
        return self.results.get(kind.experiment)

    def sample(self, target: str) -> Sample:
        """Return the quantities of the trees, and the one that is to be predicted.

        Every call returns the same object, because fits are cached by identity.
        """
        if target not in self._samples:
            names = set.intersection(*(set(tree.values) for tree in self.trees))
            columns = {name: self.column(name) for name in names}
            self._samples[target] = Sample(columns, self.column(target))
        return self._samples[target]

    @functools.cached_property
    def _samples(self) -> dict[str, Sample]:
        return {}

    def to_json(self) -> dict[str, Any]:
        """Return the record as JSON-able values."""
        return dict(to_json(self))

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> SceneRecord:
        """Read what :meth:`to_json` returned.

        Raises
        ------
        MibvhError
            If the data do not fit the fields, as those of another version of mibvh.
        """
        read = from_json(dict[str, Any], data)
        found = from_json(dict[str, Any], read.pop("results", {}))
        if unknown := sorted(set(found) - set(Result.kinds)):
            raise MibvhError(f"there is no experiment {unknown[0]!r}, but a study holds one")
        plain = from_json(cls, {**read, "results": {}})
        results = {name: from_json(Result.kinds[name], of) for name, of in found.items()}
        return dataclasses.replace(plain, results=results)


Records = Sequence[SceneRecord]


def samples(records: Records, target: str) -> list[Sample]:
    """Return the samples of all scenes; see :meth:`SceneRecord.sample`."""
    return [record.sample(target) for record in records]
