"""Tables on wide trees."""

from __future__ import annotations

import pandas as pd

from mibvh.metrics.predictors import glossary, predictors
from mibvh.studies.analyse.widths import (
    before_and_after,
    optimised,
    over_best,
    wide_trees,
    width_correlations,
)
from mibvh.studies.record.scene import Records
from mibvh.studies.record.sheet import Column, Sheet

SECTION = "Trees of more children per node"
#: Predictors that have a column per width in the table of scenes.
_PER_SCENE = {"SAH": "SAH", "fitted": "SAH + EPO", "finite rays": "finite rays"}
_OWN = (
    "Each width has its own trees, figures and counted cost (1.2 per node, 0.2 for each child box "
    "beyond the second, 1.0 per triangle; popped nodes are not re-tested)."
)


def width_sheets(records: Records) -> list[Sheet]:
    """Return the tables; none where no tree was collapsed."""
    trees = wide_trees(records)
    if trees.empty:
        return []
    correlations = width_correlations(records)
    widest = int(correlations["width"].max())
    sheets = [_overview(correlations), _scenes(correlations), _builders(trees)]
    if widest > 2:
        sheets.append(_before(trees, widest))
        if not (gains := optimised(records, trees, widest)).empty:
            sheets.append(_optimised(gains, widest))
    return [*sheets, _trees(trees)]


def _overview(correlations: pd.DataFrame) -> Sheet:
    groups = correlations.groupby(["predictor", "width"], sort=False)["pearson"]
    table = groups.agg(["mean", "min"]).unstack("width")
    names = [one.name for one in predictors() if one.name in table.index]
    frame = pd.DataFrame(
        {f"{c}{w}": table[(c, w)] for w in _widths(correlations) for c in ("mean", "min")}
    )
    return Sheet(
        name="width-r",
        section=SECTION,
        title="r with counted cost over the scenes, by children per node",
        note=_OWN,
        frame=frame.reindex(names).rename_axis("predictor").reset_index(),
        columns=[
            Column("predictor"),
            *(
                Column(f"{c}{w}", f"{w} children: {c}", ".3f")
                for w in _widths(correlations)
                for c in ("mean", "min")
            ),
        ],
        glossary=glossary(),
    )


def _scenes(correlations: pd.DataFrame) -> Sheet:
    r = correlations.pivot(index="scene", columns=["predictor", "width"], values="pearson")
    alpha = correlations[correlations["predictor"] == "fitted"].pivot(
        index="scene", columns="width", values="alpha"
    )
    parts, columns = {}, []
    for name, title in _PER_SCENE.items():
        for width in _widths(correlations):
            key = f"{name}{width}"
            parts[key] = r[(name, width)] if (name, width) in r else float("nan")
            columns.append(Column(key, f"{title}, {width}", ".3f"))
    for width in _widths(correlations):
        parts[f"alpha{width}"] = alpha[width]
        columns.append(Column(f"alpha{width}", f"α, {width}", ".2f"))
    frame = pd.DataFrame(parts, index=alpha.index).reindex(correlations["scene"].unique())
    return Sheet(
        name="width-scenes",
        section=SECTION,
        title="r with counted cost and the fitted α of each scene, by children per node",
        frame=frame.rename_axis("scene").reset_index(),
        columns=[Column("scene"), *columns],
    )


def _builders(trees: pd.DataFrame) -> Sheet:
    table = over_best(trees).pivot(
        index="builder", columns="width", values=["mean", "best", "over_binary"]
    )
    widths = _widths(trees)
    frame = pd.DataFrame(
        {f"{c}{w}": table[(c, w)] for w in widths for c in ("mean", "best", "over_binary")}
    ).reindex(trees["builder"].unique())
    return Sheet(
        name="width-builders",
        section=SECTION,
        title="Which binary tree makes the best wide one",
        note="Counted cost over that of the scene's best tree of the width, geometric mean over "
        "the scenes; on how many scenes it is the best; cost over that at two children.",
        frame=frame.rename_axis("builder").reset_index().astype({f"best{w}": int for w in widths}),
        columns=[
            Column("builder"),
            *(
                column
                for w in widths
                for column in (
                    Column(f"mean{w}", f"{w} children", ".3f", smaller_is_better=True),
                    Column(f"best{w}", "best on", "d"),
                    *([Column(f"over_binary{w}", "over two", ".3f")] if w > 2 else []),
                )
            ),
        ],
    )


def _before(trees: pd.DataFrame, width: int) -> Sheet:
    return Sheet(
        name="width-before",
        section=SECTION,
        title=f"Does a lower SAH before the collapse to {width} children help after it?",
        note="r over the trees, and by how many percent SAH after the collapse falls where SAH "
        "before it falls by one.",
        frame=before_and_after(trees, width),
        columns=[
            Column("scene"),
            Column("sah", "SAH before, after", ".3f"),
            Column("kept", "% kept of 1%", ".2f"),
            Column("epo", "EPO before, after", ".3f"),
            Column("before", "SAH before, cost after", ".3f"),
            Column("after", "SAH after, cost after", ".3f"),
            Column("cost", "cost before, after", ".3f"),
        ],
    )


def _optimised(gains: pd.DataFrame, width: int) -> Sheet:
    return Sheet(
        name="width-optimised",
        section=SECTION,
        title=f"What optimisers gain, before and after the collapse to {width} children",
        note="Optimised tree over the one that it was made from, geometric mean over the scenes.",
        frame=gains,
        columns=[
            Column("builder"),
            Column("start"),
            *(
                Column(f"{name}_{when}", f"{title} {when}", ".3f")
                for name, title in (("sah", "SAH"), ("epo", "EPO"), ("cost", "cost"))
                for when in ("before", "after")
            ),
            Column("scenes", format="d"),
        ],
    )


def _trees(trees: pd.DataFrame) -> Sheet:
    return Sheet(
        name="width-trees",
        section=SECTION,
        title="All trees at all widths",
        note="Finite rays in units of counted cost: nothing is fitted.",
        frame=trees,
        columns=[
            Column("scene"),
            Column("builder"),
            Column("width", "children", "d"),
            Column("mean_children", "mean", ".2f"),
            Column("sah", "SAH", ".2f"),
            Column("epo", "EPO", ".3f"),
            Column("lcv", "LCV", ".3f"),
            Column("finite", "finite rays", ".2f"),
            Column("counted_cost", "counted cost", ".2f"),
        ],
    )


def _widths(frame: pd.DataFrame) -> list[int]:
    return sorted(int(width) for width in frame["width"].unique())
