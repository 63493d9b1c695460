"""The experiments of a study beside prediction: rotation, depth, sensitivity; the catalogue."""

import copy
import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from conftest import scene_record, soup, tree_row

import mibvh
from mibvh.studies.analyse.builders import relative_to_best, splitting_builders
from mibvh.studies.analyse.depth import remaining_relative
from mibvh.studies.measure import rotation, stopwatch
from mibvh.studies.measure.depth import (
    SPLITS,
    DepthResult,
    remaining_after_splits,
    remaining_by_depth,
    worst_cases,
)
from mibvh.studies.measure.rotation import RotationResult
from mibvh.studies.measure.sensitivity import SensitivityResult
from mibvh.studies.measure.setting import Setting
from mibvh.studies.measure.times import Frame, time_frames, times
from mibvh.studies.paper.catalogue import (
    find_paper_scene,
    paper_comparison,
    scenes_in,
    triangle_count_notes,
)
from mibvh.studies.paper.claims import claims
from mibvh.studies.paper.published import published
from mibvh.studies.record.claim import FEWEST_SCENES
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.report.tables import answers
from mibvh.studies.report.tidy import tidy_table
from mibvh.traversal.trace import Tracer

CHOICES = {
    "width": 24,
    "height": 16,
    "scalar_rays": 256,
    "seconds": 0.0,
    "builders": ("bbvh", "sbvh", "lbvh"),
}
ALL = ("prediction", "depth", "rotation", "sensitivity")


@pytest.fixture(scope="module")
def full(tmp_path_factory, cornell):
    """A study of everything, begun with less: what it found first, its files, the end, progress."""
    folder = tmp_path_factory.mktemp("experiments")
    less = mibvh.study([cornell], folder, experiments=("prediction",), **CHOICES)
    times = {p: p.stat().st_mtime_ns for p in (folder / "cache").glob("[!s]*.*")}  # not the lock
    done = []
    more = mibvh.study(
        [cornell], folder, experiments=ALL, progress=lambda step: done.append(step.done), **CHOICES
    )
    return less, times, more, done


# ------------------------------------------------------------------ what is run


def test_only_what_is_asked_for_is_done(full):
    record = full[0].scenes[0]
    assert record.results == {}
    assert set(full[2].scenes[0].results) == {"depth", "rotation", "sensitivity"}
    assert full[0].rotation.empty
    assert full[0].sensitivity.empty
    assert full[0].depth.empty
    with pytest.raises(mibvh.MibvhError, match="no experiment 'oak'; there are: prediction"):
        mibvh.StudyOptions(experiments=("oak",))


def test_more_experiments_leave_alone_what_is_there(full):
    less, times, more, _ = full
    assert {p: p.stat().st_mtime_ns for p in times} == times
    for name in ("sah", "counted_cost", "scalar_ns", "simd_ns"):
        assert more.table[name].tolist() == less.table[name].tolist()


def test_again_recomputes_nothing(full, cornell, monkeypatch):
    def fail(*_, **__):
        pytest.fail("something was made again")

    for name in (
        "measure.trees.build",
        "measure.times.measure",
        "measure.counts.Tracer",
        "measure.times.Tracer",
        "measure.scene.diffuse_rays",
        "measure.rotation.time_frames",
        "measure.warps.simulate",
        "measure.rotation.make_records",
        "measure.sensitivity.finish",
        "measure.sensitivity.diffuse_rays",
        "measure.sensitivity.counted_costs",
    ):
        monkeypatch.setattr(f"mibvh.studies.{name}", fail)
    monkeypatch.setattr("mibvh.metrics.registry.overlap", fail)
    again = mibvh.study([cornell], full[2].folder, experiments=ALL, **CHOICES)
    assert again.rotation.equals(full[2].rotation)
    assert again.sensitivity.equals(full[2].sensitivity)


def test_progress_goes_forward_and_ends_at_one(full):
    assert full[3] == sorted(full[3])
    assert full[3][-1] == 1.0


