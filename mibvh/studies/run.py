"""Run a study: scene by scene, tree by tree, everything kept as it is finished."""

from __future__ import annotations

import base64
import dataclasses
import functools
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mibvh.builders import get, names
from mibvh.environment import environment
from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import Scene, load
from mibvh.studies.paper.catalogue import scenes_in, triangle_count_notes
from mibvh.studies.measure.depth import depth_experiment, depth_table
from mibvh.studies.options import StudyOptions
from mibvh.studies.measure.trees import RayCounter, cameras, report_part, study_tree, times
from mibvh.studies.measure.rotation import rotation_experiment, rotation_factors
from mibvh.studies.measure.sensitivity import sensitivity_experiment, sensitivity_table
from mibvh.studies.measure.store import Store, key_of
from mibvh.tree import Tree
from mibvh.variant import give_back_memory

if TYPE_CHECKING:
    import pandas as pd

#: Called as ``progress(scene, stage, done)`` with ``done`` from 0 to 1 within the scene.
Progress = Callable[[str, str, float], None]

_KEPT = "scene-"
#: Names of the scenes that the study has finished, in order.
_FINISHED = "study"
#: The tables and figures that the last run wrote.
_WRITTEN = "study-files"
#: What a scene's record holds; to be raised with every change of its fields.
_FORMAT = 6
#: What the seconds are spent on, by the first word of the pieces' names.
_STAGES = {
    "rayset": "rays",
    "tree": "trees",
    "metrics": "metrics",
    "counts": "counts",
    "depth": "depth",
    "timing": "stopwatch",
    "picture": "picture",
}


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes
    ----------
    folder : Path
        Where its files are.
    scenes : list of dict
        One record per scene; see :func:`study_scene`.
    environment : dict
        What it was measured on.
    """

    folder: Path
    scenes: list[dict[str, Any]]
    environment: dict[str, Any]

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
        """By what turning raises costs; see :func:`mibvh.studies.measure.rotation.rotation_factors`."""
        return rotation_factors(self.scenes)

    @functools.cached_property
    def sensitivity(self) -> pd.DataFrame:
        """Other choices; see :func:`mibvh.studies.measure.sensitivity.sensitivity_table`."""
        return sensitivity_table(self.scenes)

    @functools.cached_property
    def depth(self) -> pd.DataFrame:
        """Where in the trees cost and overlap sit; see :func:`mibvh.studies.measure.depth.depth_table`."""
        return depth_table(self.scenes)

    @property
    def report(self) -> Path:
        """The HTML report."""
        return self.folder / "report.html"


def study(
    scenes: Sequence[Any],
    folder: str | os.PathLike[str] = "out",
    *,
    options: StudyOptions | None = None,
    progress: Progress | None = None,
    scheduler: str | None = None,
    **choices: Any,
) -> Study:
    """Build trees for scenes, measure and predict their cost, and write a report.

    Parameters
    ----------
    scenes : sequence
        Each a Scene, what :func:`mibvh.load` takes, or a folder of such files.
    folder : path
        Results go here; run again with the same folder to go on after an interruption.
    options : StudyOptions, optional
    progress : callable, optional
        Called as ``progress(scene, stage, done)``.
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
        If a scene cannot be loaded, a builder is unknown, an option is out of range, or the
        scheduler cannot be used.
    """
    options = options or StudyOptions(**choices)
    if not scenes:
        raise MibvhError("a study needs at least one scene")
    chosen = options.builders or tuple(names())
    for name in chosen:
        get(name)
    if len(set(chosen)) < len(chosen):
        raise MibvhError(f"a builder is named twice: {', '.join(chosen)}")
    options = dataclasses.replace(options, builders=chosen)
    store = Store(Path(folder) / "cache")
    sources = [part for given in scenes for part in scenes_in(given)]
    progress = progress or (lambda *_: None)
    records: list[dict[str, Any]] = []
    taken: set[str] = set()
    if scheduler is None:
        for source in sources:
            scene = load(source)
            _check_new(scene.name, taken)
            records.append(study_scene(scene, options, store, progress))
            _note_finished(store, records)
    else:
        from mibvh.studies.cluster import study_on_cluster

        for record in study_on_cluster(sources, options, scheduler, progress):
            _check_new(record["scene"], taken)
            store.write(_KEPT + record["scene"], record)
            records.append(record)
            _note_finished(store, records)
    write_outputs(Path(folder), records)
    return Study(Path(folder), records, records[-1]["environment"])


def _note_finished(store: Store, records: list[dict[str, Any]]) -> None:
    """Note which scenes are this study's: the folder may hold those of others before it."""
    store.write(_FINISHED, {"scenes": [record["scene"] for record in records], "format": _FORMAT})


def _check_new(name: str, taken: set[str]) -> None:
    """See that no other scene of the study has this name."""
    if name in taken:
        raise MibvhError(f"two scenes are called {name}; rename a file or folder")
    taken.add(name)


