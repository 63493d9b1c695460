"""Run a study: scene by scene, tree by tree, everything kept as it is finished."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mibvh.builders import build, get, names
from mibvh.environment import environment
from mibvh.errors import MibvhError
from mibvh.files import write_text
from mibvh.metrics.epo import overlap
from mibvh.metrics.points import point_costs, ray_ends
from mibvh.metrics.predictor import path_length_ratio
from mibvh.metrics.sah import node_costs, sah_per_node
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import Scene, load
from mibvh.studies.options import StudyOptions
from mibvh.studies.stopwatch import measure
from mibvh.studies.store import Store, key_of
from mibvh.traversal.records import Records, make_records, unit_scale
from mibvh.traversal.trace import Tracer, trace
from mibvh.tree import Tree
from mibvh.variant import mitsuba

if TYPE_CHECKING:
    import pandas as pd

#: Called as ``progress(scene, stage, done)`` with ``done`` from 0 to 1 within the scene.
Progress = Callable[[str, str, float], None]

_KEPT = "scene-"
#: Groups of rays over which a tree's mean cost is kept, for the bootstrap.
_RAY_GROUPS = 64


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
        from mibvh.studies.tables import wide_table

        return wide_table(self.scenes)

    @functools.cached_property
    def correlations(self) -> pd.DataFrame:
        """One row per scene, measurement and predictor."""
        from mibvh.studies.analyse import correlations

        return correlations(self.scenes)

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
    **choices: Any,
) -> Study:
    """Build trees for scenes, measure and predict their cost, and write a report.

    Parameters
    ----------
    scenes : sequence
        Each a Scene or what :func:`mibvh.load` takes.
    folder : path
        Results go here; run again with the same folder to go on after an interruption.
    options : StudyOptions, optional
    progress : callable, optional
        Called as ``progress(scene, stage, done)``.
    **choices
        Fields of :class:`StudyOptions`, instead of ``options``.

    Returns
    -------
    Study

    Raises
    ------
    MibvhError
        If a scene cannot be loaded, a builder is unknown, or an option is out of range.
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
    records: list[dict[str, Any]] = []
    taken: set[str] = set()
    for source in scenes:
        scene = load(source)
        if scene.name in taken:
            raise MibvhError(f"two scenes are called {scene.name}; rename a file or folder")
        taken.add(scene.name)
        records.append(study_scene(scene, options, store, progress or (lambda *_: None)))
    write_outputs(Path(folder), records)
    return Study(Path(folder), records, environment())


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
        counters, times and their relative errors), and ``options``.
    """
    triangles = scene.triangles
    report = functools.partial(progress, scene.name)
    rays_key = key_of(digest=triangles.digest, cameras=_cameras(scene), **options.rays())
    report("rays", 0.0)
    rays = store.array(RaySet, rays_key, functools.partial(diffuse_rays, scene, **options.rays()))
    trees: dict[str, Tree] = {}
    rows: list[dict[str, Any]] = []
    share = 0.5 / len(options.builders)
    for i, name in enumerate(options.builders):
        part = functools.partial(_report_part, report, name, 0.02 + share * i, share)
        key, tree, row = _study_tree(name, scene, rays, rays_key, options, store, part)
        trees[key] = tree
        rows.append(row)
    timing = {}
    for i, lanes in enumerate(("scalar", "simd")):
        part = functools.partial(_report_part, report, lanes, 0.55 + 0.2 * i, 0.2)
        key = key_of(trees=list(trees), rays=rays_key, lanes=lanes, machine=environment(),
                     options=dataclasses.asdict(options))  # fmt: skip
        make = functools.partial(_times, list(trees.values()), scene, rays, lanes, options, part)
        found = _kept(store, f"timing-{key}", make)
        for row, ns, error in zip(rows, found.pop("ns"), found.pop("error"), strict=True):
            row[f"{lanes}_ns"], row[f"{lanes}_error"] = ns, error
        timing[lanes] = found
    record = {
        "scene": scene.name,
        "triangles": len(triangles),
        "digest": triangles.digest,
        "notes": scene.notes,
        "rays": {**rays.meta, "count": len(rays), "digest": rays.digest},
        "timing": timing,
        "trees": rows,
        "options": dataclasses.asdict(options),
        "environment": environment(),
        "picture": _kept(store, f"picture-{rays_key}", functools.partial(_picture, scene)),
    }
    store.write(_KEPT + scene.name, record)
    report("done", 1.0)
    return record


def _study_tree(
    name: str,
    scene: Scene,
    rays: RaySet,
    rays_key: str,
    options: StudyOptions,
    store: Store,
    report: Callable[[str, float], None],
) -> tuple[str, Tree, dict[str, Any]]:
    """Build, judge and count one tree. Returns its key, itself, and its row."""
    report("build", 0.0)
    key = key_of(digest=scene.triangles.digest, builder=name, code=get(name).fingerprint())
    tree = store.array(Tree, key, functools.partial(build, scene.triangles, name))
    report("metrics", 0.5)
    row = _kept(store, f"metrics-{key}", functools.partial(tree_metrics, tree, scene))
    report("count", 0.8)
    counts_key = key_of(tree=key, rays=rays_key, cull=options.cull)
    make = functools.partial(_counts, tree, scene, rays, options)
    counts = _kept(store, f"counts-{counts_key}", make)
    return key, tree, {"builder": name, **row, **counts}


def _report_part(
    report: Callable[[str, float], None],
    name: str,
    begin: float,
    share: float,
    stage: Any,
    done: float,
) -> None:
    """Pass the progress of a part on as that of the whole."""
    report(f"{stage} {name}", begin + share * done)


def _kept(store: Store, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """A JSON piece: read if it is here and sound, otherwise made and kept."""
    value = store.read(name)
    if value is None:
        value = make()
        store.write(name, value)
    return value


def _cameras(scene: Scene) -> list[Any]:
    """What the rays depend on besides the triangles: where some camera rays start and go."""
    mi = mitsuba()
    x, y = mi.Float([0.1, 0.9, 0.5, 0.1, 0.9]), mi.Float([0.1, 0.1, 0.5, 0.9, 0.9])
    rays = [s.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(y, x))[0] for s in scene.sensors]
    return [[np.array(ray.o).tolist(), np.array(ray.d).tolist()] for ray in rays]


def tree_metrics(tree: Tree, scene: Scene) -> dict[str, Any]:
    """SAH and EPO of a tree, in total and by depth, and its statistics."""
    found = overlap(tree, scene.triangles)
    sah_share, epo_share = sah_per_node(tree), node_costs(tree) * found.fraction
    depth_count = tree.depth + 1
    inner, sizes = ~tree.is_leaf, tree.count * tree.is_leaf
    ratio = sah_per_node(tree, 1.0, 1.0) / np.where(tree.is_leaf, tree.count, 1)
    fragments = found.fraction
    if tree.splits_triangles:
        fragments = overlap(tree, scene.triangles, fragments=True).fraction
    return {
        **tree.stats(),
        # With the cost constants left out, so that others can be tried: C_inner times the first
        # plus C_tri times the second.
        "sah_parts": [float(ratio[inner].sum()), float((ratio * sizes).sum())],
        "epo_parts": [float(found.fraction[inner].sum()), float((found.fraction * sizes).sum())],
        "epo_fragments": float((node_costs(tree) * fragments).sum()),
        "build_seconds": tree.meta["build_seconds"],
        "sah": float(sah_share.sum()),
        "epo": float(epo_share.sum()),
        "epo_pairs": found.pairs,
        "sah_by_depth": np.bincount(tree.depths, sah_share, depth_count).tolist(),
        "epo_by_depth": np.bincount(tree.depths, epo_share, depth_count).tolist(),
        "c_inner": tree.meta["c_inner"],
        "c_tri": tree.meta["c_tri"],
        "options": tree.meta["options"],
        "build_report": tree.meta["report"],
    }


def _counts(tree: Tree, scene: Scene, rays: RaySet, options: StudyOptions) -> dict[str, Any]:
    """Counters of the rays through a tree, and its point queries where they begin and end."""
    hits = trace(tree, scene.triangles, rays, "simd", cull=options.cull, repeats=1)
    summary = hits.summary()
    kept = ("hits", "inner_per_ray", "leaves_per_ray", "triangles_per_ray", "lcv",
            "inner_deviation", "steps_deviation", "lane_utilisation")  # fmt: skip
    c_inner, c_tri = tree.meta["c_inner"], tree.meta["c_tri"]
    costs = c_inner * hits.inner + c_tri * hits.tests
    group = np.arange(len(rays)) % _RAY_GROUPS
    sums = np.bincount(group, costs, _RAY_GROUPS)
    starts, ends = ray_ends(scene.triangles, rays, hits)
    at_starts = point_costs(tree, scene.triangles, starts.points, starts.triangle)
    at_ends = point_costs(tree, scene.triangles, ends.points, ends.triangle)
    return {
        **{name: summary[name] for name in kept},
        "counted_cost": hits.counted_cost(c_inner, c_tri),
        "cost_groups": (sums / np.maximum(np.bincount(group, minlength=_RAY_GROUPS), 1)).tolist(),
        "leaf_distribution": np.bincount(hits.leaves).tolist(),
        "epo_starts": float(at_starts[:, 0].mean()),
        "epo_starts_error": _standard_error(at_starts[:, 0]),
        "epo_ends": float(at_ends[:, 0].mean()) if len(ends) else 0.0,
        "point_query": float(at_starts.sum(axis=1).mean()),
        "hit_share": ends.share,
        "length_ratio": path_length_ratio(scene.triangles, rays, hits),
    }


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


def _times(
    trees: list[Tree],
    scene: Scene,
    rays: RaySet,
    lanes: Any,
    options: StudyOptions,
    report: Callable[[str, float], None],
) -> dict[str, Any]:
    """Time all trees of a scene, and the first one a second time under another name."""
    if lanes == "scalar":
        rays = rays.select(slice(None, None, -(-len(rays) // options.scalar_rays)))
    tracer = Tracer(rays, float(unit_scale(scene.triangles)), lanes, cull=options.cull)
    records = [make_records(tree, scene.triangles) for tree in trees]
    again = make_records(trees[0], scene.triangles)
    launches = [functools.partial(_launch, tracer, r) for r in [*records, again]]
    timings = measure(
        launches,
        seconds=options.seconds,
        standard_error=options.standard_error,
        progress=functools.partial(report, "time"),
    )
    ns = timings.estimate / len(rays) * 1e9
    return {
        "ns": ns[:-1].tolist(),
        "error": timings.relative_error[:-1].tolist(),
        "rounds": len(timings.seconds),
        "complete": timings.complete,
        "rays": len(rays),
        "repeat_difference": float(ns[-1] / ns[0] - 1),
    }


def _launch(tracer: Tracer, records: Records) -> float:
    return tracer.run(records)[1]


def _picture(scene: Scene) -> dict[str, Any]:
    from mibvh.studies.picture import picture

    return {"png": picture(scene)}


def write_outputs(folder: Path, records: list[dict[str, Any]]) -> None:
    """Write the tables, the environment and the report of the scenes that are finished."""
    from mibvh.studies.analyse import correlations
    from mibvh.studies.markdown import write_markdown
    from mibvh.studies.report import write_report
    from mibvh.studies.tables import write_tables

    found = correlations(records)
    write_tables(folder, records, found)
    write_text(folder / "environment.json", json.dumps(records[-1]["environment"], indent=2))
    write_text(folder / "results.md", write_markdown(records, found))
    write_report(folder, records, found)


def read_study(folder: str | os.PathLike[str]) -> Study:
    """Read a study back from its folder.

    Raises
    ------
    MibvhError
        If there is no finished scene in it.
    """
    cache = Path(folder) / "cache"
    store = Store(cache) if cache.is_dir() else None
    paths = sorted(cache.glob(f"{_KEPT}*.json"), key=lambda p: p.stat().st_mtime) if store else []
    records = [record for path in paths if store and (record := store.read(path.stem))]
    if not records:
        raise MibvhError(f"{folder}: there is no finished scene of a study in this folder")
    return Study(Path(folder), records, records[-1]["environment"])
