"""Trees of the user's own, builders with options, and given rays in a study."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import time

import numpy as np
import pandas as pd
import pytest
from conftest import soup
from test_layouts import compiled

import mibvh
from mibvh.builders import registry
from mibvh.builders.chosen import parse, parse_all
from mibvh.builders.sharing import shared_drafts
from mibvh.studies.analyse.sweep import sweeps
from mibvh.studies.measure.rotation import RotationResult, rotated
from mibvh.studies.measure.sensitivity import SensitivityResult
from mibvh.studies.measure.trees import TreeSource
from mibvh.studies.run import read_study, remake_report, write_outputs

CHOICES = {"width": 24, "height": 16, "scalar_rays": 256, "seconds": 0.0}
SCENE = "cornell@1000"


def imported(scene, builder="sbvh", **options):
    """Return a tree as another program would hand it over: no options, no report, no seconds."""
    tree = mibvh.build(scene, builder, **options)
    return mibvh.Tree.from_arrays(**tree.to_arrays(), name="other")


@pytest.fixture(scope="module")
def scene():
    return mibvh.load(SCENE)


@pytest.fixture(scope="module")
def mine(scene):
    """A tree with split triangles and leaves that no builder of ours collapses to."""
    return imported(scene, max_leaf=3, c_inner=0.1)


@pytest.fixture(scope="module")
def finished(tmp_path_factory, scene, mine):
    return mibvh.study(
        SCENE,
        tmp_path_factory.mktemp("study"),
        trees={"mine": {SCENE: mine}},
        builders="bbvh,lbvh,sbvh(budget=1.5),bittner(start=sbvh),sbvh(bins=8..24:8)",
        experiments=("all",),
        **CHOICES,
    )


@pytest.fixture
def register():
    names = []

    def add(name, function, **about):
        names.append(name)
        return mibvh.builder(name, summary="a test's", **about)(function)

    yield add
    for name in names:
        registry._registered.pop(name, None)


# ------------------------------------------------------------------ finished trees


def test_a_given_tree_is_kept_as_it_is(finished, scene, mine):
    row = finished.table.set_index("builder").loc["mine"]
    assert mine.splits_triangles
    assert row["nodes"] == len(mine)
    assert row["references"] == len(mine.references)
    assert row["sah"] == pytest.approx(mibvh.sah(mine), rel=1e-12)
    assert row["epo"] == pytest.approx(mibvh.epo(mine, scene), rel=1e-12)
    rays = mibvh.diffuse_rays(scene, width=24, height=16, samples=1)
    hits = mibvh.trace(mine, scene, rays, repeats=1)
    assert row["lcv"] == hits.lcv
    assert row["counted_cost"] == pytest.approx(hits.counted_cost())
    assert row["scalar_ns"] > 0
    assert np.isnan(row["build_seconds"])


def test_a_given_tree_stands_everywhere_and_is_audited(finished):
    record = finished.scenes[0]
    assert finished.failures == []
    names = [tree.builder for tree in record.trees]
    assert names == [
        "bbvh",
        "lbvh",
        "sbvh(budget=1.5)",
        "bittner(start=sbvh)",
        "sbvh(bins=8)",
        "sbvh(bins=16)",
        "sbvh(bins=24)",
        "mine",
    ]
    checked, like = ([check.name for check in record.trees[i].audit] for i in (-1, -2))
    assert checked == like
    assert set(finished.depth["builder"]) == set(names)
    figure = (finished.folder / "figures" / f"{SCENE}-counted.svg").read_text()
    assert 'data-builder="mine"' in figure
    trees = (finished.folder / "results.md").read_text().partition("### Trees")[2]
    assert "| mine |" in trees
    assert "–" in next(line for line in trees.splitlines() if "| mine |" in line)
    tidy = pd.read_parquet(finished.folder / "results.parquet")
    assert set(tidy.loc[tidy["builder"] == "mine", "builder_options"]) == {"{}"}


def test_a_given_tree_is_neither_rotated_nor_collapsed_anew(finished):
    record = finished.scenes[0]
    rotated = record.result(RotationResult)
    assert [t.builder for t in rotated.trees] == [t.builder for t in record.trees[:-1]]
    assert "mine" not in set(finished.rotation["builder"])
    after = {tree.builder: tree for tree in rotated.trees}
    for _, row in finished.rotation.iterrows():
        before = next(t for t in record.trees if t.builder == row["builder"])
        assert row["sah"] == after[row["builder"]]["sah"] / before["sah"]
    sizes = record.result(SensitivityResult).leaf_sizes
    assert [bool(of) for of in sizes] == [True] * 7 + [False]


def test_only_given_trees_can_be_left_after_those_that_are_built(tmp_path, mine, scene):
    """The claims and tables of a study in which one tree of two cannot be built anew."""
    found = mibvh.study(
        scene, tmp_path, trees={"mine": mine}, builders="lbvh", experiments=("all",), **CHOICES
    )
    assert found.rotation["builder"].tolist() == ["lbvh"]
    again = read_study(tmp_path)
    write_outputs(again.folder, again.scenes)


def test_given_trees_alone(tmp_path, mine, scene):
    """No builder but those that are asked for; a scene without a tree is left out."""
    path = tmp_path / "mine.npz"
    mine.save(path)
    steps = []
    found = mibvh.study(
        [scene, "hairball@300"],
        tmp_path / "out",
        trees={"mine": [path, None]},
        builders=[],
        experiments=("all",),
        progress=steps.append,
        **CHOICES,
    )
    assert [tree.builder for record in found.scenes for tree in record.trees] == ["mine"]
    assert found.left_out == {
        "hairball@300": "hairball@300: there is no builder, and no tree of it is given"
    }
    assert found.failures == []
    assert "mine" in found.report.read_text()
    over = [(step.scene, step.stage) for step in steps if step.done == 1.0]
    assert over == [("hairball@300", "left out"), (scene.name, "done")]
    again = read_study(tmp_path / "out")
    write_outputs(again.folder, again.scenes)
    with pytest.raises(mibvh.MibvhError, match="a study needs builders or trees"):
        mibvh.study(scene, tmp_path / "none", builders=[], **CHOICES)
    from typer.testing import CliRunner

    from mibvh.cli import app

    words = ["study", SCENE, "-o", tmp_path / "cli", "--tree", f"mine={path}", "--builders", ""]
    ran = CliRunner().invoke(app, [*map(str, words), "--seconds", "0", "--json"])
    assert ran.exit_code == 0, ran.output
    result = json.loads(ran.stdout.splitlines()[-1])
    assert [row["builder"] for row in result["trees"]] == ["mine"]


FINITE = "finite(count=1000,planes=16,effort=1)"


def test_finite_is_built_for_the_cameras_of_the_scene(tmp_path, scene):
    """Its trees go by the cameras, and no ray that it is built for is one that is measured."""
    choices = {**CHOICES, "experiments": ("rotation",)}

    def one(scene):
        return mibvh.study(scene, tmp_path / "out", builders=["bbvh", FINITE], **choices).scenes[0]

    first = one(scene)
    report = first.trees[1].build_report
    assert report["rays"] == f"diffuse rays of {len(scene.sensors)} viewpoints"
    turned = [row for row in first.results["rotation"].trees if row.builder == FINITE]
    assert turned[0].build_report["rays"] == report["rays"]
    training = scene.few_rays(1000, report["seed"])
    measured = mibvh.diffuse_rays(scene, width=24, height=16, samples=1, seed=0)
    both = np.concatenate([np.unique(training.o, axis=0), np.unique(measured.o, axis=0)])
    assert len(np.unique(both, axis=0)) == len(both)
    # One camera fewer: `finite` is another tree, and `bbvh` is not built again.
    fewer = dataclasses.replace(scene, sensors=scene.sensors[:-1])
    second = one(fewer)
    said = second.trees[1].build_report["rays"]
    assert said == f"diffuse rays of {len(scene.sensors) - 1} viewpoints"
    assert second.trees[0].values["build_seconds"] == first.trees[0].values["build_seconds"]
    assert second.trees[1].values["build_seconds"] != first.trees[1].values["build_seconds"]
    third = one(fewer)
    assert third.trees[1].values["build_seconds"] == second.trees[1].values["build_seconds"]


def test_rays_of_the_rotated_scene_are_those_of_its_cameras_rotated(scene):
    rays = mibvh.diffuse_rays(scene, width=24, height=16, samples=1)
    turned, _ = rotated(scene, rays)
    before, after = scene.few_rays(500, 7), turned.few_rays(500, 7)
    matrix = mibvh.rotation_about((1.0, 1.0, 1.0), 45.0)
    np.testing.assert_allclose(after.d, before.d @ np.asarray(matrix).T, atol=1e-6)
    after.check_matches(turned.triangles)
    hits = [
        mibvh.trace(mibvh.build(of, "bbvh"), of, few, repeats=1).triangle
        for of, few in ((scene, before), (turned, after))
    ]
    assert (hits[0] == hits[1]).mean() > 0.98


def test_finite_is_not_built_for_the_rays_that_are_measured(tmp_path, scene):
    with pytest.raises(
        mibvh.MibvhError, match=r"finite\(seed=3\) would be built for the rays that"
    ):
        mibvh.study(scene, tmp_path, builders=["finite(seed=3)"], seed=3, **CHOICES)
    assert not list(tmp_path.iterdir())


def test_a_file_that_an_option_names_is_part_of_the_key(tmp_path, scene):
    path = tmp_path / "rays.npz"
    source = TreeSource.of(parse(f"finite(rays={path})")[0])
    keys = []
    for seed in (1, 1, 2):
        scene.few_rays(100, seed).save(path)
        keys.append(source.key(scene))
    assert keys[0] == keys[1] != keys[2]


def test_given_trees_go_by_their_content(tmp_path, scene, mine):
    choices = {"builders": "lbvh", **CHOICES}
    one = mibvh.study(scene, tmp_path, trees={"mine": mine}, **choices)
    same = mibvh.study(scene, tmp_path, trees={"renamed": mine}, **choices).scenes[0]
    assert (same.reused["metrics"], same.reused["counts"], same.reused["audit"]) == (2, 2, 2)
    other = mibvh.study(scene, tmp_path, trees={"mine": imported(scene, "hill")}, **choices)
    assert other.scenes[0].reused["metrics"] == 1
    assert other.table["sah"].tolist()[1] != one.table["sah"].tolist()[1]


def test_all_trees_are_judged_by_the_same_constants(tmp_path, scene):
    """A tree of other constants is built by them, and its figures are in the others' units."""
    dear = mibvh.build(scene, "bbvh", c_inner=5.0)
    found = mibvh.study(
        scene, tmp_path, trees={"mine": dear}, builders="bbvh(c_inner=5)", **CHOICES
    )
    assert found.table["sah"].tolist() == [mibvh.sah(dear, 1.2, 1.0)] * 2
    assert found.table["nodes"].tolist() == [len(dear)] * 2
    assert found.table["counted_cost"].nunique() == 1
    assert found.failures == []