def study_scene(
    scene: Scene, options: StudyOptions, store: Store, progress: Progress
) -> dict[str, Any]:
    """Study one scene.

    Returns
    -------
    dict
        JSON-able: ``scene``, ``triangles``, ``rays`` (facts of the ray set), ``timing`` (per
        lane mode: rounds, whether the error asked for was reached, and how far the same tree,
        timed twice under two names, differed), ``trees`` (one dict per builder: metrics,
        counters, times and their relative errors), ``options``, ``seconds`` (what each stage
        took, in the runs that its pieces were made in), and, where those experiments were asked
        for, ``rotation`` (see :func:`~mibvh.studies.measure.rotation.rotation_experiment`) and
        ``sensitivity`` (see :func:`~mibvh.studies.measure.sensitivity.sensitivity_experiment`).
    """
    triangles = scene.triangles
    report = functools.partial(progress, scene.name)
    store.begin()
    shares = _shares(options.experiments)
    part = functools.partial(_part, report, *shares["prediction"])
    rays_key = key_of(digest=triangles.digest, cameras=cameras(scene), **options.rays())
    part("rays", 0.0)
    rays = store.array(RaySet, rays_key, functools.partial(diffuse_rays, scene, **options.rays()))
    counter = RayCounter(scene, rays, options.cull)
    trees: dict[str, Tree] = {}
    rows: list[dict[str, Any]] = []
    share = 0.5 / len(options.builders)
    for i, name in enumerate(options.builders):
        stage = functools.partial(report_part, part, name, 0.02 + share * i, share)
        key, tree, row = study_tree(name, scene, counter, rays_key, store, stage)
        if "depth" in options.experiments:
            piece = key_of(tree=key, format=2)
            row.update(store.kept(f"depth-{piece}", functools.partial(depth_experiment, tree)))
        trees[key] = tree
        rows.append(row)
    timing = {}
    for i, lanes in enumerate(("scalar", "simd")):
        stage = functools.partial(report_part, part, lanes, 0.55 + 0.2 * i, 0.2)
        key = key_of(trees=list(trees), rays=rays_key, lanes=lanes, machine=environment(),
                     options=options.stopwatch(lanes))  # fmt: skip
        make = functools.partial(times, list(trees.values()), scene, rays, lanes, options, stage)
        found = store.kept(f"timing-{key}", make)
        for row, ns, error in zip(rows, found.pop("ns"), found.pop("error"), strict=True):
            row[f"{lanes}_ns"], row[f"{lanes}_error"] = ns, error
        timing[lanes] = found
    give_back_memory()  # the records of all trees at once, of which the rest needs one at a time
    record = {
        "scene": scene.name,
        "triangles": len(triangles),
        "digest": triangles.digest,
        "notes": [*scene.notes, *triangle_count_notes(scene.name, len(triangles))],
        "rays": {**rays.meta, "count": len(rays), "digest": rays.digest},
        "timing": timing,
        "trees": rows,
        "options": dataclasses.asdict(options),
        "environment": environment(),
        "picture": store.kept(f"picture-{rays_key}", functools.partial(_picture, scene)),
    }
    seconds = {_STAGES[kind]: spent for kind, spent in store.spent.items()}
    if "rotation" in options.experiments:
        store.begin()
        part = functools.partial(_part, report, *shares["rotation"])
        record["rotation"] = rotation_experiment(
            scene, rays, rays_key, trees, environment(), options, store, part
        )
        seconds["rotation"] = sum(store.spent.values())
        give_back_memory()
    if "sensitivity" in options.experiments:
        store.begin()
        part = functools.partial(_part, report, *shares["sensitivity"])
        record["sensitivity"] = sensitivity_experiment(
            scene, rays, rays_key, trees, options, store, part
        )
        seconds["sensitivity"] = sum(store.spent.values())
    record["seconds"] = seconds
    store.write(_KEPT + scene.name, record)
    report("done", 1.0)
    return record


def _shares(experiments: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Where in the progress of a scene each experiment begins, and its share.

    They end short of 1, which says that the scene is done.
    """
    weights = {"prediction": 1.0, "rotation": 1.0, "sensitivity": 0.6}
    chosen = {n: w for n, w in weights.items() if n == "prediction" or n in experiments}
    total, begin, shares = 1.01 * sum(chosen.values()), 0.0, {}
    for name, weight in chosen.items():
        shares[name] = (begin / total, weight / total)
        begin += weight
    return shares


def _part(
    report: Callable[[str, float], None], begin: float, share: float, stage: str, done: float
) -> None:
    report(stage, begin + share * done)


def _picture(scene: Scene) -> dict[str, Any]:
    from mibvh.picture import picture, png

    return {"png": base64.b64encode(png(picture(scene))).decode()}


def write_outputs(folder: Path, records: list[dict[str, Any]]) -> None:
    """Write the tables, the environment and the report of the scenes that are finished.

    Tables and figures of an earlier run that are not among those of this one are removed.
    """
    from mibvh.studies.analyse.correlations import correlations
    from mibvh.studies.report.tables import answers, scene_answers
    from mibvh.studies.report.html import write_report
    from mibvh.studies.report.tidy import write_sheets, write_tables

    found = correlations(records)
    sheets = answers(records, found)
    of_scenes = [scene_answers(record, found) for record in records]
    write_tables(folder, records, found)
    written = write_sheets(folder, [*sheets, *(sheet for scene in of_scenes for sheet in scene)])
    write_text(folder / "environment.json", json.dumps(records[-1]["environment"], indent=2))
    write_text(folder / "results.md", "\n".join(sheet.markdown() for sheet in sheets))
    written += write_report(folder, records, found, sheets, of_scenes)
    store = Store(folder / "cache")
    for name in set((store.read(_WRITTEN) or {"files": []})["files"]) - set(written):
        (folder / name).unlink(missing_ok=True)
    store.write(_WRITTEN, {"files": written})


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
    if finished["format"] != _FORMAT:
        raise MibvhError(
            f"{folder}: this study was made by another version of mibvh; run it again with this one"
        )
    records = [record for name in finished["scenes"] if (record := store.read(_KEPT + name))]
    if len(records) < len(finished["scenes"]):
        raise MibvhError(f"{folder}: a scene of this study is damaged; run it again to mend it")
    return Study(Path(folder), records, records[-1]["environment"])
