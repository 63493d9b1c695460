"""Predictors of cost, and how well they explain measurements.

The paper's predictor is ``(1 - alpha) SAH + alpha EPO``. Alpha is the share of a ray's cost that
comes from its ends; the rest comes from its length.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.metrics.lines import inside_box
from mibvh.triangles import F64, as_triangles

#: Fewest trees that alpha is fitted to. Alpha and a line are three free parameters: over three
#: trees r is 1, or nearly so, whatever the metrics are worth.
FEWEST_TREES = 5
#: Values that differ by less than this share of the largest count as equal. It is larger than the
#: rounding errors of the metrics.
_SAME = 1e-7
#: The best fixed alpha on the paper's slides, and the default of other programs that cite it.
FIXED_ALPHAS = (0.79, 0.71)


def predict(sah: npt.ArrayLike, epo: npt.ArrayLike, alpha: float) -> npt.NDArray[np.float64]:
    """``(1 - alpha) SAH + alpha EPO`` for each tree.

    Parameters
    ----------
    sah, epo : (K,) array
    alpha : float
        From 0 to 1.
    """
    return (1 - alpha) * np.asarray(sah, np.float64) + alpha * np.asarray(epo, np.float64)


def pearson(predicted: npt.ArrayLike, measured: npt.ArrayLike) -> float:
    """Pearson's correlation coefficient.

    NaN for values that are not finite or constant up to rounding, and for fewer than three
    trees: over two trees it is always 1 or -1.
    """
    x, y = np.asarray(predicted, np.float64), np.asarray(measured, np.float64)
    if len(x) < 3 or not (_varies(x) and _varies(y)):
        return float("nan")
    x, y = _scaled(x), _scaled(y)
    # np.corrcoef takes ten times as long, and tables hold tens of thousands of r.
    return min(max(float(x @ y) / math.sqrt(float(x @ x) * float(y @ y)), -1.0), 1.0)


def _varies(values: F64) -> bool:
    """Whether values are finite, and not constant up to rounding."""
    low, high = float(values.min()), float(values.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        return False
    return high - low > _SAME * max(abs(low), abs(high))


def _scaled(values: F64) -> F64:
    """Deviations from the mean, scaled so that no square over- or underflows."""
    deviations = values - values.mean()
    return deviations / np.abs(deviations).max()


def fit_alpha(
    sah: npt.ArrayLike, epo: npt.ArrayLike, measured: npt.ArrayLike, plus: npt.ArrayLike = 0.0
) -> float:
    """Alpha that maximises Pearson's r of ``(1 - alpha) SAH + alpha EPO + plus``, in closed form.

    The one free parameter of the predictor of Aila, Karras and Laine (HPG 2013).
    r has one stationary point in alpha. Where that is a minimum or outside 0 to 1, the best alpha
    is 0 or 1.

    Parameters
    ----------
    sah, epo, measured : (K,) array
        One value per tree.
    plus : (K,) array, optional
        Further terms of the prediction, such as a fixed weight times LCV.

    Returns
    -------
    float
        From 0 to 1; NaN where no r is defined, and for fewer than :data:`FEWEST_TREES` trees.
    """
    s, e, y, more = (np.asarray(v, np.float64) for v in (sah, epo, measured, plus))
    if len(y) < FEWEST_TREES:
        return float("nan")
    base, step, centred = (v - v.mean() for v in (s + more, e - s, y))
    # With base + alpha * step for the prediction, dr / dalpha = 0 is linear in alpha.
    over = (step @ centred) * (base @ base) - (base @ centred) * (base @ step)
    under = (base @ centred) * (step @ step) - (step @ centred) * (base @ step)
    ends = [0.0, 1.0]
    candidates = [over / under, *ends] if under != 0 and 0 < over / under < 1 else ends
    # Not of what is centred: that of equal values is rounding, which would have an r.
    r = np.array([pearson(predict(s, e, alpha) + more, y) for alpha in candidates])
    if np.isnan(r).all():
        return float("nan")
    return float(candidates[int(np.nanargmax(r))])


def path_length_ratio(triangles: Any, rays: Any, hits: Any) -> float:
    """Mean length of the rays inside the scene's box over the mean chord of that box.

    The mean chord of a convex body of volume V and surface A is 4 V / A: the mean length of a long
    random ray inside it. Rays that miss count up to where they leave the box, or up to their own
    end.

    Parameters
    ----------
    triangles : Triangles or (N, 3, 3) array
    rays : RaySet
    hits : Hits
        Of these rays, from any tree.

    Returns
    -------
    float
        ``s``, without unit; NaN for a box without volume. See ``docs/alpha.md``.

    Raises
    ------
    MibvhError
        If the triangles are none.
    """
    triangles = as_triangles(triangles)
    lower, upper = triangles.bounds.astype(np.float64)
    x, y, z = upper - lower
    surface = 2 * (x * y + y * z + z * x)
    if not x * y * z > 0:
        return float("nan")
    o, d = rays.o.astype(np.float64), rays.d.astype(np.float64)
    enters, leaves = inside_box(triangles.bounds.astype(np.float64), o, d)
    ends = np.minimum(np.minimum(hits.t, rays.tmax), leaves)
    # Distances along a ray are in lengths of its direction.
    length = np.maximum(ends - np.maximum(enters, 0), 0) * np.linalg.norm(d, axis=1)
    return float(length.mean() / (4 * x * y * z / surface))


def estimate_alpha(length_ratio: float) -> float:
    """Alpha without measuring any tree: ``1 / (1 + s)``, derived in ``docs/alpha.md``.

    Parameters
    ----------
    length_ratio : float
        ``s`` from :func:`path_length_ratio`.

    Returns
    -------
    float
        From 0 to 1.
    """
    return 1.0 / (1.0 + length_ratio)


def finite_ray_cost(
    sah: npt.ArrayLike, point_query: npt.ArrayLike, length_ratio: float
) -> npt.NDArray[np.float64]:
    """Cost of a ray of finite length, with nothing fitted: ``s SAH + Q``.

    A ray visits the nodes that contain its start, and those that it enters on its way. The former
    cost a point query, ``Q``. The latter cost what the surface area heuristic says for a long ray,
    times the share ``s`` of a long ray that this one covers. Derived in ``docs/alpha.md``.

    Parameters
    ----------
    sah, point_query : (K,) array
        One per tree. The point query is the mean cost of all nodes that contain a ray's start.
    length_ratio : float
        ``s`` from :func:`path_length_ratio`.

    Returns
    -------
    (K,) float64
        In units of the cost constants. It ranks the trees of a scene; its level may be off by a
        factor that they share.
    """
    return length_ratio * np.asarray(sah, np.float64) + np.asarray(point_query, np.float64)


def fitted_combination(
    columns: Sequence[npt.ArrayLike], measured: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Linear combination with non-negative weights that correlates best with a measurement.

    Parameters
    ----------
    columns : list of (K,) array
        For instance SAH, EPO and LCV.
    measured : (K,) array

    Returns
    -------
    (K,) float64
        The combination's values, on the measurement's scale.
    """
    y = np.asarray(measured, np.float64)
    x = np.stack([np.asarray(c, np.float64) for c in columns], axis=1)
    return (x - x.mean(axis=0)) @ combination_weights(x, y) + y.mean()