def test_a_program_in_cpp_stands_beside_the_nine(tmp_path, scene):
    """Its dump as it is, and imported; the audit of the whole study passes."""
    program = compiled(tmp_path, "docs/examples/median_bvh.cpp")
    (tmp_path / "triangles").write_bytes(scene.triangles.corners.tobytes())
    words = [program, tmp_path / "triangles", tmp_path / "tree.bin"]
    told = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    mibvh.read_tree(tmp_path / "tree.bin").save(tmp_path / "tree.npz")
    trees = {"median": tmp_path / "tree.bin", "again": tmp_path / "tree.npz"}
    nine = tuple(registry._BUNDLED)
    found = mibvh.study(SCENE, tmp_path / "out", trees=trees, builders=nine, **CHOICES)
    assert len(found.table) == 11
    assert found.failures == []
    own = found.table.set_index("builder").loc[["median", "again"]]
    for row in own.itertuples():
        assert row.sah == pytest.approx(float(told.split()[-1]), rel=5e-7)
        assert row.nodes == int(told.split()[0])
    known = own[["epo", "lcv", "counted_cost", "scalar_ns", "simd_ns"]]
    assert (known > 0).all(axis=None)
    for name in trees:
        assert f'data-builder="{name}"' in found.report.read_text()


def test_a_builder_that_returns_a_finished_tree_keeps_it(scene, mine, register):
    register("finisher", lambda triangles, options, context: mine)
    tree = mibvh.build(scene, "finisher")
    for name in ("lower", "upper", "left", "first", "count", "references"):
        assert np.array_equal(getattr(tree, name), getattr(mine, name))
    assert tree.meta["builder"] == "finisher"
    assert tree.meta["build_seconds"] >= 0
    with pytest.raises(mibvh.MibvhError, match="nothing starts from those"):
        mibvh.build(scene, "hill", start="finisher")
    register("liar", lambda triangles, options, context: imported(soup(1000)))
    with pytest.raises(mibvh.MibvhError, match="made an invalid tree"):
        mibvh.build(scene, "liar")


