"""Fitted costs of traversal steps, and predictions with other cost constants."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pandas as pd

from mibvh.metrics.predictor import FEWEST_TREES, finite_ray_cost, fit_alpha, pearson, predict
from mibvh.studies.record.scene import Records, SceneRecord
from mibvh.triangles import F64

_NONE = float("nan")


@dataclasses.dataclass(frozen=True)
class StepCosts:
    """Nanoseconds of the steps of a traversal, fitted to times.

    Attributes
    ----------
    trees : int
        How many it is fitted to.
    ns_per_inner, ns_per_test : float
        Per inner node and per triangle test.
    ns_per_ray : float
        What a ray costs whatever it visits.
    c_inner : float
        The first over the second: the cost constant of this machine where ``C_tri`` is 1.
    c_inner_low, c_inner_high : float
        Its 95% interval, by the bootstrap over scenes and over the trees of each.
    mean_error, worst_error : float
        Relative, of the fitted times.
    """

    trees: int
    ns_per_inner: float = _NONE
    ns_per_test: float = _NONE
    ns_per_ray: float = _NONE
    c_inner: float = _NONE
    c_inner_low: float = _NONE
    c_inner_high: float = _NONE
    mean_error: float = _NONE
    worst_error: float = _NONE


def calibrate(records: Records, target: str = "scalar_ns") -> StepCosts:
    """Fit nanoseconds per inner node and per triangle test to all trees of all scenes.

    Returns
    -------
    StepCosts
        NaN for fewer than :data:`~mibvh.metrics.predictor.FEWEST_TREES` trees.
    """
    from scipy import optimize  # a second to import

    records = [record for record in records if record.knows(target)]
    if not records:
        return StepCosts(trees=0)
    x = np.concatenate([_steps(record) for record in records])
    y = np.concatenate([record.column(target) for record in records])
    x /= y[:, None]  # relative errors count
    if len(y) < FEWEST_TREES:
        return StepCosts(trees=len(y))
    weights, _ = optimize.nnls(x, np.ones(len(y)))
    error = np.abs(x @ weights - 1)
    inner, test, ray = (float(w) for w in weights)
    drawn = _resampled([len(record.trees) for record in records], 400)
    others = np.array([optimize.nnls(x[rows], np.ones(len(rows)))[0] for rows in drawn])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = others[:, 0] / others[:, 1]
    # Not between two values: some may be infinite.
    low, high = np.quantile(ratios, [0.025, 0.975], method="nearest")
    return StepCosts(
        trees=len(y),
        ns_per_inner=inner,
        ns_per_test=test,
        ns_per_ray=ray,
        c_inner=inner / test if test > 0 else _NONE,
        c_inner_low=float(low),
        c_inner_high=float(high),
        mean_error=float(error.mean()),
        worst_error=float(error.max()),
    )


def _steps(record: SceneRecord) -> F64:
    """Return (K, 3) float64: inner nodes per ray, triangle tests per ray and 1, for each tree."""
    ones = np.ones(len(record.trees))
    counted = (record.column("inner_per_ray"), record.column("triangles_per_ray"))
    return np.stack([*counted, ones], axis=1)


def _resampled(sizes: list[int], times: int) -> Iterator[npt.NDArray[np.int64]]:
    """Resample scenes, then the trees of each, because errors within a scene are correlated.

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


def other_constants(records: Records, target: str) -> pd.DataFrame:
    """Pearson's r with other cost constants: the paper's, equal ones, and this machine's.

    Returns
    -------
    DataFrame
        Columns ``constants, c_inner, sah`` and ``fitted`` (mean Pearson r over the scenes).
    """
    own = calibrate(records, target).c_inner
    records = [record for record in records if record.knows(target)]
    rows = []
    for name, c_inner in {"paper": 1.2, "equal": 1.0, "two boxes": 2.0, "calibrated": own}.items():
        if not np.isfinite(c_inner):
            continue
        found = []
        for record in records:
            sah, epo = (_with_constants(record, metric, c_inner) for metric in ("sah", "epo"))
            measured = record.column(target)
            alpha = fit_alpha(sah, epo, measured)
            found.append((pearson(sah, measured), pearson(predict(sah, epo, alpha), measured)))
        # Of the scenes that have one.
        alone, both = pd.DataFrame(found, columns=["sah", "fitted"], dtype=np.float64).mean()
        rows.append({"constants": name, "c_inner": c_inner, "sah": alone, "fitted": both})
    return pd.DataFrame(rows)


def _with_constants(record: SceneRecord, metric: str, c_inner: float) -> F64:
    """Return (K,) float64: SAH or EPO of the trees with another cost of an inner node."""
    parts = np.stack([record.column(f"{metric}_{part}") for part in ("inner", "leaves")], axis=1)
    return np.asarray(parts @ [c_inner, 1.0])


def absolute_errors(records: Records) -> pd.DataFrame:
    """Relative errors of the finite-rays predictor against counted cost, without fitting a line.

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
        measured, ratio = record.column("counted_cost"), float(record.column("length_ratio")[0])
        predicted = finite_ray_cost(record.column("sah"), record.column("point_query"), ratio)
        error = predicted / measured - 1
        level = predicted / measured / np.exp(np.log(predicted / measured).mean()) - 1
        with np.errstate(invalid="ignore"):  # no overlap at all where rays start
            sigma = record.column("epo_starts_error") / record.column("epo_starts")
        rows.append(
            {
                "scene": record.scene,
                "s": ratio,
                "hit_share": record.column("hit_share")[0],
                "bias": error.mean(),
                "worst": error[np.abs(error).argmax()],
                "spread": np.abs(level).max(),
                "sigma": float(np.median(sigma)) * np.sqrt(record.rays.count),
            }
        )
    return pd.DataFrame(rows)
