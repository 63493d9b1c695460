"""The tables of one scene: its trees, and how well their cost is predicted."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from mibvh.metrics.predictors import glossary
from mibvh.metrics.registry import Quantity
from mibvh.studies.record.quantities import columns, targets
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.record.sheet import Column, Sheet
from mibvh.studies.report.tables.audit import doubted

#: How well a predictor explains a measurement.
_AGREEMENT = (
    Column("alpha", "α", ".2f", "weight of EPO"),
    Column("pearson", "Pearson r", ".3f", "correlation over the trees"),
    Column("low", "low", ".3f", "lower end of the 95% bootstrap interval of r over the rays"),
    Column("high", "high", ".3f", "upper end of the 95% bootstrap interval of r over the rays"),
    Column(
        "held_out",
        "held out",
        ".3f",
        "r of trees predicted from weights and a line fitted to the others",
    ),
    Column("without_worst", "r without one", ".3f", "r without the tree that changes it most"),
    Column("spearman", "Spearman", ".3f", "rank correlation"),
    Column("kendall", "Kendall", ".3f", "rank correlation"),
    Column("worst_error", "worst error", ".1%", "largest relative error of the least-squares line"),
    Column("trees", "trees", "d", "how many"),
)


def scene_answers(record: SceneRecord, correlations: pd.DataFrame) -> list[Sheet]:
    """Return the tables of one scene.

    Parameters
    ----------
    record : SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    main = columns(main=True)
    more = [quantity for quantity in columns() if quantity not in main]
    sheets = [_trees(record, main, "trees", f"Trees of {record.scene}")]
    if more:
        sheets.append(_trees(record, more, "trees-more", f"More of the trees of {record.scene}"))
    return [*sheets, _agreement(record, correlations)]


def _trees(record: SceneRecord, shown: Sequence[Quantity], name: str, title: str) -> Sheet:
    rows = [
        {
            "builder": tree.builder,
            **tree.values,
            **{f"{q.name}_alarm": doubted(tree, q.name) for q in shown},
        }
        for tree in record.trees
    ]
    return Sheet(
        name=f"{record.scene}-{name}",
        section=record.scene,
        title=title,
        frame=pd.DataFrame(rows),
        columns=[
            Column("builder"),
            *(Column.of(q, error=True, alarm=f"{q.name}_alarm") for q in shown),
        ],
    )


def _agreement(record: SceneRecord, correlations: pd.DataFrame) -> Sheet:
    of = correlations[correlations["scene"] == record.scene]
    headings = {target.name: target.heading for target in targets()}
    return Sheet(
        name=f"{record.scene}-agreement",
        section=record.scene,
        title=f"Agreement of predicted and measured cost, {record.scene}",
        frame=of.assign(measured=of["measurement"].map(headings)),
        columns=[Column("measured"), Column("predictor"), *_AGREEMENT],
        glossary=glossary(),
    )
