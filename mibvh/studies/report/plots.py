"""Plots of the report, by matplotlib; text and lines take the colour of the page they are in.

A figure is a row of panels of one size, so that a page can also set them one below the other.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mibvh.metrics.predictor import pearson
from mibvh.metrics.registry import Quantity
from mibvh.plot.marks import STYLE, builder_colour, depth_curves, literal, named_points
from mibvh.studies.analyse.correlations import predicted
from mibvh.studies.analyse.rotation import headings
from mibvh.studies.analyse.sweep import Sweep
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.record.quantities import quantities, targets
from mibvh.studies.record.scene import SceneRecord
from mibvh.triangles import F64

#: Stands for "the text colour of the page" until the figure is in it.
_INK = "#123457"
#: Separates the parts of what is said of a point, in its group id: whose it is, and a tooltip.
_TIP = "tip|"
#: Width of a panel and room around its axes, in inches: left, right, bottom, top.
_WIDTH, _MARGINS = 3.6, (0.72, 0.12, 0.48, 0.32)
#: Builders' names in a row of the strip below the panels, and the height of a row, in inches.
_NAMES, _ROW = 9, 0.22
_SVG = "http://www.w3.org/2000/svg"


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib settings of all figures."""
    with mpl.rc_context({
        **STYLE,
        "axes.edgecolor": _INK, "axes.labelcolor": _INK, "text.color": _INK,
        "xtick.color": _INK, "ytick.color": _INK, "svg.fonttype": "none", "svg.hashsalt": "mibvh",
        "figure.facecolor": "none", "axes.facecolor": "none",
    }):  # fmt: skip
        yield


