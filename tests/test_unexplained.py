"""Noise and LCV in what is left unexplained, against simulated times of known noise."""

import numpy as np
import pytest
from conftest import scene_record, tree_row

from mibvh.metrics.predictor import pearson
from mibvh.studies.analyse.noise import noise_share, reliability, simd_deviation


def test_reliability_tells_the_correlation_that_noise_leaves():
    """Values measured with known errors: r with the true ones is the root of the reliability."""
    rng = np.random.default_rng(1)
    true = rng.normal(10, 1, 20_000)
    errors = rng.uniform(0.2, 0.8, len(true))
    measured = true + errors * rng.standard_normal(len(true))
    assert pearson(true, measured) == pytest.approx(
        np.sqrt(reliability(measured, errors)), abs=0.005
    )
    assert reliability(measured, 0 * errors) == 1
    assert reliability(measured, 9 + errors) == 0
    assert np.isnan(reliability(np.ones(5), np.ones(5)))


def test_share_of_noise_in_what_a_predictor_misses():
    """A predictor that is itself 0.9 right, of values of reliability 0.8."""
    rng = np.random.default_rng(2)
    true = rng.standard_normal(50_000)
    predictor = 0.9 * true + np.sqrt(1 - 0.81) * rng.standard_normal(len(true))
    measured = true + 0.5 * rng.standard_normal(len(true))
    r = pearson(predictor, measured)
    assert r * r == pytest.approx(0.81 * 0.8, abs=0.01)
    share = (0.81 - 0.81 * 0.8) / (1 - 0.81 * 0.8)
    assert noise_share(r, 0.8) == pytest.approx(share, abs=0.02)
    assert noise_share(0.9, 1.0) == 0
    assert noise_share(0.95, 0.8) == 1  # better than noise allows: by chance
    assert np.isnan(noise_share(float("nan"), 0.8))


def test_lcv_and_the_deviation_of_simd():
    rng = np.random.default_rng(3)
    lcv = rng.uniform(1, 3, 9)
    scalar = rng.uniform(100, 200, 9)
    simd = 0.2 * scalar * np.exp(0.1 * lcv)

    def record(simd_error):
        return scene_record(
            [
                tree_row(lcv=v, scalar_ns=s, simd_ns=m, scalar_error=0.001, simd_error=simd_error)
                for v, s, m in zip(lcv, scalar, simd, strict=True)
            ]
        )

    (row,) = simd_deviation([record(0.001)]).to_dict("records")
    assert row["explained"] == pytest.approx(1)
    assert row["deviation"] == pytest.approx(0.1 * np.abs(lcv - lcv.mean()).mean())
    assert 0 < row["noise"] < 0.01
    assert simd_deviation([record(1.0)])["noise"].item() == 1