@pytest.mark.parametrize("given", [False, True])
def test_an_experiment_may_ask_whether_its_rays_were_given(given):
    setting = Setting(*[None] * 7, rays_given=given)
    with pytest.warns(DeprecationWarning, match="own_rays is now rays_given"):
        assert setting.own_rays is given


# ------------------------------------------------------------------ rotation


def test_rotated_rays_hit_the_same(cornell):
    rays = mibvh.diffuse_rays(cornell, width=24, height=16)
    scene, moved = rotation.rotated(cornell, rays)
    for builder in ("bbvh", "sbvh"):
        hits = [
            mibvh.trace(mibvh.build(triangles, builder), triangles, r, repeats=1)
            for triangles, r in ((cornell.triangles, rays), (scene.triangles, moved))
        ]
        same = hits[0].triangle == hits[1].triangle
        assert same.mean() > 0.999  # those on an edge may go either way
        hit = same & (hits[0].triangle >= 0)
        np.testing.assert_allclose(hits[0].t[hit], hits[1].t[hit], rtol=1e-3, atol=1e-4)


def test_factors_are_one_where_turning_changes_nothing(monkeypatch, tmp_path):
    """A third of a turn about (1, 1, 1) exchanges the axes: every tree is as it was."""
    monkeypatch.setattr(rotation, "DEGREES", 120.0)
    scene = mibvh.load(soup(300))
    found = mibvh.study(
        [scene],
        tmp_path,
        experiments=("rotation",),
        **{**CHOICES, "builders": ("bbvh", "agglo", "hill")},
    )
    assert found.scenes[0].result(RotationResult).same_hits > 0.999
    for name in ("sah", "epo", "counted_cost", "finite_rays"):
        np.testing.assert_allclose(found.rotation[name], 1, rtol=2e-3, err_msg=name)


def test_factors_of_a_scene_of_walls(full):
    """Axis-aligned walls lose their thin boxes, and the ends of rays lose more than long rays."""
    factors, record = full[2].rotation, full[2].scenes[0]
    assert factors["builder"].tolist() == list(CHOICES["builders"])
    result = record.result(RotationResult)
    assert result.same_hits > 0.999
    for i, row in factors.iterrows():
        tree, turned = record.trees[i], result.trees[i]
        assert row["sah"] == turned["sah"] / tree["sah"]
        assert row["epo"] == turned["epo"] / tree["epo"]
        assert row["counted_cost"] == turned["counted_cost"] / tree["counted_cost"]
        assert row["sah"] < row["counted_cost"]
        assert row["epo"] > 1
        assert row["scalar_ns"] > 0


def test_rotation_rebuilds_trees(full, cornell):
    triangles = rotation.rotated(cornell, mibvh.diffuse_rays(cornell, width=4, height=4))[0]
    tree = mibvh.build(triangles.triangles, "lbvh")
    assert full[2].scenes[0].result(RotationResult).trees[2]["sah"] == mibvh.sah(tree)


# ------------------------------------------------------------------ depth


@pytest.mark.parametrize("builder", ["bbvh", "lbvh", "sbvh"])
def test_cuts_against_a_walk(builder):
    """Each cut is that of a plain recursion, and the deepest is the whole tree."""
    triangles = soup(200)
    tree = mibvh.build(triangles, builder)

    def cut(node, levels):
        area = tree.half_areas[node] / tree.half_areas[0]
        if levels == 0 or tree.left[node] < 0:
            return np.array([0.0, tree.count[node] * area])
        below = sum(cut(tree.left[node] + c, levels - 1) for c in range(2))
        return below + [1.2 * area, 0.0]

    spent, remaining = remaining_by_depth(tree)
    for depth in range(tree.depth + 1):
        np.testing.assert_allclose([spent[depth], remaining[depth]], cut(0, depth), rtol=1e-12)
    assert remaining[0] == len(tree.references)
    assert spent[-1] + remaining[-1] == pytest.approx(mibvh.sah(tree), rel=1e-12)