def _figure(
    panels: int, height: float = 2.8, bottom: float = 0.0, strip: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """A row of panels; margins are fixed, as fitting them to the text takes most of the time.

    Below the panels there is room for a strip that only the files have.
    """
    left, right, low, top = _MARGINS
    low = (bottom or low) + strip
    height += strip
    figure = Figure(figsize=(_WIDTH * panels, height))
    figure.set_gid(f"strip-{72 * strip:g}")
    axes = [
        figure.add_axes((
            (i + left / _WIDTH) / panels, low / height,
            (1 - (left + right) / _WIDTH) / panels, 1 - (low + top) / height,
        ), gid=f"panel-{i}")
        for i in range(panels)
    ]  # fmt: skip
    return figure, axes


def _name(axis: Axes, title: str, x: str, y: str) -> None:
    """Write title and axis labels at fixed places: finding them takes as long as drawing."""
    axis.set_title(title, loc="left", y=1.02)
    box = axis.get_window_extent()
    inch = axis.figure.dpi
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.xaxis.set_label_coords(0.5, -0.29 * inch / box.height)
    axis.yaxis.set_label_coords(-0.56 * inch / box.width, 0.5)


def _strip(record: SceneRecord) -> float:
    """Height of the strip that takes the names of a scene's builders, in inches."""
    return _ROW * (1 + (len(record.trees) - 1) // _NAMES) + 0.08


def _legend(figure: Figure, axis: Axes) -> None:
    """Name an axis's curves in the strip below the panels, clear of all curves."""
    curves, names = axis.get_legend_handles_labels()
    columns = min(max(len(names), 1), _NAMES)
    figure.legend(curves, names, loc="lower center", fontsize=7.5, ncols=columns,
                  columnspacing=1.3, handlelength=1.8, borderaxespad=0.2)  # fmt: skip


def _tip(builder: str) -> str:
    """Return the beginning of the id of what is of a builder; its tooltip follows."""
    return f"{_TIP}{builder.replace('|', '¦')}|"


def svg(figure: Figure) -> str:
    """Return a figure as SVG, page-coloured and with tooltips."""
    buffer = io.StringIO()
    with style():
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].replace(_INK, "currentColor")
    return re.sub(
        rf'id="{re.escape(_TIP)}([^"|]*)\|([^"]*)"',
        r'class="point" tabindex="0" role="img" data-builder="\1" data-tip="\2" aria-label="\2"',
        text,
    )


def panels(text: str) -> list[str]:
    """Split a figure's SVG into one per panel, without the names that only matplotlib needs.

    The strip below them is left out: a page says once what each colour stands for.
    """
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(text)
    whole = next(g for g in root if g.get("id", "").startswith("strip-"))
    strip = float(whole.attrib["id"].removeprefix("strip-"))
    axes = [g for g in whole if g.get("id", "").startswith("panel-")]
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    for name in ("width", "height"):
        del root.attrib[name]
    for child in list(root):
        if child.tag == f"{{{_SVG}}}metadata":
            root.remove(child)
    for group in root.iter(f"{{{_SVG}}}g"):
        group.attrib.pop("id", None)
    found = []
    for i, panel in enumerate(axes):
        whole[:] = [panel]
        part = width / len(axes)
        root.set("viewBox", f"{i * part:g} 0 {part:g} {height - strip:g}")
        found.append(ElementTree.tostring(root, encoding="unicode"))
    return found


def pdf(figure: Figure) -> bytes:
    """Return a figure as PDF, for papers; without a background."""
    buffer = io.BytesIO()
    with style():
        figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()


def png(figure: Figure) -> bytes:
    """Return a figure as PNG on white, for slides and papers."""
    buffer = io.BytesIO()
    figure.set_facecolor("white")
    FigureCanvasAgg(figure)
    with style():
        figure.savefig(buffer, format="png", dpi=160, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def predicted_measured(record: SceneRecord, target: Quantity) -> Figure:
    """Predicted against measured cost of a scene's trees: SAH alone, and SAH with EPO.

    Parameters
    ----------
    record : SceneRecord
    target : Quantity
        From :func:`mibvh.studies.record.quantities.targets`.
    """
    sample = record.sample(target.name)
    second = "fitted" if np.isfinite(predicted("fitted", sample)[0]) else "fixed 0.79"
    with style():
        figure, axes = _figure(2)
        for axis, name in zip(axes, ("SAH", second), strict=True):
            alpha, values = predicted(name, sample)
            _scatter(axis, record, values, target)
            r = pearson(values, sample.measured)
            label = "SAH" if name == "SAH" else f"SAH + EPO, α = {alpha:.2f}"
            title = f"{label}:  r = {r:.3f}" if np.isfinite(r) else label
            _name(axis, title, "predicted cost", f"measured: {target.heading}")
    return figure


def _scatter(axis: Axes, record: SceneRecord, values: F64, target: Quantity) -> None:
    measured = record.column(target.name)
    gids = []
    for tree, x, y in zip(record.trees, values, measured, strict=True):
        name = tree.builder
        noise = f" ±{tree[target.error]:.1%}" if target.error else ""
        gids.append(
            f"{_tip(name)}{name}: {target.heading} {y:.4g}{noise}, predicted {x:.4g}, "
            f"SAH {tree['sah']:.4g}, EPO {tree['epo']:.4g}, LCV {tree['lcv']:.3g}"
        )
    names = [tree.builder for tree in record.trees]
    named_points(axis, names, values, measured, line=True, gids=gids)


def by_depth(record: SceneRecord) -> Figure:
    """Where in the tree the cost and the overlap sit: SAH and EPO by depth."""
    with style():
        figure, axes = _figure(2, height=2.5, strip=_strip(record))
        for axis, name in zip(axes, ("sah", "epo"), strict=True):
            heading = quantities()[name].heading
            curves, gids = {}, []
            for tree in record.trees:
                levels = tree.sah_by_depth if name == "sah" else tree.epo_by_depth
                values = curves[tree.builder] = np.array(levels)
                gids.append(
                    f"{_tip(tree.builder)}{tree.builder}: {heading} {tree[name]:.4g} "
                    f"over {len(values)} levels, most at depth {values.argmax()}"
                )
            depth_curves(axis, curves, gids)
            _name(axis, f"{heading} by depth", "depth", "cost")
        _legend(figure, axes[0])
    return figure


def remaining(record: SceneRecord, found: DepthResult) -> Figure:
    """What a top-down sweep minimises: the worst-case cost that remains, by splits and by depth.

    Parameters
    ----------
    record : SceneRecord
    found : DepthResult
        Of this scene.
    """
    with style():
        figure, axes = _figure(2, height=2.5, strip=_strip(record))
        left, right, gids = {}, {}, []
        for tree, cuts in zip(record.trees, found.trees, strict=True):
            name = tree.builder
            left[name] = np.array(cuts.remaining_after_splits, dtype=np.float64)
            right[name] = np.array(cuts.spent_by_depth) + cuts.remaining_by_depth
            gids.append(
                f"{_tip(name)}{name}: {left[name][0]:.4g} as one leaf, {left[name][3]:.4g} after "
                f"7 splits, SAH {tree['sah']:.4g} when all is split"
            )
        depth_curves(axes[0], left, gids)
        depth_curves(axes[1], right, gids)
        _name(axes[0], "Worst-case triangle cost that remains", "log₂(splits + 1)", "cost")
        _name(axes[1], "SAH of the tree cut at a depth", "depth", "cost")
        for axis in axes:
            axis.set_yscale("log")
        _legend(figure, axes[0])
    return figure


def rotation(factors: pd.DataFrame) -> Figure:
    """What rotating the scenes costs, counted, against what SAH and SAH with EPO predict.

    Parameters
    ----------
    factors : DataFrame
        From :func:`mibvh.studies.analyse.rotation.rotation_factors`.
    """
    builders, titles = list(dict.fromkeys(factors["builder"])), headings()
    with style():
        figure, axes = _figure(2, height=3.0)
        for axis, name in zip(axes, ("sah", "fitted"), strict=True):
            x, y = factors[name], factors["counted_cost"]
            ends = [min(x.min(), y.min()), max(x.max(), y.max())]
            axis.plot(ends, ends, color="#888888", lw=1, zorder=1)
            for i, builder in enumerate(builders):
                for _, row in factors[factors["builder"] == builder].iterrows():
                    tip = (
                        f"{row['scene']}, {builder}: counted cost {row['counted_cost']:.2f}×, "
                        f"SAH {row['sah']:.2f}×, EPO {row['epo']:.2f}×"
                    )
                    axis.plot([row[name]], [row["counted_cost"]], "o", ms=4.5,
                              color=builder_colour(i), mec="none", alpha=0.85,
                              gid=f"{_tip(builder)}{tip}")  # fmt: skip
            title = titles[name]
            _name(axis, title, "predicted factor", "factor of counted cost")
    return figure


def swept(sweep: Sweep) -> Figure:
    """Cost of a builder's trees against one of its options.

    Parameters
    ----------
    sweep : Sweep
    """
    known = quantities()
    with style():
        figure, axes = _figure(2)
        for axis, names in zip(axes, (("counted_cost",), ("sah", "epo")), strict=True):
            for i, name in enumerate(names):
                values = sweep.column(name)
                heading = known[name].heading
                axis.plot(sweep.values, values, color=builder_colour(i), lw=1.2, label=heading)
                for x, y, tree in zip(sweep.values, values, sweep.trees, strict=True):
                    tip = f"{tree.builder}: {heading} {y:.4g}"
                    axis.plot([x], [y], "o", ms=4.5, color=builder_colour(i), mec="none",
                              gid=f"{_TIP}{tree.builder}|{tip}")  # fmt: skip
            if len(names) > 1:
                axis.legend(fontsize=7.5)
            _name(axis, " and ".join(known[n].heading for n in names), sweep.option, "cost")
    return figure


def summary(table: pd.DataFrame) -> Figure:
    """Pearson's r of each predictor, a point per scene, for each measurement.

    Parameters
    ----------
    table : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    """
    names = list(dict.fromkeys(table["predictor"]))
    shown = table[table["pearson"].notna()]
    with style():
        figure, axes = _figure(len(targets()), height=3.45, bottom=1.07)
        for axis, target in zip(axes, targets(), strict=True):
            rows = shown[shown["measurement"] == target.name]
            for i, name in enumerate(names):
                of = rows[rows["predictor"] == name]
                jitter = np.linspace(-0.2, 0.2, len(of)) if len(of) > 1 else np.zeros(len(of))
                for scene, r, dx in zip(of["scene"], of["pearson"], jitter, strict=True):
                    tip = f"{scene}: r = {r:.4f}, {name}, {target.heading}"
                    axis.plot([i + dx], [r], "o", ms=4, color=builder_colour(i), alpha=0.85,
                              mec="none", gid=f"{_TIP}|{tip}")  # fmt: skip
                if len(of):
                    axis.hlines(of["pearson"].mean(), i - 0.32, i + 0.32, color=_INK, lw=1.3)
            axis.set_xticks(
                range(len(names)), [literal(name) for name in names],
                rotation=45, ha="right", rotation_mode="anchor",
            )  # fmt: skip
            axis.grid(False, axis="x")
            _name(axis, target.heading, "", "Pearson r over the trees")
            if len(shown):
                low = shown["pearson"].min()
                axis.set_ylim(low - 0.05 * (1 - low), 1 + 0.03 * (1 - low))
    return figure
