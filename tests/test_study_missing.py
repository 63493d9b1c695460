"""A study goes on where the user's own code, or a tree that was brought, fails for one scene."""

from __future__ import annotations

import dataclasses
import json
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import soup

import mibvh
from mibvh.builders import building, registry
from mibvh.builders.draft import Draft
from mibvh.cli import main
from mibvh.metrics import registry as metric_registry
from mibvh.metrics.predictors import Predictor, add_predictor
from mibvh.metrics.predictors import registry as predictor_registry
from mibvh.metrics.registry import Metric, Quantity, add_metric
from mibvh.studies.measure.rotation import RotationResult
from mibvh.studies.record import experiment as experiments
from mibvh.studies.record.experiment import Experiment
from mibvh.studies.record.options import EXPERIMENTS
from mibvh.studies.record.scene import Result
from mibvh.studies.report.tidy import tidy_table
from mibvh.studies.run import read_study, remake_report

CHOICES = {"width": 24, "height": 16, "scalar_rays": 256, "seconds": 0.0}
BUILDERS = ("bbvh", "lbvh", "agglo", "hill", "treelet")
#: The scene in which everything of the user's fails, and the one in which it does not.
BAD, GOOD = "soup40", "soup60"


def halves(triangles, options, context):
    return np.arange(len(triangles))


def raises(triangles, options, context):
    if len(triangles) == 40:
        raise ValueError("I know no forty")
    return halves(triangles, options, context)


def rubbish(triangles, options, context):
    return "a tree" if len(triangles) == 40 else halves(triangles, options, context)


def unsound(triangles, options, context):
    """Boxes that leave out what they hold."""
    draft = Draft.from_nested(halves(triangles, options, context), triangles)
    if len(triangles) != 40:
        return draft
    refs = draft.references
    return dataclasses.replace(draft, references=dataclasses.replace(refs, upper=refs.lower))


def _odd(subject):
    builder = subject.tree.meta.get("builder")
    if builder == "lbvh":
        raise RuntimeError("no lbvh, please")
    return {"odd": "seven" if builder == "agglo" else float(len(subject.tree))}


def _fussy(values, weights):
    if len(values["sah"]) == len(BUILDERS):
        raise KeyError("too few")
    return values["sah"]


ODD = Metric(name="odd", quantities=(Quantity(name="odd", unit="", heading="odd"),), compute=_odd)
BY_ODD = Predictor(
    name="by odd", formula="odd", free="0", needs=("odd",), predict=lambda values, _: values["odd"]
)
FUSSY = Predictor(name="fussy", formula="SAH", free="0", needs=("sah",), predict=_fussy)


@pytest.fixture(scope="module")
def own():
    """Builders, a metric and predictors of the user's, for the whole module."""
    saved = dict(registry._registered), dict(metric_registry._added)
    saved_predictors = dict(predictor_registry._added)
    for function in (raises, rubbish, unsound):
        mibvh.builder(function.__name__)(function)
    add_metric(ODD)
    add_predictor(BY_ODD)
    add_predictor(FUSSY)
    yield
    for held, before in (
        (registry._registered, saved[0]),
        (metric_registry._added, saved[1]),
        (predictor_registry._added, saved_predictors),
    ):
        held.clear()
        held.update(before)


@pytest.fixture(scope="module")
def steps():
    return []


@pytest.fixture(scope="module")
def finished(own, steps, tmp_path_factory):
    tree = mibvh.build(soup(60, size=0.5), "sbvh")
    return mibvh.study(
        [soup(60, size=0.5), soup(40, size=0.5)],
        tmp_path_factory.mktemp("study"),
        trees={"brought": [tree, tree]},
        builders=(*BUILDERS, "raises", "rubbish", "unsound", "hill(start=raises)"),
        experiments=("all",),
        progress=steps.append,
        **CHOICES,
    )


