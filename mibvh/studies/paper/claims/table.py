"""All claims that a study can judge, as a table."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.record.experiment import experiments
from mibvh.studies.record.scene import Records


def claims(records: Records, correlations: pd.DataFrame) -> pd.DataFrame:
    """Judge the claims of all experiments.

    Parameters
    ----------
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.

    Returns
    -------
    DataFrame
        Columns ``claim, held, paper, ours, judged by``; topic by topic.
    """
    judged = [claim for e in experiments() for claim in e.shown("claims", records, correlations)]
    return pd.DataFrame(
        [
            {
                "claim": claim.claim,
                "held": claim.held,
                "paper": claim.paper,
                "ours": claim.ours,
                "judged by": claim.judged,
            }
            for claim in sorted(judged, key=lambda claim: claim.place)
        ]
    )
