"""Layout of figures: rows of panels, limits of axes, and the legend strip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mibvh.plot.marks import builder_colour, builder_shape
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.report.axes import dashes
from mibvh.studies.report.drawing import Dot, Drawing, Part, Stroke, Words
from mibvh.triangles import F64

#: Size of a panel of a pair, in points.
WIDTH, HEIGHT = 259.0, 202.0
#: Height of a row of the strip below the panels.
ROW = 14.0
#: Width of a builder's name there.
_NAME = 100.0


def places_of(records: Records) -> dict[str, int]:
    """Return the place of each builder among all: its colour and shape."""
    by_size = sorted(records, key=lambda record: -len(record.trees))
    names = dict.fromkeys(tree.builder for record in by_size for tree in record.trees)
    return {name: i for i, name in enumerate(names)}


def row_of_panels(
    height: float = HEIGHT, strip: float = 0.0, panels: int = 2
) -> tuple[Drawing, list[Part]]:
    """Return a drawing with a row of panels above a legend strip, which only files show."""
    sheet = Drawing(WIDTH * panels, height + strip)
    return sheet, [Part(i * WIDTH, 0.0, WIDTH, height) for i in range(panels)]


def limits_of(values: F64, margin: float = 0.06) -> tuple[float, float]:
    """Return limits of an axis that shows values, with room on both sides."""
    known = np.asarray(values, np.float64)
    known = known[np.isfinite(known)]
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    room = margin * ((high - low) or abs(high) or 1.0)
    return low - room, high + room


def legend(sheet: Drawing, names: Sequence[str], top: float, *, curves: bool) -> None:
    """Draw the legend strip below the panels, with each builder's curve or point."""
    abreast = _abreast(sheet.width)
    column = sheet.width / abreast
    for i, name in enumerate(names):
        x, y = (i % abreast) * column + 24, top + ROW * (i // abreast) + 8
        line, colour = np.array([[x - 20, y], [x + 2, y]]), builder_colour(i)
        if curves:
            sheet.add(Stroke(points=line, colour=colour, width=1.5, dash=dashes(i)))
        else:
            sheet.add(Dot(x=x - 2, y=y, shape=builder_shape(i), colour=colour))
        sheet.add(Words(x=x + 6, y=y, text=name))


def _abreast(width: float) -> int:
    return max(1, int(width // _NAME))


def strip_height(names: Sequence[str], width: float = 2 * WIDTH) -> float:
    """Return the height of the legend strip."""
    return ROW * -(-len(names) // _abreast(width)) + 4


def builders_of(record: SceneRecord) -> list[str]:
    """Return the names of a scene's trees, in the order of their colours."""
    return [tree.builder for tree in record.trees]