def test_the_other_trees_and_scenes_go_on(finished):
    names = {r.scene: [t.builder for t in r.trees] for r in finished.scenes}
    own = ["raises", "rubbish", "unsound", "hill(start=raises)", "brought"]
    assert names == {GOOD: [*BUILDERS, *own], BAD: list(BUILDERS)}
    assert finished.left_out == {}
    assert finished.failures == []
    # The figures of the trees that are there are those of a study without the others.
    alone = mibvh.study(soup(40, size=0.5), finished.folder / "alone", builders=BUILDERS, **CHOICES)
    table = finished.table[finished.table["scene"] == BAD].set_index("builder")
    for column in ("sah", "epo", "counted_cost", "warp_cost"):
        assert table[column].tolist() == alone.table[column].tolist()


def test_what_is_missing_is_named_with_its_reason(finished):
    said = {(scene, one.what): one.why for scene, one in finished.missing}
    for name, why in (
        ("raises", "builder raises failed: .*test_study_missing.py, line .*: ValueError: I know"),
        ("rubbish", "builder rubbish: a leaf must be the ids of triangles, not 'a tree'"),
        ("unsound", "builder unsound made an invalid tree"),
        ("hill.start=raises.", "builder raises failed: .*: ValueError: I know no forty"),
        ("brought", "built for another geometry than soup40"),
    ):
        found = [said[key] for key in said if pd.Series(key[1]).str.fullmatch(f"tree {name}")[0]]
        assert len(found) == 1, name
        assert pd.Series(found).str.contains(why)[0], found
    assert {scene for scene, what in said if what.startswith("tree")} == {BAD}
    assert "metric odd failed" in said[GOOD, "metric odd of tree lbvh"]
    assert "odd is 'seven', not a number" in said[GOOD, "metric odd of tree agglo"]
    assert "predictor fussy failed" in said[BAD, "predictor fussy"]
    assert (GOOD, "predictor fussy") not in said


def test_it_is_told_when_it_happens(finished, steps):
    told = [(step.scene, step.missing) for step in steps if step.missing]
    assert sorted(told) == sorted((scene, str(one)) for scene, one in finished.missing)
    of_trees = [i for i, step in enumerate(steps) if (step.missing or "").startswith("tree raises")]
    done = [i for i, s in enumerate(steps) if (s.scene, s.stage) == (BAD, "done")]
    assert of_trees[0] < done[0]


def test_figures_say_over_how_many_trees_they_are(finished):
    record = {r.scene: r for r in finished.scenes}
    assert (record[GOOD].over, record[BAD].over) == ("", "5 of 10 trees")
    page = finished.report.read_text()
    text = (finished.folder / "results.md").read_text()
    assert f"tree raises of {BAD}" in page
    assert "5 to 10 trees each" in page
    assert "I know no forty" in page
    assert f"Missing of {BAD}: tree raises is missing: builder raises failed" in text
    for told in (page, text):
        assert f"figures and correlations are over 5 of 10 trees of {BAD}" in told
    assert "5 of 10 trees" in (finished.folder / "figures" / "multiples.svg").read_text()
    r = finished.correlations.set_index(["scene", "measurement", "predictor"])
    assert r.loc[(BAD, "counted_cost", "SAH"), "trees"] == 5
    assert r.loc[(GOOD, "counted_cost", "SAH"), "trees"] == 10


def test_a_metric_is_missing_of_the_trees_that_it_fails_at(finished):
    table = finished.table[finished.table["scene"] == GOOD].set_index("builder")
    assert set(table.index[table["odd"].isna()]) == {"lbvh", "agglo"}
    r = finished.correlations.set_index(["scene", "measurement", "predictor"])
    row = r.loc[(GOOD, "counted_cost", "by odd")]
    known = table[table["odd"].notna()]
    assert row["trees"] == len(known) == 8
    assert row["pearson"] == pytest.approx(np.corrcoef(known["odd"], known["counted_cost"])[0, 1])
    row = r.loc[(BAD, "counted_cost", "fussy")]
    assert (row["trees"], np.isnan(row["pearson"])) == (0, True)
    same = r.loc[(GOOD, "counted_cost", ["SAH", "fussy"]), "pearson"]
    assert same.iloc[0] == same.iloc[1]


