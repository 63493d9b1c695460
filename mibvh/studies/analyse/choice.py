"""The cost of choosing the tree that a predictor ranks first."""

from __future__ import annotations

import numpy as np

from mibvh.metrics.predictors import predictor
from mibvh.studies.record.scene import Records, samples
from mibvh.triangles import F64


def cost_of_choice(records: Records, name: str) -> F64:
    """Counted cost of the tree that a predictor ranks first, relative to the scene's best tree.

    Parameters
    ----------
    records : sequence of SceneRecord
    name : str
        Of the predictor.

    Returns
    -------
    (S,) float64
        1 where it names the best tree; NaN where it says nothing of a scene's trees.
    """
    one, known = predictor(name), samples(records, "counted_cost")
    found = np.full(len(known), np.nan)
    for place, sample in enumerate(known):
        if not one.knows(sample.values):
            continue
        predicted, least = one(known, place)[1], sample.measured.min()
        if np.isfinite(predicted).all() and least > 0:
            found[place] = sample.measured[int(np.argmin(predicted))] / least
    return found