def combination_weights(
    columns: npt.NDArray[np.float64], measured: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Weights of that combination: non-negative least squares with a constant.

    Parameters
    ----------
    columns : (K, C) array
    measured : (K,) array

    Returns
    -------
    (C,) float64
    """
    from scipy import optimize  # slow to import

    weights, _ = optimize.nnls(columns - columns.mean(axis=0), measured - measured.mean())
    return np.asarray(weights)


def bootstrap_interval(
    predicted: npt.ArrayLike, groups: npt.ArrayLike, confidence: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Confidence interval of Pearson's r over the rays.

    Parameters
    ----------
    predicted : (K,) array
        Per tree.
    groups : (K, G) array
        Mean cost of each tree over each of G random groups of rays; the groups are resampled.
    confidence : float
    seed : int

    Returns
    -------
    low, high : float
        NaN where r is not defined.
    """
    x, y = np.asarray(predicted, np.float64), np.asarray(groups, np.float64)
    if np.isnan(pearson(x, y.mean(axis=1))):
        return float("nan"), float("nan")
    x, means = x - x.mean(), _resampled(y.tobytes(), y.shape, seed)
    size = np.sqrt((x @ x) * (means * means).sum(axis=0))
    r = (x @ means)[size > 0] / size[size > 0]  # of few rays, a draw may be of those that miss
    if not len(r):
        return float("nan"), float("nan")
    low, high = np.quantile(r, [0.5 - confidence / 2, 0.5 + confidence / 2])
    return float(low), float(high)


@functools.lru_cache(maxsize=4)
def _resampled(groups: bytes, shape: tuple[int, int], seed: int) -> F64:
    """(K, 1000): means over drawn groups, less the mean of the trees; one for all predictors."""
    y = np.frombuffer(groups, np.float64).reshape(shape)
    drawn = np.random.default_rng(seed).integers(0, shape[1], (1000, shape[1]))
    means = y[:, drawn].mean(axis=2)
    return means - means.mean(axis=0)


def fisher_interval(r: float, trees: int, confidence: float = 0.95) -> tuple[float, float]:
    """Confidence interval of Pearson's r over so few trees, by Fisher's transformation.

    The trees count as a sample of all that could be built. It is exact for normal values, and wide
    where they are few: over nine trees an r of 0.95 may be one of 0.77.

    Parameters
    ----------
    r : float
    trees : int
    confidence : float

    Returns
    -------
    low, high : float
        NaN for fewer than four trees.
    """
    if trees < 4 or not np.isfinite(r):
        return float("nan"), float("nan")
    from scipy import special  # slow to import

    half = float(special.ndtri(0.5 + confidence / 2)) / np.sqrt(trees - 3)
    centre = np.arctanh(np.clip(r, -1 + 1e-15, 1 - 1e-15))
    return float(np.tanh(centre - half)), float(np.tanh(centre + half))


def rank_correlations(predicted: npt.ArrayLike, measured: npt.ArrayLike) -> tuple[float, float]:
    """Spearman's and Kendall's rank correlation (tau-b), from the signs of all differences.

    The row sums of the signs are twice the centred ranks, equal values sharing theirs (H. E.
    Daniels, Biometrika 1944). ``scipy.stats`` says the same, but takes a second to import and ten
    times as long for a few trees, mostly for p-values.

    Parameters
    ----------
    predicted, measured : (K,) array
        Finite values.

    Returns
    -------
    spearman, kendall : float
        NaN where all values are equal, and for fewer than two.
    """
    values = (np.asarray(v, np.float64) for v in (predicted, measured))
    x, y = (np.sign(v[:, None] - v) for v in values)
    pairs = [int((signs != 0).sum()) // 2 for signs in (x, y)]  # that are not tied
    if not all(pairs):
        return float("nan"), float("nan")
    spearman = float(np.corrcoef(x.sum(axis=1), y.sum(axis=1))[1, 0])
    kendall = float((x * y).sum() / 2 / np.sqrt(pairs[0]) / np.sqrt(pairs[1]))
    return spearman, min(max(kendall, -1.0), 1.0)


def agreement(predicted: npt.ArrayLike, measured: npt.ArrayLike) -> dict[str, Any]:
    """How well a predictor explains a measurement over the trees of a scene.

    Returns
    -------
    dict
        ``trees`` (their number), ``pearson``, ``spearman``, ``kendall``, ``without_worst`` (the
        Pearson r without the tree that changes it most, as one absurd tree raises every r; NaN
        where the others are all alike), and ``worst_error`` (largest relative error of the
        least-squares line).
    """
    x, y = np.asarray(predicted, np.float64), np.asarray(measured, np.float64)
    result: dict[str, Any] = {"trees": len(x), "pearson": pearson(x, y)}
    for name in ("spearman", "kendall", "without_worst", "worst_error"):
        result[name] = float("nan")
    if np.isnan(result["pearson"]):
        return result
    result["spearman"], result["kendall"] = rank_correlations(x, y)
    if len(x) > 3:
        kept = ~np.eye(len(x), dtype=bool)
        others = [pearson(x[rest], y[rest]) for rest in kept]
        # Where nothing varies without a tree, r is that tree's alone: no change is greater.
        change = np.nan_to_num(np.abs(np.array(others) - result["pearson"]), nan=np.inf)
        result["without_worst"] = others[int(change.argmax())]
    (variance, covariance), _ = np.cov(x, y, bias=True)
    slope = covariance / variance
    line = y.mean() - slope * x.mean() + slope * x
    result["worst_error"] = float(np.abs(line / y - 1).max())
    return result
