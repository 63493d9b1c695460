"""Draw ``docs/images/results-rotation.svg`` from the table of ``docs/results/rotation.md``."""

from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.ticker import FixedLocator, NullLocator

from mibvh.plot.marks import STYLE, builder_colour

MEASURED = "counted cost"
PREDICTED = ("SAH", "SAH + EPO, average α", "ray lines, average α")
TICKS = (0.7, 1, 2, 4, 8, 14)


def table(text: str) -> list[dict[str, str]]:
    """Rows of the first table of a page, by heading."""
    lines = text[text.index("\n| ") :].strip().split("\n\n")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]


def draw(docs: Path) -> None:
    """Read the table, draw and save the figure.

    Parameters
    ----------
    docs : Path
        The folder ``docs`` of a checkout.
    """
    rows = table((docs / "results/rotation.md").read_text())
    rows = [row for row in rows if row["scene"] not in ("mean of the scenes", "paper")]
    y = [float(row[MEASURED]) for row in rows]
    with mpl.rc_context({**STYLE, "svg.hashsalt": "mibvh"}):
        figure, axes = plt.subplots(1, 3, figsize=(8, 2.9), sharey=True, layout="constrained")
        for i, (axis, name) in enumerate(zip(axes, PREDICTED, strict=True)):
            axis.plot([0.6, 15], [0.6, 15], color="#888888", lw=1)
            axis.plot([float(row[name]) for row in rows], y, "o", ms=4.5, color=builder_colour(i))
            axis.set(xscale="log", yscale="log", title=name, xlabel="predicted factor")
            for one in (axis.xaxis, axis.yaxis):
                one.set_major_locator(FixedLocator(TICKS))
                one.set_minor_locator(NullLocator())
                one.set_major_formatter("{x:g}")
        axes[0].set_ylabel("factor of counted cost")
        figure.savefig(docs / "images/results-rotation.svg", metadata={"Date": None})
