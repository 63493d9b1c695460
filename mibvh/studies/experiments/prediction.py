"""Prediction, which every study makes: its measurements are those of the scene's record."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pandas as pd

from mibvh.studies.paper.claims.builders import builder_claims
from mibvh.studies.paper.claims.prediction import prediction_claims
from mibvh.studies.paper.claims.simd import simd_claims
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.experiment import Experiment, TidyRow
from mibvh.studies.record.scene import Records, SceneRecord


def _rows(record: SceneRecord) -> Iterator[TidyRow]:
    for place, tree in enumerate(record.trees):
        yield TidyRow(place, tree.values)
    # The first tree is timed a second time under another name.
    first = record.trees[0]
    again = {
        f"{lanes}_ns_again": first[f"{lanes}_ns"] * (1 + timing.repeat_difference)
        for lanes, timing in record.timing.items()
    }
    yield TidyRow(0, again)


def _claims(records: Records, correlations: pd.DataFrame) -> Iterator[Claim]:
    return itertools.chain(
        prediction_claims(records, correlations),
        builder_claims(records, correlations),
        simd_claims(records, correlations),
    )


EXPERIMENT = Experiment(
    name="prediction",
    summary="metrics, counted cost, scalar and SIMD time, repeatability; always done",
    rows=_rows,
    claims=_claims,
)
