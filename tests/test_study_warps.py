"""Warp cost in a study: simulated, kept, audited, predicted, and what the claims make of it."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from conftest import scene_record, tree_row

import mibvh
from mibvh.metrics.predictors import predictor
from mibvh.studies.analyse.correlations import correlations
from mibvh.studies.analyse.warps import (
    deviation_by_builder,
    deviation_by_scene,
    explained,
    warp_deviation,
)
from mibvh.studies.measure import warps
from mibvh.studies.measure.store import Store
from mibvh.studies.paper.claims.simd import simd_claims
from mibvh.studies.record.claim import FEWEST_SCENES, Claim
from mibvh.studies.record.quantities import targets
from mibvh.studies.report.tables import answers
from mibvh.studies.report.tidy import tidy_table
from mibvh.traversal.divergence import simd_cost
from mibvh.traversal.warp import simulate

BUILDERS = ("bbvh", "sbvh", "lbvh")
CHOICES = {
    "width": 24,
    "height": 16,
    "scalar_rays": 256,
    "seconds": 0.0,
    "builders": BUILDERS,
    "experiments": ("prediction",),
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory, cornell):
    """Return a study with the warps of the paper's kernel."""
    return mibvh.study([cornell], tmp_path_factory.mktemp("warps"), **CHOICES)


@pytest.fixture(scope="module")
def rays(cornell):
    return mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)


# ------------------------------------------------------------------ measured


def test_runs_stay_together_and_are_spread_over_the_set():
    assert warps.simulated_rays(100_000, 32).tolist() == list(range(100_000))
    places = warps.simulated_rays(249_984, 32)
    assert len(places) <= warps.MOST_RAYS + 32
    runs = places.reshape(-1, 32)
    assert (np.diff(runs, axis=1) == 1).all()
    assert (runs[:, 0] == np.arange(len(runs)) * 3 * 32).all()
    assert warps.simulated_rays(250_003, 1).tolist() == list(range(0, 250_003, 3))


def test_values_are_those_of_the_simulation(finished, cornell, rays):
    for tree in finished.scenes[0].trees:
        found = simulate(mibvh.build(cornell.triangles, tree.builder), cornell, rays)
        assert tree["warp_cost"] == found.cost()
        assert tree["warp_utilisation"] == found.utilisation()
        assert tree["warp_scalar_cost"] == pytest.approx(tree["counted_cost"], rel=1e-12)
        assert tree["warp_overhead"] == tree["warp_cost"] / tree["warp_scalar_cost"] > 1.5


def test_cost_deviation_is_of_the_rays(finished, cornell, rays):
    for tree in finished.scenes[0].trees:
        built = mibvh.build(cornell.triangles, tree.builder)
        hits = mibvh.trace(built, cornell, rays, repeats=1)
        costs = 1.2 * hits.inner + hits.tests
        assert tree["cost_deviation"] == pytest.approx(costs.std(), rel=1e-12)
        values = {name: np.array([tree[name]]) for name in tree.values}
        for name, leaves in (("spread", None), ("spread and LCV", hits.leaves)):
            (predicted,) = predictor(name).predict(values, {})
            assert predicted == pytest.approx(simd_cost(costs, leaves), rel=1e-12)


def test_other_rules_simulate_anew_and_nothing_else(finished, cornell):
    """Warps of one lane cost what is counted; only the warps are made, and the audit of them."""
    again = mibvh.study([cornell], finished.folder, warp_width=1, warp_style="single", **CHOICES)
    assert again.table["warp_cost"].tolist() == again.table["warp_scalar_cost"].tolist()
    assert again.table["warp_utilisation"].tolist() == [1, 1, 1]
    reused = again.scenes[0].reused
    assert {name: reused[name] for name in ("trees", "metrics", "counts")} == {
        "trees": 3,
        "metrics": 3,
        "counts": 3,
    }
    assert reused.get("warps", 0) == 0
    back = mibvh.study([cornell], finished.folder, **CHOICES)
    assert back.scenes[0].reused["warps"] == 3
    assert back.table["warp_cost"].tolist() == finished.table["warp_cost"].tolist()


def test_a_part_of_the_rays_is_audited_against_the_kernel(cornell, tmp_path, monkeypatch):
    monkeypatch.setattr(warps, "MOST_RAYS", 300)
    found = mibvh.study([cornell], tmp_path, **CHOICES)
    assert found.failures == []
    assert {check.name for check in found.scenes[0].trees[0].audit} >= {"warps", "lanes"}
    table = tidy_table(found.scenes).query("measurement == 'warp_cost'")
    assert 0 < table["rays"].iloc[0] < found.scenes[0].rays.count
    assert (table["rays"] % 32 == 0).all()
    store = Store(tmp_path / "cache")
    for path in (tmp_path / "cache").glob("warps-*.json"):
        kept = store.read(path.stem)
        kept["values"]["warp_scalar_cost"] *= 1.001
        store.write(path.stem, kept)
    wrong = mibvh.study([cornell], tmp_path, **CHOICES)
    assert [(tree, check.name) for _, tree, check in wrong.failures] == [
        (builder, "warps") for builder in BUILDERS
    ]