def test_a_finished_tree_of_a_builder_in_all_experiments(tmp_path, register):
    def whole(triangles, options, context):
        tree = mibvh.build(triangles, "lbvh", max_leaf=1)
        return mibvh.Tree.from_arrays(**tree.to_arrays())

    register("whole", whole, version="1")
    found = mibvh.study(
        [soup(80)], tmp_path, builders="bbvh,whole", experiments=("all",), **CHOICES
    )
    assert found.failures == []
    assert found.scenes[0].trees[1]["nodes"] == 159
    assert found.rotation["builder"].tolist() == ["bbvh", "whole"]


# ------------------------------------------------------------------ builders with options


def test_builders_are_named_by_what_differs():
    chosen = parse_all(["bbvh", "sbvh(budget = 2.0)", "bittner(start=sbvh)", "bbvh(max_leaf=4)"])
    assert [c.name for c in chosen] == [
        "bbvh",
        "sbvh(budget=2.0)",
        "bittner(start=sbvh)",
        "bbvh(max_leaf=4)",
    ]
    assert parse("sbvh(bins=128)")[0].name == "sbvh"  # as it is by default
    assert [dict(c.options)["bins"] for c in parse("sbvh(bins=8..100:40)")] == [8, 48, 88]
    assert [dict(c.options)["alpha"] for c in parse("sbvh(alpha=0.1..0.3:0.1)")] == [0.1, 0.2, 0.3]
    # What a sweep shares with another is taken once.
    names = [c.name for c in parse_all(["sbvh", "sbvh(bins=112..128:8)"])]
    assert names == ["sbvh", "sbvh(bins=112)", "sbvh(bins=120)"]


