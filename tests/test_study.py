import dataclasses
import functools
import json
import shutil

import numpy as np
import pandas as pd
import pytest
from conftest import soup

import mibvh
from mibvh.studies.measure.counts import RayCounter, RayPaths
from mibvh.studies.measure.stopwatch import Timings, measure
from mibvh.studies.measure.store import Store
from mibvh.studies.run import read_study, write_outputs

CHOICES = {"width": 24, "height": 16, "scalar_rays": 512, "seconds": 0.0}


@pytest.fixture(scope="module")
def finished(tmp_path_factory, cornell):
    folder = tmp_path_factory.mktemp("study")
    stages = []
    return (
        mibvh.study(
            [cornell],
            folder,
            builders=("bbvh", "lbvh", "treewise"),
            progress=stages.append,
            **CHOICES,
        ),
        stages,
    )


@mibvh.builder("treewise", summary="halves the list", source="the test", version="1")
def treewise(triangles, options, context):
    """Register a builder of the user's own, which the study takes like the others."""
    return np.arange(len(triangles))


def test_table(finished, cornell):
    table = finished[0].table
    assert table["builder"].tolist() == ["bbvh", "lbvh", "treewise"]
    rays = mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)
    for _, row in table.iterrows():
        tree = mibvh.build(cornell.triangles, row["builder"])
        assert row["sah"] == mibvh.sah(tree)
        assert row["epo"] == mibvh.epo(tree, cornell.triangles)
        hits = mibvh.trace(tree, cornell.triangles, rays, repeats=1)
        assert row["lcv"] == hits.lcv
        assert row["counted_cost"] == pytest.approx(hits.counted_cost())
        assert row["scalar_ns"] > 0
        assert row["simd_ns"] > 0


def test_paths_are_found_anew_only_where_hits_differ(cornell):
    rays = mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)
    counter = RayCounter(cornell, rays, cull=False)
    tree, other = (mibvh.build(cornell.triangles, name) for name in ("bbvh", "lbvh"))
    hits, again = (mibvh.trace(t, cornell.triangles, rays, repeats=1) for t in (tree, other))
    first = counter.paths(hits)
    assert counter.paths(again) is first
    missed = dataclasses.replace(hits, triangle=np.full_like(hits.triangle, -1))
    assert len(counter.paths(missed).ends) == 0


def test_paths_of_rays_that_hit_another_of_two_triangles(cornell, monkeypatch):
    """At the same distance: as they would be found from the beginning, to the last bit."""
    rays = mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)
    tree = mibvh.build(cornell.triangles, "sbvh")
    hits = mibvh.trace(tree, cornell.triangles, rays, repeats=1)
    found, rng = [hits], np.random.default_rng(0)
    for share in (0.01, 0.5):
        other = (hits.triangle + 1) % len(cornell.triangles)
        tied = (hits.triangle >= 0) & (rng.random(len(rays)) < share)
        found.append(dataclasses.replace(hits, triangle=np.where(tied, other, hits.triangle)))
        assert 0 < np.count_nonzero(tied) < len(rays)
    expected = [RayPaths.of(cornell.triangles, rays, hits) for hits in found]
    counter = RayCounter(cornell, rays, cull=False)
    counter.paths(found[0])
    monkeypatch.setattr(RayPaths, "of", None)  # is not needed any more
    for hits, alone in zip(found, expected, strict=True):
        paths = counter.paths(hits)
        assert np.array_equal(paths.ends.points, alone.ends.points)
        assert np.array_equal(paths.ends.triangle, alone.ends.triangle)
        assert paths.ends.rays == alone.ends.rays
        for name in ("o", "d", "length", "share"):
            assert np.array_equal(getattr(paths.lines, name), getattr(alone.lines, name))
        assert paths.length_ratio == alone.length_ratio
        assert paths.hits is hits


def test_files(finished):
    study = finished[0]
    tidy = pd.read_parquet(study.folder / "results.parquet")
    one = tidy.query("builder == 'lbvh' and measurement == 'sah'")
    assert one["value"].tolist() == study.table.query("builder == 'lbvh'")["sah"].tolist()
    assert one["lane_width"].iloc[0] == study.environment["lane_width"]
    assert json.loads((study.folder / "environment.json").read_text()) == study.environment


def test_seconds_are_those_of_the_stages(finished):
    seconds = finished[0].scenes[0].seconds
    assert list(seconds) == [
        "rays",
        "trees",
        "metrics",
        "counts",
        "warps",
        "audit",
        "stopwatch",
        "picture",
        "depth",
    ]
    assert all(spent > 0 for spent in seconds.values())
    built = finished[0].table["build_seconds"].sum()
    assert seconds["trees"] >= built
    assert "Where the time of the study went" in finished[0].report.read_text()


