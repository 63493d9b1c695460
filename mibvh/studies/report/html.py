"""The report: one HTML file that works offline, and its figures as files."""

from __future__ import annotations

import base64
import functools
import io
import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mibvh.files import atomic_path, file_name, make_folder, write_text
from mibvh.metrics.predictors import predictors
from mibvh.studies.analyse.correlations import overview, worst_error
from mibvh.studies.analyse.rotation import rotation_factors
from mibvh.studies.analyse.sweep import sweeps
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.record.experiment import experiments
from mibvh.studies.record.quantities import quantities, targets
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.studies.record.serialise import to_json
from mibvh.studies.record.sheet import Sheet
from mibvh.studies.report import plots
from mibvh.studies.report.tables.prediction import SECTION as PREDICTION
from mibvh.studies.report.tables.prediction import times_known
from mibvh.studies.report.tables.rotation import SECTION as ROTATION

#: What is said below the figures of a scene that are of its trees.
_CAPTIONS = {
    "depth": "Where in the trees the expected cost and the overlap sit.",
    "remaining": "What would remain to be tested if the tree ended there: what a sweep minimises.",
}
#: What the predictors that a reader asks for first are held against.
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
    records: Records,
    found: pd.DataFrame,
    sheets: list[Sheet],
    of_scenes: list[list[Sheet]],
    left_out: Mapping[str, str],
) -> list[str]:
    """Write ``report.html``, and each figure as SVG, PDF and PNG under ``figures/``.

    Parameters
    ----------
    folder : Path
    records : sequence of SceneRecord
    found : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    sheets : list of Sheet
        Over the scenes; see :func:`mibvh.studies.report.tables.answers`.
    of_scenes : list of list of Sheet
        Of each scene; see :func:`mibvh.studies.report.tables.scene_answers`.
    left_out : mapping of str to str
        Scenes that could not be studied, and why.

    Returns
    -------
    list of str
        The figures' files, relative to the folder.
    """
    make_folder(folder / "figures")
    draw = _Draw(folder)
    factors = rotation_factors(records)
    page = _template().render(
        builders=_builders(records),
        left_out=left_out,
        sections=[
            (title, list(group)) for title, group in itertools.groupby(sheets, lambda s: s.section)
        ],
        scenes=[
            _scene(draw, record, found, of_scene)
            for record, of_scene in zip(records, of_scenes, strict=True)
        ],
        headline=_overall(found),
        times_known=times_known(records, quantities()["scalar_ns"]),
        prediction=PREDICTION,
        summary=draw("summary", plots.summary(found)),
        rotating=ROTATION if len(factors) else None,
        rotation=draw("rotation", plots.rotation(factors)) if len(factors) else [],
        environment=records[-1].environment,
        options=to_json(records[-1].options),
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
        drawn = plots.svg(figure)
        files = [f"figures/{file_name(name)}.{kind}" for kind in ("svg", "pdf", "png")]
        write_text(self._folder / files[0], drawn.replace("currentColor", "#222"))
        for file, data in ((files[1], plots.pdf(figure)), (files[2], plots.png(figure))):
            with atomic_path(self._folder / file) as path:
                path.write_bytes(data)
        self.written += files
        return plots.panels(drawn)


def _builders(records: Records) -> list[dict[str, str]]:
    """Name and colour of each builder; those of the scene that has most come first."""
    by_size = sorted(records, key=lambda record: -len(record.trees))
    names = dict.fromkeys(tree.builder for record in by_size for tree in record.trees)
    return [{"name": name, "colour": plots.builder_colour(i)} for i, name in enumerate(names)]


def _scene(
    draw: _Draw, record: SceneRecord, found: pd.DataFrame, sheets: list[Sheet]
) -> dict[str, Any]:
    name = record.scene
    return {
        "name": name,
        "triangles": f"{record.triangles:,}",
        "rays": f"{record.rays.count:,}",
        "viewpoints": record.rays.viewpoints,
        "notes": record.notes,
        "picture": record.picture,
        "thumbnail": _thumbnail(record.picture),
        "timing": record.timing,
        "sheets": sheets,
        "r": _of_scene(record, found[found["scene"] == name]),
        "figures": [
            (caption, draw(f"{name}-{key}", figure)) for key, caption, figure in _figures(record)
        ],
    }


def _figures(record: SceneRecord) -> Iterator[tuple[str, str, Any]]:
    """Yield the name of a figure's file, what is said below it, and the figure."""
    for target in targets():
        yield target.figure, target.caption, plots.predicted_measured(record, target)
    yield "depth", _CAPTIONS["depth"], plots.by_depth(record)
    if depth := record.result(DepthResult):
        yield "remaining", _CAPTIONS["remaining"], plots.remaining(record, depth)
    for experiment in experiments():
        yield from experiment.figures(record)
    for sweep in sweeps(record):
        name = f"sweep-{sweep.builder}-{sweep.option}"
        yield name, f"{sweep.name}: cost against {sweep.option}.", plots.swept(sweep)


def _overall(found: pd.DataFrame) -> list[tuple[str, ...]]:
    """Of each headline predictor: title, mean and least r with counted cost, the same with time.

    Empty where no r is known.
    """
    summary = overview(found)
    tiles = []
    for one in predictors():
        if one.headline:
            values = [summary.loc[(m, one.name), c] for m in _FIRST_HELD for c in ("mean", "min")]
            if np.isfinite(values[0]):
                tiles.append((one.headline, *map(_r, values)))
    return tiles


def _of_scene(record: SceneRecord, found: pd.DataFrame) -> list[tuple[str, str, str, str]]:
    """Of each measurement: its name, r of SAH, r with EPO (α fitted), and how well it is known."""
    r = found.set_index(["measurement", "predictor"])["pearson"]
    return [
        (
            target.heading,
            _r(r[target.name, "SAH"]),
            _r(r[target.name, "fitted"]),
            f"times ±{worst_error([record], target.error):.1%}" if target.error else "no noise",
        )
        for target in targets()
    ]


def _r(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def _thumbnail(png: str) -> str:
    """A picture, base64-encoded, as a small JPEG; empty if there is none."""
    if not png:
        return ""
    from PIL import Image

    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    picture.thumbnail((_THUMBNAIL, _THUMBNAIL))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=82)
    return base64.b64encode(buffer.getvalue()).decode()
