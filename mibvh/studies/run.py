"""Run a study: scene by scene, everything kept as it is finished; then tables and a report."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import json
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mibvh.builders import get, names
from mibvh.builders.chosen import parse_all
from mibvh.code import code_digest
from mibvh.errors import MibvhError, did_you_mean
from mibvh.files import file_name, write_text
from mibvh.scene import load
from mibvh.studies.ahead import compiled_ahead
from mibvh.studies.analyse.depth import depth_table
from mibvh.studies.analyse.missing import missing
from mibvh.studies.analyse.rotation import rotation_factors
from mibvh.studies.analyse.sensitivity import sensitivity_table
from mibvh.studies.lock import alone_in
from mibvh.studies.measure.scene import study_scene
from mibvh.studies.measure.store import Store
from mibvh.studies.paper.catalogue import triangle_count_notes
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import LEFT_OUT, MISSING, Listener, Progress
from mibvh.studies.record.scene import FORMAT, Missing, SceneRecord
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.studies.sources import Source, checked, study_sources

if TYPE_CHECKING:
    import pandas as pd

    from mibvh.audit.record import Check

_KEPT = "scene-"
#: Names of the scenes that the study has finished, in order.
_FINISHED = "study"
#: The tables and figures that the last run wrote.
_WRITTEN = "study-files"
#: What the names of these look like, relative to the folder.
_OUTPUT = re.compile(r"(?:tables|figures)/[^/\\]+\.(?:csv|tex|svg|pdf|png)")


@dataclasses.dataclass(frozen=True)
class _Finished:
    scenes: list[str]
    format: int
    left_out: dict[str, str]


@dataclasses.dataclass(frozen=True)
class _Written:
    files: list[str]


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes
    ----------
    folder : Path
        Where its files are.
    scenes : list of SceneRecord
        One per scene.
    environment : dict
        What it was measured on.
    left_out : dict of str to str
        Scenes that could not be studied, and why.
    """

    folder: Path
    scenes: list[SceneRecord]
    environment: dict[str, Any]
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def table(self) -> pd.DataFrame:
        """One row per scene and tree."""
        from mibvh.studies.report.tidy import wide_table

        return wide_table(self.scenes)

    @functools.cached_property
    def correlations(self) -> pd.DataFrame:
        """One row per scene, measurement and predictor."""
        from mibvh.studies.analyse.correlations import correlations

        return correlations(self.scenes)

    @functools.cached_property
    def rotation(self) -> pd.DataFrame:
        """By what rotating raises costs; see :mod:`mibvh.studies.analyse.rotation`."""
        return rotation_factors(self.scenes)

    @functools.cached_property
    def sensitivity(self) -> pd.DataFrame:
        """Other choices; see :mod:`mibvh.studies.analyse.sensitivity`."""
        return sensitivity_table(self.scenes)

    @functools.cached_property
    def depth(self) -> pd.DataFrame:
        """Where in the trees cost and overlap sit; see :mod:`mibvh.studies.analyse.depth`."""
        return depth_table(self.scenes)

    @property
    def failures(self) -> list[tuple[str, str, Check]]:
        """The scene, the tree and the check of every number that failed its audit."""
        from mibvh.studies.report.tables.audit import failures

        return failures(self.scenes)

    @functools.cached_property
    def missing(self) -> list[tuple[str, Missing]]:
        """The scene and what is missing of it: the study goes on where the user's code fails."""
        return missing(self.scenes)

    @property
    def report(self) -> Path:
        """The HTML report."""
        return self.folder / "report.html"


def study(
    scenes: Any = (),
    folder: str | os.PathLike[str] = "out",
    *,
    trees: Mapping[str, Any] | None = None,
    rays: Any = None,
    options: StudyOptions | None = None,
    progress: Listener | None = None,
    scheduler: str | None = None,
    **choices: Any,
) -> Study:
    """Build trees for scenes, measure and predict their cost, and write a report.

    Parameters
    ----------
    scenes : sequence, or one scene
        Each a Scene, what :func:`mibvh.load` takes, or a folder of such files. One that cannot be
        studied is left out, as :attr:`Study.left_out` and the report say.
    folder : path
        Results go here; run again with the same folder to go on after an interruption.
    trees : mapping of str to trees, optional
        Finished trees, which are kept as they are, by the names that they get in tables. Of each,
        a Tree or the file of one for each scene: by the scene's name, ``{"mine": {"cornell":
        tree}}``, as a sequence in the order of the scenes (None where there is none), or alone
        for a single scene. Trees are judged by the paper's cost constants, whatever they were
        built for.
    rays : optional
        A RaySet or file of rays (:func:`mibvh.read_rays`) for each scene, in the same ways; traced
        instead of diffuse rays from the scene's cameras.
    options : StudyOptions, optional
    progress : callable, optional
        Called with a :class:`mibvh.studies.Progress` at every step.
    scheduler : str, optional
        Address of a Dask scheduler whose workers study the scenes, each on one worker (see
        :mod:`mibvh.studies.cluster`); ``scenes`` are then names and files, no Scene objects.
    **choices
        Fields of :class:`StudyOptions`, instead of ``options``.

    Returns
    -------
    Study

    Raises
    ------
    MibvhError
        If a scene cannot be loaded, a builder is unknown, an option is out of range, the
        scheduler cannot be used, another study is at work in the folder, or it cannot be written.
    """
    options = _with_builders(options or _options(choices))
    sources, left_out = study_sources(scenes, trees or {}, rays)
    if scheduler is None or trees or rays is not None:
        sources, unreadable = checked(sources, keep=scheduler is None)
        left_out |= unreadable
    if not options.builders:
        if not trees:
            raise MibvhError(
                "a study needs builders or trees; where builders are not mentioned, it has all of "
                "the paper's"
            )
        bare = {
            one.name: f"{one.name}: there is no builder, and no tree of it is given"
            for one in sources
            if not one.trees
        }
        sources, left_out = [one for one in sources if one.name not in bare], left_out | bare
    if not sources:
        raise MibvhError("; ".join(left_out.values()))
    listener = _listener(progress)
    for name, why in left_out.items():
        listener(_left_out(name, why))
    store = Store(Path(folder) / "cache")
    with alone_in(Path(folder)):
        return _study(sources, left_out, store, options, listener, scheduler)


