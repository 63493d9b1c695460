"""The figure of Pearson's r of each predictor, with one point per scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mibvh.metrics.registry import Quantity
from mibvh.studies.analyse.correlations import SCALAR
from mibvh.studies.record.quantities import targets
from mibvh.studies.report.axes import MARGINS, Panel
from mibvh.studies.report.drawing import INK, Drawing, Stroke, Words
from mibvh.studies.report.layout import row_of_panels
from mibvh.triangles import F64

#: Values of r that are marked on their axis where there is room, the first ones first; the points
#: that a mark takes; and what an r of 1 is short of it there.
_MARKED_R = (0.9, 0.99, 0.999, 0.0, 0.5, -0.5, 0.97, 0.997, 0.7, 0.9997)
_ROOM = 30.0
_LEAST = 1e-4
#: Of the mean of points that are no builder's.
_ACCENT = "#D55E00"


def summary(table: pd.DataFrame, names: Sequence[str]) -> Drawing:
    """Draw Pearson's r of some predictors with counted cost and scalar time, one point per scene.

    The axis is logarithmic in 1 - r: most r are near 1, where a linear axis tells nothing apart.

    Parameters
    ----------
    table : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    names : sequence of str
        Of the predictors, one per row.
    """
    shown = table[table["pearson"].notna() & table["predictor"].isin(names)]
    short = _short_of_one(shown["pearson"].to_numpy(np.float64))
    limits = (1.2 * max([*short, 0.05]), min([*short, 0.01]) / 1.4)
    held = [q for q in targets() if q.name in ("counted_cost", SCALAR.ns)]
    height = 60 + 24.0 * len(names)
    sheet, parts = row_of_panels(height, panels=len(held))
    margins = (98.0, *MARGINS[1:])
    for part, target in zip(parts, held, strict=True):
        bar = "; bar: mean" if shown["scene"].nunique() > 1 else ""
        labels = (f"dots: scenes{bar}; log of 1 − r", "")
        panel = Panel(
            sheet,
            part,
            limits,
            (len(names) - 0.5, -0.5),
            title=f"r with {target.heading}",
            labels=labels,
            log=(True, False),
            ticks=(False, False),
            margins=margins,
        )
        _mark(panel, limits)
        for i, name in enumerate(names):
            of = shown[(shown["measurement"] == target.name) & (shown["predictor"] == name)]
            _summary_row(panel, of, name, i, target)
    return sheet


def _mark(panel: Panel, limits: tuple[float, float]) -> None:
    taken: list[float] = []
    for r in _MARKED_R:
        x = float(panel.x(1 - r))
        if limits[1] <= 1 - r <= limits[0] and all(abs(x - other) > _ROOM for other in taken):
            panel.mark_across(1 - r, f"{r:g}")
            taken.append(x)


def _short_of_one(r: F64) -> F64:
    """Return 1 - r, or a small value if r is 1."""
    return np.maximum(1 - r, _LEAST)


def _summary_row(panel: Panel, of: pd.DataFrame, name: str, i: int, target: Quantity) -> None:
    y = float(panel.y(i))
    panel.sheet.add(Words(x=panel.part.x + 92, y=y, text=name, anchor="end"))
    tips = [
        f"{s}: r = {r:.4f}, {name}, {target.heading}"
        for s, r in zip(of["scene"], of["pearson"], strict=True)
    ]
    spread = np.linspace(-0.18, 0.18, len(of)) if len(of) > 1 else np.zeros(len(of))
    panel.dots(
        _short_of_one(of["pearson"].to_numpy(np.float64)),
        i + spread,
        [""] * len(of),
        tips,
        [i] * len(of),
        size=4.5,
        shapes=False,
        opacity=0.6,
        # Not a builder's colour: these are predictors.
        colour=INK,
    )
    if len(of) > 1:
        mean = float(panel.x(_short_of_one(of["pearson"].mean())))
        ends = np.array([[mean, y - 9], [mean, y + 9]])
        panel.sheet.add(Stroke(points=ends, width=2.2, colour=_ACCENT))
