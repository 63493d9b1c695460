"""A user's own predictor, metric and experiment: each is added once and shows everywhere."""

import dataclasses
import functools
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import scene_record, soup, tree_row

import mibvh
from mibvh.builders import registry as builder_registry
from mibvh.metrics import registry as metric_registry
from mibvh.metrics.predictors import Predictor, Sample, add_predictor, predictor, predictors
from mibvh.metrics.predictors import registry as predictor_registry
from mibvh.metrics.registry import Metric, Quantity, add_metric
from mibvh.studies import Progress
from mibvh.studies.analyse.builders import splitting_builders
from mibvh.studies.record import experiment as experiment_registry
from mibvh.studies.record.claim import Claim
from mibvh.studies.record.experiment import Experiment, TidyRow, add_experiment
from mibvh.studies.record.options import EXPERIMENTS
from mibvh.studies.record.quantities import quantities
from mibvh.studies.record.scene import Result, SceneRecord
from mibvh.studies.record.serialise import from_json, to_json
from mibvh.studies.record.sheet import Column, Sheet
from mibvh.studies.report.tidy import tidy_table, wide_table
from mibvh.studies.run import read_study

CHOICES = {"width": 24, "height": 16, "scalar_rays": 256, "seconds": 0.0}


# ------------------------------------------------------------------ a metric, a predictor


def _balance(subject):
    leaves = subject.tree.depths[subject.tree.is_leaf]
    return {"balance": float(np.ptp(leaves))}


BALANCE = Metric(
    name="balance",
    quantities=(
        Quantity(
            name="balance", unit="levels", heading="imbalance", format=".1f", help="of leaves"
        ),
    ),
    compute=_balance,
)
PREDICTOR = Predictor(
    name="by balance",
    formula="SAH and how deep the leaves lie apart",
    free="0",
    needs=("sah", "balance"),
    predict=lambda values, _: values["sah"] + values["balance"],
    rotated="SAH + imbalance",
    varied="by balance",
    headline="imbalance",
)


@dataclasses.dataclass(frozen=True)
class CountResult(Result, experiment="count leaves"):
    leaves: list[int]


def _measure(setting, report):
    report("leaves", 0.5)
    return CountResult([int(tree.is_leaf.sum()) for tree in setting.trees.values()])


def _rows(record):
    if found := record.result(CountResult):
        for place, leaves in enumerate(found.leaves):
            yield TidyRow(place, {"leaves_again": leaves}, {"experiment": "count leaves"})


def _sheets(records):
    frame = pd.DataFrame({"scene": [r.scene for r in records]})
    return [
        Sheet(
            name="leaf-counts",
            section="Leaves",
            title="Leaves counted again",
            frame=frame,
            columns=[Column("scene")],
        )
    ]


def _claims(records, found):
    yield Claim(
        topic="leaves",
        claim="trees have leaves",
        paper="–",
        ours="yes",
        judged="any",
        conditions=(True,),
    )


COUNT = Experiment(
    name="count leaves",
    summary="counts the leaves again",
    measure=_measure,
    weight=0.1,
    quantities=(Quantity(name="leaves_again", unit="count", per_tree=False),),
    rows=_rows,
    sheets=_sheets,
    claims=_claims,
)


@pytest.fixture
def added(monkeypatch):
    """Register all three for one test."""
    monkeypatch.setattr(metric_registry, "_added", {})
    monkeypatch.setattr(predictor_registry, "_added", {})
    known = dict(experiment_registry._experiments)
    monkeypatch.setattr(experiment_registry, "_experiments", known)
    monkeypatch.setitem(EXPERIMENTS, COUNT.name, "")
    add_metric(BALANCE)
    add_predictor(PREDICTOR)
    add_experiment(COUNT)


