"""The first figure of the report: the best tree of each scene, and the others relative to it."""

from __future__ import annotations

import numpy as np

from mibvh.plot.marks import builder_colour, builder_shape
from mibvh.studies.analyse.correlations import SCALAR
from mibvh.studies.analyse.winners import winner, winner_in_time
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.report.drawing import Dot, Drawing, Part, Stroke, Words
from mibvh.studies.report.layout import legend, places_of, strip_height
from mibvh.triangles import F64

#: Width and height of a scene's row, and how many stand side by side.
_WINNERS, _STEP, _ABREAST = 300.0, 76.0, 3
#: Where a row's line begins and ends, and the costs over the best beyond which trees stand in a
#: row behind its end.
_BEGIN, _END, _MOST = 12.0, 200.0, 0.6
#: Where the first of the trees behind the end stands, how far apart they are, and where the last
#: stands at most.
_BEYOND, _APART, _LAST = 230.0, 8.0, 288.0
#: Costs over the best that are marked on the line.
_MARKED = (0.0, 0.2, 0.4, 0.6)
_GREY = "#888888"


def winners(records: Records) -> Drawing:
    """Draw the winner of each scene, its lead and error, and the other trees.

    A row per scene: its name, who wins by counted cost and by scalar time, and a point per tree at
    its counted cost over the best. Trees that cost more than the line is long stand side by side
    behind its end, in the order of their costs.
    """
    places, abreast = places_of(records), min(len(records), _ABREAST)
    width, height = _WINNERS * abreast, _STEP * -(-len(records) // abreast)
    sheet = Drawing(width, height + strip_height(list(places), width))
    for i, record in enumerate(records):
        x, y = (i % abreast) * _WINNERS, (i // abreast) * _STEP
        sheet.parts.append(Part(x, y, _WINNERS, _STEP, f"{record.scene}: {winner(record)}"))
        _winner_row(sheet, record, places, x, y)
    legend(sheet, list(places), height, curves=False)
    return sheet


def _over(record: SceneRecord) -> F64:
    costs = record.column("counted_cost")
    return costs / costs.min() - 1 if costs.min() > 0 else np.zeros(len(costs))


def _winner_row(
    sheet: Drawing, record: SceneRecord, places: dict[str, int], left: float, top: float
) -> None:
    best, y = winner(record), top + 52
    sheet.add(
        Words(x=left + 2, y=top + 8, text=record.scene, size=11, strong=True),
        Words(x=left + 2, y=top + 23, text=str(best), size=10),
        Words(x=left + 2, y=top + 37, text=_in_time(record), size=10, opacity=0.8),
        Stroke(points=np.array([[left + _BEGIN, y], [left + _END, y]]), colour=_GREY, opacity=0.5),
    )
    for mark in _MARKED:
        x = left + _along(mark)
        sheet.add(
            Stroke(points=np.array([[x, y - 4], [x, y + 4]]), colour=_GREY, opacity=0.5),
            Words(x=x, y=y + 13, text=f"+{mark:.0%}" if mark else "best", anchor="middle"),
        )
    costs = _over(record)
    order = np.argsort(costs, kind="stable")
    on_line = int((costs <= _MOST).sum())
    if on_line < len(order):
        sheet.add(Words(x=left + _BEYOND - 4, y=y + 13, text=f"{len(order) - on_line} beyond"))
    apart = min(_APART, (_LAST - _BEYOND) / max(len(order) - on_line - 1, 1))
    # The best is drawn last, on top.
    for rank, i in reversed(list(enumerate(order))):
        tree, over = record.trees[i], float(costs[i])
        along = _along(over) if rank < on_line else _BEYOND + apart * (rank - on_line)
        sheet.add(
            Dot(
                x=left + along,
                y=y,
                shape=builder_shape(places[tree.builder]),
                size=10.0 if tree.builder == best.builder else 7.0,
                colour=builder_colour(places[tree.builder]),
                owner=tree.builder,
                tip=f"{record.scene}: {tree.builder}, counted cost {tree['counted_cost']:.4g}, "
                f"+{over:.1%} over the best",
            )
        )


def _along(over: float) -> float:
    """Return the position of a relative cost on the line."""
    return _BEGIN + over / _MOST * (_END - _BEGIN)


def _in_time(record: SceneRecord) -> str:
    timed = winner_in_time(record, SCALAR)
    return f"in time: {timed}" if timed is not None and timed.second else ""