@pytest.mark.parametrize(
    ("builders", "said"),
    [
        ("bbhv", r"no builder 'bbhv' \(did you mean 'bbvh'\?\)"),
        ("sbvh(bin=8)", r"no option 'bin' \(did you mean 'bins'\?\)"),
        ("sbvh(bins=8", "options stand in parentheses"),
        ("sbvh(bins)", "options are written name=value"),
        ("sbvh(bins=0)", "option bins must be from"),
        ("sbvh(bins=many)", "option bins must be of type int"),
        ("sbvh(bins=8,bins=16)", "option bins is given twice"),
        ("sbvh(bins=8..1:2)", "LOW..HIGH:STEP"),
        ("sbvh(bins=8..9:0)", "LOW..HIGH:STEP"),
        ("sbvh(bins=1..1000)", "too many trees"),
        ("sbvh(bins=8..60:2,max_leaf=1..8)", "216 trees; at most 64"),
        ("bittner(start=sbhv)", r"no builder 'sbhv' \(did you mean 'sbvh'"),
        ("sbvh,sbvh(bins=128)", "a builder is named twice: sbvh"),
    ],
)
def test_builders_are_refused_before_any_work(builders, said, tmp_path):
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.study("nowhere.ply", tmp_path / "out", builders=builders, **CHOICES)
    assert not (tmp_path / "out").exists()


def test_trees_that_others_start_from_are_built_once(tmp_path, register, scene):
    calls = []

    def slow(triangles, options, context):
        calls.append(options)
        time.sleep(0.25)
        return np.arange(len(triangles))

    register("slow", slow, version="1")
    found = mibvh.study(
        scene,
        tmp_path,
        builders="slow,hill(start=slow),lbvh,bittner(start=slow),slow(max_leaf=2)",
        **CHOICES,
    )
    assert [options.max_leaf for options in calls] == [8, 2]
    seconds = found.table.set_index("builder")["build_seconds"]
    # What a tree took includes what the one that it starts from took.
    assert (seconds.drop("lbvh") >= 0.25).all()
    for name, options in (("hill", {}), ("bittner", {})):
        alone = mibvh.build(scene, name, start="slow", **options)
        row = found.table.set_index("builder").loc[f"{name}(start=slow)"]
        assert (row["sah"], row["nodes"]) == (mibvh.sah(alone), len(alone))


def test_shared_drafts_are_those_that_would_be_built(scene):
    """Of the paper's optimisers, on split triangles too; nothing changes what is shared."""
    chosen = parse_all(
        [
            "sbvh",
            "hill(start=sbvh)",
            "bittner(start=sbvh)",
            "treelet(start=sbvh)",
            "hill(start=hill)",
        ]
    )
    alone = [mibvh.build(scene, c.builder, **dict(c.options)).digest for c in chosen]
    with shared_drafts(scene.triangles.digest) as drafts:
        drafts.want(frozenset().union(*(c.starts() for c in chosen)))
        shared = [mibvh.build(scene, c.builder, **dict(c.options)).digest for c in chosen]
        assert drafts.spared > 0
        # Another scene's are not taken.
        other = mibvh.build(soup(50), "hill", start="sbvh")
    assert shared == alone
    assert other.digest == mibvh.build(soup(50), "hill", start="sbvh").digest


