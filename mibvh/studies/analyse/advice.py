"""The advised predictor: without fit or traversal, and not significantly worse than any other."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd

#: Predictors that can be used before a tree is traced. Of those that the noise does not tell
#: apart the first is advised: over many scenes it was as good as any, and its parts have a meaning.
ADVISED = ("finite rays", "finite by lines", "estimated", "SAH")
#: Standard errors beyond which one r is better than another.
_SURE = 2.0
#: An r of 1 counts as this much: Fisher's z of 1 has no end.
_MOST = 1 - 1e-6


@dataclasses.dataclass(frozen=True)
class Advice:
    """A predictor, and those that do as well.

    Attributes
    ----------
    name : str
    best : str
        The one of the greatest mean r.
    equals : tuple of str
        Others that the noise does not tell from the best, ``best`` among them.
    """

    name: str
    best: str
    equals: tuple[str, ...]


def advice(correlations: pd.DataFrame) -> Advice | None:
    """Return the advised predictor; None if no r is known.

    Predictors are compared by the mean of Fisher's z of their r with counted cost. Its standard
    error over S scenes of n trees is taken as √(2 / (n − 3) / S), as if two predictors had nothing
    in common: a difference within twice of that decides nothing.

    Parameters
    ----------
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    of = correlations[correlations["measurement"] == "counted_cost"]
    r = of.pivot(index="scene", columns="predictor", values="pearson")
    r = r[[name for name in ADVISED if name in r]].dropna()
    if r.empty:
        return None
    trees = of.groupby("scene")["trees"].max().reindex(r.index).to_numpy(np.float64)
    z = np.arctanh(r.clip(-_MOST, _MOST)).mean()
    with np.errstate(divide="ignore"):
        error = float(np.sqrt(np.sum(2 / np.maximum(trees - 3, 0)))) / len(r)
    best = str(r.mean().idxmax())
    equal = [str(name) for name in r if z[best] - z[name] <= _SURE * error]
    return Advice(equal[0], best, tuple(equal[1:]))
