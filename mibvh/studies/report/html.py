"""The report: one HTML file that works offline, and its figures as files.

It answers in the order in which a reader asks: which tree is best and by how much, how well that
was predicted, by what, where the cost sits; then the paper's claims, the scenes, and all tables.
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mibvh.builders import all_names, get
from mibvh.builders.chosen import builder_of
from mibvh.files import file_name, make_folder, write_text
from mibvh.metrics.predictors import predictors
from mibvh.plot.marks import builder_colour, builder_shape
from mibvh.studies.analyse.advice import advice
from mibvh.studies.analyse.correlations import LANES, overview, worst_error
from mibvh.studies.analyse.missing import missing
from mibvh.studies.analyse.rotation import rotation_factors
from mibvh.studies.analyse.sweep import sweeps
from mibvh.studies.measure.depth import DepthResult
from mibvh.studies.record.claim import FEWEST_SCENES
from mibvh.studies.record.experiment import experiments
from mibvh.studies.record.quantities import targets
from mibvh.studies.record.scene import Records, SceneRecord, Timing
from mibvh.studies.record.serialise import to_json
from mibvh.studies.record.sheet import Sheet, within
from mibvh.studies.report import plots
from mibvh.studies.report.agreement import multiples, predicted_measured
from mibvh.studies.report.answer import answer
from mibvh.studies.report.drawing import Drawing, icon
from mibvh.studies.report.layout import places_of
from mibvh.studies.report.overall import overall
from mibvh.studies.report.summary import summary
from mibvh.studies.report.tables.audit import failures
from mibvh.studies.report.tables.builders import SECTION as DEPTH
from mibvh.studies.report.tables.claims import SECTION as CLAIMS
from mibvh.studies.report.tables.prediction import NAMED, by_traversal
from mibvh.studies.report.tables.rotation import SECTION as ROTATION
from mibvh.studies.report.winners import winners

#: What is said below the figures of a scene that are of its trees.
_CAPTIONS = {
    "depth": "Where in the trees the expected cost and the overlap sit.",
    "remaining": "What would remain to be tested if the tree ended there: what a sweep minimises.",
}
#: What the predictors that a reader asks for first are held against.
_FIRST_HELD = ("counted_cost", "scalar_ns")
#: What words mean that the page begins with.
_WORDS = {
    "tree": "a bounding volume hierarchy (BVH) of a scene, called by the builder that made it",
    "counted cost": "mean over the rays: 1.2 for each inner node visited, 1.0 for each triangle "
    "tested. The rays are traced and all visits counted, so that it is exact for its rays",
    "scalar and SIMD time": "nanoseconds per ray, with one lane of the processor's vectors in use, "
    "or with all of them",
    "warp cost": "counted cost of simulated warps, which wait for their slowest ray",
    "SAH": "surface area heuristic: what endless random lines through the scene cost",
    "EPO": "end-point overlap: mean cost of the nodes that a point of the surfaces lies in, though "
    "its triangle is not in them",
    "point query": "mean cost of all nodes that a ray's start lies in",
    "LCV": "leaf count variability: standard deviation over the rays of how many leaves one visits",
    "r": "Pearson's correlation of predicted and measured cost over the trees of a scene: 1 is "
    "perfect",
    "α": "share of EPO in (1 − α) SAH + α EPO",
    "s": "mean length of the rays over the mean chord of the scene's box",
}
#: Width of the small pictures, in pixels: twice what is shown, for fine screens.
_THUMBNAIL = 320


@functools.cache
def template() -> Any:
    """Return the template of the page."""
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
    correlations: pd.DataFrame,
    sheets: list[Sheet],
    of_scenes: list[list[Sheet]],
    left_out: Mapping[str, str],
    kinds: Sequence[str] = (),
) -> list[str]:
    """Write ``report.html``, and each figure as SVG under ``figures/``.

    Parameters
    ----------
    folder : Path
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.
    sheets : list of Sheet
        Over the scenes; see :func:`mibvh.studies.report.tables.answers`.
    of_scenes : list of list of Sheet
        Of each scene; see :func:`mibvh.studies.report.tables.scene_answers`.
    left_out : mapping of str to str
        Scenes that could not be studied, and why.
    kinds : sequence of str
        Other forms to draw the figures in, from :data:`~mibvh.studies.report.drawing.KINDS`; a
        form takes some 50 ms per figure.

    Returns
    -------
    list of str
        The figures' files, relative to the folder.
    """
    make_folder(folder / "figures")
    draw = _Draw(folder, kinds)
    factors = rotation_factors(records)
    first = {CLAIMS, DEPTH}
    titles = dict.fromkeys(sheet.section for sheet in sheets)
    groups = {title: [s for s in sheets if s.section == title] for title in titles}
    main, ranked = _main_predictor(correlations), overall(records)
    claims = groups.get(CLAIMS, [])
    page = template().render(
        builders=_builders(records),
        left_out=left_out,
        missing=missing(records),
        trees=_trees_each(records),
        doubted=len(failures(records)),
        answer=answer(records, correlations),
        overall=draw("overall", ranked) if ranked is not None else [],
        winners=draw("winners", winners(records)),
        multiples=draw("multiples", multiples(records, main)),
        main=main,
        named=_predictors(correlations, named=True),
        others=_predictors(correlations, named=False),
        by_traversal=[name for name in by_traversal() if name in _known(correlations)],
        summary=draw(
            "summary", summary(correlations, [n for n in NAMED if n in _known(correlations)])
        ),
        other_summary=draw("summary-others", summary(correlations, _other_names(correlations))),
        where=groups.get(DEPTH, []),
        claims=claims,
        unjudged=_unjudged(claims),
        fewest=FEWEST_SCENES,
        sections=[(title, group) for title, group in groups.items() if title not in first],
        scenes=[
            _scene(draw, record, correlations, of_scene, main)
            for record, of_scene in zip(records, of_scenes, strict=True)
        ],
        words=_WORDS,
        out_of_time=_out_of_time(records),
        rotating=ROTATION if len(factors) else None,
        rotation=draw("rotation", plots.rotation(factors)) if len(factors) else [],
        environment=records[-1].environment,
        options=_options(records),
    )
    write_text(folder / "report.html", page)
    return draw.written


@dataclasses.dataclass(frozen=True)
class _BuilderKey:
    """An entry of the builders' legend."""

    name: str
    colour: str
    icon: str
    gloss: str


