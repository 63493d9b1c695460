import dataclasses

import numpy as np
import pytest
from conftest import closed_box, scene_record, soup, tree_row
from scipy import stats

import mibvh
from mibvh.metrics.predictor import (
    agreement,
    bootstrap_interval,
    estimate_alpha,
    finite_ray_cost,
    fit_alpha,
    fitted_combination,
    path_length_ratio,
    pearson,
    predict,
    rank_correlations,
)
from mibvh.metrics.predictors import predictor
from mibvh.metrics.sah import node_costs
from mibvh.studies.analyse.calibration import calibrate
from mibvh.studies.record.scene import samples


def test_fit_alpha_recovers_the_mixture():
    rng = np.random.default_rng(0)
    sah, epo = rng.random((2, 9))
    measured = 3 * predict(sah, epo, 0.7) + 5
    assert fit_alpha(sah, epo, measured) == pytest.approx(0.7, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_fit_alpha_is_the_best_of_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    sah, epo = rng.random((2, 9))
    measured = rng.normal(0.2, 1) * sah + rng.normal(0.2, 1) * epo + 0.3 * rng.random(9)
    best = max(pearson(predict(sah, epo, a), measured) for a in np.linspace(0, 1, 2001))
    alpha = fit_alpha(sah, epo, measured)
    assert 0 <= alpha <= 1
    assert pearson(predict(sah, epo, alpha), measured) == pytest.approx(best, abs=1e-5)


def test_too_few_trees_have_no_correlation():
    assert np.isnan(pearson([1, 2], [3, 4]))
    assert np.isnan(pearson([1, 1, 1], [3, 4, 5]))
    assert np.isnan(fit_alpha([1, 2, 3, 4], [1, 3, 2, 4], [3, 4, 1, 2]))


def test_rounding_is_no_variation():
    rng = np.random.default_rng(7)
    values = 2 * (1 + 1e-9 * rng.standard_normal(9))
    assert np.isnan(pearson(values, rng.random(9)))
    assert np.isnan(pearson(rng.random(9), [np.nan] * 9))
    assert np.isfinite(pearson(2 + 1e-5 * rng.random(9), rng.random(9)))


def test_step_costs_want_trees():
    tree = tree_row(inner_per_ray=3.0, triangles_per_ray=2.0, scalar_ns=9.0)
    found = calibrate([scene_record([tree] * 4)])
    assert found.trees == 4
    assert np.isnan(found.c_inner)


def test_agreement_names_the_absurd_tree():
    """Eight unrelated trees and a terrible one: a high r that vanishes without it."""
    rng = np.random.default_rng(3)
    x, y = np.append(rng.random(8), 50), np.append(rng.random(8), 50)
    found = agreement(x, y)
    assert found["trees"] == 9
    assert found["pearson"] > 0.99
    assert abs(found["without_worst"]) < 0.9
    # Without the last tree all cost the same: the whole r is that tree's.
    alone = agreement([5.0, 5.1, 5.2, 5.3, 17.0], [1.2, 1.2, 1.2, 1.2, 13.2])
    assert alone["pearson"] > 0.99
    assert np.isnan(alone["without_worst"])
    line = agreement([1, 2, 3, 4], [2, 4, 6, 8])
    assert line["worst_error"] == pytest.approx(0, abs=1e-12)
    assert line["spearman"] == pytest.approx(1)
    assert line["kendall"] == pytest.approx(1)


def test_no_alpha_is_fitted_to_rounding_errors():
    """Equal values differ by their rounding; less their mean, that is all there is of them."""
    rng = np.random.default_rng(0)
    same = 100.0 * (1 + 1e-13 * rng.standard_normal((3, 9)))
    assert np.isnan(fit_alpha(*same))
    assert np.isnan(fit_alpha(rng.random(9), rng.random(9), same[0]))


@pytest.mark.parametrize("seed", range(12))
def test_correlations_are_those_of_scipy(seed):
    """Ranks with ties and without, values of any scale, few trees and many."""
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 30))
    x, y = random.normal(size=(2, count)) * 10.0 ** random.integers(-9, 9, (2, 1))
    if seed % 2:  # ties
        x, y = np.round(x / np.ptp(x) * 4), np.round(y / np.ptp(y) * 6)
    spearman, kendall = rank_correlations(x, y)
    assert spearman == pytest.approx(stats.spearmanr(x, y).statistic, abs=1e-14)
    assert kendall == pytest.approx(stats.kendalltau(x, y).statistic, abs=1e-14)
    assert pearson(x, y) == pytest.approx(stats.pearsonr(x, y).statistic, abs=1e-12)
    line = stats.linregress(x, y)
    wrong = np.abs((line.intercept + line.slope * x) / np.where(y, y, np.nan) - 1)
    if np.isfinite(wrong).all():
        assert agreement(x, y)["worst_error"] == pytest.approx(wrong.max(), rel=1e-9)