def test_splitting_the_largest_first():
    tree = mibvh.build(soup(200), "bbvh")
    worst = worst_cases(tree)
    found = remaining_after_splits(tree)
    frontier, by_hand = [0], [worst[0]]
    while inner := [n for n in frontier if tree.left[n] >= 0]:
        node = max(inner, key=lambda n: worst[n])
        frontier.remove(node)
        frontier += [tree.left[node], tree.left[node] + 1]
        by_hand.append(sum(worst[n] for n in frontier))
    for splits, value in zip(SPLITS, found, strict=True):
        if splits < len(by_hand):
            assert value == pytest.approx(by_hand[splits], rel=1e-12)
        else:
            assert value is None
    assert sum(v is not None for v in found) > 4


def test_the_sweep_minimises_what_remains(full):
    """Of one split no object split leaves less than the full sweep's."""
    triangles = soup(400)
    least = remaining_after_splits(mibvh.build(triangles, "bbvh"))[1]
    for builder in ("lbvh", "agglo", "hill", "treelet"):
        assert remaining_after_splits(mibvh.build(triangles, builder))[1] >= least * (1 - 1e-9)
    table = remaining_relative(full[2].scenes)
    assert (table.loc["bbvh"].dropna() == 1).all()
    assert table.loc["lbvh", 7] > 1


def test_depth_table_adds_up(full):
    for (_, builder), group in full[2].depth.groupby(["scene", "builder"]):
        tree = next(t for t in full[2].scenes[0].trees if t.builder == builder)
        assert group["sah"].sum() == pytest.approx(tree["sah"])
        assert group["epo"].sum() == pytest.approx(tree["epo"])
        assert group["depth"].tolist() == list(range(tree["depth"] + 1))


# ------------------------------------------------------------------ sensitivity


def test_own_choices_give_the_study_s_own_r(full):
    """The leaf size, bounce and viewpoints of the study are among those that are tried."""
    r = full[2].correlations.query("measurement == 'counted_cost'").set_index("predictor")
    table = full[2].sensitivity.set_index(["experiment", "choice"]).sort_index()
    views = full[2].scenes[0].rays.viewpoints
    for case in (("leaf size", 8), ("bounce", 1), ("viewpoints", views)):
        row = table.loc[case]
        assert float(row["sah"].iloc[0] if isinstance(row, pd.DataFrame) else row["sah"]) == (
            pytest.approx(r.loc["SAH", "pearson"], rel=1e-9)
        )
    counts = full[2].sensitivity.groupby(["experiment", "choice"]).size()
    assert counts["viewpoints"].tolist() == [views] * (views - 1) + [1]
    assert counts["leaf size"].index.tolist() == [1, 2, 4, 8, 16]
    assert counts["bounce"].index.tolist() == [1, 2, 3]


def test_trees_that_two_builders_made_alike_tell_of_the_stopwatch(cornell, monkeypatch):
    """Their difference counts as that of a tree timed twice: an error of every tree's time."""
    rays = mibvh.diffuse_rays(cornell, width=24, height=16)
    one, other = (mibvh.build(cornell.triangles, name) for name in ("bbvh", "lbvh"))
    asked = []

    def measure(launches, **options):
        asked.append(options["same"])
        return stopwatch.measure(launches, **options)

    monkeypatch.setattr("mibvh.studies.measure.times.measure", measure)
    options = StudyOptions(seconds=0.1, standard_error=1e-6)
    trees = {"a": other, "b": one, "c": one, "d": other}
    times(trees, cornell, rays, "scalar", options, lambda *stage: None)
    # The first and the last tree have second names, 4 and 5.
    assert asked == [[(0, 4), (3, 5), (1, 2), (0, 3)]]


def test_trees_are_launched_whole_once_before_the_stopwatch(cornell, monkeypatch):
    """Those of the first frame, which decide how the rays are split; the others not at all."""
    rays = mibvh.diffuse_rays(cornell, width=24, height=16)
    trees = {name: mibvh.build(cornell.triangles, name) for name in ("bbvh", "lbvh", "sbvh")}
    launched = []
    run = Tracer.run

    def counted(self, records, **options):
        launched.append(self.count)
        return run(self, records, **options)

    def no_stopwatch(launches, **options):
        asked.append((len(launches), len(launched)))
        return stopwatch.measure(launches, **options)

    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(Tracer, "run", counted)
    monkeypatch.setattr("mibvh.studies.measure.times.measure", no_stopwatch)
    options = StudyOptions(seconds=0.1, standard_error=1e-6)
    frame = Frame(cornell, rays, trees, list(trees))
    found = time_frames([frame, frame], "scalar", options, lambda *stage: None)
    assert asked == [(6, 3)]
    assert np.isfinite(found.ns).all()