def test_progress_ends_at_one(finished):
    done = [step.done for step in finished[1]]
    assert done[-1] == 1.0
    assert done == sorted(done)


def test_again_recomputes_nothing_and_report_remakes(finished, cornell, monkeypatch):
    study = finished[0]
    before = {p: p.stat().st_mtime_ns for p in (study.folder / "cache").glob("t*")}
    for name in (
        "studies.measure.trees.build",
        "studies.measure.times.measure",
        "studies.measure.scene.diffuse_rays",
        "studies.measure.counts.Tracer",
        "studies.measure.times.Tracer",
        "metrics.registry.overlap",
    ):
        monkeypatch.setattr(f"mibvh.{name}", lambda *_, name=name, **__: pytest.fail(name))
    again = mibvh.study([cornell], study.folder, builders=("bbvh", "lbvh", "treewise"), **CHOICES)
    assert again.table.equals(study.table)
    assert again.scenes[0].seconds == study.scenes[0].seconds
    assert {p: p.stat().st_mtime_ns for p in (study.folder / "cache").glob("t*")} == before
    study.report.unlink()
    found = read_study(study.folder)
    write_outputs(found.folder, found.scenes)
    assert study.report.exists()


def test_a_damaged_piece_is_made_anew(finished, cornell):
    study = finished[0]
    tree = next((study.folder / "cache").glob("tree-*.npz"))
    metrics = next((study.folder / "cache").glob("metrics-*.json"))
    tree.write_bytes(tree.read_bytes()[:1000])
    metrics.write_text(metrics.read_text().replace('"sah": ', '"sah": 9'))
    again = mibvh.study([cornell], study.folder, builders=("bbvh", "lbvh", "treewise"), **CHOICES)
    for name in ("sah", "epo", "lcv", "counted_cost"):
        assert again.table[name].tolist() == study.table[name].tolist()
    assert mibvh.Tree.load(tree).validate() == []


def test_a_folder_that_held_other_studies(tmp_path, monkeypatch):
    choices = {"builders": ("bbvh", "lbvh"), **CHOICES}
    mibvh.study([soup(40)], tmp_path, **choices)
    mibvh.study([soup(50)], tmp_path, **choices)
    assert [r.scene for r in read_study(tmp_path).scenes] == ["soup50"]
    monkeypatch.setattr("mibvh.studies.finished.FORMAT", 0)
    with pytest.raises(mibvh.MibvhError, match="made by another version of mibvh"):
        read_study(tmp_path)


def test_what_an_earlier_run_wrote_goes_and_what_others_wrote_stays(tmp_path):
    mibvh.study([soup(40)], tmp_path, builders=("bbvh", "lbvh"), **CHOICES)
    old = {
        p.relative_to(tmp_path)
        for kind in ("tables", "figures")
        for p in (tmp_path / kind).glob("soup40-*")
    }
    assert len(old) > 8
    (tmp_path / "figures" / "own.svg").write_text("<svg/>")
    mibvh.study([soup(50)], tmp_path, builders=("bbvh", "lbvh"), **CHOICES)
    assert not any((tmp_path / p).exists() for p in old)
    assert (tmp_path / "figures" / "own.svg").exists()
    assert list((tmp_path / "figures").glob("soup50-*"))


def test_a_flat_scene(tmp_path, cornell):
    """No ray has a part inside its box, and none hits it: no metric of lines, and no crash."""
    across = np.arange(5.0)
    x, y = (v.ravel() for v in np.meshgrid(across, across))
    corners = np.stack(
        [np.stack([x + dx, y + dy, 0 * x], axis=1) for dx, dy in ((0, 0), (1, 0), (0, 1))], axis=1
    )
    flat = dataclasses.replace(mibvh.Triangles(corners.astype(np.float32)), name="flat")
    found = mibvh.study([flat, cornell], tmp_path, builders=("bbvh", "lbvh", "hill"), **CHOICES)
    of_flat = found.table[found.table["scene"] == "flat"]
    assert of_flat["sah_lines"].isna().all()
    assert (of_flat["counted_cost"] > 0).all()
    assert found.report.exists()


def test_a_damaged_scene_is_named(tmp_path, finished):
    shutil.copytree(finished[0].folder / "cache", tmp_path / "cache")
    (tmp_path / "cache" / f"scene-{finished[0].scenes[0].scene}.json").write_text("{")
    with pytest.raises(mibvh.MibvhError, match="run it again to mend it"):
        read_study(tmp_path)


def test_impossible_studies(tmp_path, cornell):
    with pytest.raises(mibvh.MibvhError, match="at least one scene"):
        mibvh.study([], tmp_path)
    with pytest.raises(mibvh.MibvhError, match="no builder 'oak'"):
        mibvh.study([cornell], tmp_path, builders=("oak",))
    with pytest.raises(mibvh.MibvhError, match="named twice"):
        mibvh.study([cornell], tmp_path, builders=("bbvh", "bbvh"))
    with pytest.raises(mibvh.MibvhError, match="two scenes are called"):
        mibvh.study([cornell, cornell], tmp_path, builders=("bbvh",), **CHOICES)
    with pytest.raises(mibvh.MibvhError, match="no finished scene"):
        read_study(tmp_path / "nothing")


