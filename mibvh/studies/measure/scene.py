"""A study of one scene: rays, trees, times, then the requested experiments."""

from __future__ import annotations

import base64
import dataclasses
import functools
from collections.abc import Sequence

from mibvh.builders.sharing import shared_drafts
from mibvh.code import code_digest
from mibvh.environment import environment
from mibvh.errors import MibvhError, TreeFailed
from mibvh.memory import COMPILED, used_memory
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import Scene
from mibvh.studies.measure.cameras import cameras
from mibvh.studies.measure.counts import RayCounter
from mibvh.studies.measure.given import Given
from mibvh.studies.measure.memory import Peaks, check_memory, make_room, predicted_memory
from mibvh.studies.measure.scene_digest import scene_digest
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.store import Store, key_of
from mibvh.studies.measure.times import LANES, kept_times
from mibvh.studies.measure.trees import bundled_drafts, sources_of, study_trees
from mibvh.studies.measure.warps import WarpRules
from mibvh.studies.record.experiment import Experiment, chosen
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import Listener, Progress, Reporter
from mibvh.studies.record.scene import RayFacts, SceneRecord, Timing, TreeRow

#: Stage of the report's table of seconds, by the first word of the pieces' names.
_STAGES = {
    "rayset": "rays",
    "tree": "trees",
    "metrics": "metrics",
    "counts": "counts",
    "warps": "warps",
    "timing": "stopwatch",
    "picture": "picture",
    "audit": "audit",
}
#: Name of the base experiment, which every study runs.
BASE = "prediction"


@dataclasses.dataclass(frozen=True)
class _Picture:
    """A PNG, base64-encoded (empty if there is none), and a note for the reader."""

    png: str
    note: str


def study_scene(
    scene: Scene,
    options: StudyOptions,
    store: Store,
    listener: Listener,
    given: Given = Given(),  # noqa: B008 - is never changed
) -> SceneRecord:
    """Study one scene.

    Parameters
    ----------
    scene : Scene
    options : StudyOptions
        ``builders`` must not be None.
    store : Store
    listener : callable
        Called with a :class:`Progress` at every step.
    given : Given
        Finished trees and rays that the user brings.

    Returns
    -------
    SceneRecord
        Trees that failed are listed in ``missing``.

    Raises
    ------
    MibvhError
        If the scene cannot be studied, or all of its trees fail.
    """
    asked = chosen(options.experiments)
    with shared_drafts(scene.triangles.digest, store.folder) as drafts:
        if any(experiment.drafts for experiment in asked):
            drafts.later = bundled_drafts(options.builders or ())
        return _study_scene(scene, asked, options, store, listener, given)


def _study_scene(
    scene: Scene,
    asked: Sequence[Experiment],
    options: StudyOptions,
    store: Store,
    listener: Listener,
    given: Given,
) -> SceneRecord:
    """Run the base experiment, then those that are asked for."""
    shares = _shares(asked)
    reporter = Reporter(listener, scene.name)
    peaks = Peaks()
    store.begin()
    part = reporter.of("", *shares[BASE])
    setting, record = _predict(scene, options, store, given, part, peaks)
    seconds = {_STAGES[kind]: spent for kind, spent in store.spent.items()}
    reused = {_STAGES[kind]: count for kind, count in store.reused.items()}
    results = {}
    for experiment in asked:
        # The last step held the records of all trees in memory; the next needs one at a time.
        make_room(scene)
        store.begin()
        part = reporter.of(experiment.name, *shares[experiment.name])
        if experiment.measure is not None:
            with peaks.of(experiment.name):
                try:
                    results[experiment.name] = experiment.found(setting, part)
                except TreeFailed as error:
                    reporter.missing(f"experiment {experiment.name}", error)
        seconds[experiment.name] = sum(store.spent.values())
        reused[experiment.name] = store.reused.total()
    listener(Progress(scene.name, "", "done", None, 1.0))
    return dataclasses.replace(
        record,
        results=results,
        seconds=seconds,
        reused=reused,
        memory={**record.memory, **peaks.found},
        missing=reporter.found_missing,
    )