def _study(
    sources: Sequence[Source],
    left_out: dict[str, str],
    store: Store,
    options: StudyOptions,
    listener: Listener,
    scheduler: str | None,
) -> Study:
    """Study the scenes, keep the records, and write the outputs."""
    folder = store.folder.parent
    if scheduler is None:
        found = _study_here(sources, options, store, listener)
    else:
        from mibvh.studies.cluster import study_on_cluster

        found = study_on_cluster(sources, options, scheduler, listener)
    records: list[SceneRecord] = []
    for source, record in zip(sources, found, strict=True):
        if isinstance(record, MibvhError):
            left_out[source.name] = str(record)
            listener(_left_out(source.name, str(record)))
            continue
        notes = [*record.notes, *triangle_count_notes(record.scene, record.triangles)]
        records.append(dataclasses.replace(record, notes=notes))
        store.write(_KEPT + file_name(record.scene), records[-1].to_json())
        # The folder may hold scenes of other studies before this one.
        store.write(_FINISHED, to_json(_Finished([r.scene for r in records], FORMAT, left_out)))
    if not records:
        raise MibvhError("; ".join(left_out.values()))
    store.write(_FINISHED, to_json(_Finished([r.scene for r in records], FORMAT, left_out)))
    study = Study(folder, records, records[-1].environment, left_out)
    for scene, one in study.missing:
        if one not in next(record.missing for record in records if record.scene == scene):
            listener(Progress(scene, "", MISSING, None, 1.0, missing=str(one)))
    write_outputs(folder, records, left_out)
    return study


def _left_out(name: str, why: str) -> Progress:
    return Progress(name, "", LEFT_OUT, None, 1.0, missing=f"left out: {why}")


def _options(choices: dict[str, Any]) -> StudyOptions:
    """Options of a study by name."""
    known = [field.name for field in dataclasses.fields(StudyOptions)]
    for name in choices:
        if name not in known:
            raise MibvhError(
                f"study has no option {name!r}{did_you_mean(name, known)}; it has: "
                f"{', '.join(known)}"
            )
    return StudyOptions(**choices)


def _with_builders(options: StudyOptions) -> StudyOptions:
    """Fill in the builders, and see that each is known, its options too, and named once."""
    chosen = parse_all(tuple(names()) if options.builders is None else options.builders)
    for one in chosen:
        entry = get(one.builder)
        seed = getattr(entry.options(**dict(one.options)), "seed", None)
        if entry.traces and seed == options.seed:
            raise MibvhError(
                f"{one.name} would be built for the rays that it is measured with: give the study "
                f"another seed than {seed}, or the builder"
            )
    return dataclasses.replace(options, builders=tuple(one.name for one in chosen))


def _study_here(
    sources: Sequence[Source], options: StudyOptions, store: Store, listener: Listener
) -> Iterator[SceneRecord | MibvhError]:
    """Study the scenes one after the other on this machine."""
    chosen = [one.builder for one in parse_all(options.builders or ())]

    def say(part: str) -> None:
        builder = part if part in names() else None
        listener(Progress(sources[0].name, "", "compiling", builder, 0.0))

    with compiled_ahead(chosen, say) as compile_all:
        for source in sources:
            try:
                scene = load(source.scene)
                compile_all()
                yield study_scene(scene, options, store, listener, source.given())
            except MibvhError as error:
                yield error


def _listener(progress: Callable[..., None] | None) -> Listener:
    """Return what is told of the steps; callbacks of three arguments are of older versions."""
    if progress is None:
        return lambda step: None
    try:
        inspect.signature(progress).bind("scene", "stage", 0.0)
    except (TypeError, ValueError):
        return progress
    try:
        inspect.signature(progress).bind("step")
    except TypeError:
        warnings.warn(
            "progress(scene, stage, done) is deprecated: it is called with one Progress",
            DeprecationWarning,
            stacklevel=3,
        )
        return lambda step: progress(step.scene, _words(step), step.done)
    return progress


