"""Figures of the report, by matplotlib; text and lines take the colour of the page they are in."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mibvh.metrics.predictor import pearson
from mibvh.studies.analyse import MEASUREMENTS, column, predictors

#: Stands for "the text colour of the page" until the figure is in it.
_INK = "#123457"
#: Colour-blind safe (Okabe and Ito), readable on light and dark.
_COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#8C8C00", "#7F7F7F",
            "#A65ACD", "#C04040"]  # fmt: skip
#: Separates the text of a tooltip from the mark of one in a group id.
_TIP = "tip|"


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib settings of all figures."""
    with mpl.rc_context({
        "font.size": 9, "axes.spines.top": False, "axes.spines.right": False,
        "axes.edgecolor": _INK, "axes.labelcolor": _INK, "text.color": _INK, "axes.titlesize": 10,
        "xtick.color": _INK, "ytick.color": _INK, "svg.fonttype": "none", "svg.hashsalt": "mibvh",
        "figure.facecolor": "none", "axes.facecolor": "none", "legend.frameon": False,
        "font.family": "sans-serif",
    }):  # fmt: skip
        yield


def builder_colour(builders: list[str], name: str) -> str:
    """Colour of a builder: by its place in the list."""
    return _COLOURS[builders.index(name) % len(_COLOURS)]


def svg(figure: Figure) -> str:
    """Return a figure as SVG to stand inside an HTML page: page-coloured, with tooltips."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].replace(_INK, "currentColor")
    return re.sub(
        rf'id="{re.escape(_TIP)}([^"]*)"', r'class="point" tabindex="0" data-tip="\1"', text
    )


def png(figure: Figure) -> bytes:
    """Return a figure as PNG on white, for slides and papers."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=160, facecolor="white")
    return buffer.getvalue()


def predicted_measured(record: dict[str, Any], measurement: str) -> Figure:
    """Predicted against measured cost of a scene's trees: SAH alone, and SAH with EPO.

    Parameters
    ----------
    record : dict
        A scene's record.
    measurement : str
        A key of :data:`mibvh.studies.analyse.MEASUREMENTS`.
    """
    measured = column(record, measurement)
    builders = [tree["builder"] for tree in record["trees"]]
    both = predictors(record, measurement)
    second = "fitted" if np.isfinite(both["fitted"][0]) else "fixed 0.79"
    with style():
        figure = Figure(figsize=(7.2, 3.1), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        for axis, name in zip(axes, ("SAH", second), strict=True):
            alpha, values = both[name]
            _scatter(axis, record, builders, values, measured, measurement)
            r = pearson(values, measured)
            label = "SAH" if name == "SAH" else f"SAH + EPO, α = {alpha:.2f}"
            axis.set_title(f"{label}: r = {r:.3f}" if np.isfinite(r) else label)
            axis.set_xlabel("predicted cost")
        axes[0].set_ylabel(f"measured: {MEASUREMENTS[measurement]}")
    return figure


def _scatter(
    axis: Axes,
    record: dict[str, Any],
    builders: list[str],
    values: np.ndarray,
    measured: np.ndarray,
    measurement: str,
) -> None:
    if len(values) > 1 and np.ptp(values) > 0:
        slope, intercept = np.polyfit(values, measured, 1)
        ends = np.array([values.min(), values.max()])
        axis.plot(ends, intercept + slope * ends, color="#888888", lw=1, zorder=1)
    for tree, x, y in zip(record["trees"], values, measured, strict=True):
        name = tree["builder"]
        tip = (
            f"{name}: {MEASUREMENTS[measurement]} {y:.4g}, predicted {x:.4g}, "
            f"SAH {tree['sah']:.4g}, EPO {tree['epo']:.4g}, LCV {tree['lcv']:.3g}"
        )
        colour = builder_colour(builders, name)
        axis.scatter(
            [x], [y], s=48, color=colour, gid=_TIP + tip, zorder=3, edgecolor="white", lw=0.5
        )
    _label_points(axis, builders, values, measured)
    axis.margins(0.14)


def _label_points(axis: Axes, labels: list[str], x: np.ndarray, y: np.ndarray) -> None:
    """Name the points: those that nearly coincide together, on alternate sides going up."""
    spread = np.maximum([np.ptp(x), np.ptp(y)], 1e-12)
    groups: list[list[int]] = []
    for i in np.argsort(y):
        for group in groups:
            gap = np.abs([x[i] - x[group[0]], y[i] - y[group[0]]]) / spread
            if gap[0] < 0.08 and gap[1] < 0.05:
                group.append(i)
                break
        else:
            groups.append([i])
    for place, group in enumerate(groups):
        at = group[0]
        # On the right edge there is no room to the right, nor on the left edge to the left.
        right = (
            bool(place % 2)
            if 0.2 < (x[at] - x.min()) / spread[0] < 0.8
            else ((x[at] - x.min()) / spread[0] <= 0.2)
        )
        at = max(group, key=lambda i: x[i]) if right else min(group, key=lambda i: x[i])
        axis.annotate(", ".join(labels[i] for i in group), (x[at], y[at]),
                      xytext=(7 if right else -7, 0), textcoords="offset points",
                      ha="left" if right else "right", va="center", fontsize=8)  # fmt: skip


def by_depth(record: dict[str, Any]) -> Figure:
    """Where in the tree the cost and the overlap sit: SAH and EPO by depth."""
    builders = [tree["builder"] for tree in record["trees"]]
    with style():
        figure = Figure(figsize=(7.2, 2.6), layout="constrained")
        axes = figure.subplots(1, 2)
        for axis, name, title in zip(
            axes, ("sah_by_depth", "epo_by_depth"), ("SAH by depth", "EPO by depth"), strict=True
        ):
            for tree in record["trees"]:
                values = np.array(tree[name])
                axis.plot(values, lw=1.4, color=builder_colour(builders, tree["builder"]),
                          label=tree["builder"])  # fmt: skip
            axis.set_title(title)
            axis.set_xlabel("depth")
        axes[0].set_ylabel("cost")
        axes[1].legend(fontsize=7, ncols=2 if len(builders) > 5 else 1)
    return figure


def summary(table: Any) -> Figure:
    """Pearson's r of each predictor, a point per scene, for each measurement.

    Parameters
    ----------
    table : DataFrame
        From :func:`mibvh.studies.analyse.correlations`.
    """
    names = list(dict.fromkeys(table["predictor"]))
    with style():
        figure = Figure(figsize=(7.2, 3.1), layout="constrained")
        axes = np.atleast_1d(figure.subplots(1, len(MEASUREMENTS), sharey=True))
        for axis, (measurement, title) in zip(axes, MEASUREMENTS.items(), strict=True):
            rows = table[(table["measurement"] == measurement) & table["pearson"].notna()]
            for i, name in enumerate(names):
                of = rows[rows["predictor"] == name]
                jitter = np.linspace(-0.12, 0.12, len(of)) if len(of) > 1 else np.zeros(len(of))
                for (_, row), dx in zip(of.iterrows(), jitter, strict=True):
                    tip = f"{row['scene']}: r = {row['pearson']:.4f}, {name}, {title}"
                    colour = _COLOURS[i % len(_COLOURS)]
                    axis.scatter([i + dx], [row["pearson"]], s=22, color=colour, gid=_TIP + tip)
                if len(of):
                    axis.hlines(of["pearson"].mean(), i - 0.3, i + 0.3, color=_INK, lw=1.2)
            axis.set_xticks(
                range(len(names)), names, rotation=55, ha="right", rotation_mode="anchor"
            )
            axis.set_title(title)
        axes[0].set_ylabel("Pearson r over the trees")
    return figure