@dataclasses.dataclass(frozen=True)
class _PredictorCard:
    """A predictor, with its r with counted cost and with scalar time, as text."""

    name: str
    formula: str
    free: str
    counted: str
    timed: str


@dataclasses.dataclass(frozen=True)
class _ScenePart:
    """The section of a scene.

    Attributes
    ----------
    picture, thumbnail : str
        A PNG and a JPEG, base64-encoded; empty if there is none.
    r : list of tuple
        Of each measurement its name, r by predictor, and its error.
    figures : list of tuple
        Of each figure its caption, and the SVG of its panels.
    """

    name: str
    triangles: str
    rays: str
    viewpoints: int
    notes: list[str]
    over: str
    picture: str
    thumbnail: str
    timing: dict[str, Timing]
    sheets: list[Sheet]
    r: list[tuple[str, dict[str, str], str]]
    figures: list[tuple[str, list[str]]]


class _Draw:
    """Writes the files of figures, and records their names."""

    def __init__(self, folder: Path, kinds: Sequence[str]) -> None:
        self._folder, self._kinds = folder, kinds
        self.written: list[str] = []

    def __call__(self, name: str, figure: Drawing) -> list[str]:
        """Write a figure. Returns the SVG of each of its panels, to stand in the page."""
        stem = f"figures/{file_name(name)}"
        write_text(self._folder / f"{stem}.svg", figure.file())
        for kind in self._kinds:
            figure.save(self._folder / f"{stem}.{kind}")
        self.written += [f"{stem}.{kind}" for kind in ("svg", *self._kinds)]
        return [figure.svg(part) for part in figure.parts]


def _trees_each(records: Records) -> str:
    """Format the number of trees per scene."""
    counts = sorted({len(record.trees) for record in records})
    told = " to ".join(map(str, dict.fromkeys((counts[0], counts[-1]))))
    return f"{told} tree{'s' * (counts[-1] != 1)} each"


def _known(correlations: pd.DataFrame) -> list[str]:
    return list(dict.fromkeys(correlations["predictor"]))


def _other_names(correlations: pd.DataFrame) -> list[str]:
    return [name for name in _known(correlations) if name not in NAMED]


def _main_predictor(correlations: pd.DataFrame) -> str:
    """Return the predictor of the small multiples, which is the advised one."""
    advised, known = advice(correlations), _known(correlations)
    if advised is not None:
        return advised.name
    return next((name for name in ("finite rays", "fitted", "SAH") if name in known), known[0])


def _unjudged(claims: Sequence[Sheet]) -> int:
    """Return the number of claims if none was judged, otherwise 0."""
    held = claims[0].frame["held"] if claims else pd.Series(dtype=str)
    return len(held) if held.str.startswith("not judged").all() else 0


def _out_of_time(records: Records) -> str:
    """Say in how many scenes the time ran out before the requested error was reached."""
    told = []
    for lanes in LANES:
        timings = [record.timing[lanes.key] for record in records]
        over = sum(not timing.complete for timing in timings if timing.portions)
        if over:
            told.append(
                f"{lanes.title} in {over} of {len(records)} scene{'s' * (len(records) != 1)}"
            )
    error = records[-1].options.standard_error
    return f"before the error asked for (±{error:.1%}) was reached: {', '.join(told)}" * bool(told)


