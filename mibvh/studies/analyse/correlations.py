"""From measurements to answers: how well each predictor explains each measurement."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from mibvh.metrics.predictor import (
    FEWEST_TREES,
    FIXED_ALPHAS,
    agreement,
    bootstrap_interval,
    estimate_alpha,
    finite_ray_cost,
    fit_alpha,
    fitted_combination,
    held_out,
    pearson,
    predict,
)

#: Measurements that predictors are held against: column, what it is.
MEASUREMENTS = {
    "counted_cost": "counted cost",
    "scalar_ns": "scalar ns/ray",
    "simd_ns": "SIMD ns/ray",
}
#: Lane modes and how they are written.
LANES = {"scalar": "scalar", "simd": "SIMD"}
#: Predictors, and what each is.
PREDICTORS = {
    "SAH": "the surface area heuristic alone",
    "fitted": "(1 − α) SAH + α EPO, α fitted to the scene's trees",
    **{f"fixed {a}": f"(1 − α) SAH + α EPO, α = {a}" for a in FIXED_ALPHAS},
    "fixed best": "(1 − α) SAH + α EPO, the α of greatest mean r over these scenes",
    "estimated": "(1 − α) SAH + α EPO, α from the rays' mean length; no tree is measured",
    "ray ends": "(1 − α) SAH + α EPO at the rays' starts and ends, α fitted",
    "ray lines": "(1 − α) SAH of the rays' lines + α EPO at their starts and ends, α fitted",
    "finite rays": "s SAH + point query at the rays' starts; nothing is fitted",
    "finite by lines": "the same with the SAH of the rays' lines; nothing is fitted",
    "touched": "all nodes that rays touch up to their hits: the least that a traversal visits",
    "with LCV": "(1 − α) SAH + α EPO + β LCV, α and β fitted to the scene's trees",
    "LCV fixed": "the same, α fitted, the β of greatest mean r over these scenes",
    "LCV from others": "the same, α fitted, the β of greatest mean r over the other scenes",
}
#: What :func:`calibrate` finds.
_STEP_COSTS = ("ns_per_inner", "ns_per_test", "ns_per_ray", "c_inner", "c_inner_low",
               "c_inner_high", "mean_error", "worst_error")  # fmt: skip
#: Weights of LCV that are tried, in cost per leaf.
_LCV_WEIGHTS = np.concatenate([[0.0], np.geomspace(0.1, 100, 31)])
_NONE = float("nan")


def column(record: dict[str, Any], name: str) -> np.ndarray:
    """One value per tree of a scene's record."""
    return np.array([tree[name] for tree in record["trees"]], dtype=np.float64)


def worst_time_error(records: list[dict[str, Any]], lanes: str) -> float:
    """Largest standard error of a tree's time, relative to the scene's other trees."""
    return max(float(column(record, f"{lanes}_error").max()) for record in records)


@dataclasses.dataclass(frozen=True)
class Pooled:
    """Weights that are fitted to several scenes at once; NaN where there is nothing to fit.

    Attributes
    ----------
    alpha : float
        Alpha of the greatest mean Pearson r over all scenes.
    lcv : float
        Weight of LCV of the greatest mean r over all scenes, alpha being fitted to each.
    lcv_from_others : float
        The same without the scene that it is for, so that no scene fits its own.
    """

    alpha: float = _NONE
    lcv: float = _NONE
    lcv_from_others: float = _NONE


