"""Run a study: scene by scene, then tables and a report. Each scene is kept once it is done."""

from __future__ import annotations

import dataclasses
import inspect
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mibvh.builders import get, names
from mibvh.builders.chosen import parse_all
from mibvh.errors import MibvhError, did_you_mean
from mibvh.scene import load
from mibvh.studies.ahead import compiled_ahead
from mibvh.studies.finished import Study, keep_list, keep_record, read_study
from mibvh.studies.lock import alone_in
from mibvh.studies.measure.scene import study_scene
from mibvh.studies.measure.store import Store
from mibvh.studies.outputs import remake_report, write_outputs
from mibvh.studies.paper.catalogue import triangle_count_notes
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import LEFT_OUT, MISSING, Listener, Progress
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.sources import Source, checked, study_sources

__all__ = ["Study", "read_study", "remake_report", "study", "write_outputs"]


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
        sources, without = _with_given_trees(sources)
        left_out |= without
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
        keep_record(store, records[-1])
        keep_list(store, records, left_out)
    if not records:
        raise MibvhError("; ".join(left_out.values()))
    keep_list(store, records, left_out)
    study = Study(folder, records, records[-1].environment, left_out)
    for scene, one in study.missing:
        if one not in next(record.missing for record in records if record.scene == scene):
            listener(Progress(scene, "", MISSING, None, 1.0, missing=str(one)))
    write_outputs(folder, records, left_out)
    return study


def _with_given_trees(sources: Sequence[Source]) -> tuple[list[Source], dict[str, str]]:
    """Separate the scenes that a tree is given for from the others, and say why those are out."""
    without = {
        source.name: f"{source.name}: there is no builder, and no tree of it is given"
        for source in sources
        if not source.trees
    }
    return [source for source in sources if source.name not in without], without


def _left_out(name: str, why: str) -> Progress:
    return Progress(name, "", LEFT_OUT, None, 1.0, missing=f"left out: {why}")


def _options(choices: dict[str, Any]) -> StudyOptions:
    """Options of a study from keyword arguments, whose names are checked."""
    known = [field.name for field in dataclasses.fields(StudyOptions)]
    for name in choices:
        if name not in known:
            raise MibvhError(
                f"study has no option {name!r}{did_you_mean(name, known)}; it has: "
                f"{', '.join(known)}"
            )
    return StudyOptions(**choices)


def _with_builders(options: StudyOptions) -> StudyOptions:
    """Fill in the default builders, check them all, and refuse to train on the rays of the test."""
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
    """Return the callback in its present form; older callbacks take three arguments."""
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
