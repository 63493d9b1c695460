"""Figures of cost by depth, and of the experiments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mibvh.plot.marks import builder_colour
from mibvh.studies.analyse.rotation import headings
from mibvh.studies.analyse.sweep import Sweep
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.record.quantities import quantities
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.report.axes import Panel
from mibvh.studies.report.drawing import Drawing, Part, Words
from mibvh.studies.report.layout import (
    WIDTH,
    builders_of,
    legend,
    limits_of,
    row_of_panels,
    strip_height,
)

# ------ Where the cost sits ------


def by_depth(record: SceneRecord) -> Drawing:
    """Draw SAH and EPO by depth."""
    sheet, parts = row_of_panels(180.0, strip_height(builders_of(record)))
    for part, name in zip(parts, ("sah", "epo"), strict=True):
        heading = quantities()[name].heading
        levels = [t.sah_by_depth if name == "sah" else t.epo_by_depth for t in record.trees]
        tips = [
            f"{tree.builder}: {heading} {tree[name]:.4g} over {len(values)} levels, most at depth "
            f"{int(np.argmax(values)) if len(values) else 0}"
            for tree, values in zip(record.trees, levels, strict=True)
        ]
        _curves(sheet, part, record, levels, tips, f"{heading} by depth", "depth")
    legend(sheet, builders_of(record), 180.0, curves=True)
    return sheet


def remaining(record: SceneRecord, found: DepthResult) -> Drawing:
    """Draw the remaining worst-case cost, which a top-down sweep minimises, by splits and depth.

    Parameters
    ----------
    record : SceneRecord
    found : DepthResult
        Of this scene.
    """
    sheet, parts = row_of_panels(180.0, strip_height(builders_of(record)))
    left = [np.array(cuts.remaining_after_splits, dtype=np.float64) for cuts in found.trees]
    right = [np.array(c.spent_by_depth) + np.array(c.remaining_by_depth) for c in found.trees]
    tips = [
        f"{tree.builder}: {values[0]:.4g} as one leaf, {values[3]:.4g} after 7 splits, "
        f"SAH {tree['sah']:.4g} when all is split"
        for tree, values in zip(record.trees, left, strict=True)
    ]
    titles = (
        ("Worst-case triangle cost that remains", "log₂(splits + 1)"),
        (
            "SAH of the tree cut at a depth",
            "depth",
        ),
    )
    for part, curves, (title, x) in zip(parts, (left, right), titles, strict=True):
        _curves(sheet, part, record, curves, tips, title, x, log=True)
    legend(sheet, builders_of(record), 180.0, curves=True)
    return sheet


def _curves(
    sheet: Drawing,
    part: Part,
    record: SceneRecord,
    curves: Sequence,
    tips: Sequence[str],
    title: str,
    x: str,
    log: bool = False,
) -> None:
    values = np.concatenate([np.asarray(c, np.float64) for c in curves] or [np.zeros(1)])
    known = values[np.isfinite(values) & ((values > 0) | (not log))]
    y = limits_of(known)
    if log and len(known):
        y = (float(known.min()) / 1.15, float(known.max()) * 1.15)
    longest = max((len(c) for c in curves), default=1)
    panel = Panel(
        sheet, part, (0, max(longest - 1, 1)), y, title=title, labels=(x, "cost"), log=(False, log)
    )
    for i, (tree, curve, tip) in enumerate(zip(record.trees, curves, tips, strict=True)):
        panel.curve(np.arange(len(curve)), curve, tree.builder, tip, i)


# ------ Experiments ------


def rotation(factors: pd.DataFrame) -> Drawing:
    """Draw counted against predicted factors of rotation, for SAH and for SAH with EPO.

    Parameters
    ----------
    factors : DataFrame
        From :func:`mibvh.studies.analyse.rotation.rotation_factors`.
    """
    builders, titles = list(dict.fromkeys(factors["builder"])), headings()
    place = [builders.index(name) for name in factors["builder"]]
    tips = [
        f"{row['scene']}, {row['builder']}: counted cost {row['counted_cost']:.2f}×, "
        f"SAH {row['sah']:.2f}×, EPO {row['epo']:.2f}×"
        for _, row in factors.iterrows()
    ]
    sheet, parts = row_of_panels(WIDTH)
    shown = ("sah", "fitted")
    # One scale for both axes and both panels: on the diagonal a factor is predicted exactly.
    values = factors[["counted_cost", *shown]].to_numpy(np.float64)
    known = values[np.isfinite(values) & (values > 0)]
    limits = (float(known.min()) / 1.1, float(known.max()) * 1.1) if len(known) else (0.5, 2.0)
    for part, name in zip(parts, shown, strict=True):
        x, y = factors[name].to_numpy(np.float64), factors["counted_cost"].to_numpy(np.float64)
        labels = ("predicted factor", "factor of counted cost")
        panel = Panel(
            sheet, part, limits, limits, title=titles[name], labels=labels, log=(True, True)
        )
        panel.line(limits, limits)
        panel.dots(
            x, y, list(factors["builder"]), tips, place, size=4.5, shapes=False, opacity=0.85
        )
    return sheet


def swept(sweep: Sweep) -> Drawing:
    """Draw the cost of a builder's trees against one of its options.

    Parameters
    ----------
    sweep : Sweep
    """
    known = quantities()
    sheet, parts = row_of_panels()
    for part, names in zip(parts, (("counted_cost",), ("sah", "epo")), strict=True):
        columns = [sweep.column(name) for name in names]
        title = " and ".join(known[n].heading for n in names)
        panel = Panel(
            sheet,
            part,
            limits_of(np.asarray(sweep.values, np.float64)),
            limits_of(np.concatenate(columns)),
            title=title,
            labels=(sweep.option, "cost"),
        )
        for i, (name, values) in enumerate(zip(names, columns, strict=True)):
            heading = known[name].heading
            panel.line(sweep.values, values, colour=builder_colour(i), width=1.2)
            tips = [
                f"{tree.builder}: {heading} {y:.4g}"
                for tree, y in zip(sweep.trees, values, strict=True)
            ]
            owners = [tree.builder for tree in sweep.trees]
            panel.dots(
                sweep.values, values, owners, tips, [i] * len(owners), size=4.5, shapes=False
            )
            at = float(panel.x(sweep.values[-1])), float(panel.y(values[-1]))
            if len(names) > 1:
                sheet.add(Words(x=at[0] - 4, y=at[1] - 7, text=heading, anchor="end"))
    return sheet