def test_impossible_warps():
    with pytest.raises(mibvh.MibvhError, match="the warp width must be one of 1, 2, 4"):
        mibvh.StudyOptions(warp_width=3)
    with pytest.raises(mibvh.MibvhError, match="the warp style must be one of single, while-while"):
        mibvh.StudyOptions(warp_style="packet")


# ------------------------------------------------------------------ shown


def test_warp_cost_is_predicted_drawn_and_listed(finished):
    assert [target.name for target in targets()] == [
        "counted_cost",
        "scalar_ns",
        "simd_ns",
        "warp_cost",
    ]
    of_warps = finished.correlations.query("measurement == 'warp_cost'").set_index("predictor")
    r = np.corrcoef(finished.table["sah"], finished.table["warp_cost"])[0, 1]
    assert of_warps.loc["SAH", "pearson"] == pytest.approx(r)
    assert "spread" in of_warps.index
    name = finished.scenes[0].scene
    assert (finished.folder / "figures" / f"{name}-warp.svg").exists()
    sheets = {sheet.name: sheet for sheet in answers(finished.scenes, finished.correlations)}
    assert {"warp-deviation", "warp-deviation-scenes"} <= set(sheets)
    assert "warp_cost_mean" in sheets["overview"].keys
    assert "warp cost" in set(sheets["r"].frame["measured"])
    page = finished.report.read_text()
    assert "Warp cost against scalar: deviation by builder" in page
    assert "32 wide, persistent" in page


# ------------------------------------------------------------------ judged

#: Warp over scalar cost and LCV of each tree; times are 3% apart where warps are more.
_RATIOS = {"bbvh": 2.0, "sbvh": 1.95, "lbvh": 2.2, "hill": 2.3, "agglo": 2.25, "treelet": 2.1}


def record(name, *, ratios=_RATIOS, noise=0.001, factor=1.0):
    """Return a scene whose trees depart from scalar lanes by known ratios."""
    rows = []
    for place, (builder, ratio) in enumerate(ratios.items()):
        scalar = factor * (10 + place)
        rows.append(
            tree_row(
                builder,
                sah=scalar,
                epo=place**2 / 4,
                lcv=ratio,
                counted_cost=scalar,
                cost_deviation=scalar * ratio,
                length_ratio=0.3,
                warp_cost=ratio * scalar,
                warp_scalar_cost=scalar,
                warp_utilisation=1 / ratio,
                scalar_ns=100 * scalar,
                simd_ns=20 * scalar * (1 + 0.03 * place),
                scalar_error=noise,
                simd_error=noise,
            )
        )
    rows = [dataclasses.replace(row, cost_groups=[row["counted_cost"]] * 4) for row in rows]
    return scene_record(rows, name)


def test_deviations_by_hand():
    records = [record("one"), record("two", ratios={"bbvh": 1.0, "sbvh": np.e, "lbvh": 1.0})]
    of = warp_deviation(records)
    two = of[of["scene"] == "two"]["simulated"]
    np.testing.assert_allclose(two, [-1 / 3, 2 / 3, -1 / 3], atol=1e-12)
    one = np.log(list(_RATIOS.values()))
    np.testing.assert_allclose(of[of["scene"] == "one"]["simulated"], one - one.mean())
    by_builder = deviation_by_builder(records).set_index("builder")
    assert by_builder.loc["sbvh", "greatest"] == pytest.approx(2 / 3)
    assert by_builder["scenes"].tolist() == [2, 2, 2, 1, 1, 1]
    by_scene = deviation_by_scene(records).set_index("scene")
    assert by_scene.loc["two", "largest"] == pytest.approx(2 / 3)
    assert by_scene.loc["two", "simulated"] == pytest.approx(4 / 9)
    assert by_scene["r_spread"].tolist() == pytest.approx([1, 1])
    steps = np.log(1 + 0.03 * np.arange(6))
    assert by_scene.loc["one", "timed"] == pytest.approx(np.abs(steps - steps.mean()).mean())


def test_a_scene_without_times_has_no_timed_deviation():
    untimed = record("one")
    for row in untimed.trees:
        row.values["simd_ns"] = np.nan
    (row,) = deviation_by_scene([untimed]).to_dict("records")
    assert np.isnan(row["timed"])
    assert np.isnan(row["r_timed"])
    assert row["simulated"] > 0


def test_a_flat_scene_has_no_lcv_and_takes_none_away():
    """Where no ray meets a leaf LCV is zero: that scene says nothing of it, the others do."""
    flat = record("flat")
    for row in flat.trees:
        row.values.update(lcv=0.0, cost_deviation=0.0)
    assert warp_deviation([flat])[["lcv", "spread"]].isna().all(axis=None)
    assert np.isnan(deviation_by_scene([flat])["r_lcv"].item())
    assert explained([flat, record("one")]) == explained([record("one")])


def judged(records):
    found = simd_claims(records, correlations(records))
    return {claim.claim: claim for claim in found}


