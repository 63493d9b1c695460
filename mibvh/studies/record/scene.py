"""What a study knows of a scene, as typed records.

Numbers of a tree stand in :attr:`TreeRow.values` under the names of the quantities that are
declared in :mod:`mibvh.studies.record.quantities`; all else has a field of its own.
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

#: To be raised with every change of the fields below.
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
    """A tree of a scene, and what was found of it.

    Attributes
    ----------
    builder : str
        What the tree is called in tables.
    options : dict
        The builder's, seeds included.
    values : dict of str to float
        By the names of quantities.
    sah_by_depth, epo_by_depth : list of float
        Cost of the nodes at each depth.
    cost_groups : list of float
        Mean counted cost over each of some random groups of rays, for the bootstrap.
    costs_by_origin : list of OriginCost
    leaf_distribution : list of int
        How many rays visited 0, 1, 2, ... leaves.
    build_report : dict
        What the builder said of its work.
    audit : list of Check
        The checks of the tree and of its figures.
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
        In which every tree was timed once.
    complete : bool
        Whether the error asked for was reached before the time ran out.
    rays, portions : int
        How many rays were timed, and in how many portions; no portions where they are too few
        to be timed.
    copies : int
        How often they were repeated to fill a launch.
    clock : str
        By which the trees are compared: ``kernel``, its wall time, or ``process``, the CPU time
        of the process.
    repeat_difference : float
        By how much the first tree, timed twice under two names, differed from itself; NaN where
        no tree was.
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
    """What of a scene could not be had, and why: the rest of its figures are without it.

    Attributes
    ----------
    what : str
        Such as ``tree mine``, or ``metric hops of tree bbvh``.
    why : str
        One sentence.
    tree : str
        The tree that has no row for it; empty where it is less than a tree.
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
    """What an experiment found of a scene; a dataclass per experiment inherits from this.

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
    """All that a study knows of a scene.

    Attributes
    ----------
    scene : str
        Its name.
    triangles : int
    digest : str
        Hash of the triangles.
    notes : list of str
        What a reader has to know, in sentences.
    rays : RayFacts
    timing : dict of str to Timing
        By lane mode, ``scalar`` and ``simd``.
    trees : list of TreeRow
    options : StudyOptions
    environment : dict
        What it was measured on; see :func:`mibvh.environment.environment`.
    picture : str
        PNG, base64-encoded; empty where there is none.
    seconds : dict of str to float
        What each stage took, in the runs that its pieces were made in.
    reused : dict of str to int
        How many pieces of each stage the last run took from the study's folder.
    code : str
        Hash of the code that measured the scene.
    memory : dict of str to float
        Bytes that the process had in use at most, by stage, in the last run; as ``predicted``, what
        was expected of it all.
    results : dict of str to Result
        Of the experiments beside prediction that were run, by name.
    missing : list of Missing
        Trees that a builder of the user's own failed at, and the like; the next run tries them
        again.
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
        object.__setattr__(self, "scene", plain(self.scene))  # a file may be called anything

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
        """Whether a quantity is known of all trees: times are not, where rays are too few."""
        return bool(np.isfinite(self.column(name)).all())

    @property
    def over(self) -> str:
        """Over how many trees the scene's figures are, where some are missing; otherwise empty."""
        count, without = len(self.trees), [one.tree for one in self.missing if one.tree]
        return f"{count} of {count + len(without)} trees" if without else ""

    def splits_triangles(self, tree: TreeRow) -> bool:
        """Whether a tree enters some triangle more than once."""
        return tree["references"] > self.triangles

    def result(self, kind: type[R]) -> R | None:
        """Return what an experiment found, or None if it was not run."""
        return self.results.get(kind.experiment)

    def sample(self, target: str) -> Sample:
        """Return what is known of the trees, and the quantity that is to be predicted.

        It is the same object whenever it is asked for, so that fits to it are kept.
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
            If it is of another version of mibvh.
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
