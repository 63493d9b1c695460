"""The table of all trees of all scenes."""

from __future__ import annotations

import pandas as pd

from mibvh.studies.record.quantities import columns
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet


def tree_sheet(records: Records) -> Sheet:
    """Return what matters most of each tree."""
    shown = columns(main=True)
    rows = [
        {
            "scene": record.scene,
            "triangles": record.triangles,
            "builder": tree.builder,
            **{quantity.name: tree[quantity.name] for quantity in shown},
        }
        for record in records
        for tree in record.trees
    ]
    return Sheet(
        name="trees",
        section="Trees",
        title="Trees",
        frame=pd.DataFrame(rows),
        columns=[
            Column("scene"),
            Column("triangles", format=","),
            Column("builder"),
            # No best is marked: rows are of several scenes.
            *(Column(q.name, q.heading, q.format, q.help) for q in shown),
        ],
    )