def test_stopwatch_takes_the_drift_out():
    """Two trees of which one takes 2% longer, on a machine that drifts by a factor of three."""
    rng = np.random.default_rng(0)
    drift = np.repeat(np.linspace(1, 3, 40), 2)
    wobble = 1 + 0.01 * rng.normal(size=80)
    readings = iter([1.0, 1.0, *(drift * wobble)])  # of the first launches, and of 40 rounds

    timings = measure(
        [lambda _: next(readings), lambda _: 1.02 * next(readings)],
        seconds=1e9,
        standard_error=0.002,
    )
    assert timings.complete
    ratio = timings.estimate[1] / timings.estimate[0]
    assert ratio == pytest.approx(1.02, abs=0.008)


def _scatter_of_estimates(portions):
    """Seven rounds at a time on a machine that is slow for about as long as a tree takes."""
    rng = np.random.default_rng(4)
    slow = [False]

    def launch(tree, portion):
        assert 0 <= portion < portions
        slow[0] ^= rng.random() < 0.5 / portions
        return (1.02 if tree else 1.0) * (1.5 if slow[0] else 1.0) / portions

    trees = [functools.partial(launch, k) for k in range(4)]
    runs = [
        measure(trees, portions=portions, seconds=0.0, standard_error=0.0).estimate
        for _ in range(100)
    ]
    return np.std([run[1] / run[0] for run in runs])


def test_portions_take_out_a_drift_shorter_than_a_round():
    assert _scatter_of_estimates(16) < 0.5 * _scatter_of_estimates(1)


def test_standard_error_is_that_of_the_median():
    """Over many repetitions, estimates scatter as their own errors say."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(300):
        kernel, process = 1 + 0.02 * rng.normal(size=(2, 25, 4))
        timings = Timings({"kernel": kernel, "process": process})
        found.append((timings.estimate[0], timings.relative_error[0]))
    estimates, errors = np.array(found).T
    assert estimates.std() == pytest.approx(errors.mean(), rel=0.35)


def test_no_error_is_smaller_than_what_the_same_tree_differed_by():
    rng = np.random.default_rng(2)
    seconds = 1 + 0.001 * rng.normal(size=(25, 4))
    seconds[:, 3] *= 1.05  # the first tree under another name, in a worse place of the memory
    timings = Timings({"kernel": seconds, "process": seconds}, same=((0, 3),))
    assert timings.same_tree_differences("kernel") == pytest.approx(0.05, abs=0.002)
    assert (timings.relative_error >= 0.045).all()


def test_rounds_in_runs_of_trouble_count_as_fewer():
    """Trouble that lasts four rounds makes the error larger than the same trouble scattered."""
    rng = np.random.default_rng(3)
    seconds = np.ones((60, 3))
    slow = np.repeat(rng.random(15) < 0.5, 4)
    seconds[slow, 0] += 0.02 * rng.random(slow.sum())
    scattered = seconds[rng.permutation(60)]
    runs, apart = (Timings({"kernel": s, "process": s}) for s in (seconds, scattered))
    assert runs.relative_error[0] > apart.relative_error[0]


def test_the_clock_that_agrees_with_itself_gives_the_ratios():
    rng = np.random.default_rng(4)
    truth = np.array([1.0, 1.1, 1.0])
    kernel = 3 * truth * (1 + 0.2 * rng.normal(size=(30, 3)))
    process = truth * (1 + 0.002 * rng.normal(size=(30, 3)))
    timings = Timings({"kernel": kernel, "process": process}, same=((0, 2),))
    assert timings.clock == "process"
    estimate = timings.estimate
    assert estimate[1] / estimate[0] == pytest.approx(1.1, abs=0.005)
    assert estimate.mean() == pytest.approx(3 * truth.mean(), rel=0.1)  # the level is the kernel's


def test_store_rejects_damage(tmp_path):
    store = Store(tmp_path / "kept")
    store.write("piece", {"value": 3})
    assert store.read("piece") == {"value": 3}
    path = tmp_path / "kept" / "piece.json"
    path.write_text(path.read_text().replace("3", "4"))
    assert store.read("piece") is None
    assert store.read("absent") is None
    calls = []
    tree = store.array(mibvh.Tree, "k", lambda: calls.append(1) or mibvh.build(soup(9), "lbvh"))
    assert store.array(mibvh.Tree, "k", lambda: calls.append(2)).references.tolist() == (
        tree.references.tolist()
    )
    assert calls == [1]