def test_leaf_sizes_and_bounces_against_the_library(full, cornell):
    found = full[2].scenes[0].result(SensitivityResult)
    rays = mibvh.diffuse_rays(cornell, width=24, height=16, samples=1, bounces=3)
    for i, builder in enumerate(("bbvh", "sbvh")):
        tree = mibvh.build(cornell.triangles, builder, max_leaf=1)
        one = found.leaf_sizes[i][0]
        assert one.max_leaf == 1
        assert one.values["mean_leaf_size"] == 1
        if builder == "bbvh":
            assert one.values["sah"] == mibvh.sah(tree)
            assert one.values["epo"] == mibvh.epo(tree, cornell.triangles)
        tree = mibvh.build(cornell.triangles, builder)
        for entry in found.bounces[i]:
            chosen = (rays.bounce == entry.bounce) & (rays.viewpoint == entry.viewpoint)
            hits = mibvh.trace(tree, cornell.triangles, rays.select(chosen), repeats=1)
            assert entry.bounce > 1
            assert entry.rays == chosen.sum()
            assert entry.cost == pytest.approx(hits.counted_cost(), rel=1e-9)


def test_the_builder_s_own_leaf_size_is_its_own_tree(tmp_path):
    """Those too whose triangles are split beforehand, or whose leaves go by another measure."""
    study = mibvh.study(
        ["cornell@1000"],
        tmp_path,
        builders="sbvh,bbvh(presplit=0.3),finite",
        experiments="sensitivity",
        width=12,
        height=8,
        seconds=1e-3,
    )
    for tree, sizes in zip(
        study.scenes[0].trees, study.scenes[0].result(SensitivityResult).leaf_sizes, strict=True
    ):
        own = next(size.values for size in sizes if size.max_leaf == 8)
        for name in ("sah", "epo", "mean_leaf_size", "counted_cost"):
            assert own[name] == pytest.approx(tree[name], rel=1e-9), (tree.builder, name)


def test_tidy_rows_say_what_they_are_of(full):
    table = tidy_table(full[2].scenes)
    record = full[2].scenes[0]
    plain = table.query("experiment == 'prediction' and measurement == 'sah'")
    assert plain["value"].tolist() == full[2].table["sah"].tolist()
    turned = table.query("rotation == 45 and measurement == 'epo' and builder == 'sbvh'")
    assert turned["value"].tolist() == [record.result(RotationResult).trees[1]["epo"]]
    sizes = table.query("experiment == 'leaf size' and measurement == 'sah' and builder == 'bbvh'")
    assert sizes["max_leaf"].tolist() == [1, 2, 4, 8, 16]
    deep = table.query("bounce == 3 and builder == 'lbvh'")
    assert len(deep) == record.rays.viewpoints
    assert (deep["measurement"] == "counted_cost").all()
    # The leaves are collapsed to that size; the builder ran with its own.
    assert json.loads(sizes["builder_options"].iloc[0])["max_leaf"] == 8
    assert turned["digest"].tolist() == [record.result(RotationResult).digest] != [record.digest]
    assert set(table.query("measurement == 'scalar_ns'")["rays"]) <= set(range(1, 257))
    assert plain["rays"].tolist() == [0, 0, 0]
    again = table.query("measurement == 'simd_ns_again'")["value"].item()
    of_first = record.trees[0]["simd_ns"] * (1 + record.timing["simd"].repeat_difference)
    assert again == of_first
    cut = table.query("experiment == 'depth' and builder == 'lbvh' and cut_depth >= 0")
    cuts = record.result(DepthResult).trees
    kept = {"epo_at_depth": record.trees[2].epo_by_depth, "nodes_at_depth": cuts[2].nodes_by_depth}
    for name, values in kept.items():
        found = cut.loc[cut["measurement"] == name, "value"]
        assert found.tolist() == values
    left = table.query("experiment == 'splits' and builder == 'bbvh'").set_index("splits")["value"]
    assert left[7] == cuts[0].remaining_after_splits[3]
    key = [
        "scene",
        "builder",
        "experiment",
        "rotation",
        "max_leaf",
        "bounce",
        "viewpoint",
        "cut_depth",
        "splits",
        "measurement",
    ]
    assert not table.duplicated(key).any()
    assert table["study_options"].str.contains('"seed": 0').all()