def test_a_start_of_the_users_own_is_part_of_the_key(tmp_path, register):
    def study(order, version):
        register("own", lambda t, o, c: np.arange(len(t))[::order], version=version)
        return mibvh.study([soup(40)], tmp_path, builders="hill(start=own,sweeps=0)", **CHOICES)

    first = study(1, "1").table["sah"].tolist()
    assert study(3, "1").table["sah"].tolist() == first
    register("own", lambda t, o, c: np.argsort(t.corners[:, 0, 0]), version="2")
    second = mibvh.study([soup(40)], tmp_path, builders="hill(start=own,sweeps=0)", **CHOICES)
    assert second.table["sah"].tolist() != first


def test_an_option_called_start_need_not_name_a_builder(register):
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Options(mibvh.Options):
        start: str = mibvh.option("left", "where to begin")

    register("sided", lambda t, o, c: np.arange(len(t)), options=Options)
    (chosen,) = parse("sided(start=right)")
    assert chosen.name == "sided(start=right)"
    assert chosen.starts() == frozenset()


def test_a_sweep_is_drawn(finished):
    (found,) = (s for s in sweeps(finished.scenes[0]) if s.option == "bins")
    assert found.builder == "sbvh"
    assert found.values == [8, 16, 24]
    table = finished.table.set_index("builder")
    assert found.column("sah").tolist() == [
        table.loc[f"sbvh(bins={n})", "sah"] for n in (8, 16, 24)
    ]
    assert (finished.folder / "figures" / f"{SCENE}-sweep-sbvh-bins.svg").exists()
    assert "cost against bins" in finished.report.read_text()


def test_figures_are_pdf_where_they_are_asked_for(finished):
    remake_report(finished.folder, ("pdf",))
    for path in (finished.folder / "figures").glob("*.svg"):
        assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF")


# ------------------------------------------------------------------ rays of one's own


def test_given_rays_are_traced(tmp_path, scene):
    rays = mibvh.diffuse_rays(scene, width=16, height=12, samples=1, bounces=2, seed=5)
    plain = mibvh.RaySet(rays.o, rays.d, bounce=rays.bounce, viewpoint=rays.viewpoint)
    path = tmp_path / "rays.npz"
    np.savez(path, o=plain.o, d=plain.d, bounce=plain.bounce, viewpoint=plain.viewpoint)
    found = mibvh.study(
        SCENE,
        tmp_path / "out",
        rays=path,
        builders="bbvh,lbvh",
        experiments=("all",),
        **CHOICES,
    )
    record = found.scenes[0]
    assert (record.rays.count, record.rays.digest) == (len(plain), plain.digest)
    hits = mibvh.trace(mibvh.build(scene, "lbvh"), scene, plain, repeats=1)
    assert found.table["counted_cost"][1] == pytest.approx(hits.counted_cost())
    origins = record.trees[0].costs_by_origin
    assert {entry.bounce for entry in origins} == {1, 2}
    assert {entry.viewpoint for entry in origins} == set(range(5))
    assert found.failures == []
    assert {"bounce", "viewpoints"} <= set(found.sensitivity["experiment"])
    assert any("The rays were given (rays.npz)" in note for note in record.notes)
    other = mibvh.study(
        SCENE, tmp_path / "out", rays=rays.select(slice(100)), **CHOICES, builders="bbvh,lbvh"
    )
    assert other.scenes[0].reused.get("counts", 0) == 0
    assert other.scenes[0].rays.count == 100


def test_rays_that_a_study_cannot_take(tmp_path, scene):
    shadow = mibvh.make_rays(scene, "shadow", width=8, height=6, samples=1)
    other = mibvh.diffuse_rays("cornell@3000", width=8, height=6, samples=1)
    for rays, said in (
        (shadow, "are shadow rays, which end at any hit"),
        (other, "made for another geometry"),
        (other.select(slice(0)), "there are no rays"),
        (tmp_path / "none.npz", "there is no such ray file"),
        ([shadow, shadow], "2 given for 1 scenes"),
    ):
        with pytest.raises(mibvh.MibvhError, match=said):
            mibvh.study(scene, tmp_path / "out", rays=rays, builders="bbvh", **CHOICES)
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------ refusals before any work