def pool(records: list[dict[str, Any]], measurement: str) -> list[Pooled]:
    """Fit the weights that scenes share.

    Returns
    -------
    list of Pooled
        One per scene; scenes with no r, for having too few trees, are left out of the means.
    """
    by_alpha, by_lcv = [], []
    for record in records:
        sah, epo, lcv, y = (column(record, name) for name in ("sah", "epo", "lcv", measurement))
        by_alpha.append([pearson(predict(sah, epo, a), y) for a in np.linspace(0, 1, 101)])
        by_lcv.append([pearson(_with_lcv(sah, epo, lcv, y, w)[1], y) for w in _LCV_WEIGHTS])
    best_alpha = _best(np.linspace(0, 1, 101), np.array(by_alpha))
    best_lcv = _best(_LCV_WEIGHTS, np.array(by_lcv))
    others = [_best(_LCV_WEIGHTS, np.delete(by_lcv, i, axis=0)) for i in range(len(records))]
    return [Pooled(best_alpha, best_lcv, other) for other in others]


def _best(choices: npt.NDArray[np.float64], r: npt.NDArray[np.float64]) -> float:
    """Choice of the greatest mean of r (scene, choice); NaN where no scene has an r."""
    r = r[np.isfinite(r).any(axis=1)]
    mean = np.nan_to_num(r).mean(axis=0) if len(r) else r
    return float(choices[int(mean.argmax())]) if len(r) else _NONE


def _with_lcv(
    sah: npt.NDArray[np.float64],
    epo: npt.NDArray[np.float64],
    lcv: npt.NDArray[np.float64],
    measured: npt.NDArray[np.float64],
    weight: float,
) -> tuple[float, npt.NDArray[np.float64]]:
    """Fitted alpha and prediction, with LCV of a fixed weight in it."""
    alpha = fit_alpha(sah, epo, measured, weight * lcv)
    return alpha, predict(sah, epo, alpha) + weight * lcv


def predictors(
    record: dict[str, Any], measurement: str, pooled: Pooled | None = None
) -> dict[str, tuple[float, np.ndarray]]:
    """Alpha (NaN where there is none) and prediction of each of :data:`PREDICTORS`."""
    pooled = pooled or Pooled()
    sah, epo, lcv, measured = (column(record, name) for name in ("sah", "epo", "lcv", measurement))
    of_lines, query = (column(record, name) for name in ("sah_lines", "point_query"))
    share, ratio, line_share = (
        float(column(record, name)[0]) for name in ("hit_share", "length_ratio", "line_share")
    )
    at_ends = column(record, "epo_starts") + share * column(record, "epo_ends")
    alphas = {
        "SAH": 0.0,
        "fitted": fit_alpha(sah, epo, measured),
        **{f"fixed {a}": a for a in FIXED_ALPHAS},
        "fixed best": pooled.alpha,
        "estimated": estimate_alpha(ratio),
    }
    found = {name: (alpha, predict(sah, epo, alpha)) for name, alpha in alphas.items()}
    of_ends = fit_alpha(sah, at_ends, measured)
    found["ray ends"] = (of_ends, predict(sah, at_ends, of_ends))
    on_lines = fit_alpha(of_lines, at_ends, measured)
    found["ray lines"] = (on_lines, predict(of_lines, at_ends, on_lines))
    found["finite rays"] = (_NONE, finite_ray_cost(sah, query, ratio))
    found["finite by lines"] = (_NONE, finite_ray_cost(of_lines, query, line_share))
    found["touched"] = (_NONE, column(record, "touched"))
    columns = [sah, epo, lcv]
    enough = len(measured) > len(columns) + 1
    combined = fitted_combination(columns, measured) if enough else np.full(len(measured), _NONE)
    found["with LCV"] = (_NONE, combined)
    found["LCV fixed"] = _with_lcv(sah, epo, lcv, measured, pooled.lcv)
    found["LCV from others"] = _with_lcv(sah, epo, lcv, measured, pooled.lcv_from_others)
    return found


