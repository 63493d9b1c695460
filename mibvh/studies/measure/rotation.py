"""The rotation experiment: a scene and its rays turned 45 degrees about (1, 1, 1).

The paper's additional test (slides, "Rotated scenes"): boxes fit worse, so every cost grows, but
that of rays that begin and end in the scene grows more than SAH says. The stored rays are turned
with the triangles, so both frames trace the same paths; all trees are built anew.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import pandas as pd

from mibvh.metrics.predictor import FIXED_ALPHAS, finite_ray_cost, predict
from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.analyse.correlations import predictors
from mibvh.studies.options import StudyOptions
from mibvh.studies.measure.trees import (
    RayCounter,
    launch,
    portions,
    report_part,
    study_tree,
    timed_rays,
)
from mibvh.studies.measure.stopwatch import measure
from mibvh.studies.measure.store import Store, key_of
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.tree import Tree
from mibvh.triangles import rotation_about

AXIS = (1.0, 1.0, 1.0)
DEGREES = 45.0
#: Factors on the slides, mean over 22 scenes.
PAPER = {"scalar_ns": 2.7, "sah": 1.5, "epo": 3.9, "predictor": 2.6}
#: What is compared, and its heading.
FACTORS = {
    "counted_cost": "counted cost",
    "scalar_ns": "scalar ns/ray",
    "sah": "SAH",
    "epo": "EPO",
    "predictor": "SAH + EPO, average α",
    "fixed": f"SAH + EPO, α = {FIXED_ALPHAS[0]}",
    "ray_lines": "ray lines, average α",
    "finite_rays": "finite rays",
    "finite_by_lines": "finite by lines",
    "touched": "touched",
}


def turned(scene: Scene, rays: RaySet) -> tuple[Scene, RaySet]:
    """Turn a scene's triangles and its rays alike."""
    matrix = rotation_about(AXIS, DEGREES)
    triangles = dataclasses.replace(scene.triangles.rotated(matrix), name=scene.name)
    moved = rays.rotated(matrix)
    moved = dataclasses.replace(moved, meta={**moved.meta, "digest": triangles.digest})
    return dataclasses.replace(scene, triangles=triangles), moved


def rotation_experiment(
    scene: Scene,
    rays: RaySet,
    rays_key: str,
    trees: dict[str, Tree],
    machine: Any,
    options: StudyOptions,
    store: Store,
    report: Callable[[str, float], None],
) -> dict[str, Any]:
    """Build, judge, count and time the trees of the turned scene.

    Parameters
    ----------
    trees : dict of str to Tree
        Those of the scene as it is, by their keys.
    machine
        What times depend on besides.

    Returns
    -------
    dict
        JSON-able: ``axis``, ``degrees``, ``digest`` (of the turned triangles), ``same_hits``
        (share of the rays that hit the same triangle in both frames), ``trees`` (rows as in the
        scene's record, without SIMD times, and with ``scalar_ns_before``: the unturned tree's
        time in the same rounds of the stopwatch), ``timing``.
    """
    there, moved = turned(scene, rays)
    moved_key = key_of(rays=rays_key, axis=AXIS, degrees=DEGREES)
    counter = RayCounter(there, moved, options.cull)
    share = 0.6 / len(options.builders)
    found: dict[str, Tree] = {}
    rows = []
    for i, name in enumerate(options.builders):
        part = functools.partial(report_part, report, f"{name} turned", share * i, share)
        key, tree, row = study_tree(name, there, counter, moved_key, store, part)
        found[key] = tree
        rows.append(row)
    frames = [(scene, rays, list(trees.values())), (there, moved, list(found.values()))]
    keys = {"before": list(trees), "after": list(found), "rays": rays_key}
    part = functools.partial(report_part, report, "turned", 0.6, 0.4)
    timing = store.kept(
        f"rotation-{key_of(**keys, machine=machine, options=options.stopwatch('scalar'))}",
        functools.partial(_times_of_both, frames, options, part),
    )
    hits = store.kept(
        f"same-{key_of(**keys)}",
        lambda: {"share": _same_hits(frames)},
    )
    for row, before, after, error in zip(
        rows, timing.pop("before"), timing.pop("after"), timing.pop("error"), strict=True
    ):
        row["scalar_ns_before"], row["scalar_ns"], row["scalar_error"] = before, after, error
    return {
        "axis": AXIS, "degrees": DEGREES, "digest": there.triangles.digest,
        "same_hits": hits["share"], "trees": rows, "timing": timing,
    }  # fmt: skip


