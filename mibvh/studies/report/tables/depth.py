"""Tables of the depth experiment."""

from __future__ import annotations

from mibvh.studies.analyse.depth import half_depths, remaining_relative
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet
from mibvh.studies.report.tables.builders import SECTION

#: Of the numbers of splits, those that are shown.
_SHOWN_SPLITS = (1, 3, 7, 15, 63, 255, 1023)


def depth_sheets(records: Records) -> list[Sheet]:
    """Return the tables; none where the experiment was not run."""
    if not any(record.result(DepthResult) for record in records):
        return []
    return [*_worst_case(records), _where(records)]


def _worst_case(records: Records) -> list[Sheet]:
    remaining = remaining_relative(records)
    if remaining.empty:
        return []
    shown = [n for n in _SHOWN_SPLITS if remaining[n].notna().any()]
    sheet = Sheet(
        name="worst-case",
        section=SECTION,
        title="Worst-case triangle cost that remains, relative to bbvh",
        note="Trees cut after so many splits, the largest part split first; what remains counts "
        "as leaves. A top-down sweep minimises this, split by split. Mean over the scenes; "
        "a splitting builder starts with more references.",
        frame=remaining.rename(columns={n: f"after {n}" for n in shown}).reset_index(),
        columns=[Column("builder"), *(Column(f"after {n}", format=".0%") for n in shown)],
    )
    return [sheet]


def _where(records: Records) -> Sheet:
    return Sheet(
        name="where",
        section=SECTION,
        title="Where in the trees cost and overlap sit: depths, mean over the scenes",
        note="The depth above which half of the expected cost, of the overlap and of the nodes "
        "lies, and the depth of the tree.",
        frame=half_depths(records),
        columns=[
            Column("builder"),
            Column("sah", "half of SAH above", ".1f"),
            Column("epo", "half of EPO above", ".1f"),
            Column("nodes", "half of the nodes above", ".1f"),
            Column("depth", "depth of the tree", ".1f"),
        ],
    )
