"""Tables on what the builders optimise."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.analyse.builders import relative_to, relative_to_best
from mibvh.studies.paper.published import published
from mibvh.studies.record.quantities import columns
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

SECTION = "What the builders optimise"


def builder_sheets(records: Records) -> list[Sheet]:
    """Return builders relative to lbvh, if there is one, and to the best of each scene."""
    costs = [quantity for quantity in columns() if quantity.smaller_is_better]
    relative = pd.DataFrame({q.name: relative_to(records, q.name) for q in costs})
    best = Sheet(
        name="sah-over-best",
        section=SECTION,
        title="SAH over the best tree found for the scene",
        frame=relative_to_best(records).reset_index(),
        columns=[
            Column("builder"),
            Column("mean", format=".3f", smaller_is_better=True),
            Column("max", format=".3f", smaller_is_better=True),
            Column("scene", "where"),
        ],
    )
    if relative.empty:
        return [best]
    relative["paper"] = pd.Series(published().epo)
    sheet = Sheet(
        name="builders",
        section=SECTION,
        title="Builders relative to lbvh, mean over the scenes",
        frame=relative.rename_axis("builder").reset_index(),
        columns=[
            Column("builder"),
            *(Column(quantity.name, quantity.heading, ".0%") for quantity in costs),
            Column("paper", "paper: EPO", ".0%"),
        ],
    )
    return [sheet, best]