# ------------------------------------------------------------------ the paper's scenes


def test_catalogue():
    known = published().known_scenes
    assert len(known) == 16
    assert [s.name for s in known] == sorted(s.name for s in known)
    hairball = find_paper_scene("HairBall")
    assert (hairball.r_sah, hairball.r_sah_epo, hairball.triangles) == (0.652, 0.992, 2880000)
    assert find_paper_scene("san_miguel") is find_paper_scene("San-Miguel")
    assert find_paper_scene("happy_vrip").name == "Buddha"
    assert find_paper_scene("cornell") is None
    assert find_paper_scene("arabic").triangles is None


def test_triangle_counts_are_checked():
    assert triangle_count_notes("sibenik", 75284) == []
    assert triangle_count_notes("cornell", 1) == []
    assert triangle_count_notes("bubs", 1) == []  # the count is not known
    (note,) = triangle_count_notes("sibenik", 75282)
    assert "75,282" in note
    assert "75,284" in note


def test_a_folder_of_scenes(tmp_path):
    import trimesh

    corners = soup(60).corners
    trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), process=False
    ).export(tmp_path / "sibenik.ply")
    (tmp_path / "blade").mkdir()
    (tmp_path / "blade" / "scene.xml").write_text('<scene version="3.0.0"/>')
    (tmp_path / "empty").mkdir()
    (tmp_path / "README.txt").write_text("no scene")
    assert scenes_in(tmp_path) == [tmp_path / "blade" / "scene.xml", tmp_path / "sibenik.ply"]
    assert scenes_in("cornell@300") == ["cornell@300"]
    with pytest.raises(mibvh.MibvhError, match="no scene in this folder"):
        scenes_in(tmp_path / "empty")
    (tmp_path / "blade" / "scene.xml").unlink()
    found = mibvh.study([tmp_path], tmp_path / "out", **CHOICES)
    assert found.table["scene"].unique().tolist() == ["sibenik"]
    assert any("75,284" in note for note in found.scenes[0].notes)
    row = paper_comparison(found.scenes, found.correlations).iloc[0]
    assert (row["scene"], row["triangles"], row["expected"]) == ("sibenik", 60, 75284)
    assert row["paper_r_sah"] is None or np.isnan(row["paper_r_sah"])


# ------------------------------------------------------------------ answers


def test_every_experiment_has_its_tables(full):
    names = [sheet.name for sheet in answers(full[2].scenes, full[2].correlations)]
    for name in (
        "claims",
        "sah-over-best",
        "worst-case",
        "where",
        "rotation-scenes",
        "rotation-builders",
        "sensitivity",
        "sensitivity-leaf-size",
        "sensitivity-bounce",
        "sensitivity-viewpoints",
    ):
        assert name in names
        assert (full[2].folder / "tables" / f"{name}.csv").stat().st_size > 0
        assert (full[2].folder / "tables" / f"{name}.tex").read_text().isascii()
    less = [sheet.name for sheet in answers(full[0].scenes, full[0].correlations)]
    assert not {"where", "rotation-scenes", "sensitivity"} & set(less)
    page = full[2].report.read_text()
    assert "whether they held" in page
    assert page.count("data-tip") > 20
    for name in ("rotation", f"{full[2].scenes[0].scene}-remaining"):
        drawn = (full[2].folder / "figures" / f"{name}.svg").read_text()
        assert drawn.startswith("<svg")
        assert drawn.count("<polyline") > 5  # axes, and what is drawn in them