def correlations(records: list[dict[str, Any]]) -> pd.DataFrame:
    """Agreement of each predictor with each measurement, per scene.

    Returns
    -------
    DataFrame
        Columns ``scene, measurement, predictor, alpha``, those of
        :func:`mibvh.metrics.predictor.agreement`, ``held_out`` (Pearson r of trees predicted from
        a fit to the other trees, for predictors with fitted weights), and ``low, high`` (95%
        bootstrap interval of r over the rays, for counted cost).
    """
    rows = []
    for measurement in MEASUREMENTS:
        for record, pooled in zip(records, pool(records, measurement), strict=True):
            measured = column(record, measurement)
            groups = np.array([tree["cost_groups"] for tree in record["trees"]])
            for name, (alpha, values) in predictors(record, measurement, pooled).items():
                low = high = float("nan")
                if measurement == "counted_cost":
                    low, high = bootstrap_interval(values, groups)
                rows.append({
                    "scene": record["scene"], "measurement": measurement, "predictor": name,
                    "alpha": alpha, **agreement(values, measured),
                    "held_out": _held_out(record, name, measured), "low": low, "high": high,
                })  # fmt: skip
    return pd.DataFrame(rows)


def _held_out(record: dict[str, Any], predictor: str, measured: np.ndarray) -> float:
    """Pearson r of trees predicted from a fit to the others."""
    names = {"fitted": ("sah", "epo"), "with LCV": ("sah", "epo", "lcv")}.get(predictor)
    if names is None:
        return float("nan")
    predicted = held_out([column(record, name) for name in names], measured)
    return pearson(predicted, measured) if np.isfinite(predicted).all() else float("nan")


def overview(table: pd.DataFrame) -> pd.DataFrame:
    """Mean, minimum and maximum over the scenes of Pearson's r, as in the paper's tables.

    Returns
    -------
    DataFrame
        Index ``(measurement, predictor)``; columns ``mean, min, max, scenes``, and
        ``worst_error``: the largest misprediction of any tree, as a share.
    """
    groups = table.groupby(["measurement", "predictor"], sort=False)
    found = groups["pearson"].agg(["mean", "min", "max", "count"])
    found["worst_error"] = groups["worst_error"].max()
    return found.rename(columns={"count": "scenes"})


def relative_to(records: list[dict[str, Any]], name: str, base: str = "lbvh") -> pd.Series:
    """Mean over the scenes of a metric, per builder, as a share of one builder's.

    Parameters
    ----------
    records : list of dict
    name : str
        A metric, such as ``epo``.
    base : str
        The builder that is 1.

    Returns
    -------
    Series
        By builder; empty where no scene has the base builder.
    """
    rows = [
        {t["builder"]: t[name] / b[name] for t in r["trees"]}
        for r in records
        for b in r["trees"]
        if b["builder"] == base and b[name] > 0
    ]
    return pd.DataFrame(rows).mean() if rows else pd.Series(dtype=float)


def calibrate(records: list[dict[str, Any]], measurement: str = "scalar_ns") -> dict[str, float]:
    """Fit nanoseconds per inner node and per triangle test to all trees of all scenes.

    Returns
    -------
    dict
        ``ns_per_inner``, ``ns_per_test``, ``ns_per_ray`` (what a ray costs whatever it visits),
        ``c_inner`` (the first over the second: the cost constant of this machine where
        ``C_tri`` is 1), ``c_inner_low`` and ``c_inner_high`` (its 95% interval, by the bootstrap
        over scenes and over the trees of each), ``mean_error`` and ``worst_error`` (relative, of
        the fitted times), and ``trees``. NaN for fewer than
        :data:`~mibvh.metrics.predictor.FEWEST_TREES` trees.
    """
    from scipy import optimize  # a second to import

    x = np.concatenate([
        np.stack([column(r, "inner_per_ray"), column(r, "triangles_per_ray"),
                  np.ones(len(r["trees"]))], axis=1)
        for r in records
    ])  # fmt: skip
    y = np.concatenate([column(r, measurement) for r in records])
    x /= y[:, None]  # relative errors count
    if len(y) < FEWEST_TREES:
        return {**dict.fromkeys(_STEP_COSTS, _NONE), "trees": len(y)}
    weights, _ = optimize.nnls(x, np.ones(len(y)))
    error = np.abs(x @ weights - 1)
    inner, test, ray = (float(w) for w in weights)
    drawn = _resampled([len(r["trees"]) for r in records], 400)
    others = np.array([optimize.nnls(x[rows], np.ones(len(rows)))[0] for rows in drawn])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = others[:, 0] / others[:, 1]
    # Not between two values: some may be infinite.
    low, high = np.quantile(ratios, [0.025, 0.975], method="nearest")
    return {
        "ns_per_inner": inner, "ns_per_test": test, "ns_per_ray": ray,
        "c_inner": inner / test if test > 0 else float("nan"),
        "c_inner_low": float(low), "c_inner_high": float(high),
        "mean_error": float(error.mean()), "worst_error": float(error.max()), "trees": len(y),
    }  # fmt: skip


