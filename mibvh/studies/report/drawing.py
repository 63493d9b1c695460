"""Drawings of the report: a list of marks, written as SVG by a template, as PDF and PNG on demand.

A mark stands at points from the top left corner. SVG takes a millisecond, and the page takes the
same marks; matplotlib draws them where a paper or a slide needs another form.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mibvh.files import atomic_path
from mibvh.plot.marks import literal
from mibvh.triangles import F64

#: The colour of text: that of the page, or dark where there is none.
INK = "currentColor"
_DARK = "#222222"
#: The forms that figures have beside SVG.
KINDS = ("pdf", "png")
_FONT = "ui-sans-serif, system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"
#: How far below the middle of the text its baseline is, in shares of its size.
_BASELINE = 0.35


@dataclasses.dataclass(frozen=True, kw_only=True)
class Mark:
    """Base class of all marks.

    Attributes
    ----------
    colour : str
    owner : str
        The builder whose it is, if it is one's.
    tip : str
        Said of it where a reader points at it.
    """

    colour: str = INK
    owner: str = ""
    tip: str = ""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Stroke(Mark):
    """A line through points (N, 2)."""

    points: F64
    width: float = 0.7
    dash: tuple[float, ...] = ()
    opacity: float = 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dot(Mark):
    """A point of one of matplotlib's marker shapes; hollow ones are outlines."""

    x: float
    y: float
    shape: str = "o"
    size: float = 6.0
    hollow: bool = False
    opacity: float = 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Words(Mark):
    """Text around its middle height; ``anchor`` is ``start``, ``middle`` or ``end``."""

    x: float
    y: float
    text: str
    size: float = 9.0
    anchor: str = "start"
    turn: float = 0.0
    strong: bool = False
    opacity: float = 1.0


class Part(NamedTuple):
    """A part of a drawing that a page may show alone: its corner, size and title."""

    x: float
    y: float
    width: float
    height: float
    title: str = ""


