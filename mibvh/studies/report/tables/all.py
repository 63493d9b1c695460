"""All tables over the scenes of a study, in the order in which they are read."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.record.experiment import experiments
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Sheet
from mibvh.studies.report.tables.audit import audit_sheets
from mibvh.studies.report.tables.builders import builder_sheets
from mibvh.studies.report.tables.claims import claim_sheets
from mibvh.studies.report.tables.instrument import instrument_sheets
from mibvh.studies.report.tables.prediction import prediction_sheets
from mibvh.studies.report.tables.steps import step_sheets
from mibvh.studies.report.tables.trees import tree_sheet
from mibvh.studies.report.tables.warps import warp_sheets


def answers(records: Records, correlations: pd.DataFrame) -> list[Sheet]:
    """Return all tables over the scenes.

    Parameters
    ----------
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    return [
        *claim_sheets(records, correlations),
        *prediction_sheets(records, correlations),
        *warp_sheets(records),
        *builder_sheets(records),
        *(sheet for experiment in experiments() for sheet in experiment.shown("sheets", records)),
        *step_sheets(records),
        *instrument_sheets(records, correlations),
        *audit_sheets(records),
        tree_sheet(records),
    ]
