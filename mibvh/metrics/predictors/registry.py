"""The registry of predictors: each is an object that fits its weights and predicts.

A new predictor is one file beside this one with its :class:`Predictor` objects in ``PREDICTORS``,
and one line in :data:`_BUNDLED`; a user's own is passed to :func:`add_predictor`. Correlations,
rotation and sensitivity tables, the report's glossary and the table in the documentation follow.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError, guard

F64 = npt.NDArray[np.float64]
#: Fitted weights by name, such as ``{"alpha": 0.71}``.
Weights = Mapping[str, float]
#: Quantities of a scene's trees by name, (K,) float64 each.
Values = Mapping[str, F64]

_NONE = float("nan")


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """A scene's trees: their quantities, and a measurement.

    Samples are compared by identity, so that fits can be cached.

    Attributes
    ----------
    values : mapping of str to (K,) float64
        Quantities by name.
    measured : (K,) float64
        What is predicted, up to a linear function.
    """

    values: Values
    measured: F64

    def where(self, chosen: npt.NDArray[np.bool_]) -> Sample:
        """Return the sample of some of the trees."""
        if chosen.all():
            return self
        return Sample({name: v[chosen] for name, v in self.values.items()}, self.measured[chosen])


def no_weights(samples: Sequence[Sample], this: int) -> Weights:
    """Fit nothing."""
    return {}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Predictor:
    """A predictor of the cost of trees.

    Attributes
    ----------
    name : str
        Its name in tables.
    formula : str
        What it is, for the glossary.
    free : str
        Its free parameters, such as ``1 per scene``; ``0`` where nothing is fitted.
    needs : tuple of str
        Quantities that ``predict`` takes.
    fit : callable
        ``fit(samples, this)`` returns the weights for the scene ``samples[this]``. The other
        scenes are given for weights that scenes share.
    predict : callable
        ``predict(values, weights)`` returns (K,) float64.
    linear : tuple of str
        Quantities of which it is a linear combination with free weights. Each tree can then be
        predicted from a fit to the others.
    headline : str
        Its title among the main predictors; empty for the others.
    rotated : str
        Its heading in the tables of the rotation experiment, with weights fitted to counted cost
        and averaged over the scenes; empty where it is left out.
    varied : str
        Its heading in the tables of the sensitivity experiment; empty where it is left out.
    """

    name: str
    formula: str
    free: str
    needs: tuple[str, ...]
    predict: Callable[[Values, Weights], F64]
    fit: Callable[[Sequence[Sample], int], Weights] = no_weights
    linear: tuple[str, ...] = ()
    headline: str = ""
    rotated: str = ""
    varied: str = ""

    @property
    def key(self) -> str:
        """Its name as a column of a DataFrame."""
        return self.name.lower().replace(" ", "_")

    def __call__(self, samples: Sequence[Sample], this: int = 0) -> tuple[Weights, F64]:
        """Fit and predict a scene's trees. Returns the weights and (K,) float64."""
        weights = self.fit(samples, this)
        return weights, self.predict(samples[this].values, weights)

    def knows(self, values: Values) -> bool:
        """Whether all quantities that it needs are present."""
        return all(name in values for name in self.needs)


#: Modules with ``PREDICTORS``, in the order of the tables.
_BUNDLED = (
    "mibvh.metrics.predictors.paper",
    "mibvh.metrics.predictors.ends",
    "mibvh.metrics.predictors.variability",
    "mibvh.metrics.predictors.lanes",
)
_added: dict[str, Predictor] = {}


def add_predictor(predictor: Predictor) -> Predictor:
    """Register a predictor. All later studies evaluate and show it.

    Where it fails, it predicts NaN, and the study says why (:func:`faults`).

    Raises
    ------
    MibvhError
        If a bundled one has its name.
    """
    if predictor.name in {bundled.name for bundled in _bundled()}:
        raise MibvhError(f"two predictors are called {predictor.name}; rename your own")
    _added[predictor.name] = predictor
    return predictor


def predictors() -> tuple[Predictor, ...]:
    """Return all predictors: the bundled ones, then the user's own in the order of addition."""
    return (*_bundled(), *map(_forgiving, _added.values()))


def _bundled() -> list[Predictor]:
    return [p for name in _BUNDLED for p in importlib.import_module(name).PREDICTORS]


def faults(samples: Sequence[Sample], this: int) -> dict[str, MibvhError]:
    """Return the errors of the user's predictors for a scene, by the predictor's name."""
    found = {}
    values = samples[this].values
    for one in _added.values():
        try:
            if one.knows(values):
                _predicted(one, values, _fitted(one, samples, this))
        except MibvhError as error:
            found[one.name] = error
    return found


def _forgiving(one: Predictor) -> Predictor:
    """Wrap a user's predictor so that it predicts NaN instead of failing."""

    def fit(samples: Sequence[Sample], this: int) -> Weights:
        try:
            return _fitted(one, samples, this)
        except MibvhError:
            return {}

    def predict(values: Values, weights: Weights) -> F64:
        try:
            return _predicted(one, values, weights)
        except MibvhError:
            return np.full(_count(values), _NONE)

    return dataclasses.replace(one, fit=fit, predict=predict)


def _fitted(one: Predictor, samples: Sequence[Sample], this: int) -> Weights:
    """Fit a user's predictor to the trees that have all quantities it needs."""
    with guard(f"predictor {one.name}", one.fit):
        weights = one.fit([s.where(_known(one, s.values)) for s in samples], this)
        return {str(name): float(value) for name, value in dict(weights).items()}


def _predicted(one: Predictor, values: Values, weights: Weights) -> F64:
    """Predict with a user's predictor; NaN for trees that lack a quantity it needs."""
    known = _known(one, values)
    found = np.full(len(known), _NONE)
    with guard(f"predictor {one.name}", one.predict):
        some = {name: value[known] for name, value in values.items()}
        given = np.asarray(one.predict(some, weights))
        predicted = given.real.astype(np.float64)
    if np.iscomplexobj(given):
        raise MibvhError(f"predictor {one.name} gives complex numbers")
    if predicted.shape != (known.sum(),):
        raise MibvhError(
            f"predictor {one.name} gives an array {predicted.shape} for {known.sum()} trees"
        )
    found[known] = predicted
    return found


def _known(one: Predictor, values: Values) -> npt.NDArray[np.bool_]:
    """Return (K,) bool: the trees that have all quantities a predictor needs."""
    known = np.full(_count(values), one.knows(values))
    for name in one.needs if one.knows(values) else ():
        known &= np.isfinite(values[name])
    return known


def _count(values: Values) -> int:
    return len(next(iter(values.values())))


def predictor(name: str) -> Predictor:
    """Look up a predictor by name.

    Raises
    ------
    MibvhError
        If there is none.
    """
    known = {p.name: p for p in predictors()}
    if name not in known:
        raise MibvhError(f"there is no predictor {name!r}; there are: {', '.join(known)}")
    return known[name]


def glossary() -> dict[str, str]:
    """Return the formula of each predictor, by name."""
    return {p.name: p.formula for p in predictors()}


def alpha_of(weights: Weights) -> float:
    """Return alpha, the weight of EPO; NaN if there is none."""
    return float(weights.get("alpha", _NONE))