@pytest.fixture(scope="module")
def ten():
    """Return ten scenes in which deviations are large, and the sweeps lowest."""
    return [record(f"scene{i}", factor=1 + 0.1 * i) for i in range(FEWEST_SCENES)]


def test_simd_claims_are_judged_on_warps_and_on_times_apart(ten):
    found = judged(ten)
    warps_claim = found["SIMD deviates from scalar by 5 to 10%, in simulated warps"]
    assert warps_claim.held == "yes"  # 5.5% on average; 8.8% for the most deviating tree
    assert "32 wide, persistent" in warps_claim.judged
    timed = found["SIMD deviates from scalar by little"]
    assert timed.held == "yes"
    assert "times of this machine" in timed.judged
    assert found["top-down sweeps are SIMD friendly"].held == "yes"
    assert found["top-down sweeps have the lowest LCV of all"].held == "yes"


def test_lcv_is_held_against_the_spread():
    """Once LCV explains all and the spread half, once the other way round."""
    name = "LCV explains best how SIMD deviates from scalar, in simulated warps"
    held = []
    for exact, other in (("lcv", "cost_deviation"), ("cost_deviation", "lcv")):
        records = [record(f"scene{i}") for i in range(FEWEST_SCENES)]
        for row in itertools.chain.from_iterable(r.trees for r in records):
            scale = {"lcv": 1.0, "cost_deviation": row["counted_cost"]}
            ratio = row["warp_cost"] / row["warp_scalar_cost"]
            row.values[exact] = ratio * scale[exact]
            row.values[other] = (3.0 if row.builder == "bbvh" else 2.0) * scale[other]
        held.append(judged(records)[name].held)
    assert held == ["yes", "no"]


def test_claims_on_noisy_times_leave_those_on_warps_alone():
    noisy = [record(f"scene{i}", noise=0.2) for i in range(FEWEST_SCENES)]
    found = judged(noisy)
    assert found["SIMD deviates from scalar by little"].held == "not judged"
    assert found["with LCV, SIMD time is predicted as well as scalar time"].held == "not judged"
    assert found["top-down sweeps are SIMD friendly"].held == "yes"


def test_claims_on_warps_can_fail():
    other = {"bbvh": 2.6, "sbvh": 2.6, "lbvh": 1.4, "hill": 1.4}
    found = judged([record(f"scene{i}", ratios=other) for i in range(FEWEST_SCENES)])
    assert found["top-down sweeps are SIMD friendly"].held == "no"
    assert found["top-down sweeps have the lowest LCV of all"].held == "no"
    assert found["SIMD deviates from scalar by 5 to 10%, in simulated warps"].held == "no"


def test_warps_with_lcv_are_held_against_scalar_cost(ten):
    """Warp cost that LCV, SAH and EPO together explain, and one that they cannot."""
    name = "with LCV, the cost of simulated warps is predicted as well as scalar cost"
    rng = np.random.default_rng(0)
    sah = np.linspace(10, 20, 9)
    lcv, noise = rng.normal(size=(2, 9))
    held = []
    for warp in (sah + 4 * lcv, sah + 4 * noise):
        rows = [
            tree_row(
                f"tree{k}",
                sah=sah[k],
                epo=1.0 + k % 2,
                lcv=3 + lcv[k],
                counted_cost=sah[k],
                cost_deviation=1.0,
                length_ratio=0.3,
                warp_cost=warp[k],
                warp_scalar_cost=sah[k],
                warp_utilisation=0.5,
                scalar_ns=sah[k],
                simd_ns=sah[k],
                scalar_error=0.2,
                simd_error=0.2,
            )
            for k in range(9)
        ]
        rows = [dataclasses.replace(row, cost_groups=[row["counted_cost"]] * 4) for row in rows]
        held.append(judged([scene_record(rows, f"s{i}") for i in range(FEWEST_SCENES)])[name].held)
    assert held == ["yes", "no"]


# ------------------------------------------------------------------ few scenes


def test_no_claim_of_the_paper_is_judged_on_fewer_than_ten_scenes(ten):
    assert FEWEST_SCENES == 10
    few = judged(ten[:9])
    assert {claim.held for claim in few.values()} == {"not judged: 9 scenes"}
    assert not any("not judged" in claim.held for claim in judged(ten).values())


def test_every_claim_says_on_how_many_scenes(finished):
    from mibvh.studies.record.experiment import experiments

    found = list(
        itertools.chain.from_iterable(
            e.claims(finished.scenes, finished.correlations) for e in experiments()
        )
    )
    assert len(found) > 10
    assert all(claim.scenes in (0, 1) for claim in found)
    assert {claim.held for claim in found} == {"not judged", "not judged: 1 scene"}


def test_a_users_claim_need_not_be_over_scenes():
    of = {"topic": "own", "claim": "", "paper": "", "ours": "", "judged": ""}
    assert Claim(**of, conditions=(True,)).held == "yes"
    assert Claim(**of, conditions=(True, False), scenes=10).held == "partly"
    assert Claim(**of, conditions=(False,), scenes=9).held == "not judged: 9 scenes"
