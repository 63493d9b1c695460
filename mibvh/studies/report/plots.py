"""Figures of the report: what is drawn of a study's records, panel by panel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import predictor
from mibvh.metrics.registry import Quantity
from mibvh.plot.marks import builder_colour
from mibvh.studies.analyse.correlations import SCALAR, predicted
from mibvh.studies.analyse.rotation import headings
from mibvh.studies.analyse.sweep import Sweep
from mibvh.studies.analyse.winners import winner, winner_in_time
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.record.quantities import quantities, targets
from mibvh.studies.record.scene import Records, SceneRecord, samples
from mibvh.studies.report.axes import MARGINS, Panel
from mibvh.studies.report.drawing import INK, Dot, Drawing, Part, Stroke, Words
from mibvh.triangles import F64

#: Size of a panel of a pair, in points.
_WIDTH, _HEIGHT = 259.0, 202.0
#: Builders' names in a row of the strip below the panels, and the height of a row.
_NAMES, _ROW = 5, 14.0
#: The small multiples: size, margins, how many in a row of the file.
_SMALL, _SMALL_MARGINS, _COLUMNS = (150.0, 148.0), (30.0, 8.0, 22.0, 38.0), 4
#: The winners: width of the figure, height of a scene's row, where its line begins and ends, and
#: the costs over the best beyond which trees stand in a row behind its end.
_WINNERS, _STEP, _BEGIN, _END, _MOST = 300.0, 76.0, 8.0, 200.0, 0.6
#: Where the first of the trees behind the end stands, and how far apart they are.
_BEYOND, _APART = 230.0, 8.0
#: Costs over the best that are marked on the line.
_MARKED = (0.0, 0.2, 0.4, 0.6)
_GREY = "#888888"
#: Of the mean of points that are no builder's.
_ACCENT = "#D55E00"


def places_of(records: Records) -> dict[str, int]:
    """Return the place of each builder among all: its colour and shape."""
    by_size = sorted(records, key=lambda record: -len(record.trees))
    names = dict.fromkeys(tree.builder for record in by_size for tree in record.trees)
    return {name: i for i, name in enumerate(names)}


def row_of_panels(
    height: float = _HEIGHT, strip: float = 0.0, panels: int = 2
) -> tuple[Drawing, list[Part]]:
    """Return a drawing and its panels, in a row above a strip that only files have."""
    sheet = Drawing(_WIDTH * panels, height + strip)
    return sheet, [Part(i * _WIDTH, 0.0, _WIDTH, height) for i in range(panels)]


def limits_of(values: F64, margin: float = 0.06) -> tuple[float, float]:
    """Return limits of an axis that shows values, with room on both sides."""
    known = np.asarray(values, np.float64)
    known = known[np.isfinite(known)]
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    room = margin * ((high - low) or abs(high) or 1.0)
    return low - room, high + room


def _legend(sheet: Drawing, names: Sequence[str], top: float) -> None:
    """Name the builders in the strip below the panels."""
    column = sheet.width / _NAMES
    for i, name in enumerate(names):
        x, y = (i % _NAMES) * column + 14, top + _ROW * (i // _NAMES) + 8
        line = np.array([[x - 10, y], [x + 2, y]])
        sheet.add(Stroke(points=line, colour=builder_colour(i), width=2))
        sheet.add(Words(x=x + 6, y=y, text=name))


def _strip(record: SceneRecord) -> float:
    return _ROW * (1 + (len(record.trees) - 1) // _NAMES) + 4


# ------ The winners ------


def winners(records: Records) -> Drawing:
    """Of each scene the winner, its lead and error, and where the other trees stand.

    A row per scene: its name, who wins by counted cost and by scalar time, and a point per tree at
    its counted cost over the best. Trees that cost more than the line is long stand side by side
    behind its end, in the order of their costs.
    """
    sheet = Drawing(_WINNERS, _STEP * len(records))
    places = places_of(records)
    for row, record in enumerate(records):
        part = Part(0.0, row * _STEP, _WINNERS, _STEP, f"{record.scene}: {winner(record)}")
        sheet.parts.append(part)
        _winner_row(sheet, record, places, row * _STEP)
    return sheet


def _over(record: SceneRecord) -> F64:
    costs = record.column("counted_cost")
    return costs / costs.min() - 1 if costs.min() > 0 else np.zeros(len(costs))


def _winner_row(sheet: Drawing, record: SceneRecord, places: dict[str, int], top: float) -> None:
    best, y = winner(record), top + 52
    sheet.add(
        Words(x=_BEGIN - 6, y=top + 8, text=record.scene, size=11, strong=True),
        Words(x=_BEGIN - 6, y=top + 23, text=str(best), size=10),
        Words(x=_BEGIN - 6, y=top + 37, text=_in_time(record), size=10, opacity=0.8),
        Stroke(points=np.array([[_BEGIN, y], [_END, y]]), colour=_GREY, opacity=0.5),
    )
    for mark in _MARKED:
        x = _along(mark)
        sheet.add(
            Stroke(points=np.array([[x, y - 4], [x, y + 4]]), colour=_GREY, opacity=0.5),
            Words(x=x, y=y + 13, text=f"+{mark:.0%}" if mark else "best", anchor="middle"),
        )
    costs = _over(record)
    order = np.argsort(costs, kind="stable")
    on_line = int((costs <= _MOST).sum())
    if on_line < len(order):
        sheet.add(Words(x=_BEYOND - 4, y=y + 13, text=f"{len(order) - on_line} beyond"))
    # The best is drawn last, on top.
    for rank, i in reversed(list(enumerate(order))):
        tree, over = record.trees[i], float(costs[i])
        sheet.add(
            Dot(
                x=_along(over) if rank < on_line else _BEYOND + _APART * (rank - on_line),
                y=y,
                size=10.0 if tree.builder == best.builder else 7.0,
                colour=builder_colour(places[tree.builder]),
                owner=tree.builder,
                tip=f"{record.scene}: {tree.builder}, counted cost {tree['counted_cost']:.4g}, "
                f"+{over:.1%} over the best",
            )
        )


def _along(over: float) -> float:
    """Where a cost over the best stands on the line."""
    return _BEGIN + over / _MOST * (_END - _BEGIN)


def _in_time(record: SceneRecord) -> str:
    timed = winner_in_time(record, SCALAR)
    return f"in time: {timed}" if timed is not None and timed.second else ""


# ------ Predicted against measured ------


def multiples(records: Records, name: str) -> Drawing:
    """Predicted against counted cost, a panel per scene: SAH in grey, a predictor in colour.

    Both are put on the measured scale by their least-squares lines, so that one axis serves both:
    on the diagonal a tree is predicted exactly, and r is what it was.
    """
    rows = -(-len(records) // _COLUMNS)
    columns = min(len(records), _COLUMNS)
    sheet = Drawing(_SMALL[0] * columns, _SMALL[1] * rows)
    places, known = places_of(records), samples(records, "counted_cost")
    for i, record in enumerate(records):
        corner = (i % _COLUMNS) * _SMALL[0], (i // _COLUMNS) * _SMALL[1]
        _multiple(sheet, record, _lines(known, i, name), places, Part(*corner, *_SMALL), name)
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
    limits = limits_of(np.concatenate([sah, main, measured]), 0.08)
    panel = Panel(sheet, part, limits, limits, margins=_SMALL_MARGINS)
    said = f"r {_r(r_sah)} → {_r(r_main)}" + (f", {record.over}" if record.over else "")
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


def _r(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def predicted_measured(record: SceneRecord, target: Quantity) -> Drawing:
    """Predicted against measured cost of a scene's trees: SAH alone, and SAH with EPO.

    Parameters
    ----------
    record : SceneRecord
    target : Quantity
        From :func:`mibvh.studies.record.quantities.targets`.
    """
    sample = record.sample(target.name)
    second = "fitted" if np.isfinite(predicted("fitted", sample)[0]) else "fixed 0.79"
    sheet, parts = row_of_panels()
    for part, name in zip(parts, ("SAH", second), strict=True):
        alpha, values = predicted(name, sample)
        r = pearson(values, sample.measured)
        label = "SAH" if name == "SAH" else f"SAH + EPO, α = {alpha:.2f}"
        title = f"{label}:  r = {r:.3f}" if np.isfinite(r) else label
        limits = limits_of(values, 0.16), limits_of(sample.measured, 0.1)
        labels = ("predicted cost", f"measured: {target.heading}")
        panel = Panel(sheet, part, *limits, title=title, labels=labels)
        _scatter(panel, record, values, target)
    return sheet


def _scatter(panel: Panel, record: SceneRecord, values: F64, target: Quantity) -> None:
    measured = record.column(target.name)
    tips = []
    for tree, x, y in zip(record.trees, values, measured, strict=True):
        noise = f" ±{tree[target.error]:.1%}" if target.error else ""
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
    if len(values) > 1 and np.isfinite(measured).all() and np.ptp(values) > 0:
        slope, base = np.polyfit(values, measured, 1)
        ends = np.array([values.min(), values.max()])
        panel.line(ends, base + slope * ends)
    panel.dots(values, measured, names, tips, range(len(names)))
    if np.isfinite(measured).all():
        panel.names(values, measured, names)


def summary(table: pd.DataFrame, names: Sequence[str]) -> Drawing:
    """Pearson's r of some predictors, a point per scene, with counted cost and scalar time.

    Parameters
    ----------
    table : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    names : sequence of str
        Of the predictors, one per row.
    """
    shown = table[table["pearson"].notna() & table["predictor"].isin(names)]
    low = min(float(shown["pearson"].min()), 0.95) if len(shown) else 0.0
    limits = (low - 0.04 * (1 - low), 1 + 0.02 * (1 - low))
    held = [q for q in targets() if q.name in ("counted_cost", SCALAR.ns)]
    height = 60 + 24.0 * len(names)
    sheet, parts = row_of_panels(height, panels=len(held))
    margins = (98.0, *MARGINS[1:])
    for part, target in zip(parts, held, strict=True):
        labels = ("Pearson's r over a scene's trees", "")
        panel = Panel(
            sheet,
            part,
            limits,
            (len(names) - 0.5, -0.5),
            title=f"with {target.heading}",
            labels=labels,
            ticks=(True, False),
            margins=margins,
        )
        for i, name in enumerate(names):
            of = shown[(shown["measurement"] == target.name) & (shown["predictor"] == name)]
            _summary_row(panel, of, name, i, target)
    return sheet


def _summary_row(panel: Panel, of: pd.DataFrame, name: str, i: int, target: Quantity) -> None:
    y = float(panel.y(i))
    panel.sheet.add(Words(x=panel.part.x + 92, y=y, text=name, anchor="end"))
    tips = [
        f"{s}: r = {r:.4f}, {name}, {target.heading}"
        for s, r in zip(of["scene"], of["pearson"], strict=True)
    ]
    spread = np.linspace(-0.18, 0.18, len(of)) if len(of) > 1 else np.zeros(len(of))
    panel.dots(
        of["pearson"].to_numpy(),
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
        mean = float(panel.x(of["pearson"].mean()))
        ends = np.array([[mean, y - 9], [mean, y + 9]])
        panel.sheet.add(Stroke(points=ends, width=2.2, colour=_ACCENT))


# ------ Where the cost sits ------


def by_depth(record: SceneRecord) -> Drawing:
    """Where in the tree the cost and the overlap sit: SAH and EPO by depth."""
    sheet, parts = row_of_panels(180.0, _strip(record))
    for part, name in zip(parts, ("sah", "epo"), strict=True):
        heading = quantities()[name].heading
        levels = [t.sah_by_depth if name == "sah" else t.epo_by_depth for t in record.trees]
        tips = [
            f"{tree.builder}: {heading} {tree[name]:.4g} over {len(values)} levels, most at depth "
            f"{int(np.argmax(values)) if len(values) else 0}"
            for tree, values in zip(record.trees, levels, strict=True)
        ]
        _curves(sheet, part, record, levels, tips, f"{heading} by depth", "depth")
    _legend(sheet, [tree.builder for tree in record.trees], 180.0)
    return sheet


def remaining(record: SceneRecord, found: DepthResult) -> Drawing:
    """What a top-down sweep minimises: the worst-case cost that remains, by splits and by depth.

    Parameters
    ----------
    record : SceneRecord
    found : DepthResult
        Of this scene.
    """
    sheet, parts = row_of_panels(180.0, _strip(record))
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
    _legend(sheet, [tree.builder for tree in record.trees], 180.0)
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
    """What rotating the scenes costs, counted, against what SAH and SAH with EPO predict.

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
    sheet, parts = row_of_panels(_WIDTH)
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
    """Cost of a builder's trees against one of its options.

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
