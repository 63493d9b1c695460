"""Predictors over all scenes at once, held out by scene and by builders; the level in pieces."""

import numpy as np
import pytest
from conftest import scene_record, tree_row

from mibvh.metrics.predictor import fisher_interval
from mibvh.metrics.predictors import Sample, predictor
from mibvh.studies.analyse.left_out import predicted_from_others
from mibvh.studies.analyse.level import level_pieces
from mibvh.studies.analyse.pooled import family, pooled
from mibvh.studies.record.quantities import quantities

BUILDERS = ("bbvh", "sbvh", "agglo", "lbvh", "hill", "anneal", "bittner", "treelet", "streelet")
COUNTED = quantities()["counted_cost"]


def scene(name, alpha, level=1.0, noise=0.0, seed=0):
    """A scene whose cost is the paper's formula, times a level and some noise."""
    rng = np.random.default_rng(seed)
    sah, epo = rng.uniform(20, 60, 9), rng.uniform(1, 30, 9)
    cost = level * ((1 - alpha) * sah + alpha * epo) * np.exp(noise * rng.standard_normal(9))
    return scene_record(
        [
            tree_row(b, sah=s, epo=e, counted_cost=c)
            for b, s, e, c in zip(BUILDERS, sah, epo, cost, strict=True)
        ],
        name,
    )


def rows(records, *names):
    table = pooled(records, COUNTED, [predictor(name) for name in names])
    return table.set_index("predictor")


def test_scenes_of_another_level_do_not_make_an_r():
    """SAH predicts nothing within these scenes, but the scenes' levels differ by a factor."""
    rng = np.random.default_rng(5)
    records = [
        scene_record(
            [
                tree_row(b, sah=k * s, epo=1.0 + s, counted_cost=k * c)
                for b, s, c in zip(
                    BUILDERS, rng.uniform(9, 11, 9), rng.uniform(9, 11, 9), strict=True
                )
            ],
            str(k),
        )
        for k in (1, 10, 100, 1000)
    ]
    x, y = (
        np.concatenate([r.column(n) / r.column(n).mean() for r in records])
        for n in ("sah", "counted_cost")
    )
    found = rows(records, "SAH").loc["SAH"]
    assert found["pooled"] == pytest.approx(np.corrcoef(x, y)[0, 1])
    assert abs(found["pooled"]) < 0.5
    together = [np.concatenate([r.column(n) for r in records]) for n in ("sah", "counted_cost")]
    assert np.corrcoef(together)[0, 1] > 0.99  # what it would be without


def test_weights_of_other_scenes():
    alike = rows([scene("a", 0.5), scene("b", 0.5, 7.0, seed=1)], "fitted").loc["fitted"]
    assert alike[["mean", "pooled", "by_scene", "by_family"]].tolist() == pytest.approx([1] * 4)
    assert alike["family_error"] == pytest.approx(0, abs=1e-9)
    other = [scene("a", 0.05), scene("b", 0.95, seed=1), scene("c", 0.9, seed=2)]
    found = rows(other, "fitted").loc["fitted"]
    assert found["mean"] == pytest.approx(1)
    assert found["by_scene"] < 0.9
    values = [
        (1 - alpha) * r.column("sah") + alpha * r.column("epo")
        for r, alpha in zip(other, (0.925, 0.475, 0.5), strict=True)  # means of the two others
    ]
    x = np.concatenate([v / v.mean() for v in values])
    y = np.concatenate([r.column("counted_cost") / r.column("counted_cost").mean() for r in other])
    assert found["by_scene"] == pytest.approx(np.corrcoef(x, y)[0, 1])


def test_a_weight_of_all_scenes_is_fitted_without_the_one_it_is_judged_on():
    """Two scenes want an alpha of 0.9, one of 0.1; it gets theirs, and they one between."""
    records = [scene("a", 0.1), scene("b", 0.9, seed=1), scene("c", 0.9, seed=2)]
    found = rows(records, "fixed best").loc["fixed best"]
    without = [rows(records[:i] + records[i + 1 :], "fixed best") for i in range(3)]
    assert without[0].loc["fixed best", "mean"] == pytest.approx(1)
    shared = [best_alpha(records[:i] + records[i + 1 :]) for i in range(3)]
    assert shared[0] == pytest.approx(0.9)
    values = [
        (1 - alpha) * r.column("sah") + alpha * r.column("epo")
        for r, alpha in zip(records, shared, strict=True)
    ]
    x = np.concatenate([v / v.mean() for v in values])
    y = np.concatenate(
        [r.column("counted_cost") / r.column("counted_cost").mean() for r in records]
    )
    assert found["by_scene"] == pytest.approx(np.corrcoef(x, y)[0, 1])