def test_experiments_are_of_the_trees_that_are_there(finished):
    for record in finished.scenes:
        names = [tree.builder for tree in record.trees if tree.builder != "brought"]
        assert [tree.builder for tree in record.result(RotationResult).trees] == names
    assert set(finished.depth["scene"]) == {GOOD, BAD}


def test_the_folder_says_it_too(finished):
    again = read_study(finished.folder)
    assert again.missing == finished.missing
    assert remake_report(finished.folder).report.read_text() == finished.report.read_text()


def test_the_next_run_tries_it_again(own, tmp_path):
    calls = []

    def mends(triangles, options, context):
        calls.append(len(triangles))
        if len(calls) == 1:
            raise ValueError("not yet")
        return halves(triangles, options, context)

    mibvh.builder("mends", version="1")(mends)
    found = [
        mibvh.study([soup(40, size=0.5)], tmp_path, builders=("bbvh", "mends"), **CHOICES)
        for _ in range(3)
    ]
    assert [len(one.scenes[0].trees) for one in found] == [1, 2, 2]
    assert [one.what for _, one in found[0].missing] == ["tree mends"]
    assert found[1].missing == found[2].missing == []
    assert calls == [40, 40]  # a tree that was built is kept
    assert found[1].scenes[0].reused["trees"] == 1
    # Options are text in one order, whether their tree was built now or read back.
    tables = [tidy_table(one.scenes).query("builder == 'mends'") for one in found[1:]]
    assert len(set(pd.concat(tables)["builder_options"])) == 1


@dataclasses.dataclass(frozen=True)
class Leaves(Result, experiment="own leaves"):
    leaves: list[int]


def _raised(setting, report):
    raise KeyError("no leaves")


@pytest.fixture
def experiment(monkeypatch):
    """Register an experiment of the user's for one test: called with what measures or shows it."""
    monkeypatch.setattr(experiments, "_experiments", dict(experiments._experiments))
    monkeypatch.setitem(EXPERIMENTS, "own leaves", "")

    def register(**functions):
        experiments.add_experiment(Experiment(name="own leaves", summary="", **functions))

    return register


@pytest.mark.parametrize(
    ("measure", "why"),
    [
        (_raised, "KeyError: 'no leaves'"),
        (lambda setting, report: None, "it returns a NoneType"),
        (lambda setting, report: Leaves(np.arange(3)), "ndarray is not JSON serializable"),
        (lambda setting, report: Leaves(["a"]), "'a' is no"),
    ],
)
def test_an_experiment_is_missing_of_the_scenes_that_it_fails_at(
    experiment, tmp_path, measure, why
):
    def some(setting, report):
        return Leaves([3]) if len(setting.scene.triangles) == 60 else measure(setting, report)

    experiment(measure=some)
    scenes = [soup(40, size=0.5), soup(60, size=0.5)]
    asked = {"builders": "bbvh", "experiments": ("prediction", "own leaves"), **CHOICES}
    found = mibvh.study(scenes, tmp_path, **asked)
    assert [record.scene for record in found.scenes] == [BAD, GOOD]
    assert [(scene, one.what) for scene, one in found.missing] == [(BAD, "experiment own leaves")]
    said = found.missing[0][1].why
    assert "experiment own leaves failed: " in said
    assert "test_study_missing.py" in said
    assert why in said
    assert found.scenes[1].result(Leaves).leaves == [3]
    assert read_study(tmp_path).missing == found.missing
    EXPERIMENTS.pop("own leaves")  # as where the plugin is missing
    with pytest.raises(mibvh.MibvhError, match=r"--plugin that is missing .*'own leaves'"):
        read_study(tmp_path)
    experiment(measure=lambda setting, report: Leaves([4]))
    mended = mibvh.study(scenes, tmp_path, **asked)
    assert mended.missing == []
    assert [record.result(Leaves).leaves for record in mended.scenes] == [[4], [4]]