def test_trees_are_refused_before_any_work(tmp_path, scene, mine):
    path = tmp_path / "t.npz"
    mine.save(path)
    deep = chain(80)
    for trees, said in (
        ({"bbvh": mine}, "cannot have the name of a builder, bbvh"),
        ({"embree": mine}, "cannot have the name of a builder, embree"),
        ({"a|b": mine}, "cannot be called 'a|b'"),
        ({"a": {"cornel": mine}}, r"no scene of the study \(did you mean 'cornell@1000'"),
        ({"a": [mine, mine]}, "2 given for 1 scenes"),
        ({"a": tmp_path / "none.npz"}, "none.npz"),
        ({"a": 3.5}, "is a Tree or a file, not a float"),
        ({"a": imported(soup(50))}, "tree a of cornell@1000: .* another geometry"),
    ):
        with pytest.raises(mibvh.MibvhError, match=said):
            mibvh.study(SCENE, tmp_path / "out", trees=trees, builders="bbvh", **CHOICES)
    with pytest.raises(mibvh.MibvhError, match="80 levels deep; the traversal stack has 64"):
        mibvh.study(deep[0], tmp_path / "out", trees={"a": deep[1]}, builders="bbvh", **CHOICES)
    assert not (tmp_path / "out").exists()


def chain(levels):
    """Triangles in a row, and a tree of them that takes them off one by one."""
    n = levels + 1
    corners = np.zeros((n, 3, 3), np.float32)
    corners[:, :, 0] = np.arange(n)[:, None] + np.array([0, 0.5, 0], np.float32)
    corners[:, 1, 1] = corners[:, 2, 2] = 1
    nodes, left, right, first = [], [], [], []
    for i in range(levels):
        nodes += [(i, n - 1), (i, i)]
        left += [2 * i + 1, -1]
        right += [2 * i + 2, -1]
        first += [0, i]
    nodes.append((n - 1, n - 1))
    left.append(-1), right.append(-1), first.append(n - 1)
    lower = np.array([[a, 0, 0] for a, _ in nodes], np.float32)
    upper = np.array([[b + 0.5, 1, 1] for _, b in nodes], np.float32)
    tree = mibvh.Tree.from_arrays(lower, upper, left, right, first, np.ones(len(left), int))
    return mibvh.Triangles(corners, "row"), tree


def test_scenes_that_cannot_be_read_are_left_out(tmp_path, scene):
    (tmp_path / "broken.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    sources = [tmp_path / "broken.ply", SCENE, "no_such_scene"]
    found = mibvh.study(sources, tmp_path / "out", builders="bbvh,lbvh", **CHOICES)
    assert [record.scene for record in found.scenes] == [SCENE]
    assert set(found.left_out) == {"broken", "no_such_scene"}
    assert read_study(tmp_path / "out").left_out == found.left_out
    for file in ("report.html", "results.md"):
        text = (tmp_path / "out" / file).read_text()
        assert "Left out" in text
        assert "no_such_scene" in text
        assert "broken.ply" in text
    with pytest.raises(mibvh.MibvhError, match="no_such_scene: there is no such file"):
        mibvh.study(["no_such_scene"], tmp_path / "none", builders="bbvh", **CHOICES)


def test_names_clash_before_any_work(tmp_path):
    for sources in ([SCENE, SCENE], [soup(40), soup(40)]):
        with pytest.raises(mibvh.MibvhError, match="two scenes are called"):
            mibvh.study(sources, tmp_path / "out", builders="bbvh", **CHOICES)
    assert not (tmp_path / "out").exists()


def test_mistakes_in_python_are_one_sentence(tmp_path, scene):
    tree = mibvh.build(scene)
    rays = mibvh.diffuse_rays(scene, width=8, height=6, samples=1)
    for call, said in (
        (lambda: mibvh.sah(scene), "tree must be a Tree, not a Scene"),
        (lambda: mibvh.epo(scene, tree), "tree must be a Tree, not a Scene"),
        (lambda: mibvh.trace(scene, tree, rays), "tree must be a Tree, not a Scene"),
        (lambda: mibvh.trace(tree, scene, [1, 2]), "rays must be a RaySet, not a list"),
        (lambda: mibvh.study(builders="bbvh"), "a study needs at least one scene"),
        (lambda: mibvh.study(SCENE, tmp_path, builder="bbvh"), r"did you mean 'builders'"),
        (lambda: mibvh.study(SCENE, tmp_path, experiments="dept"), r"did you mean 'depth'"),
        (lambda: mibvh.study(3, tmp_path), "a scene is a file"),
    ):
        with pytest.raises(mibvh.MibvhError, match=said):
            call()