def best_alpha(records):
    """Of greatest mean r, in steps of a hundredth."""
    alphas = np.linspace(0, 1, 101)
    r = [
        [
            np.corrcoef((1 - a) * s.column("sah") + a * s.column("epo"), s.column("counted_cost"))[
                0, 1
            ]
            for a in alphas
        ]
        for s in records
    ]
    return alphas[np.mean(r, axis=0).argmax()]


def test_other_builders_are_of_other_families():
    assert family("bittner(start=sbvh)") == family("bittner") == "bittner"
    assert family("sbvh") == family("bbvh")
    assert family("mine") == "mine"
    record = scene("a", 0.5, noise=0.1)
    found = rows([record], "SAH").loc["SAH"]
    sah, cost = record.column("sah"), record.column("counted_cost")
    groups = np.array([family(b) for b in BUILDERS])
    predicted = np.empty(9)
    for name in set(groups):
        kept = groups != name
        slope, base = np.polyfit(sah[kept], cost[kept], 1)
        predicted[~kept] = base + slope * sah[~kept]
    assert found["by_family"] == pytest.approx(np.corrcoef(predicted, cost)[0, 1])
    assert found["family_error"] == pytest.approx(np.abs(predicted / cost - 1).mean())


def test_the_interval_of_an_r_over_few_trees():
    """Over samples of nine, 95% of the intervals hold the true correlation."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(2000):
        x = rng.standard_normal(9)
        y = 0.8 * x + 0.6 * rng.standard_normal(9)
        low, high = fisher_interval(float(np.corrcoef(x, y)[0, 1]), 9)
        held += low <= 0.8 <= high
    assert held / 2000 == pytest.approx(0.95, abs=0.015)
    assert fisher_interval(0.95, 9) == pytest.approx((0.775, 0.990), abs=5e-4)
    assert np.isnan(fisher_interval(0.9, 3)).all()


def test_pieces_of_the_level_multiply_to_it():
    values = {
        "sah": 20.0,
        "point_query": 6.0,
        "length_ratio": 0.5,
        "sah_lines": 30.0,
        "line_share": 0.6,
        "touched": 12.0,
        "counted_cost": 15.0,
        "hit_share": 0.7,
    }
    record = scene_record([tree_row("bbvh", **values)])
    found = level_pieces([record]).iloc[0]
    assert found["level"] == pytest.approx(16 / 15)
    assert found["which_lines"] == pytest.approx(16 / 24)
    assert found["along"] == pytest.approx(24 / 12)
    assert found["order"] == pytest.approx(12 / 15)
    assert found["which_lines"] * found["along"] * found["order"] == pytest.approx(found["level"])
    assert level_pieces([scene("a", 0.5)]).empty


def test_a_tree_that_is_left_out_is_predicted_by_alpha_and_a_line_of_the_others():
    """Against all alphas in steps of a thousandth; SAH gets no negative weight here."""
    rng = np.random.default_rng(3)
    values = {"sah": rng.uniform(20, 60, 9), "epo": rng.uniform(1, 30, 9)}
    measured = 40 - 0.2 * values["sah"] + 2 * values["epo"] + rng.standard_normal(9)
    found = predicted_from_others(predictor("fitted"), [Sample(values, measured)], 0, np.arange(9))
    for i in range(9):
        kept = np.arange(9) != i
        mixes = [(1 - a) * values["sah"] + a * values["epo"] for a in np.linspace(0, 1, 1001)]
        best = max(mixes, key=lambda mix: np.corrcoef(mix[kept], measured[kept])[0, 1])
        expected = np.polyval(np.polyfit(best[kept], measured[kept], 1), best[i])
        assert found[i] == pytest.approx(expected, rel=2e-3)
    few = {name: v[:3] for name, v in values.items()}
    assert np.isnan(
        predicted_from_others(predictor("fitted"), [Sample(few, measured[:3])], 0, np.arange(3))
    ).all()