def test_ranks_of_equal_values_do_not_correlate():
    for x, y in ([1, 1, 1], [1, 2, 3]), ([1, 2, 3], [2, 2, 2]), ([1], [1]):
        assert np.isnan(rank_correlations(x, y)).all()


def test_intervals_over_other_groups_are_not_those_of_the_last_ones():
    """The drawn groups are kept, by what they hold."""
    random = np.random.default_rng(0)
    x, noise = np.arange(9.0), random.normal(size=(9, 32))
    near, far = (x[:, None] + scale * noise for scale in (0.1, 3.0))
    first = bootstrap_interval(x, near)
    assert bootstrap_interval(x, far)[0] < first[0]
    assert bootstrap_interval(x, near) == first
    assert bootstrap_interval(x, near, seed=1) != first


def test_fitted_combination_takes_no_negative_weight():
    rng = np.random.default_rng(0)
    a, b, c = rng.random((3, 9))
    np.testing.assert_allclose(fitted_combination([a, b, c], a + 2 * b + 3 * c), a + 2 * b + 3 * c)
    only_a = fitted_combination([a, -a], 5 * a)
    assert pearson(only_a, a) == pytest.approx(1)


def test_bootstrap_interval_covers_r():
    """For one set of trees, the interval of r holds the r of far more rays."""
    rng = np.random.default_rng(0)
    predicted = rng.random(8)
    true_cost = predicted + 0.1 * rng.random(8)
    r, held = pearson(predicted, true_cost), 0
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(size=(8, 64))
        low, high = bootstrap_interval(predicted, true_cost[:, None] + 0.5 * noise, seed=seed)
        held += low <= r + 0.01 and high >= r - 0.05
        assert low <= high
    assert held >= 45


def test_path_length_in_a_closed_cube_by_hand():
    """In a unit cube (mean chord 2/3) rays end at the walls."""
    box = mibvh.Triangles(closed_box())
    o = np.array([[0.5, 0.5, 0.25], [0.5, 0.5, 0.5]], np.float32)
    d = np.array([[0, 0, 1], [1, 0, 0]], np.float32)
    zeros = np.zeros(2, np.int32)
    rays = mibvh.RaySet(o, d, np.full(2, np.inf, np.float32), zeros, zeros, zeros)
    hits = mibvh.trace(mibvh.build(box, "bbvh"), box, rays, repeats=1)
    assert path_length_ratio(box, rays, hits) == pytest.approx((0.75 + 0.5) / 2 / (2 / 3))
    assert estimate_alpha(1.0) == 0.5


def test_path_length_of_directions_of_any_length():
    """Distances are in lengths of the direction; the ratio is of lengths in the scene."""
    box = mibvh.Triangles(closed_box())
    o = np.full((2, 3), 0.5, np.float32)
    d = np.array([[0, 0, 1], [1, 0, 0]], np.float32)
    ratios = []
    for length in (1.0, 4.0):
        rays = mibvh.RaySet(o, d * np.float32(length))
        hits = mibvh.trace(mibvh.build(box, "bbvh"), box, rays, repeats=1)
        ratios.append(path_length_ratio(box, rays, hits))
    assert ratios == pytest.approx([0.75, 0.75])


@pytest.mark.slow
def test_finite_rays_are_predicted_without_a_fit():
    """The derivation's own case: segments of one length, of any place and direction.

    Starts are even in a box that holds all segments that touch the tree; counted per volume of
    the root, the nodes touched are those that hold the start and those that are entered.
    """
    rng = np.random.default_rng(0)
    triangles = soup(1000, 1, 0.05)
    tree = mibvh.build(triangles, "lbvh")
    lower, upper = triangles.bounds.astype(float)
    length, count = 0.4, 40000
    o = lower - length + (upper - lower + 2 * length) * rng.random((count, 3))
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    touched, holds = np.zeros(count), np.zeros(count)
    for node, cost in enumerate(node_costs(tree)):
        a, b = (tree.lower[node] - o) / d, (tree.upper[node] - o) / d
        near, far = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
        touched += cost * ((near <= far) & (near <= length) & (far >= 0))
        holds += cost * ((near <= 0) & (far >= 0))
    x, y, z = upper - lower
    per_root = np.prod(upper - lower + 2 * length) / (x * y * z)
    ratio = length / (4 * x * y * z / (2 * (x * y + y * z + z * x)))
    predicted = finite_ray_cost([mibvh.sah(tree)], [holds.mean() * per_root], ratio)[0]
    assert predicted == pytest.approx(touched.mean() * per_root, rel=0.03)
    assert 0.2 < holds.mean() / touched.mean() < 0.8  # both parts matter