def test_what_a_user_adds_shows_everywhere(added, tmp_path):
    steps = []
    builders = ("bbvh", "lbvh", "agglo", "hill", "treelet")
    study = mibvh.study(
        [soup(300)],
        tmp_path,
        builders=builders,
        experiments=("all",),
        progress=steps.append,
        **CHOICES,
    )
    # The metric: in the record, in both files, in the tables, under its heading.
    tree = mibvh.build(soup(300), "lbvh")
    expected = np.ptp(tree.depths[tree.is_leaf])
    assert study.table.set_index("builder").loc["lbvh", "balance"] == expected
    tidy = pd.read_parquet(tmp_path / "results.parquet")
    mine = tidy[tidy["measurement"] == "balance"]
    assert set(mine["experiment"]) == {"prediction", "rotation"}
    assert set(mine["unit"]) == {"levels"}
    assert "imbalance" in (tmp_path / "tables" / "soup300-trees-more.csv").read_text()
    # The predictor: correlations, rotation, sensitivity, noise, the page's headline and glossary.
    assert "by balance" in set(study.correlations["predictor"])
    assert (study.rotation["by_balance"] > 0).all()
    r = study.sensitivity.set_index("experiment")["by_balance"]
    assert r["bounce"].notna().all()
    assert r["leaf size"].isna().all()  # of other leaf sizes the balance is not known
    text = (tmp_path / "results.md").read_text()
    assert "SAH + imbalance" in text
    assert "noise in what by balance misses" in text
    page = study.report.read_text()
    assert PREDICTOR.formula in page
    assert "<b>by balance</b>" in page
    # The experiment: progress, result, files, tables, claims; and it is read back.
    assert Progress("soup300", "count leaves", "leaves", None, 0.0).experiment in {
        step.experiment for step in steps
    }
    rotating = [step for step in steps if step.experiment == "rotation"]
    assert {step.builder for step in rotating if step.stage == "build"} == set(builders)
    leaves = [int(n) for n in study.table["leaves"]]
    assert study.scenes[0].result(CountResult).leaves == leaves
    assert read_study(tmp_path).scenes[0].result(CountResult).leaves == leaves
    again = tidy[tidy["measurement"] == "leaves_again"]
    assert again["value"].tolist() == leaves
    assert "Leaves counted again" in text
    assert "trees have leaves" in text


def test_a_metric_says_what_it_computes():
    wrong = dataclasses.replace(BALANCE, compute=lambda subject: {"other": 1.0})
    with pytest.raises(mibvh.MibvhError, match="metric balance declares balance; balance is miss"):
        wrong(metric_registry.Subject(mibvh.build(soup(20), "lbvh"), soup(20)))


def test_no_two_quantities_of_one_name(added):
    add_metric(dataclasses.replace(BALANCE, name="second"))
    with pytest.raises(mibvh.MibvhError, match="two quantities are called balance"):
        quantities()


# ------------------------------------------------------------------ predictors


def test_no_two_predictors_of_one_name(added):
    add_predictor(PREDICTOR)  # one's own may be replaced
    with pytest.raises(mibvh.MibvhError, match="two predictors are called SAH"):
        add_predictor(dataclasses.replace(PREDICTOR, name="SAH"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda sah: sah + 1j, "predictor mine gives complex numbers"),
        (lambda sah: sah[:1], r"predictor mine gives an array \(1,\) for 3 trees"),
        (lambda sah: ["a"] * len(sah), "predictor mine failed: .*ValueError"),
    ],
)
def test_what_a_user_s_predictor_may_not_give_is_said(added, given, said):
    mine = Predictor(
        name="mine",
        formula="SAH",
        free="0",
        needs=("sah",),
        predict=lambda values, _: given(values["sah"]),
    )
    add_predictor(mine)
    sample = Sample({"sah": np.array([1.0, 2.0, 3.0])}, np.array([1.0, 2.0, 3.0]))
    found = predictor_registry.faults([sample], 0)
    assert re.search(said, str(found["mine"]))
    assert np.isnan(predictor("mine")([sample])[1]).all()


def test_weights_of_one_scene_predict_another():
    """What is fitted to some trees is applied to others by ``predict`` alone."""
    rng = np.random.default_rng(0)
    sah, epo, lcv = rng.random((3, 9))
    record = scene_record(
        [
            tree_row(sah=s, epo=e, lcv=v, counted_cost=0.3 * s + 0.7 * e)
            for s, e, v in zip(sah, epo, lcv, strict=True)
        ]
    )
    fitted = predictor("fitted")
    weights, values = fitted([record.sample("counted_cost")])
    assert weights["alpha"] == pytest.approx(0.7)
    np.testing.assert_allclose(values, 0.3 * sah + 0.7 * epo)
    other = {"sah": np.array([1.0, 2.0]), "epo": np.array([3.0, 1.0])}
    np.testing.assert_allclose(fitted.predict(other, weights), [0.3 + 2.1, 0.6 + 0.7])


def test_unknown_predictor():
    with pytest.raises(mibvh.MibvhError, match="no predictor 'oak'; there are: SAH, fitted"):
        predictor("oak")


def test_the_documentation_lists_every_predictor():
    text = (Path(__file__).parents[1] / "docs" / "metrics.md").read_text(encoding="utf-8")
    table = text[text.index("## Predictors") :]
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", table, re.M)[1:]
    assert rows[: len(predictors())] == [(p.name, p.formula, p.free) for p in predictors()]


# ------------------------------------------------------------------ records


def test_a_record_is_read_as_it_was_written(small_study):
    record = small_study.scenes[0]
    read = SceneRecord.from_json(json.loads(json.dumps(record.to_json())))
    assert read == record
    assert isinstance(read.trees[0].values["references"], int)  # or tables would say 300.0
    assert isinstance(read.options.builders, tuple)


