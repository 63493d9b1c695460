"""Results for wide trees: how well they are predicted, and which are the best."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from mibvh.metrics.predictor import pearson
from mibvh.metrics.predictors import Sample, alpha_of, predictor, predictors
from mibvh.studies.measure.widths import WidthResult, columns_at
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.triangles import F64

_TARGET = "counted_cost"


def width_results(records: Records) -> dict[str, WidthResult]:
    """Return the results of the scenes that have this experiment, by the scene's name."""
    results = {record.scene: record.result(WidthResult) for record in records}
    return {scene: found for scene, found in results.items() if found is not None}


def widths_of(records: Records) -> list[int]:
    """Return the widths that all of these scenes have."""
    found = [set(result.widths) for result in width_results(records).values()]
    return sorted(set.intersection(*found)) if found else []


def width_samples(records: Records, width: int) -> list[Sample]:
    """Return the samples of all scenes at one width, with that width's metrics and counted cost."""
    columns = [columns_at(found, width) for found in width_results(records).values()]
    return [Sample(values, values[_TARGET]) for values in columns]


def width_correlations(records: Records) -> pd.DataFrame:
    """Agreement of each predictor with counted cost, per scene and width.

    Returns
    -------
    DataFrame
        Columns ``scene, width, predictor, alpha, pearson``; empty where no tree was collapsed.
    """
    scenes = list(width_results(records))
    rows = []
    for width in widths_of(records):
        known = width_samples(records, width)
        for place, scene in enumerate(scenes):
            for one in predictors():
                if one.knows(known[place].values):
                    weights, values = one(known, place)
                    rows.append(
                        {
                            "scene": scene,
                            "width": width,
                            "predictor": one.name,
                            "alpha": alpha_of(weights),
                            "pearson": pearson(values, known[place].measured),
                        }
                    )
    return pd.DataFrame(rows, columns=["scene", "width", "predictor", "alpha", "pearson"])


def wide_trees(records: Records) -> pd.DataFrame:
    """Tabulate all trees at all widths.

    Returns
    -------
    DataFrame
        Columns ``scene, builder, width, sah, epo, lcv, finite, counted_cost, mean_children``;
        ``finite`` is what finite rays predict, in the units of counted cost.
    """
    finite = predictor("finite rays")
    rows = []
    for record in records:
        found = record.result(WidthResult)
        if found is None:
            continue
        for width in found.widths:
            columns = columns_at(found, width)
            of_rays = finite([Sample(columns, columns[_TARGET])])[1]
            for place, tree in enumerate(record.trees):
                names = ("sah", "epo", "lcv", _TARGET, "mean_children")
                values = {name: columns[name][place] for name in names}
                row = {"scene": record.scene, "builder": tree.builder, "width": width}
                rows.append({**row, **values, "finite": of_rays[place]})
    return pd.DataFrame(rows)


def over_best(trees: pd.DataFrame) -> pd.DataFrame:
    """Counted cost of each builder's trees relative to the scene's best, for each width.

    Parameters
    ----------
    trees : DataFrame
        From :func:`wide_trees`.

    Returns
    -------
    DataFrame
        Columns ``builder, width, mean`` (geometric, over the scenes), ``best`` (on how many scenes
        it is the cheapest) and ``over_binary`` (cost over that at width two, geometric mean).
    """
    cost = trees.set_index(["scene", "builder", "width"])[_TARGET]
    binary = cost.xs(2, level="width")
    rows = []
    for (builder, width), of in trees.groupby(["builder", "width"], sort=False):
        own = of.set_index("scene")[_TARGET]
        least = cost.xs(width, level="width").groupby("scene").min()[own.index]
        at_two = binary.xs(builder, level="builder")[own.index]
        rows.append(
            {
                "builder": builder,
                "width": width,
                "mean": _geometric((own / least).to_numpy()),
                "best": int((own == least).sum()),
                "over_binary": _geometric((own / at_two).to_numpy()),
            }
        )
    return pd.DataFrame(rows)


def before_and_after(trees: pd.DataFrame, width: int) -> pd.DataFrame:
    """How well SAH before the collapse predicts the cost after it, compared with SAH after it.

    Parameters
    ----------
    trees : DataFrame
        From :func:`wide_trees`.
    width : int

    Returns
    -------
    DataFrame
        Per scene: ``sah`` (r of SAH before with SAH after), ``epo``, ``before`` (r of SAH before
        with cost after), ``after`` (r of SAH after with cost after), ``cost`` (r of cost before
        with cost after), and ``kept``: by how much SAH after falls in the mean where SAH before
        falls by 1%, in percent (the slope of logarithms).
    """
    rows = []
    for scene, of in trees.groupby("scene", sort=False):
        two, wide = (of[of["width"] == w].set_index("builder") for w in (2, width))
        sah = two["sah"].to_numpy(), wide["sah"].to_numpy()
        rows.append(
            {
                "scene": scene,
                "sah": pearson(*sah),
                "epo": pearson(two["epo"], wide["epo"]),
                "before": pearson(sah[0], wide[_TARGET]),
                "after": pearson(sah[1], wide[_TARGET]),
                "cost": pearson(two[_TARGET], wide[_TARGET]),
                "kept": _slope(*sah),
            }
        )
    return pd.DataFrame(rows)


def optimised(records: Records, trees: pd.DataFrame, width: int) -> pd.DataFrame:
    """Gains of optimisers over their start trees, before and after the collapse.

    Returns
    -------
    DataFrame
        Columns ``builder, start, scenes`` and, as geometric means over the scenes,
        ``sah_before``, ``sah_after``, ``epo_before``, ``epo_after``, ``cost_before``,
        ``cost_after``: optimised over start.
    """
    known = trees.set_index(["scene", "builder", "width"])
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    for record in records:
        if record.result(WidthResult) is None:
            continue
        for builder, start in _pairs(record):
            ratios = {}
            for name, short in (("sah", "sah"), ("epo", "epo"), (_TARGET, "cost")):
                for w, when in ((2, "before"), (width, "after")):
                    own, other = (known.loc[(record.scene, b, w), name] for b in (builder, start))
                    ratios[f"{short}_{when}"] = own / other if other > 0 else np.nan
            found.setdefault((builder, start), []).append(ratios)
    rows = [
        {
            "builder": builder,
            "start": start,
            "scenes": len(of),
            **{name: _geometric(np.array([r[name] for r in of])) for name in of[0]},
        }
        for (builder, start), of in found.items()
    ]
    return pd.DataFrame(rows)


def _pairs(record: SceneRecord) -> Iterator[tuple[str, str]]:
    """Return the optimised trees of a scene with their start trees, if both are there."""
    names = {tree.builder for tree in record.trees}
    for tree in record.trees:
        start = tree.options.get("start")
        if start in names and start != tree.builder:
            yield tree.builder, start


def _geometric(values: F64) -> float:
    """Geometric mean; NaN if a value is NaN or not positive."""
    return float(np.exp(np.mean(np.log(values)))) if (values > 0).all() else float("nan")


def _slope(before: F64, after: F64) -> float:
    """Slope of the logarithms' least-squares line."""
    if len(before) < 3 or not (np.concatenate([before, after]) > 0).all():
        return float("nan")
    x, y = np.log(before), np.log(after)
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y / (x @ x)) if x @ x > 0 else float("nan")
