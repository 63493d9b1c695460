"""The report: one HTML file that works offline, and its figures as files."""

from __future__ import annotations

import base64
import functools
import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mibvh.files import atomic_path, write_text
from mibvh.studies.report import plots as figures
from mibvh.studies.analyse.correlations import MEASUREMENTS, PREDICTORS, overview, worst_time_error
from mibvh.studies.report.tables import PREDICTION, times_known
from mibvh.studies.report.experiment_tables import TURNING
from mibvh.studies.measure.rotation import rotation_factors
from mibvh.studies.sheet import Sheet

#: Figures of a scene: file name, what to say below it.
CAPTIONS = {
    "counted": "Counted cost per ray against the prediction: no stopwatch, no noise.",
    "scalar": "Scalar time per ray against the prediction.",
    "simd": "SIMD time per ray against the prediction.",
    "depth": "Where in the trees the expected cost and the overlap sit.",
    "remaining": "What would remain to be tested if the tree ended there: what a sweep minimises.",
}
#: Predictors that a reader asks for first, and their titles.
_FIRST = {
    "SAH": "SAH alone",
    "fitted": "SAH + EPO, α fitted per scene",
    "finite rays": "finite rays, nothing fitted",
}
#: What they are held against.
_FIRST_HELD = ("counted_cost", "scalar_ns")
#: Width of the small pictures, in pixels: twice what is shown, for fine screens.
_THUMBNAIL = 320


@functools.cache
def _template() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("mibvh.studies.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html")


def write_report(
    folder: Path,
    records: list[dict[str, Any]],
    found: pd.DataFrame,
    sheets: list[Sheet],
    of_scenes: list[list[Sheet]],
) -> list[str]:
    """Write ``report.html``, and each figure as SVG and PNG under ``figures/``.

    Parameters
    ----------
    folder : Path
    records : list of dict
        One per scene.
    found : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    sheets : list of Sheet
        Over the scenes; see :func:`mibvh.studies.report.tables.answers`.
    of_scenes : list of list of Sheet
        Of each scene; see :func:`mibvh.studies.report.tables.scene_answers`.

    Returns
    -------
    list of str
        The figures' files, relative to the folder.
    """
    (folder / "figures").mkdir(exist_ok=True)
    draw = _Draw(folder)
    factors = rotation_factors(records)
    page = _template().render(
        builders=_builders(records),
        sections=[
            (title, list(group)) for title, group in itertools.groupby(sheets, lambda s: s.section)
        ],
        scenes=[
            _scene(draw, record, found, of_scene)
            for record, of_scene in zip(records, of_scenes, strict=True)
        ],
        headline=_overall(found),
        times_known=times_known(records, "scalar_ns"),
        prediction=PREDICTION,
        summary=draw("summary", figures.summary(found)),
        turning=TURNING if len(factors) else None,
        rotation=draw("rotation", figures.rotation(factors)) if len(factors) else [],
        predictors=PREDICTORS,
        environment=records[-1]["environment"],
        options=records[-1]["options"],
    )
    write_text(folder / "report.html", page)
    return draw.written


class _Draw:
    """Writes figures' files, and notes which."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.written: list[str] = []

    def __call__(self, name: str, figure: Any) -> list[str]:
        """Write a figure. Returns the SVG of each of its panels, to stand in the page."""
        drawn = figures.svg(figure)
        files = [f"figures/{name}.{kind}" for kind in ("svg", "png")]
        write_text(self._folder / files[0], drawn.replace("currentColor", "#222"))
        with atomic_path(self._folder / files[1]) as path:
            path.write_bytes(figures.png(figure))
        self.written += files
        return figures.panels(drawn)


def _builders(records: list[dict[str, Any]]) -> list[dict[str, str]]:
    """Name and colour of each builder, in the order of the scene that has most."""
    most = max(records, key=lambda record: len(record["trees"]))
    return [
        {"name": tree["builder"], "colour": figures.builder_colour(i)}
        for i, tree in enumerate(most["trees"])
    ]


def _scene(
    draw: _Draw, record: dict[str, Any], found: pd.DataFrame, sheets: list[Sheet]
) -> dict[str, Any]:
    name = record["scene"]
    drawn = {
        "counted": figures.predicted_measured(record, "counted_cost"),
        "scalar": figures.predicted_measured(record, "scalar_ns"),
        "simd": figures.predicted_measured(record, "simd_ns"),
        "depth": figures.by_depth(record),
    }
    if "depth" in record["options"]["experiments"]:
        drawn["remaining"] = figures.remaining(record)
    return {
        "name": name,
        "triangles": f"{record['triangles']:,}",
        "rays": f"{record['rays']['count']:,}",
        "viewpoints": record["rays"]["viewpoints"],
        "notes": record["notes"],
        "picture": record["picture"]["png"],
        "thumbnail": _thumbnail(record["picture"]["png"]),
        "timing": record["timing"],
        "sheets": sheets,
        "r": _of_scene(record, found[found["scene"] == name]),
        "figures": [
            (CAPTIONS[key], draw(f"{name}-{key}", figure)) for key, figure in drawn.items()
        ],
    }


def _overall(found: pd.DataFrame) -> list[tuple[str, ...]]:
    """Of each of :data:`_FIRST`: title, mean and least r with counted cost, the same with time.

    Empty where no r is known.
    """
    summary = overview(found)
    tiles = []
    for name, title in _FIRST.items():
        values = [summary.loc[(m, name), c] for m in _FIRST_HELD for c in ("mean", "min")]
        if np.isfinite(values[0]):
            tiles.append((title, *map(_r, values)))
    return tiles


def _of_scene(record: dict[str, Any], found: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    """Of each measurement: its name, r of SAH, r with EPO (α fitted), and how well it is known."""
    r = found.set_index(["measurement", "predictor"])["pearson"]
    known = {
        f"{lanes}_ns": f"times ±{worst_time_error([record], lanes):.1%}"
        for lanes in record["timing"]
    }
    return [
        (title, _r(r[m, "SAH"]), _r(r[m, "fitted"]), known.get(m, "no noise"))
        for m, title in MEASUREMENTS.items()
    ]


def _r(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def _thumbnail(png: str) -> str:
    """A picture, base64-encoded, as a small JPEG."""
    from PIL import Image

    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    picture.thumbnail((_THUMBNAIL, _THUMBNAIL))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=82)
    return base64.b64encode(buffer.getvalue()).decode()
