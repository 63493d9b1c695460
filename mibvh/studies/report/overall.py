"""The figure beside the findings: what each builder's trees cost over the best of each scene."""

from __future__ import annotations

import numpy as np

from mibvh.plot.marks import builder_colour, builder_shape
from mibvh.studies.analyse.winners import cost_over_best
from mibvh.studies.record.scene import Records
from mibvh.studies.report.axes import Panel
from mibvh.studies.report.drawing import Dot, Drawing, Part, Stroke, Words
from mibvh.studies.report.layout import places_of
from mibvh.triangles import F64

_WIDTH, _ROW = 380.0, 19.0
#: Left, right, bottom and top of the rows; the names stand on the left, the means on the right.
_MARGINS = (104.0, 62.0, 30.0, 34.0)
#: How far the axis goes beyond the greatest mean.
_ROOM = 1.15
#: Letters of a name that fit beside a row.
_NAME = 18


def overall(records: Records) -> Drawing | None:
    """Draw a row per builder, the cheapest first: its mean as a bar, and a point per scene.

    Scenes that cost more than the axis is long are at its end. None if no builder has a tree of
    every scene.
    """
    over = {name: shares - 1 for name, shares in cost_over_best(records).items()}
    if not over:
        return None
    height = _ROW * len(over) + _MARGINS[2] + _MARGINS[3]
    sheet = Drawing(_WIDTH, height)
    end = _ROOM * max([float(shares.mean()) for shares in over.values()] + [0.01])
    panel = Panel(
        sheet,
        Part(0.0, 0.0, _WIDTH, height),
        (0.0, end),
        (len(over) - 0.5, -0.5),
        ticks=(False, False),
        margins=_MARGINS,
    )
    beyond = any((shares > end).any() for shares in over.values())
    said = f"bar: mean of {len(records)} scenes; dots: scenes" if len(records) > 1 else ""
    sheet.add(
        Words(x=5.0, y=10.0, text="Counted cost above the scene's best", size=9.5, strong=True),
        Words(x=5.0, y=23.0, text=said + ", those beyond at the edge" * beyond, opacity=0.8),
    )
    for value in panel.x.ticks(4):
        panel.mark_across(value, f"+{value:.0%}" if value else "best")
    places, scenes = places_of(records), [record.scene for record in records]
    for i, (name, shares) in enumerate(over.items()):
        _row(panel, i, name, shares, places[name], scenes)
    return sheet


def _row(panel: Panel, i: int, name: str, shares: F64, place: int, scenes: list[str]) -> None:
    y, begin = float(panel.y(i)), float(panel.x(0.0))
    mean, colour = float(shares.mean()), builder_colour(place)
    worst = int(shares.argmax())
    tip = f"{name}: +{mean:.1%} on average, +{shares[worst]:.1%} at worst ({scenes[worst]})"
    bar = np.array([[begin, y], [float(panel.x(mean)), y]])
    panel.sheet.add(
        Stroke(points=bar, colour=colour, width=9.0, opacity=0.35, owner=name, tip=tip),
        Dot(x=10.0, y=y, shape=builder_shape(place), size=6.5, colour=colour),
        Words(x=18.0, y=y, text=name[:_NAME], strong=i == 0),
        Words(x=_WIDTH - 4, y=y, text=f"+{mean:.1%}" if mean else "best", anchor="end"),
    )
    panel.dots(
        shares,
        np.full(len(shares), float(i)),
        [name] * len(shares),
        [f"{scene}: {name}, +{share:.1%}" for scene, share in zip(scenes, shares, strict=True)],
        [place] * len(shares),
        size=4.0,
        shapes=False,
        opacity=0.8,
    )