def _words(step: Progress) -> str:
    return f"{step.stage} {step.builder}" if step.builder else step.stage


def write_outputs(
    folder: Path,
    records: Sequence[SceneRecord],
    left_out: Mapping[str, str] | None = None,
    figures: Sequence[str] = (),
) -> None:
    """Write the tables, the environment and the report of the scenes that are finished.

    Tables and figures of an earlier run that are not among those of this one are removed.
    Whatever the records say, nothing outside the folder is written or removed.
    """
    from mibvh.studies.analyse.correlations import correlations
    from mibvh.studies.record.sheet import literal
    from mibvh.studies.report.answer import answer
    from mibvh.studies.report.html import write_report
    from mibvh.studies.report.tables import answers, scene_answers
    from mibvh.studies.report.tidy import write_sheets, write_tables

    found = correlations(records)
    sheets = answers(records, found)
    of_scenes = [scene_answers(record, found) for record in records]
    write_tables(folder, records, found)
    written = write_sheets(folder, [*sheets, *(sheet for scene in of_scenes for sheet in scene)])
    write_text(folder / "environment.json", json.dumps(records[-1].environment, indent=2))
    without = [f"Left out: {name}: {why}\n" for name, why in (left_out or {}).items()]
    without += [f"Missing of {scene}: {literal(f'{one}')}\n" for scene, one in missing(records)]
    findings = "".join(f"- {literal(line)}\n" for line in answer(records, found))
    parts = [*without, findings, *(sheet.markdown() for sheet in sheets)]
    write_text(folder / "results.md", "\n".join(parts))
    written += write_report(folder, records, found, sheets, of_scenes, left_out or {}, figures)
    store = Store(folder / "cache")
    for name in _written_before(store) - set(written):
        with contextlib.suppress(OSError):
            (folder / name).unlink()
    store.write(_WRITTEN, {"files": written})


def _written_before(store: Store) -> set[str]:
    """The tables and figures of the run before; names of other files are nobody's of ours."""
    try:
        found = from_json(_Written, store.read(_WRITTEN) or {"files": []})
    except MibvhError:
        return set()
    return {name for name in found.files if _OUTPUT.fullmatch(name)}


def remake_report(folder: str | os.PathLike[str], figures: Sequence[str] = ()) -> Study:
    """Write a study's tables and report anew, without measuring again.

    The folder may be somebody else's: what stands in its records is taken for data.

    Parameters
    ----------
    folder : path
    figures : sequence of str
        What figures are drawn as beside SVG: ``pdf``, ``png``.

    Raises
    ------
    MibvhError
        As of :func:`read_study`, or if the records make no sense, a study is at work in the
        folder, it cannot be written, or there is no such form of figures.
    """
    from mibvh.studies.report.drawing import KINDS

    for kind in figures:
        if kind not in KINDS:
            raise MibvhError(f"figures are drawn as {' or '.join(KINDS)} beside SVG, not {kind!r}")
    found = read_study(folder)
    with alone_in(found.folder):
        try:
            write_outputs(found.folder, found.scenes, found.left_out, figures)
        except MibvhError:
            raise
        # The types are right, but not what they tell together: lists of other lengths, a picture
        # that is none, quantities that are missing. Nearly anything can come of it.
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            raise MibvhError(
                f"{folder}: no report can be made of this study's records ({reason})"
            ) from error
    return found


def read_study(folder: str | os.PathLike[str]) -> Study:
    """Read a study back from its folder.

    Raises
    ------
    MibvhError
        If there is no finished scene in it, or another version of mibvh or damage left it
        unreadable.
    """
    cache = Path(folder) / "cache"
    store = Store(cache) if cache.is_dir() else None
    finished = store.read(_FINISHED) if store else None
    if store is None or finished is None:
        raise MibvhError(f"{folder}: there is no finished scene of a study in this folder")
    if isinstance(finished, dict) and finished.get("format", FORMAT) != FORMAT:
        raise MibvhError(
            f"{folder}: this study was made by another version of mibvh; run it again with this one"
        )
    try:
        listed = from_json(_Finished, finished)
        records = [_read_record(store, name) for name in listed.scenes]
    except MibvhError:
        raise MibvhError(
            f"{folder}: a scene of this study is damaged; run it again to mend it"
        ) from None
    if not records:
        raise MibvhError(f"{folder}: there is no finished scene of a study in this folder")
    return Study(Path(folder), records, records[-1].environment, listed.left_out)


def _read_record(store: Store, name: str) -> SceneRecord:
    found = store.read(_KEPT + file_name(name))
    if found is None:
        raise MibvhError(f"{name}: damaged")
    return _with_code_note(SceneRecord.from_json(found))


def _with_code_note(record: SceneRecord) -> SceneRecord:
    """Say of a scene if other code than this one measured it."""
    if record.code == code_digest("mibvh.studies.measure.scene"):
        return record
    note = "Measured by other code than that of this mibvh: run the study again to bring it up."
    return dataclasses.replace(record, notes=[*record.notes, note])