def _predict(
    scene: Scene,
    options: StudyOptions,
    store: Store,
    given: Given,
    report: Reporter,
    peaks: Peaks,
) -> tuple[Setting, SceneRecord]:
    """Run the base experiment: make rays and trees, count the rays, time them, render a picture."""
    machine = environment()
    sources = sources_of(options.builders or (), given.trees)
    needed = check_memory(scene, predicted_memory(scene, options, sources, given))
    expected = used_memory() + COMPILED + needed
    report.expect(expected)
    with peaks.of("rays"):
        rays = _rays(scene, options, store) if given.rays is None else given.rays
    counter = RayCounter(scene, rays, options.cull, WarpRules(**options.warps()))
    with peaks.of("trees"):
        trees, rows = study_trees(sources, counter, store, report)
    if not rows:
        reasons = "; ".join(dict.fromkeys(one.why for one in report.found_missing))
        raise MibvhError(f"{scene.name}: there is no tree ({reasons})")
    make_room(scene)
    sources = {name: sources[name] for name in trees}
    setting = Setting(scene, rays, trees, options, machine, store, sources, given.rays is not None)
    with peaks.of("stopwatch"):
        rows, timing = _time(setting, rows, report)
    picture_key = key_of("mibvh.picture", scene=scene_digest(scene), cameras=cameras(scene))
    with peaks.of("picture"):
        picture = store.record(
            f"picture-{picture_key}", _Picture, functools.partial(_picture, scene)
        )
    return setting, SceneRecord(
        scene=scene.name,
        triangles=len(scene.triangles),
        digest=scene.triangles.digest,
        notes=[*scene.notes, *given.notes(trees), *([picture.note] if picture.note else [])],
        rays=RayFacts(
            count=len(rays),
            digest=rays.digest,
            viewpoints=rays.meta.get("viewpoints", len(set(rays.viewpoint.tolist()))),
            seed=rays.meta.get("seed", -1),
            meta=rays.meta,
        ),
        timing=timing,
        trees=rows,
        options=options,
        environment=machine,
        picture=picture.png,
        seconds={},
        reused={},
        memory={"predicted": expected},
        code=code_digest(__name__),
    )


def _rays(scene: Scene, options: StudyOptions, store: Store) -> RaySet:
    """Make the diffuse rays of a scene."""
    key = key_of(
        "mibvh.rays.diffuse",
        digest=scene.triangles.digest,
        cameras=cameras(scene),
        **options.rays(),
    )
    return store.array(RaySet, key, functools.partial(diffuse_rays, scene, **options.rays()))


def _time(
    setting: Setting, rows: list[TreeRow], report: Reporter
) -> tuple[list[TreeRow], dict[str, Timing]]:
    """Time the trees in each lane mode; return the rows with times, and how they were timed."""
    timing: dict[str, Timing] = {}
    for i, lanes in enumerate(LANES):
        found = kept_times(setting, lanes, "single", report.part(0.55 + 0.2 * i, 0.2))
        columns = {f"{lanes}_ns": found.ns, f"{lanes}_error": found.error} | {
            f"{lanes}_ns_{clock}": ns for clock, ns in found.ns_by_clock.items()
        }
        rows = [
            row.with_values(**{name: column[place] for name, column in columns.items()})
            for place, row in enumerate(rows)
        ]
        timing[lanes] = found.timing
    return rows, timing


def _shares(asked: Sequence[Experiment]) -> dict[str, tuple[float, float]]:
    """Return, for each experiment, where its progress begins and its share, within 0 to 1.

    The last one ends below 1, because 1 means that the scene is done.
    """
    weights = {BASE: 1.0} | {experiment.name: experiment.weight for experiment in asked}
    total, begin, shares = 1.01 * sum(weights.values()), 0.0, {}
    for name, weight in weights.items():
        shares[name] = (begin / total, weight / total)
        begin += weight
    return shares


def _picture(scene: Scene) -> _Picture:
    """Render a scene; if that fails light it from the camera, or do without a picture."""
    from mibvh.picture import picture, png

    said = ""
    for samples, instead in ((32, "is lit from the camera"), (0, "is missing")):
        try:
            pixels = picture(scene, samples=samples)
        except Exception as error:  # Mitsuba's plugins raise nearly anything
            reason = " ".join((str(error) or type(error).__name__).split())[:200]
            said = f"the picture {instead}: Mitsuba cannot render this scene ({reason})"
        else:
            return _Picture(base64.b64encode(png(pixels)).decode(), said)
    return _Picture("", said)
