import numpy as np
import pytest

from mibvh.metrics.predictor import agreement, fit_alpha, pearson, predict


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
    assert np.isnan(fit_alpha([1, 2], [1, 2], [3, 4]))


def test_agreement_names_the_absurd_tree():
    """Eight unrelated trees and a terrible one: a high r that vanishes without it."""
    rng = np.random.default_rng(3)
    x, y = np.append(rng.random(8), 50), np.append(rng.random(8), 50)
    found = agreement(x, y)
    assert found["trees"] == 9
    assert found["pearson"] > 0.99
    assert abs(found["without_worst"]) < 0.9
    line = agreement([1, 2, 3, 4], [2, 4, 6, 8])
    assert line["worst_error"] == pytest.approx(0, abs=1e-12)
    assert line["spearman"] == pytest.approx(1)
    assert line["kendall"] == pytest.approx(1)
