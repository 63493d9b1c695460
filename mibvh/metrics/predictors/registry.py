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

from mibvh.errors import MibvhError

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
        """Whether all quantities that it needs are given."""
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
    """Register a predictor. All later studies evaluate and show it."""
    _added[predictor.name] = predictor
    return predictor


def predictors() -> tuple[Predictor, ...]:
    """Return all predictors: the bundled ones, then the user's own in the order of addition."""
    bundled = (p for name in _BUNDLED for p in importlib.import_module(name).PREDICTORS)
    return (*bundled, *_added.values())


def predictor(name: str) -> Predictor:
    """Return the predictor of that name.

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
    """Return what each predictor is, by name."""
    return {p.name: p.formula for p in predictors()}


def alpha_of(weights: Weights) -> float:
    """Weight of EPO among fitted weights; NaN where there is none."""
    return float(weights.get("alpha", _NONE))
