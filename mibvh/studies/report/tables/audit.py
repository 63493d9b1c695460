"""The audit: what was checked of each scene, and what failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pandas as pd

from mibvh.audit.record import Check
from mibvh.studies.measure.rotation import RotationResult
from mibvh.studies.record.experiment import experiments
from mibvh.studies.record.quantities import SIMULATED
from mibvh.studies.record.scene import Records, SceneRecord, TreeRow
from mibvh.studies.record.sheet import Column, Sheet

_SECTION = "The audit"
#: What the checks hold against each other.
_CHECKS = {
    "tree": "the tree's invariants, coverage of split triangles included",
    "sah": "SAH, against a sum over the boxes",
    "epo": "exact EPO, against points on the surfaces",
    "self hits": "rays that hit the triangle they leave",
    "hits": "hits, against brute force in float64",
    "mitsuba": "hits, against Mitsuba's own intersection",
    "counts": "counted cost, against a second launch",
    "lanes": "SIMD lanes, against scalar lanes and a simulation without Dr.Jit",
    "warps": "simulated warps of one lane, against counted cost of the same rays",
    "trees": "hits, against those of the scene's other trees",
}
_SIMULATED = tuple(quantity.name for quantity in SIMULATED)
#: Which quantities of a tree a failed check casts doubt on; all of them, where it is not named.
_DOUBTS = {"sah": ("sah",), "epo": ("epo",), "warps": _SIMULATED}


def audits(record: SceneRecord) -> list[tuple[str, Sequence[Check]]]:
    """Return the checks of all that was audited of a scene, and how each is called."""
    found: list[tuple[str, Sequence[Check]]] = [(t.builder, t.audit) for t in record.trees]
    if rotation := record.result(RotationResult):
        found += [(f"{tree.builder} (rotated)", tree.audit) for tree in rotation.trees]
    for experiment in experiments():
        found += experiment.shown("audits", record)
    return found


def failures(records: Records) -> list[tuple[str, str, Check]]:
    """Return the scene, the tree and the check of each failure."""
    return [
        (record.scene, name, check)
        for record in records
        for name, checks in audits(record)
        for check in checks
        if not check.passed
    ]


def doubted(tree: TreeRow, quantity: str) -> bool:
    """Whether a check that a quantity hinges on has failed."""
    return any(quantity in _DOUBTS.get(check.name, (quantity,)) for check in tree.failures)


def audit_sheets(records: Records) -> list[Sheet]:
    """Return how many checks each scene passed, and the failures, if there are any."""
    sheets = [_summary(records)]
    if found := failures(records):
        sheets.append(_failures(found))
    return sheets


def _summary(records: Records) -> Sheet:
    rows = []
    for record in records:
        checks = [check for _, of in audits(record) for check in of]
        failed = Counter(check.name for check in checks if not check.passed)
        names = ", ".join(f"{name} ({count})" for name, count in failed.items())
        rows.append(
            {
                "scene": record.scene,
                "checks": len(checks),
                "failed": failed.total(),
                "which": names or "none",
                "alarm": failed.total() > 0,
            }
        )
    return Sheet(
        name="audit",
        section=_SECTION,
        title="Numbers checked by independent code",
        note="Each tree: " + "; ".join(_CHECKS.values()) + ".",
        frame=pd.DataFrame(rows),
        columns=[
            Column("scene"),
            Column("checks", format="d"),
            Column("failed", format="d", alarm="alarm"),
            Column("which", "failed checks", alarm="alarm"),
        ],
    )


def _failures(found: list[tuple[str, str, Check]]) -> Sheet:
    rows = [
        {
            "scene": scene,
            "tree": tree,
            "check": check.name,
            "value": check.value,
            "expected": check.expected,
            "tolerance": check.tolerance,
            "compared": check.detail,
            "alarm": True,
        }
        for scene, tree, check in found
    ]
    return Sheet(
        name="audit-failures",
        section=_SECTION,
        title="Numbers that failed the audit",
        frame=pd.DataFrame(rows),
        columns=[
            Column("scene"),
            Column("tree"),
            Column("check", alarm="alarm"),
            Column("value", format=".6g", alarm="alarm"),
            Column("expected", format=".6g"),
            Column("tolerance", "within", ".3g"),
            Column("compared"),
        ],
        unfolded=True,
    )