def test_a_record_of_other_fields_is_refused(small_study):
    data = small_study.scenes[0].to_json()
    del data["trees"][0]["options"]
    with pytest.raises(mibvh.MibvhError, match="no TreeRow of this version"):
        SceneRecord.from_json(data)
    data = small_study.scenes[0].to_json()
    data["results"] = {"oak": {}}
    with pytest.raises(mibvh.MibvhError, match="no experiment 'oak'"):
        SceneRecord.from_json(data)


def test_quantities_of_a_plugin_that_is_not_loaded():
    declared = {name: 1.0 for name, q in quantities().items() if q.per_tree}
    record = scene_record([tree_row(**declared, oaks=2.0), tree_row("lbvh", **declared)])
    column = wide_table([record])["oaks"]
    np.testing.assert_array_equal(column, [2.0, np.nan])
    with pytest.raises(mibvh.MibvhError, match=r"tree lbvh has no 'oaks': .* without the plugin"):
        record.trees[1]["oaks"]


def test_results_have_quantities_of_a_plugin_that_is_not_loaded(small_study):
    record = small_study.scenes[0]
    trees = [tree.with_values(oaks=float(i)) for i, tree in enumerate(record.trees)]
    table = tidy_table([dataclasses.replace(record, trees=trees)])
    rows = table[table["measurement"] == "oaks"]
    assert rows["value"].tolist() == [float(i) for i in range(len(trees))]
    assert set(rows["unit"]) == {""}
    assert len(table) == len(tidy_table([record])) + len(trees)


def test_containers_of_dataclasses():
    @dataclasses.dataclass(frozen=True)
    class Inner:
        x: float

    @dataclasses.dataclass(frozen=True)
    class Outer:
        some: dict[str, list[Inner]]
        none: Inner | None
        pair: tuple[int, ...]

    # Local classes: annotations are resolved here, as their module does not know them.
    Outer.__annotations__ |= {"some": dict[str, list[Inner]], "none": Inner | None}
    value = Outer({"a": [Inner(1.5)]}, None, (1, 2))
    assert from_json(Outer, json.loads(json.dumps(to_json(value)))) == value


# ------------------------------------------------------------------ what users get wrong, or had


def test_builders_given_as_a_text():
    assert mibvh.StudyOptions(builders="bbvh").builders == ("bbvh",)
    both = mibvh.StudyOptions(builders="bbvh, sbvh(bins=8,budget=2)")
    assert both.builders == ("bbvh", "sbvh(bins=8,budget=2)")
    assert mibvh.StudyOptions(builders=["bbvh"]).builders == ("bbvh",)
    with pytest.raises(mibvh.MibvhError, match="builders takes names, not 3"):
        mibvh.StudyOptions(builders=3)


def test_a_users_builder_that_splits_triangles_is_seen_to():
    plain, mine = tree_row("bbvh", references=100), tree_row("mine", references=101)
    assert splitting_builders([scene_record([plain, mine])]) == {"mine"}


def test_a_users_builder_of_a_bundled_name_stays(monkeypatch):
    """Bundled builders are imported when they are asked for, some of them by another."""
    bundled = builder_registry.get("bbvh")
    monkeypatch.setitem(builder_registry._registered, "bbvh", bundled)  # to be put back

    @mibvh.builder("bbvh", summary="mine")
    def mine(triangles, options, context):
        raise ValueError("wrong")

    mibvh.builder("bbvh", summary=bundled.summary)(bundled.function)  # what an import does
    own = builder_registry.get("bbvh")
    assert own.function is mine
    assert (bundled.bundled, own.bundled) == (True, False)
    assert own.code() is None  # a study builds its trees in every run
    assert own.asks_scene
    with pytest.raises(mibvh.MibvhError, match=r"builder bbvh failed: .*ValueError: wrong"):
        mibvh.build(soup(20), "bbvh")


def test_progress_of_three_arguments_still_works(tmp_path):
    steps = []

    def watch(scene, stage, done):
        steps.append((scene, stage, done))

    study = functools.partial(mibvh.study, [soup(40)], tmp_path, builders=("bbvh",), **CHOICES)
    with pytest.warns(DeprecationWarning, match="called with one Progress"):
        study(progress=watch)
    assert ("soup40", "build bbvh") in {step[:2] for step in steps}
    assert steps[-1] == ("soup40", "done", 1.0)


def test_records_as_dicts_are_deprecated(small_study):
    record = small_study.scenes[0]
    with pytest.warns(DeprecationWarning, match=r"record\.trees"):
        assert record["trees"] is record.trees


def test_units_at_their_old_place():
    from mibvh.studies import tables

    with pytest.warns(DeprecationWarning, match="quantities"):
        assert tables.UNITS["scalar_ns"] == "ns/ray"