@pytest.mark.parametrize("seed", range(5))
def test_fit_alpha_beside_a_fixed_part_is_the_best_of_a_fine_grid(seed):
    rng = np.random.default_rng(seed)
    sah, epo, lcv, noise = rng.random((4, 9))
    measured = predict(sah, epo, rng.random()) + rng.normal(0, 2) * lcv + noise
    r = [pearson(predict(sah, epo, a) + 0.7 * lcv, measured) for a in np.linspace(0, 1, 2001)]
    alpha = fit_alpha(sah, epo, measured, 0.7 * lcv)
    found = pearson(predict(sah, epo, alpha) + 0.7 * lcv, measured)
    assert found == pytest.approx(max(r), abs=1e-5)


def lcv_scene(seed, weight):
    """A scene's record whose cost is SAH, EPO and LCV, the last at ``weight``."""
    rng = np.random.default_rng(seed)
    sah, epo, lcv = rng.random((3, 9))
    cost = predict(sah, epo, 0.4) + weight * lcv
    names = ("sah", "epo", "lcv", "counted_cost")
    rows = zip(sah, epo, lcv, cost, strict=True)
    return scene_record([tree_row(**dict(zip(names, row, strict=True))) for row in rows])


def test_the_fixed_weight_of_lcv_of_a_scene_comes_from_the_others():
    """Scenes with a weight of 2, and one with a weight of 20 that does not fit its own."""
    records = [lcv_scene(seed, 2.0) for seed in range(5)] + [lcv_scene(5, 20.0)]
    known = samples(records, "counted_cost")
    shared, others = predictor("LCV fixed"), predictor("LCV from others")
    assert len({shared.fit(known, i)["beta"] for i in range(6)}) == 1
    betas = [others.fit(known, i)["beta"] for i in range(6)]
    assert betas[5] == pytest.approx(2, rel=0.15)  # on the grid of weights
    assert betas[0] > betas[5]
    assert shared.fit(known[:1], 0)["beta"] == pytest.approx(2, rel=0.15)
    assert np.isnan(others.fit(known[:1], 0)["beta"])


def test_step_costs_and_how_well_they_are_known():
    rng = np.random.default_rng(3)
    steps = rng.random((40, 2))
    ns = 6 * steps[:, 0] + 4 * steps[:, 1] + 10
    trees = timed_trees(steps, ns)
    exact = calibrate([scene_record(trees[:20]), scene_record(trees[20:])])
    assert [exact.c_inner, exact.c_inner_low, exact.c_inner_high] == pytest.approx([1.5] * 3)
    assert exact.mean_error == pytest.approx(0, abs=1e-9)
    noisy = calibrate([scene_record(timed_trees(steps, ns * rng.uniform(0.9, 1.1, 40)))])
    assert noisy.c_inner_low < 1.5 < noisy.c_inner_high
    assert noisy.c_inner_high - noisy.c_inner_low > 0.1


def timed_trees(steps, ns):
    """Trees whose rays take so many inner nodes and triangle tests (a row each), and a time."""
    return [
        tree_row(inner_per_ray=inner, triangles_per_ray=tests, scalar_ns=time)
        for (inner, tests), time in zip(steps, ns, strict=True)
    ]


def test_trees_of_one_scene_do_not_tell_more_of_step_costs_for_being_many():
    """Scenes whose steps cost differently: more trees of each do not narrow the interval."""
    rng = np.random.default_rng(5)
    widths = []
    for trees in (8, 128):
        records = []
        for inner, test in zip(rng.permutation(np.linspace(3, 9, 12)), [4.0] * 12, strict=True):
            steps = rng.random((trees, 2))
            records.append(scene_record(timed_trees(steps, steps @ [inner, test])))
        found = calibrate(records)
        widths.append(found.c_inner_high - found.c_inner_low)
    assert widths[1] > 0.6 * widths[0]


def test_only_what_lies_in_the_box_counts_for_the_path_length():
    """Rays from outside the unit cube, past it, and with an end of their own; mean chord 2/3."""
    box = mibvh.Triangles(closed_box())
    o = np.array([[0.5, 0.5, -3], [0.5, 5, -3], [0.5, 0.5, 0.25]], np.float32)
    d = np.array([[0, 0, 1], [0, 0, 1], [0, 1, 0]], np.float32)
    zeros = np.zeros(3, np.int32)
    tmax = np.array([np.inf, np.inf, 0.125], np.float32)
    rays = mibvh.RaySet(o, d, tmax, zeros, zeros, zeros)
    hits = mibvh.trace(mibvh.build(box, "bbvh"), box, rays, repeats=1)
    # The first ends where it enters, the second misses, the third ends by itself.
    assert path_length_ratio(box, rays, hits) == pytest.approx(0.125 / 3 / (2 / 3))
    all_miss = dataclasses.replace(hits, t=np.full(3, np.inf, np.float32))
    assert path_length_ratio(box, rays, all_miss) == pytest.approx((1 + 0.125) / 3 / (2 / 3))