def _times_of_both(
    frames: list[tuple[Scene, RaySet, list[Tree]]],
    options: StudyOptions,
    report: Callable[[str, float], None],
) -> dict[str, Any]:
    """Time the trees of both frames in the same rounds, so that drift cancels in the factors."""
    launches = []
    for scene, rays, trees in frames:
        some = timed_rays(rays, "scalar", options)
        tracers = portions(some, scene, "scalar", options)
        launches += [
            functools.partial(launch, tracers, make_records(tree, scene.triangles))
            for tree in trees
        ]
    timings = measure(
        launches,
        portions=len(tracers),
        seconds=options.seconds,
        standard_error=options.standard_error,
        progress=functools.partial(report, "time"),
    )
    ns, half = timings.estimate / len(some) * 1e9, len(launches) // 2
    return {
        "before": ns[:half].tolist(),
        "after": ns[half:].tolist(),
        "error": timings.relative_error[half:].tolist(),
        "rounds": len(timings.seconds),
        "complete": timings.complete,
        "rays": len(some),
    }


def _same_hits(frames: list[tuple[Scene, RaySet, list[Tree]]]) -> float:
    """Share of the rays that hit the same triangle, or nothing, in both frames."""
    hits = []
    for scene, rays, trees in frames:
        tracer = Tracer(rays, float(unit_scale(scene.triangles)))
        outputs, _ = tracer.run(make_records(trees[0], scene.triangles))
        hits.append(tracer.fetch(outputs[1]))
    return float((hits[0] == hits[1]).mean())


# ------------------------------------------------------------------ answers


def average_alphas(records: list[dict[str, Any]]) -> tuple[float, float]:
    """Mean over the scenes of the alphas fitted to counted cost; NaN where none can be fitted.

    Returns
    -------
    fitted, ray_lines : float
        Of the predictors of those names.
    """
    found = [predictors(record, "counted_cost") for record in records]
    fitted = pd.DataFrame([[f[name][0] for name in ("fitted", "ray lines")] for f in found])
    alpha, of_lines = fitted.mean()  # of the scenes that have one
    return float(alpha), float(of_lines)


def rotation_factors(records: list[dict[str, Any]]) -> pd.DataFrame:
    """By what the turned scenes' costs exceed those of the scenes as they are.

    The predictors with an average alpha have the mean over all scenes of the alphas fitted to
    counted cost, which has no noise, where the paper fits to scalar time.

    Returns
    -------
    DataFrame
        One row per scene and builder: ``scene, builder``, and a column per key of
        :data:`FACTORS`; empty where no scene was turned. NaN where the unturned cost is zero.
    """
    alpha, of_lines = average_alphas(records)
    rows = []
    for record in records:
        if "rotation" not in record:
            continue
        for before, after in zip(record["trees"], record["rotation"]["trees"], strict=True):
            there, here = (_foretold(tree, alpha, of_lines) for tree in (after, before))
            rows.append({
                "scene": record["scene"], "builder": before["builder"],
                **{name: _ratio(there[name], here[name]) for name in there},
                "scalar_ns": _ratio(after["scalar_ns"], after["scalar_ns_before"]),
            })  # fmt: skip
    return pd.DataFrame(rows, columns=["scene", "builder", *FACTORS])


def _foretold(tree: dict[str, Any], alpha: float, of_lines: float) -> dict[str, float]:
    """Counted cost of a tree, and what each predictor says of it."""
    at_ends = tree["epo_starts"] + tree["hit_share"] * tree["epo_ends"]
    return {
        **{name: tree[name] for name in ("counted_cost", "sah", "epo", "touched")},
        "predictor": float(predict(tree["sah"], tree["epo"], alpha)),
        "fixed": float(predict(tree["sah"], tree["epo"], FIXED_ALPHAS[0])),
        "ray_lines": float(predict(tree["sah_lines"], at_ends, of_lines)),
        "finite_rays": float(
            finite_ray_cost(tree["sah"], tree["point_query"], tree["length_ratio"])
        ),
        "finite_by_lines": float(
            finite_ray_cost(tree["sah_lines"], tree["point_query"], tree["line_share"])
        ),
    }


def _ratio(after: float, before: float) -> float:
    return after / before if before > 0 else float("nan")