class Drawing:
    """A sheet with marks; its size is in points.

    Attributes
    ----------
    width, height : float
    marks : list of Mark
    parts : list of Part
        The panels; what is in none of them stands in files only.
    """

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self.marks: list[Any] = []
        self.parts: list[Part] = []
        self._written: dict[int, str] = {}

    def add(self, *marks: Mark) -> None:
        """Add marks on top."""
        self.marks += marks

    def svg(self, part: Part | None = None) -> str:
        """Return SVG of the drawing or of a part; text takes the colour of the page."""
        x, y, width, height, title = part or Part(0, 0, self.width, self.height)
        marks = self.marks if part is None else [m for m in self.marks if _inside(m, part)]
        body = "".join(map(self._svg_of, marks))
        if title:
            body = f'<g role="group" aria-label="{escape(title)}">{body}</g>'
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x:g} {y:g} {width:g} {height:g}" '
            f'font-family="{_FONT}" fill="none">{body}</svg>'
        )

    def _svg_of(self, mark: Mark) -> str:
        """The SVG of a mark: the file and the page write the same."""
        if id(mark) not in self._written:
            self._written[id(mark)] = _svg(mark)
        return self._written[id(mark)]

    def file(self) -> str:
        """Return the text of a self-contained SVG file."""
        size = f'width="{self.width:g}pt" height="{self.height:g}pt" viewBox'
        return self.svg().replace("viewBox", size, 1).replace(INK, _DARK)

    def save(self, path: Path) -> None:
        """Write it as PDF, or as PNG on white, by the file's ending."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(self.width / 72, self.height / 72))
        FigureCanvasAgg(figure)
        for mark in self.marks:
            figure.add_artist(_artist(mark, self))
        kind = path.suffix[1:]
        options: dict[str, Any] = (
            {"metadata": {"CreationDate": None}, "transparent": True}
            if kind == "pdf"
            else {"dpi": 160, "facecolor": "white", "pil_kwargs": {"compress_level": 4}}
        )
        with atomic_path(path) as temporary:
            figure.savefig(temporary, format=kind, **options)


def icon(shape: str, colour: str) -> str:
    """Return a small SVG of a point, to stand in a line of text."""
    dot = "".join(_shape(Dot(x=6, y=6, shape=shape, size=9, colour=colour)))
    return f'<svg class="icon" viewBox="0 0 12 12" aria-hidden="true">{dot}</svg>'


def _inside(mark: Any, part: Part) -> bool:
    x, y = mark.points.mean(axis=0) if isinstance(mark, Stroke) else (mark.x, mark.y)
    return bool(part.x <= x <= part.x + part.width and part.y <= y <= part.y + part.height)


def _svg(mark: Any) -> str:
    drawn = "".join(_shape(mark))
    if not mark.tip:
        return drawn
    tip, owner = escape(mark.tip), escape(mark.owner)
    whose = f' data-builder="{owner}"' if mark.owner else ""
    return (
        f'<g class="point" tabindex="0" role="img"{whose} data-tip="{tip}" aria-label="{tip}">'
        f"{drawn}</g>"
    )


def _shape(mark: Any) -> Iterator[str]:
    faint = f' opacity="{mark.opacity:g}"' if mark.opacity < 1 else ""
    if isinstance(mark, Words):
        turn = f' transform="rotate({mark.turn:g} {mark.x:.1f} {mark.y:.1f})"' if mark.turn else ""
        strong = ' font-weight="600"' if mark.strong else ""
        yield (
            f'<text x="{mark.x:.1f}" y="{mark.y + _BASELINE * mark.size:.1f}" '
            f'font-size="{mark.size:g}" text-anchor="{mark.anchor}" fill="{mark.colour}"'
            f"{strong}{turn}{faint}>{escape(mark.text)}</text>"
        )
    elif isinstance(mark, Stroke):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in mark.points)
        dash = f' stroke-dasharray="{" ".join(f"{d:g}" for d in mark.dash)}"' if mark.dash else ""
        yield (
            f'<polyline points="{points}" stroke="{mark.colour}" stroke-width="{mark.width:g}"'
            f' stroke-linejoin="round"{dash}{faint}/>'
        )
    else:
        edge = f'stroke="{mark.colour}"' if mark.hollow else f'fill="{mark.colour}"'
        if mark.shape == "o":
            at = f'cx="{mark.x:.1f}" cy="{mark.y:.1f}" r="{mark.size / 2:g}"'
            yield f"<circle {at} {edge}{faint}/>"
        else:
            corners = _outline(mark.shape) * [mark.size, -mark.size] + [mark.x, mark.y]
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
            yield f'<polygon points="{points}" {edge}{faint}/>'


@functools.cache
def _outline(shape: str) -> F64:
    """(N, 2) float64: corners of a marker of size 1, upwards."""
    from matplotlib.markers import MarkerStyle

    style = MarkerStyle(shape)
    return np.asarray(style.get_path().transformed(style.get_transform()).vertices, np.float64)


def _artist(mark: Any, sheet: Drawing) -> Any:
    """The mark as matplotlib draws it, in shares of the sheet."""
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

    colour = _DARK if mark.colour == INK else mark.colour
    if isinstance(mark, Words):
        return Text(
            mark.x / sheet.width,
            1 - mark.y / sheet.height,
            literal(mark.text),
            fontsize=mark.size,
            color=colour,
            alpha=mark.opacity,
            ha={"start": "left", "middle": "center", "end": "right"}[mark.anchor],
            va="center",
            rotation=-mark.turn,
            rotation_mode="anchor",
            fontweight="bold" if mark.strong else "normal",
        )
    if isinstance(mark, Stroke):
        x, y = mark.points.T
        style: Any = (0, tuple(d / mark.width for d in mark.dash)) if mark.dash else "solid"
        return Line2D(
            x / sheet.width,
            1 - y / sheet.height,
            color=colour,
            lw=mark.width,
            ls=style,
            alpha=mark.opacity,
        )
    return Line2D(
        [mark.x / sheet.width],
        [1 - mark.y / sheet.height],
        marker=mark.shape,
        ms=mark.size,
        color=colour,
        mfc="none" if mark.hollow else colour,
        mec=colour if mark.hollow else "none",
        alpha=mark.opacity,
    )
