"""Shared by all pictures: colours, settings, labelled points, curves by depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mibvh.triangles import F64

#: Settings of the figures that mibvh makes; colours of text and page are the user's.
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "font.family": "sans-serif",
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "axes.grid": True,
    "grid.color": "#88888833",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
}
#: Colour-blind safe (Okabe and Ito), readable on light and dark backgrounds. Shapes and dashes
#: distinguish the builders as well.
COLOURS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#D55E00",
    "#56B4E9",
    "#8C8C00",
    "#8A8A8A",
    "#A65ACD",
)
#: Shapes of points and dashes of curves, by the place of the builder.
SHAPES = "oDs^vPXpd"
DASHES = ("solid", (0, (4, 1.2)), (0, (1.2, 1)))
#: Colour map of quantities on white: darker means more.
SEQUENTIAL = "viridis_r"
#: How far from its point, in points, and in which directions a label may be placed.
_RADII = (5, 12, 20, 30, 42, 56)
_DIRECTIONS = ((1, 0), (-1, 0), (0.7, 0.7), (0.7, -0.7), (-0.7, 0.7), (-0.7, -0.7), (0, 1), (0, -1))


def builder_colour(place: int) -> str:
    """Colour of a builder, by its index."""
    return COLOURS[place % len(COLOURS)]


def builder_shape(place: int) -> str:
    """Shape of a builder's points, by its index: with its colour it is unique among 81."""
    return SHAPES[(place + place // len(COLOURS)) % len(SHAPES)]


def builder_dash(place: int) -> Any:
    """Dashes of a builder's curves, by its index: with its colour they are unique among 27."""
    return DASHES[(place + place // len(COLOURS)) % len(DASHES)]


def literal(name: str) -> str:
    """Return a name so that matplotlib writes it as it is: a pair of ``$`` begins no formula."""
    return name.replace("$", r"\$")


def named_points(
    axis: Axes,
    names: Sequence[str],
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    line: bool = False,
    gids: Sequence[str] | None = None,
) -> None:
    """Draw a point per builder, with its name beside it.

    Parameters
    ----------
    axis : Axes
        Of its final size, as labels are placed where there is room.
    names : sequence of str
    x, y : (K,) array
    line : bool
        Whether to draw the least-squares line.
    gids : sequence of str, optional
        Group ids of the points in an SVG.
    """
    across, up = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if line and len(names) > 1 and np.ptp(across) > 0:
        slope, intercept = np.polyfit(across, up, 1)
        ends = np.array([across.min(), across.max()])
        axis.plot(ends, intercept + slope * ends, color="#888888", lw=1, zorder=1)
    for i in range(len(names)):
        axis.plot(
            across[i : i + 1],
            up[i : i + 1],
            builder_shape(i),
            ms=6.5,
            color=builder_colour(i),
            zorder=3,
            mec="white",
            mew=0.5,
            gid=gids[i] if gids else None,
        )
    axis.margins(0.16, 0.1)
    _label_points(axis, names, across, up)


class LabelPlace(NamedTuple):
    """Where a label stands: its middle, and the point that it is of.

    Attributes
    ----------
    of : int
        The point.
    centre : (2,) float64
    nearest : (2,) float64
        Of the label's rectangle to the point.
    far : bool
        Whether the point lies so far away that a line has to lead there.
    """

    of: int
    centre: F64
    nearest: F64
    far: bool


def label_places(
    points: F64, labels: Sequence[str], size: F64, *, only_clear: bool = False
) -> list[LabelPlace]:
    """Find room for labels: near each point, clear of the others and their labels.

    Lower points come first, as they are of better trees.

    Parameters
    ----------
    points : (K, 2) float64
        In typographic points from a corner of the axes.
    labels : sequence of str
        A point whose label is empty only takes room.
    size : (2,) float64
        Of the axes.
    only_clear : bool
        Whether to leave out labels that would cover something or need a line to their point.

    Returns
    -------
    list of LabelPlace
        In the order of the points.
    """
    marks = np.concatenate([points - 4, points + 4], axis=1)
    radii = _RADII[:1] if only_clear else _RADII
    offsets = np.array([(r, *d) for r in radii for d in _DIRECTIONS], np.float64)
    taken: list[F64] = []
    found: dict[int, LabelPlace] = {}
    for i in np.argsort(points[:, 1]):
        if not labels[i]:
            continue
        half = np.array([2.5 * len(labels[i]), 5.0])  # of the text, about
        others = np.array([*taken, *np.delete(marks, i, axis=0)]).reshape(-1, 4)
        radius, direction = offsets[:, :1], offsets[:, 1:]
        centres = points[i] + np.sign(direction) * half + radius * direction
        low, high = centres - half, centres + half
        outside = np.maximum(-low, 0) + np.maximum(high - size, 0)
        edges = np.minimum(high[:, None], others[:, 2:]) - np.maximum(low[:, None], others[:, :2])
        overlap = np.maximum(edges, 0).prod(axis=2).sum(axis=1)
        covers = 10 * outside.sum(axis=1) + 3 * overlap
        best = int((covers + radius[:, 0]).argmin())
        if only_clear and covers[best] > 0:
            continue
        taken.append(np.concatenate([low[best], high[best]]))
        nearest = np.clip(points[i], low[best], high[best])
        found[int(i)] = LabelPlace(int(i), centres[best], nearest, bool(radius[best, 0] > 5))
    return [found[i] for i in sorted(found)]


def _label_points(axis: Axes, labels: Sequence[str], x: F64, y: F64) -> None:
    """Label the points where there is room."""
    low, high = (np.array(limits) for limits in zip(axis.get_xlim(), axis.get_ylim(), strict=True))
    box = axis.get_window_extent()
    size = np.array([box.width, box.height]) * 72 / axis.figure.dpi
    points = (np.stack([x, y], axis=1) - low) / (high - low) * size
    for place in label_places(points, labels, size):
        if place.far:
            ends = np.stack([points[place.of], place.nearest]) / size * (high - low) + low
            axis.plot(ends[:, 0], ends[:, 1], color="#888888", lw=0.6, zorder=2)
        x_text, y_text = place.centre / size * (high - low) + low
        axis.text(
            x_text,
            y_text,
            literal(labels[place.of]),
            fontsize=8,
            ha="center",
            va="center",
            zorder=4,
        )


def depth_curves(
    axis: Axes, curves: Mapping[str, npt.ArrayLike], gids: Sequence[str] | None = None
) -> None:
    """Draw a curve per builder over the depth of the tree.

    Parameters
    ----------
    axis : Axes
    curves : mapping of label to (D,) array
    gids : sequence of str, optional
        Group ids of the curves in an SVG.
    """
    for i, (label, values) in enumerate(curves.items()):
        axis.plot(
            np.asarray(values),
            lw=1.5,
            color=builder_colour(i),
            ls=builder_dash(i),
            label=literal(label),
            gid=gids[i] if gids else None,
        )
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
