"""Sensitivity: other leaf sizes, deeper bounces, fewer viewpoints.

Everything here is by counted cost, which has no noise, so that small changes of r can be seen.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from mibvh.builders import Context, get
from mibvh.builders.finish import finish
from mibvh.metrics.epo import epo
from mibvh.metrics.predictor import FIXED_ALPHAS, fit_alpha, pearson, predict
from mibvh.metrics.sah import sah
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import Scene
from mibvh.studies.options import StudyOptions
from mibvh.studies.measure.trees import cameras, costs_by_origin, counted_costs, report_part
from mibvh.studies.measure.store import Store, key_of
from mibvh.traversal.records import unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.tree import Tree

#: Largest leaves that are tried.
LEAF_SIZES = (1, 2, 4, 8, 16)
#: Bounces that are tried, each a set of its own.
BOUNCES = 3
#: Rays that trees of other leaf sizes are counted on, at most.
_LEAF_RAYS = 262_144


def sensitivity_experiment(
    scene: Scene,
    rays: RaySet,
    rays_key: str,
    trees: dict[str, Tree],
    options: StudyOptions,
    store: Store,
    report: Callable[[str, float], None],
) -> dict[str, Any]:
    """Count what other leaf sizes and deeper bounces cost.

    Parameters
    ----------
    trees : dict of str to Tree
        By their keys, in the order of ``options.builders``.

    Returns
    -------
    dict
        JSON-able: ``leaf_sizes`` (per builder a list with a dict per size), ``bounces`` (per
        builder the costs of the rays deeper than the scene's ray set, by bounce and viewpoint).
    """
    share = 0.7 / len(trees)
    leaf_sizes = []
    for i, (name, key) in enumerate(zip(options.builders, trees, strict=True)):
        report(f"leaf sizes {name}", share * i)
        piece = key_of(
            tree=key, rays=rays_key, cull=options.cull, sizes=LEAF_SIZES, most=_LEAF_RAYS
        )
        make = functools.partial(_leaf_sizes, name, scene, rays, options.cull)
        leaf_sizes.append(store.kept(f"leaves-{piece}", make)["sizes"])
    part = functools.partial(report_part, report, "bounces", 0.7, 0.3)
    return {"leaf_sizes": leaf_sizes, "bounces": _bounces(scene, trees, options, store, part)}


def _leaf_sizes(name: str, scene: Scene, rays: RaySet, cull: bool) -> dict[str, Any]:
    """Finish one builder's draft with each leaf size, and judge and count the trees."""
    triangles, entry = scene.triangles, get(name)
    chosen = entry.options()
    draft = entry.draft(triangles, chosen, Context())
    some = rays.select(slice(None, None, -(-len(rays) // _LEAF_RAYS)))
    tracer = Tracer(some, float(unit_scale(triangles)), cull=cull)
    meta = {"triangles": len(triangles), "digest": triangles.digest,
            "c_inner": chosen.c_inner, "c_tri": chosen.c_tri}  # fmt: skip
    sizes = []
    for size in LEAF_SIZES:
        tree = finish(draft, c_inner=chosen.c_inner, c_tri=chosen.c_tri, max_leaf=size, meta=meta)
        sizes.append({
            "max_leaf": size, "rays": len(some),
            "sah": sah(tree),
            "epo": epo(tree, triangles),
            "counted_cost": float(counted_costs(tracer, tree, triangles).mean()),
            "mean_leaf_size": tree.stats()["mean_leaf_size"],
        })  # fmt: skip
    return {"sizes": sizes}


def _bounces(
    scene: Scene,
    trees: dict[str, Tree],
    options: StudyOptions,
    store: Store,
    report: Callable[[str, float], None],
) -> list[list[dict[str, Any]]]:
    """Costs of the rays that are deeper than those of the scene's own ray set."""
    choices = {**options.rays(), "bounces": max(BOUNCES, options.bounces)}
    key = key_of(digest=scene.triangles.digest, cameras=cameras(scene), deeper=True, **choices)

    def deeper() -> RaySet:
        found = diffuse_rays(scene, **choices)
        return found.select(found.bounce > options.bounces)

    report("rays", 0.0)
    rays = store.array(RaySet, key, deeper)
    if len(rays) == 0:
        return [[] for _ in trees]
    tracer = None
    costs = []
    for i, (name, tree) in enumerate(trees.items()):
        report("count", 0.2 + 0.8 * i / len(trees))
        tracer = tracer or Tracer(rays, float(unit_scale(scene.triangles)), cull=options.cull)
        make = functools.partial(_counted, tracer, tree, scene, rays)
        costs.append(store.kept(f"deeper-{key_of(tree=name, rays=key, cull=options.cull)}", make))
    return [found["costs"] for found in costs]


def _counted(tracer: Tracer, tree: Tree, scene: Scene, rays: RaySet) -> dict[str, Any]:
    return {"costs": costs_by_origin(rays, counted_costs(tracer, tree, scene.triangles))}


# ------------------------------------------------------------------ answers


def sensitivity_table(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Pearson's r with counted cost under each choice.

    Returns
    -------
    DataFrame
        Columns ``scene, experiment`` (``leaf size``, ``bounce`` or ``viewpoints``), ``choice``
        (the largest leaf, the bounce, or how many viewpoints), ``which`` (the viewpoints; there
        is a row for each run of so many neighbours), ``sah, fitted, fixed`` (Pearson r of SAH, of
        SAH + EPO with fitted alpha, with alpha 0.79) and ``alpha``. Empty where the experiment
        was not run.
    """
    rows = []
    for record in records:
        if "sensitivity" not in record:
            continue
        for experiment, choice, which, columns in _cases(record):
            measured, s, e = (np.asarray(c, np.float64) for c in columns)
            alpha = fit_alpha(s, e, measured)
            rows.append({
                "scene": record["scene"], "experiment": experiment, "choice": choice,
                "which": which,
                "sah": pearson(s, measured), "fitted": pearson(predict(s, e, alpha), measured),
                "fixed": pearson(predict(s, e, FIXED_ALPHAS[0]), measured), "alpha": alpha,
            })  # fmt: skip
    names = ["scene", "experiment", "choice", "which", "sah", "fitted", "fixed", "alpha"]
    return pd.DataFrame(rows, columns=names)


def _cases(record: dict[str, Any]) -> Any:
    """Yield what is varied, its value, which viewpoints, and cost, SAH and EPO per tree."""
    own = [[t[name] for t in record["trees"]] for name in ("sah", "epo")]
    leaf_sizes = record["sensitivity"]["leaf_sizes"]
    for i, size in enumerate(LEAF_SIZES):
        names = ("counted_cost", "sah", "epo")
        yield "leaf size", size, "", [[sizes[i][n] for sizes in leaf_sizes] for n in names]
    origins = [
        [*tree["costs_by_origin"], *deeper]
        for tree, deeper in zip(record["trees"], record["sensitivity"]["bounces"], strict=True)
    ]
    for bounce in sorted({entry["bounce"] for entry in origins[0]}):
        costs = [_mean_cost([e for e in tree if e["bounce"] == bounce]) for tree in origins]
        yield "bounce", bounce, "", [costs, *own]
    by_view = [tree["costs_by_origin"] for tree in record["trees"]]
    views = sorted({entry["viewpoint"] for entry in by_view[0]})
    for many in range(1, len(views) + 1):
        for first in range(len(views) if many < len(views) else 1):
            chosen = [views[(first + i) % len(views)] for i in range(many)]
            costs = [_mean_cost([e for e in tree if e["viewpoint"] in chosen]) for tree in by_view]
            yield "viewpoints", many, " ".join(map(str, chosen)), [costs, *own]


def _mean_cost(entries: list[dict[str, Any]]) -> float:
    """Mean over all rays of some origins."""
    return sum(e["cost"] * e["rays"] for e in entries) / sum(e["rays"] for e in entries)


def sensitivity_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and minimum of r over the scenes (and sets of viewpoints) for each choice.

    Parameters
    ----------
    table : DataFrame
        From :func:`sensitivity_table`.

    Returns
    -------
    DataFrame
        Columns ``experiment, choice, cases, sah, sah_min, fitted, fitted_min, fixed, fixed_min,
        alpha``.
    """
    rows = []
    for (experiment, choice), group in table.groupby(["experiment", "choice"], sort=False):
        row: dict[str, Any] = {"experiment": experiment, "choice": choice, "cases": len(group)}
        for name in ("sah", "fitted", "fixed"):
            row[name], row[f"{name}_min"] = group[name].mean(), group[name].min()
        rows.append({**row, "alpha": group["alpha"].mean()})
    names = ["experiment", "choice", "cases", "sah", "sah_min", "fitted", "fitted_min", "fixed",
             "fixed_min", "alpha"]  # fmt: skip
    return pd.DataFrame(rows, columns=names)