@pytest.mark.parametrize("part", ["rows", "sheets", "claims", "figures", "audits"])
def test_what_shows_an_experiment_fails_in_one_sentence(experiment, tmp_path, part):
    def shows(*_):
        yield from ()
        raise IndexError("nothing to show")

    asked = {"builders": "bbvh", "experiments": ("prediction", "own leaves"), **CHOICES}
    experiment(measure=lambda setting, report: Leaves([3]), **{part: shows})
    with pytest.raises(mibvh.MibvhError) as caught:
        mibvh.study(soup(40, size=0.5), tmp_path, **asked)
    assert f"experiment own leaves: {part} failed: " in str(caught.value)
    assert "IndexError: nothing to show" in str(caught.value)
    experiment(measure=lambda setting, report: Leaves([3]))
    assert remake_report(tmp_path).scenes[0].result(Leaves).leaves == [3]


def test_a_scene_without_any_tree_is_left_out(own, tmp_path):
    found = mibvh.study(
        [soup(60, size=0.5), soup(40, size=0.5)], tmp_path, builders="raises", **CHOICES
    )
    assert [record.scene for record in found.scenes] == [GOOD]
    assert "soup40: there is no tree (builder raises failed" in found.left_out[BAD]
    with pytest.raises(mibvh.MibvhError, match=r"there is no tree \(builder raises failed"):
        mibvh.study(soup(40, size=0.5), tmp_path / "alone", builders="raises", **CHOICES)


def test_a_tree_of_no_scene_is_refused_at_once(own, tmp_path):
    tree = mibvh.build(soup(50, size=0.5), "bbvh")
    with pytest.raises(mibvh.MibvhError, match=r"tree brought of soup60: .*another geometry"):
        mibvh.study(
            [soup(60, size=0.5), soup(40, size=0.5)],
            tmp_path / "out",
            trees={"brought": [tree, tree]},
            builders="bbvh",
            **CHOICES,
        )
    assert not (tmp_path / "out").exists()


def test_a_bundled_builder_that_fails_is_a_loud_end(tmp_path, monkeypatch):
    def broken(triangles, options, context):
        raise ZeroDivisionError("a bug")

    broken.__module__ = registry.get("lbvh").function.__module__
    found = dataclasses.replace(registry.get("lbvh"), function=broken)
    monkeypatch.setitem(registry._registered, "lbvh", found)
    monkeypatch.setattr(building, "warm_up", lambda name, progress: None)
    with pytest.raises(ZeroDivisionError):
        mibvh.study([soup(40, size=0.5)], tmp_path, builders=("bbvh", "lbvh"), **CHOICES)


PLUGIN = """
import numpy as np
import mibvh

@mibvh.builder("raises", summary="a test's")
def raises(triangles, options, context):
    if len(triangles) < 900:
        raise ValueError("I know no few")
    return np.arange(len(triangles))
"""


@pytest.mark.parametrize("debug", [False, True])
def test_the_command_says_it_twice_and_ends_with_2(debug, tmp_path, monkeypatch, capsys):
    (tmp_path / "plugin.py").write_text(PLUGIN)
    words = [
        *(["--debug"] if debug else []),
        *("--plugin", tmp_path / "plugin.py", "study", "cornell@900", "hairball@300"),
        *("-o", tmp_path / "out", "--builders", "bbvh,raises", "--seconds", "0", "--json"),
    ]
    monkeypatch.setattr(sys, "argv", ["mibvh", *map(str, words)])
    monkeypatch.setenv("MIBVH_DEBUG", "")  # undone after the test, as --debug sets it
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    out, err = capsys.readouterr()
    lines = [json.loads(line) for line in out.splitlines()]
    (event,) = [line for line in lines if line.get("missing") and line["event"] == "progress"]
    sentence = "tree raises is missing: builder raises failed: "
    assert event["scene"] == "hairball@300"
    assert event["missing"].startswith(sentence)
    assert event["missing"].endswith("ValueError: I know no few")
    assert [(one["scene"], one["tree"]) for one in lines[-1]["missing"]] == [
        ("hairball@300", "raises")
    ]
    assert len(lines[-1]["trees"]) == 3
    assert f"mibvh: hairball@300: {sentence}" in err
    assert ("Traceback" in err) == debug
