"""Figures of predicted against measured cost: one panel per scene, or per measurement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import predictor
from mibvh.metrics.registry import Quantity
from mibvh.studies.analyse.correlations import predicted
from mibvh.studies.record.scene import Records, SceneRecord, samples
from mibvh.studies.record.sheet import within
from mibvh.studies.report.axes import Panel
from mibvh.studies.report.drawing import Drawing, Part, Words
from mibvh.studies.report.layout import (
    HEIGHT,
    ROW,
    builders_of,
    legend,
    limits_of,
    places_of,
    row_of_panels,
    strip_height,
)
from mibvh.triangles import F64

#: The small multiples: size, margins, how many in a row of the file.
_SMALL, _SMALL_MARGINS, _COLUMNS = (150.0, 154.0), (30.0, 8.0, 22.0, 44.0), 4
#: Share of an axis below which the trees but the dearest would be crowded.
_CROWDED = 0.5


def multiples(records: Records, name: str) -> Drawing:
    """Predicted against counted cost, a panel per scene: SAH in grey, a predictor in colour.

    Both are put on the measured scale by their least-squares lines, so that one axis serves both:
    on the diagonal a tree is predicted exactly, and r is what it was.
    """
    places, known = places_of(records), samples(records, "counted_cost")
    columns = min(len(records), _COLUMNS)
    width, height = _SMALL[0] * columns, _SMALL[1] * -(-len(records) // columns)
    said = ["up: counted cost per ray", f"across: {name}, on that scale", "hollow: SAH, likewise"]
    if name == "SAH":
        said.pop()
    strip = ROW * len(said) + strip_height(list(places), width)
    sheet = Drawing(width, height + strip)
    for i, record in enumerate(records):
        corner = (i % columns) * _SMALL[0], (i // columns) * _SMALL[1]
        _multiple(sheet, record, _lines(known, i, name), places, Part(*corner, *_SMALL), name)
    for i, line in enumerate(said):
        sheet.add(Words(x=4, y=height + 8 + ROW * i, text=line))
    legend(sheet, list(places), height + ROW * len(said), curves=False)
    return sheet


def _lines(known: list, place: int, name: str) -> tuple[F64, F64, float, float]:
    """SAH and a predictor on the measured scale, and r of both."""
    measured = known[place].measured
    found = []
    for one in ("SAH", name):
        values = predictor(one)(known, place)[1]
        if not (np.isfinite(values).all() and np.ptp(values) > 0):
            values = np.full(len(measured), np.nan)
        else:
            slope, base = np.polyfit(values, measured, 1) if len(values) > 1 else (0.0, measured[0])
            values = base + slope * values
        found.append(values)
    r = [pearson(values, measured) if np.isfinite(values).all() else np.nan for values in found]
    # A falling line has a negative r on either scale.
    return found[0], found[1], r[0], r[1]


def _multiple(
    sheet: Drawing,
    record: SceneRecord,
    found: tuple[F64, F64, float, float],
    places: dict[str, int],
    part: Part,
    name: str,
) -> None:
    sah, main, r_sah, r_main = found
    measured = record.column("counted_cost")
    near = together(measured)
    limits = limits_of(np.concatenate([sah[near], main[near], measured[near]]), 0.12)
    panel = Panel(sheet, part, limits, limits, margins=_SMALL_MARGINS)
    said = f"r: SAH {_r(r_sah)}" + (f", {name} {_r(r_main)}" if name != "SAH" else "")
    said += f", {record.over}" if record.over else ""
    sheet.parts[-1] = part._replace(title=f"{record.scene}, {name} against counted cost: {said}")
    sheet.add(
        Words(x=part.x + 4, y=part.y + 8, text=record.scene[:24], size=10, strong=True),
        Words(x=part.x + 4, y=part.y + 22, text=said, size=9),
    )
    panel.line(limits, limits)
    panel.hollow(sah, measured)
    owners = [tree.builder for tree in record.trees]
    tips = [
        f"{record.scene}, {tree.builder}: counted cost {y:.4g}, {name} says {x:.4g}, SAH {s:.4g} "
        "(all by the least-squares line)"
        for tree, x, y, s in zip(record.trees, main, measured, sah, strict=True)
    ]
    panel.dots(main, measured, owners, tips, [places[o] for o in owners], size=5.5)
    _at_edge(panel, owners, main, measured, (6.0, -8.0))


def _at_edge(
    panel: Panel, names: Sequence[str], values: F64, measured: F64, beside: tuple[float, float]
) -> None:
    """Label the tree at the edge of a panel with its name and cost."""
    for i in np.flatnonzero(~together(measured)).tolist():
        x, y = float(panel.x(values[i])) + beside[0], float(panel.y(measured[i])) + beside[1]
        said = f"{names[i]}: {measured[i]:.3g} ↗"
        panel.sheet.add(Words(x=x, y=y, text=said, size=8, anchor="end"))


def together(measured: F64) -> npt.NDArray[np.bool_]:
    """Return (T,) bool: all trees except the most expensive, if it would crowd the others.

    They would where they fill less than half of the axis. The dearest then stands at the edge of
    the panel, with its cost.
    """
    near = np.ones(len(measured), dtype=bool)
    if len(measured) > 3:
        order = np.argsort(measured)
        best, second, dearest = measured[order[[0, -2, -1]]]
        near[order[-1]] = not second - best < _CROWDED * (dearest - best)
    return near


def _r(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def predicted_measured(record: SceneRecord, target: Quantity, main: str) -> Drawing:
    """Predicted against measured cost of a scene's trees: SAH, SAH with EPO, and the advised one.

    Parameters
    ----------
    record : SceneRecord
    target : Quantity
        From :func:`mibvh.studies.record.quantities.targets`.
    main : str
        Name of the advised predictor.
    """
    sample = record.sample(target.name)
    second = "fitted" if np.isfinite(predicted("fitted", sample)[0]) else "fixed 0.79"
    names = [*dict.fromkeys(("SAH", second, main))]
    sheet, parts = row_of_panels(strip=strip_height(builders_of(record)), panels=len(names))
    for part, name in zip(parts, names, strict=True):
        alpha, values = predicted(name, sample)
        r = pearson(values, sample.measured)
        label = f"SAH + EPO, α = {alpha:.2f}" if name == second else name
        title = f"{label}:  r = {r:.3f}" if np.isfinite(r) else label
        limits = limits_beside(values, sample.measured)
        labels = ("predicted cost", f"measured: {target.heading}")
        panel = Panel(sheet, part, *limits, title=title, labels=labels)
        _scatter(panel, record, values, target)
    legend(sheet, builders_of(record), HEIGHT, curves=False)
    return sheet


def _scatter(panel: Panel, record: SceneRecord, values: F64, target: Quantity) -> None:
    measured = record.column(target.name)
    tips = []
    for tree, x, y in zip(record.trees, values, measured, strict=True):
        noise = f" {within(tree[target.error])}" if target.error else ""
        tips.append(
            f"{tree.builder}: {target.heading} {y:.4g}{noise}, predicted {x:.4g}, "
            f"SAH {tree['sah']:.4g}, EPO {tree['epo']:.4g}, LCV {tree['lcv']:.3g}"
        )
    scatter(panel, [tree.builder for tree in record.trees], values, measured, tips)


def scatter(
    panel: Panel, names: Sequence[str], values: F64, measured: F64, tips: Sequence[str]
) -> None:
    """Draw predicted against measured cost of trees, with the line that fits them best.

    Parameters
    ----------
    panel : Panel
    names : sequence of str
        Of the builders, in the order of their colours.
    values, measured : (T,) float64
    tips : sequence of str
    """
    line, near = np.empty((0, 2)), together(measured)
    if len(values) > 1 and np.isfinite(measured).all() and np.ptp(values) > 0:
        slope, base = np.polyfit(values, measured, 1)
        ends = np.array([values[near].min(), values[near].max()])
        line = _line_through(np.stack([ends, base + slope * ends], axis=1))
        low, high = sorted((panel.y.low, panel.y.high))
        line = line[(line[:, 1] >= low) & (line[:, 1] <= high)]
        if len(line) > 1:  # beside the dearest tree it may pass the panel by
            panel.line(*line.T)
    panel.dots(values, measured, names, tips, range(len(names)))
    if np.isfinite(measured).all():
        said = [name if of else "" for name, of in zip(names, near, strict=True)]
        panel.names(values, measured, said, line)
    _at_edge(panel, names, values, measured, (-7.0, 1.0))


def limits_beside(values: F64, measured: F64) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return limits of predicted and of measured cost for :func:`scatter`."""
    near = together(measured)
    return limits_of(values[near], 0.16), limits_of(measured[near], 0.1)


def _line_through(ends: F64) -> F64:
    """Return (40, 2) points along a line, which labels must not cover."""
    return np.linspace(ends[0], ends[1], 40)
