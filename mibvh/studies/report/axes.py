"""A panel of a drawing: axes with ticks, and points, lines and curves in data coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from mibvh.plot.marks import builder_colour, builder_dash, builder_shape, label_places
from mibvh.studies.report.drawing import Dot, Drawing, Part, Stroke, Words
from mibvh.triangles import F64

#: Room around the axes: left, right, bottom, top, in points.
MARGINS = (46.0, 10.0, 34.0, 22.0)
_GREY = "#888888"
_TICK = 8.5


class Axis:
    """One axis of a panel: its limits, and the positions of values.

    Parameters
    ----------
    low, high : float
        Limits in data coordinates; the greater one may come first.
    begin, end : float
        Where these stand, in points.
    log : bool
    """

    def __init__(
        self, low: float, high: float, begin: float, end: float, log: bool = False
    ) -> None:
        if low == high:
            low, high = low - 0.1 * (abs(low) or 1), low + 0.1 * (abs(low) or 1)
        self.low, self.high, self.log = low, high, log and min(low, high) > 0
        self._begin, self._end = begin, end

    def __call__(self, values: npt.ArrayLike) -> F64:
        """Return the positions of values in points; those outside the limits are at the edge."""
        of = np.log if self.log else np.asarray
        low, high = sorted((self.low, self.high))
        clipped = np.clip(np.asarray(values, np.float64), low, high)
        share = (of(clipped) - of(self.low)) / (of(self.high) - of(self.low))
        return np.asarray(self._begin + share * (self._end - self._begin), np.float64)

    def ticks(self, count: int = 5) -> F64:
        """Return round values within the limits."""
        from matplotlib.ticker import LogLocator, MaxNLocator

        low, high = sorted((self.low, self.high))
        if self.log:
            subs = (1.0,) if high / low > 300 else (1.0, 2.0, 5.0)
            at = LogLocator(subs=subs, numticks=12).tick_values(low, high)
        else:
            at = MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low, high)
        found = np.asarray(at, np.float64)
        slack = 1e-9 * (high - low)
        return found[(found >= low - slack) & (found <= high + slack)]


class Panel:
    """Axes on a part of a drawing.

    Parameters
    ----------
    sheet : Drawing
    part : Part
        The panel with its margins.
    x, y : (2,) of float
        Limits.
    title : str
    labels : (2,) of str
        What the axes show.
    log : (2,) of bool
    ticks : (2,) of bool
        Whether the axes have numbers.
    margins : (4,) of float
        As :data:`MARGINS`.
    """

    def __init__(
        self,
        sheet: Drawing,
        part: Part,
        x: Sequence[float],
        y: Sequence[float],
        *,
        title: str = "",
        labels: Sequence[str] = ("", ""),
        log: Sequence[bool] = (False, False),
        ticks: Sequence[bool] = (True, True),
        margins: Sequence[float] = MARGINS,
    ) -> None:
        left, right, bottom, top = margins
        self.sheet, self.part = sheet, part
        self._x0, self._x1 = part.x + left, part.x + part.width - right
        self._y0, self._y1 = part.y + part.height - bottom, part.y + top
        self.x = Axis(x[0], x[1], self._x0, self._x1, log[0])
        self.y = Axis(y[0], y[1], self._y0, self._y1, log[1])
        sheet.parts.append(part._replace(title=title))
        if ticks[0]:
            self._ticks_across()
        if ticks[1]:
            self._ticks_up()
        corner = np.array([[self._x0, self._y1], [self._x0, self._y0], [self._x1, self._y0]])
        sheet.add(Stroke(points=corner, opacity=0.7))
        middle = (self._x0 + self._x1) / 2, (self._y0 + self._y1) / 2
        sheet.add(Words(x=self._x0, y=self._y1 - 11, text=title, size=9.5))
        if labels[0]:
            sheet.add(
                Words(x=middle[0], y=part.y + part.height - 7, text=labels[0], anchor="middle")
            )
        if labels[1]:
            sheet.add(Words(x=part.x + 8, y=middle[1], text=labels[1], anchor="middle", turn=-90))

    def _ticks_across(self) -> None:
        for value in self.x.ticks(5):
            self.mark_across(value, _number(value))

    def mark_across(self, value: float, text: str) -> None:
        """Mark a value of the horizontal axis."""
        x = float(self.x(value))
        grid = np.array([[x, self._y0], [x, self._y1]])
        self.sheet.add(
            Stroke(points=grid, colour=_GREY, width=0.5, opacity=0.25),
            Words(x=x, y=self._y0 + 9, text=text, size=_TICK, anchor="middle"),
        )

    def _ticks_up(self) -> None:
        for value in self.y.ticks(5):
            y = float(self.y(value))
            grid = np.array([[self._x0, y], [self._x1, y]])
            self.sheet.add(
                Stroke(points=grid, colour=_GREY, width=0.5, opacity=0.25),
                Words(x=self._x0 - 4, y=y, text=_number(value), size=_TICK, anchor="end"),
            )

    def line(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        *,
        colour: str = _GREY,
        width: float = 1.0,
        opacity: float = 1.0,
    ) -> None:
        """Draw a line through points."""
        points = np.stack([self.x(x), self.y(y)], axis=1)
        self.sheet.add(Stroke(points=points, colour=colour, width=width, opacity=opacity))

    def dots(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        owners: Sequence[str],
        tips: Sequence[str],
        places: Sequence[int],
        *,
        size: float = 6.5,
        shapes: bool = True,
        opacity: float = 1.0,
        colour: str = "",
    ) -> None:
        """Draw a point per builder.

        Parameters
        ----------
        x, y : (K,) array
        owners, tips : sequence of str
        places : sequence of int
            Of the builders among all: their colours and shapes.
        size : float
        shapes : bool
            Whether builders have shapes of their own.
        opacity : float
        colour : str
            Of all points; empty for the builders' own.
        """
        for px, py, owner, tip, i in zip(self.x(x), self.y(y), owners, tips, places, strict=True):
            if np.isfinite(px + py):
                shape = builder_shape(i) if shapes else "o"
                self.sheet.add(
                    Dot(
                        x=float(px),
                        y=float(py),
                        shape=shape,
                        size=size,
                        owner=owner,
                        tip=tip,
                        colour=colour or builder_colour(i),
                        opacity=opacity,
                    )
                )

    def hollow(self, x: npt.ArrayLike, y: npt.ArrayLike) -> None:
        """Draw small grey outlines."""
        for px, py in zip(self.x(x), self.y(y), strict=True):
            if np.isfinite(px + py):
                dot = Dot(x=float(px), y=float(py), size=4.5, hollow=True, colour=_GREY)
                self.sheet.add(dot)

    def names(
        self, x: npt.ArrayLike, y: npt.ArrayLike, names: Sequence[str], beside: npt.ArrayLike = ()
    ) -> None:
        """Write names beside points, those of low ones first, and only where there is room.

        Parameters
        ----------
        x, y : (K,) array
        names : sequence of str
            Empty where a point needs none.
        beside : (M, 2) array, optional
            Other points that are not to be covered, such as those of a line.
        """
        corner, upwards = [self._x0, self._y0], [1, -1]
        every = np.concatenate([np.stack([x, y], axis=1), np.reshape(beside, (-1, 2))])
        points = (np.stack([self.x(every[:, 0]), self.y(every[:, 1])], axis=1) - corner) * upwards
        size = np.array([self._x1 - self._x0, self._y0 - self._y1])
        labels = [*names, *[""] * (len(every) - len(names))]
        for place in label_places(points, labels, size, only_clear=True):
            at = place.centre * upwards + corner
            self.sheet.add(Words(x=at[0], y=at[1], text=names[place.of], size=8, anchor="middle"))

    def curve(self, x: npt.ArrayLike, y: npt.ArrayLike, owner: str, tip: str, i: int) -> None:
        """Draw the curve of a builder, of its colour and dashes."""
        known = np.isfinite(np.asarray(y, np.float64))
        if not known.any():
            return
        points = np.stack([self.x(np.asarray(x)[known]), self.y(np.asarray(y)[known])], axis=1)
        self.sheet.add(
            Stroke(
                points=points,
                colour=builder_colour(i),
                width=1.5,
                owner=owner,
                tip=tip,
                dash=dashes(i),
            )
        )


def dashes(place: int) -> tuple[float, ...]:
    """Return the lengths of a builder's dashes, in points; none for a line without gaps."""
    dash = builder_dash(place)
    return () if isinstance(dash, str) else tuple(1.5 * d for d in dash[1])


def _number(value: float) -> str:
    return f"{value:,.10g}" if abs(value) >= 1e4 else f"{float(f'{value:.6g}'):g}"