def judged(record, found):
    """Judge the claims on a scene that is there often enough for them to be judged."""
    names = [f"{record.scene}{i}" for i in range(FEWEST_SCENES)]
    records = [dataclasses.replace(record, scene=name) for name in names]
    table = claims(records, pd.concat([found.assign(scene=name) for name in names]))
    return table.set_index("claim")


def test_claims_are_judged_by_the_results(full):
    table = judged(full[2].scenes[0], full[2].correlations)
    turning = next(c for c in table.index if c.startswith("rotating the scene"))
    mean = full[2].rotation.groupby("scene")[["counted_cost", "sah"]].mean().mean()
    assert f"SAH {mean['sah']:.1f}×" in table.loc[turning, "ours"]
    assert mean["counted_cost"] > mean["sah"]
    assert table.loc[turning, "held"] in ("yes", "partly")
    one = claims(full[2].scenes, full[2].correlations).set_index("claim")
    assert one.loc[turning, "held"] == "not judged: 1 scene"
    assert one.loc[turning, "ours"] == table.loc[turning, "ours"]
    less = claims(full[0].scenes, full[0].correlations).set_index("claim")
    assert less.loc[turning, ["ours", "held"]].tolist() == ["–", "not judged"]


def test_a_claim_can_fail(full):
    """Records in which overlap shrinks when the scene is turned, and the sweep has most of it."""
    record = copy.deepcopy(full[2].scenes[0])
    before = {"bbvh": 30.0, "sbvh": 1.0, "lbvh": 20.0}
    for tree, turned in zip(record.trees, record.result(RotationResult).trees, strict=True):
        tree.values["epo"] = before[tree.builder]
        turned.values["epo"] = 0.5 * tree["epo"]
    table = judged(record, full[2].correlations)
    assert table.loc["of all figures EPO grows most with rotating", "held"] == "no"
    sweeps = table.loc["top-down sweeps optimise EPO much better than SAH"]
    assert sweeps["held"] == "partly"
    assert "bbvh: EPO 150%" in sweeps["ours"]


def test_the_sweep_is_compared_with_trees_that_do_not_split_triangles():
    """bbvh far above a spatial split's tree, but not above the others."""
    builders = {"bbvh": 10.0, "sbvh": 5.0, "hill": 9.0, "agglo": 9.5, "lbvh": 12.0}
    record = scene_record(
        [tree_row(b, sah=v, references=120 if b == "sbvh" else 100) for b, v in builders.items()]
    )
    assert relative_to_best([record]).loc["bbvh", "max"] == 2.0
    alike = relative_to_best([record], without=splitting_builders([record]))
    assert alike.loc["bbvh", "max"] == pytest.approx(10 / 9)
    assert "sbvh" not in alike.index


def test_lcv_of_the_sweeps_is_held_against_every_builder(full):
    held = []
    for lcv in (2.0, 0.5):  # of lbvh
        record = copy.deepcopy(full[2].scenes[0])
        for tree in record.trees:
            tree.values["lcv"] = {"bbvh": 1.1, "sbvh": 1.0, "lbvh": lcv}[tree.builder]
        table = judged(record, full[2].correlations)
        held.append(table.loc["top-down sweeps have the lowest LCV of all", "held"])
    assert held == ["yes", "no"]


def test_noise_is_not_judged(full):
    """Times with a large error judge nothing; with a small one the same times do."""
    record = copy.deepcopy(full[2].scenes[0])
    held = []
    for error in (0.001, 0.2):
        for tree in [*record.trees, *record.result(RotationResult).trees]:
            tree.values["scalar_error"] = error
            tree.values["simd_error"] = error
        table = judged(record, full[2].correlations)
        held.append(table["held"])
        reliable = table.loc["SAH alone is not a reliable predictor of time", "judged by"]
        assert ("by counted cost" in reliable) == (error > 0.05)
    simd = "SIMD deviates from scalar by little"
    assert held[0][simd] in ("yes", "no")
    assert held[1][simd] == "not judged"