def _resampled(sizes: list[int], times: int) -> Iterator[np.ndarray]:
    """Draw scenes, and trees of each, as trees of one scene err alike.

    Yields
    ------
    (K,) int64
        Rows of all scenes' trees, one scene after the other in ``sizes``.
    """
    generator = np.random.default_rng(0)
    begin = np.cumsum([0, *sizes])
    for _ in range(times):
        scenes = generator.integers(0, len(sizes), len(sizes))
        yield np.concatenate([begin[k] + generator.integers(0, sizes[k], sizes[k]) for k in scenes])


def sensitivity(records: list[dict[str, Any]], measurement: str) -> pd.DataFrame:
    """What other cost constants do to r: the paper's, equal ones, and this machine's own.

    Returns
    -------
    DataFrame
        Columns ``constants, c_inner, sah`` and ``fitted`` (mean Pearson r over the scenes).
    """
    own = calibrate(records, measurement)["c_inner"]
    rows = []
    for name, c_inner in {"paper": 1.2, "equal": 1.0, "two boxes": 2.0, "calibrated": own}.items():
        if not np.isfinite(c_inner):
            continue
        found = []
        for record in records:
            sah, epo = (
                np.array([t[part] for t in record["trees"]]) @ [c_inner, 1.0]
                for part in ("sah_parts", "epo_parts")
            )
            measured = column(record, measurement)
            alpha = fit_alpha(sah, epo, measured)
            found.append((pearson(sah, measured), pearson(predict(sah, epo, alpha), measured)))
        alone, both = pd.DataFrame(found).mean()  # of the scenes that have one
        rows.append({"constants": name, "c_inner": c_inner, "sah": alone, "fitted": both})
    return pd.DataFrame(rows)


def absolute_errors(records: list[dict[str, Any]]) -> pd.DataFrame:
    """How far the finite-rays predictor is from counted cost, with no line fitted in between.

    Returns
    -------
    DataFrame
        Per scene: ``s`` (mean ray length over mean chord), ``hit_share``, ``bias`` (mean relative
        error), ``worst`` (largest relative error of a tree), ``spread`` (largest after the scene's
        bias is taken out), and ``sigma`` (standard deviation of the extra cost at a ray's start,
        over its mean: squared and divided by the square of the error wanted, the rays needed).
    """
    rows = []
    for record in records:
        measured, ratio = column(record, "counted_cost"), float(column(record, "length_ratio")[0])
        predicted = finite_ray_cost(column(record, "sah"), column(record, "point_query"), ratio)
        error = predicted / measured - 1
        level = predicted / measured / np.exp(np.log(predicted / measured).mean()) - 1
        with np.errstate(invalid="ignore"):  # no overlap at all where rays start
            sigma = column(record, "epo_starts_error") / column(record, "epo_starts")
        rows.append({
            "scene": record["scene"], "s": ratio, "hit_share": column(record, "hit_share")[0],
            "bias": error.mean(), "worst": error[np.abs(error).argmax()],
            "spread": np.abs(level).max(),
            "sigma": float(np.median(sigma)) * np.sqrt(record["rays"]["count"]),
        })  # fmt: skip
    return pd.DataFrame(rows)