def _options(records: Records) -> dict[str, Any]:
    """Return the options that the scenes share, without unused ones.

    Of an experiment that other runs added the results count, and of viewpoints those that a scene
    has.
    """
    found: dict[str, Any] = {}
    for record in records:
        for name, value in to_json(record.options).items():
            if value not in found.setdefault(name, []):
                found[name].append(value)
    run = [name for record in records for name in (*record.options.experiments, *record.results)]
    found["experiments"] = [list(dict.fromkeys(run))]
    found["viewpoints"] = sorted({record.rays.viewpoints for record in records})
    found["cull"] = ["yes" if cull else "no" for cull in found["cull"]]
    told = {}
    for name, values in found.items():
        texts = [", ".join(map(str, v)) if isinstance(v, list) else str(v) for v in values]
        told[name.replace("_", " ")] = " or ".join(filter(None, texts))
    return {name: text for name, text in told.items() if text and text != "None"}


def _predictors(correlations: pd.DataFrame, named: bool) -> list[_PredictorCard]:
    """Return the cards of the named predictors, or of the others."""
    table = overview(correlations)
    several = correlations["scene"].nunique() > 1
    rows = []
    for one in sorted(predictors(), key=lambda p: [*NAMED, p.name].index(p.name)):
        if (one.name in NAMED) is not named or one.name not in _known(correlations):
            continue
        r = [[table.loc[(t, one.name), c] for c in ("mean", "min")] for t in _FIRST_HELD]
        rows.append(
            _PredictorCard(
                name=one.name,
                formula=one.formula,
                free="nothing fitted" if one.free == "0" else f"fitted: {one.free}",
                counted=_r(r[0][0]) + (f" ({_r(r[0][1])})" if several else ""),
                timed=_r(r[1][0]) + (f" ({_r(r[1][1])})" if several else ""),
            )
        )
    return rows


def _builders(records: Records) -> list[_BuilderKey]:
    """Return the entries of the builders' legend, in the order of the scene with most trees."""
    return [
        _BuilderKey(
            name=name,
            colour=builder_colour(i),
            icon=icon(builder_shape(i), builder_colour(i)),
            gloss=_gloss(name),
        )
        for name, i in places_of(records).items()
    ]


def _gloss(name: str) -> str:
    """Return what a builder does and its source; empty for a given tree."""
    if builder_of(name) not in all_names():
        return ""
    one = get(builder_of(name))
    summary = one.summary.replace("`", "")
    return f"{summary} ({one.source})" if one.source else summary


def _scene(
    draw: _Draw, record: SceneRecord, correlations: pd.DataFrame, sheets: list[Sheet], main: str
) -> _ScenePart:
    name = record.scene
    over = f" Over {record.over}." if record.over else ""
    return _ScenePart(
        name=name,
        triangles=f"{record.triangles:,}",
        rays=f"{record.rays.count:,}",
        viewpoints=record.rays.viewpoints,
        notes=record.notes,
        over=record.over,
        picture=record.picture,
        thumbnail=_thumbnail(record.picture),
        timing=record.timing,
        sheets=sheets,
        r=_of_scene(record, correlations[correlations["scene"] == name], main),
        figures=[
            (f"{caption}{over}", draw(f"{name}-{key}", figure))
            for key, caption, figure in _figures(record, main)
        ],
    )


def _figures(record: SceneRecord, main: str) -> Iterator[tuple[str, str, Any]]:
    """Yield the file name, caption and drawing of each figure."""
    for target in targets():
        yield target.figure, target.caption, predicted_measured(record, target, main)
    yield "depth", _CAPTIONS["depth"], plots.by_depth(record)
    if depth := record.result(DepthResult):
        yield "remaining", _CAPTIONS["remaining"], plots.remaining(record, depth)
    for experiment in experiments():
        yield from experiment.shown("figures", record)
    for sweep in sweeps(record):
        name = f"sweep-{sweep.builder}-{sweep.option}"
        yield name, f"{sweep.name}: cost against {sweep.option}.", plots.swept(sweep)


def _of_scene(
    record: SceneRecord, correlations: pd.DataFrame, main: str
) -> list[tuple[str, dict[str, str], str]]:
    """Return, for each measurement, its name, r of three predictors, and its error."""
    r = correlations.set_index(["measurement", "predictor"])["pearson"]
    names = dict.fromkeys(("SAH", "fitted", main))
    return [
        (
            target.heading,
            {name: _r(r[target.name, name]) for name in names},
            f"times {within(worst_error([record], target.error))}"
            if target.error
            else "exact for its rays",
        )
        for target in targets()
    ]


def _r(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "–"


def _thumbnail(png: str) -> str:
    """Return a picture as a small base64-encoded JPEG; empty if there is none."""
    if not png:
        return ""
    from PIL import Image

    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    picture.thumbnail((_THUMBNAIL, _THUMBNAIL))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=82)
    return base64.b64encode(buffer.getvalue()).decode()
