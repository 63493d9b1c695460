"""Tables of the paper's claims, and of its own scenes if there are any among those studied."""

from __future__ import annotations

import numpy as np
import pandas as pd

from mibvh.studies.paper.catalogue import paper_comparison
from mibvh.studies.paper.claims import claims
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet
from mibvh.studies.report.tables.prediction import times_known

SECTION = "The paper's claims"


def claim_sheets(records: Records, correlations: pd.DataFrame) -> list[Sheet]:
    """Return the table of claims, and that of the paper's scenes if it has rows."""
    frame = claims(records, correlations)
    sheet = Sheet(
        name="claims",
        section=SECTION,
        title="The paper's claims, and whether they held",
        note="The paper's figures are those of its slides (22 scenes, GTX 680), where nothing "
        "else is said. What it takes for a claim to have held is our choice, and stands in "
        f"the last column. {_noise(records)} A claim on times is no surer than they are.",
        frame=frame,
        columns=[Column(str(key)) for key in frame],
        unfolded=True,
    )
    compared = paper_comparison(records, correlations)
    return [sheet, _scenes(compared)] if len(compared) else [sheet]


def _scenes(compared: pd.DataFrame) -> Sheet:
    numbers = {str(c): float for c in compared if c not in ("scene", "triangles")}
    return Sheet(
        name="paper-scenes",
        section=SECTION,
        title="Scenes of the paper's own",
        note="r with scalar ns/ray, α fitted. Triangles expected are those of the file that can "
        "be downloaded today (mibvh scenes paper); few of the paper's figures are known.",
        frame=compared.astype(numbers),
        columns=[
            Column("scene"),
            Column("triangles", format=",.0f"),
            Column("expected", "triangles expected", ",.0f"),
            Column("r_sah", "r of SAH", ".3f"),
            Column("paper_r_sah", "paper: r of SAH", ".3f"),
            Column("r_sah_epo", "r of SAH + EPO", ".3f"),
            Column("paper_r_sah_epo", "paper: r of SAH + EPO", ".3f"),
            Column("alpha", "α", ".2f"),
            Column("paper_alpha", "paper: α", ".2f"),
        ],
    )


def _noise(records: Records) -> str:
    """How well the stopwatch knew the times: the worst of all scenes."""
    twice = [abs(t.repeat_difference) for r in records for t in r.timing.values()]
    known = times_known(records)
    if not known:
        return "No time is known."
    return f"{known} The same tree timed twice differed by up to {np.nanmax(twice):.1%}."
