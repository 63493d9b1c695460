"""Tables on what a step of a traversal costs."""

from __future__ import annotations

import dataclasses

import pandas as pd

from mibvh.metrics.registry import DIGITS
from mibvh.studies.analyse.calibration import calibrate, other_constants
from mibvh.studies.analyse.correlations import LANES, SCALAR
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

_SECTION = "What a step costs"


def step_sheets(records: Records) -> list[Sheet]:
    """Return the fitted step costs, and what other cost constants do to r."""
    return [_step_costs(records), _constants(records)]


def _step_costs(records: Records) -> Sheet:
    rows = [
        {"lanes": lanes.title, **dataclasses.asdict(calibrate(records, lanes.ns))}
        for lanes in LANES
    ]
    return Sheet(
        name="step-costs",
        section=_SECTION,
        title="What a step costs",
        note="Nanoseconds fitted to all trees of all scenes: per inner node, per triangle test, "
        "and per ray, whatever it visits. The paper takes 1.2 for C_inner / C_tri. The 95% "
        "interval of this ratio is by the bootstrap over scenes and their trees: where it is "
        "wide, the times do not determine the ratio.",
        frame=pd.DataFrame(rows),
        columns=[
            Column("lanes"),
            Column("ns_per_inner", "ns per inner node", DIGITS),
            Column("ns_per_test", "ns per triangle", DIGITS),
            Column("ns_per_ray", "ns per ray", DIGITS),
            Column("c_inner", "C_inner / C_tri", ".2f"),
            Column("c_inner_low", "95% from", ".2f"),
            Column("c_inner_high", "to", ".2f"),
            Column("mean_error", "mean error", ".1%"),
            Column("worst_error", "worst error", ".1%"),
            Column("trees"),
        ],
    )


def _constants(records: Records) -> Sheet:
    return Sheet(
        name="cost-constants",
        section=_SECTION,
        title="Other cost constants: mean r against scalar ns/ray",
        frame=other_constants(records, SCALAR.ns),
        columns=[
            Column("constants"),
            Column("c_inner", "C_inner / C_tri", ".2f"),
            Column("sah", "SAH", ".3f"),
            Column("fitted", format=".3f"),
        ],
    )
