"""Studies by children per node and by kinds of rays, held against the library's own functions."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import mibvh
from mibvh.metrics.occlusion import saved_by_any_hit
from mibvh.metrics.points import point_costs, ray_starts
from mibvh.studies.analyse.kinds import MIXED, kind_correlations, kind_samples
from mibvh.studies.analyse.widths import wide_trees, width_correlations
from mibvh.studies.measure.counts import LINES, lines_of
from mibvh.studies.measure.kinds import KindResult
from mibvh.studies.measure.store import Store
from mibvh.studies.measure.widths import WidthResult
from mibvh.studies.paper.claims import claims
from mibvh.studies.record.options import kinds_or_files, weights, widths_of
from mibvh.studies.record.serialise import to_json
from mibvh.studies.report.tables import answers
from mibvh.studies.report.tidy import tidy_table
from mibvh.studies.run import read_study

BUILDERS = ("bbvh", "sbvh", "lbvh", "hill", "treelet")
CHOICES = {
    "width": 24,
    "height": 16,
    "scalar_rays": 256,
    "seconds": 0.0,
    "builders": BUILDERS,
    "experiments": ("prediction",),
}
KINDS = ("diffuse", "shadow", "ao", "primary")
ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def scene():
    return mibvh.load("livingroom@2000")


@pytest.fixture(scope="module")
def found(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("widths")
    return mibvh.study([scene], folder, widths="4,8", kinds=KINDS, **CHOICES)


@pytest.fixture(scope="module")
def trees(scene):
    return {name: mibvh.build(scene, name) for name in BUILDERS}


def test_choices_turn_their_experiments_on():
    options = mibvh.StudyOptions(widths="8,4", kinds=("ao",))
    assert options.experiments == ("prediction", "depth", "width", "kinds")
    assert options.widths == (4, 8)
    assert mibvh.StudyOptions().experiments == ("prediction", "depth")
    assert widths_of("") == ()


@pytest.mark.parametrize("asked", ["3", "2,eight", (16,)])
def test_other_widths_are_refused(asked):
    with pytest.raises(mibvh.MibvhError, match="widths are of 2, 4, 8"):
        mibvh.StudyOptions(widths=asked)


def test_kinds_and_their_weights():
    assert weights(("shadow:2", "diffuse:0.5")) == {"shadow": 2.0, "diffuse": 0.5}
    assert weights(("shadow", "bounce2")) == {"shadow": None, "bounce2": None}
    for wrong, said in (
        (("oak",), "no kind of rays 'oak'"),
        (("ao", "ao"), "named twice"),
        (("ao:1", "shadow"), "all kinds of rays have a weight, or none"),
        (("ao:-1",), "not negative"),
        (("ao:0",), "all 0"),
    ):
        with pytest.raises(mibvh.MibvhError, match=said):
            mibvh.StudyOptions(kinds=wrong)


def test_commands_in_the_docs_name_rays_that_a_study_takes():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    told = re.findall(r"--rays ([a-z][\w:.,]*)", "\n".join(page.read_text() for page in pages))
    asked = [kinds for kinds, _ in map(kinds_or_files, told) if kinds]
    assert len(asked) > 2
    for kinds in asked:
        assert mibvh.StudyOptions(kinds=kinds).kinds == kinds


def test_kinds_are_told_from_files():
    assert kinds_or_files("diffuse,shadow2:3") == (("diffuse", "shadow2:3"), [])
    assert kinds_or_files("a.npz,,b.ply") == ((), ["a.npz", "", "b.ply"])
    assert kinds_or_files("") == ((), [])
    with pytest.raises(mibvh.MibvhError, match="not both: ao is a kind, and"):
        kinds_or_files("ao,a.npz")


# ------------------------------------------------------------------ widths


def test_wide_figures_are_the_library_s(found, scene, trees):
    """Also of trees that split triangles."""
    record = found.scenes[0]
    result = record.result(WidthResult)
    assert result.widths == [2, 4, 8]
    rays = mibvh.diffuse_rays(scene, width=24, height=16, samples=1)
    starts = ray_starts(scene.triangles, rays)
    assert trees["sbvh"].splits_triangles
    for row, wide_rows in zip(record.trees, result.trees, strict=True):
        for name in ("sah", "epo", "lcv", "counted_cost", "point_query", "sah_lines"):
            assert wide_rows[0].values[name] == row[name]
        for width, got in zip((4, 8), wide_rows[1:], strict=True):
            wide = mibvh.collapse(trees[row.builder], width)
            hits = mibvh.trace(wide, scene.triangles, rays, repeats=1)
            query = point_costs(wide, scene.triangles, starts.points, starts.triangle)
            values = got.values
            assert values["sah"] == pytest.approx(mibvh.sah(wide), rel=1e-12)
            assert values["epo"] == pytest.approx(mibvh.epo(wide, scene.triangles), rel=1e-12)
            assert values["counted_cost"] == pytest.approx(hits.counted_cost(), rel=1e-12)
            assert values["point_query"] == pytest.approx(query.sum(axis=1).mean(), rel=1e-12)
            assert values["lcv"] == hits.lcv
            assert values["boxes_per_ray"] == hits.boxes.mean()


def test_tables_claims_and_figures_are_of_every_width(found):
    record = found.scenes[0]
    r = width_correlations(found.scenes)
    own = found.correlations.query("measurement == 'counted_cost'").set_index("predictor")
    two = r[r["width"] == 2].set_index("predictor")
    assert set(two.index) == set(own.index)
    for name in two.index:  # at two children, the study's own
        assert two.loc[name, "pearson"] == pytest.approx(own.loc[name, "pearson"], nan_ok=True)
    at_eight = [rows[2].values for rows in record.result(WidthResult).trees]
    sah, cost = (np.array([v[name] for v in at_eight]) for name in ("sah", "counted_cost"))
    alone = r.query("width == 8 and predictor == 'SAH'")["pearson"].item()
    assert alone == pytest.approx(np.corrcoef(sah, cost)[0, 1])
    assert len(wide_trees(found.scenes)) == 3 * len(BUILDERS)
    names = [sheet.name for sheet in answers(found.scenes, found.correlations)]
    for name in (
        "width-r",
        "width-scenes",
        "width-builders",
        "width-before",
        "width-optimised",
        "width-trees",
        "kinds-r",
        "kinds-scenes",
        "kinds-builders",
    ):
        assert name in names
        assert (found.folder / "tables" / f"{name}.csv").stat().st_size > 0
    told = " ".join(claims(found.scenes, found.correlations)["claim"])
    assert "4 children per node: SAH alone" in told
    assert "8 children per node: with EPO" in told
    for name in ("width", "kinds"):
        assert (found.folder / "figures" / f"livingroom@2000-{name}.svg").stat().st_size > 5000


def test_a_wrong_wide_figure_fails_the_audit(found, scene):
    """A kept piece with other numbers and a fitting checksum, as somebody might make it."""
    assert found.failures == []
    store = Store(found.folder / "cache")
    pieces = sorted((found.folder / "cache").glob("wide-*.json"))
    assert len(pieces) == 2 * len(BUILDERS)
    before = json.loads(pieces[0].read_text())["value"]
    for name in ("sah", "epo", "counted_cost"):
        values = {**before["values"], name: before["values"][name] * 1.3}
        store.write(pieces[0].stem, {"values": values})
        again = mibvh.study([scene], found.folder, widths="4,8", kinds=KINDS, **CHOICES)
        store.write(pieces[0].stem, before)
        failed = {(tree, check.name) for _, tree, check in again.failures}
        assert len(failed) == 1
        tree, check = failed.pop()
        assert "children)" in tree
        assert check == {"counted_cost": "counts"}.get(name, name)


def test_again_recomputes_nothing(found, scene, monkeypatch):
    def fail(*_, **__):
        pytest.fail("something was made again")

    for name in (
        "measure.counts.Tracer",
        "measure.widths.overlap",
        "measure.widths.collapse",
        "measure.kinds.make_rays",
    ):
        monkeypatch.setattr(f"mibvh.studies.{name}", fail)
    again = mibvh.study([scene], found.folder, widths="4,8", kinds=KINDS, **CHOICES)
    assert again.failures == []
    read = read_study(found.folder)
    told = [json.dumps(to_json(of.scenes[0].results)) for of in (again, found, read)]
    assert told[0] == told[1] == told[2]  # as texts: NaN is not equal to itself


# ------------------------------------------------------------------ kinds of rays


def test_kinds_cost_what_their_kernels_visit(found, scene, trees):
    record = found.scenes[0]
    result = record.result(KindResult)
    assert [kind.name for kind in result.sets] == list(KINDS)
    assert [kind.occlusion for kind in result.sets] == [False, True, True, False]
    for kind in result.sets:
        rays = mibvh.make_rays(scene, kind.name, width=24, height=16, samples=1)
        assert kind.rays == kind.made == len(rays) == kind.weight
        closest = mibvh.trace(trees["bbvh"], scene.triangles, rays, any_hit=False, repeats=1)
        for name, values in zip(BUILDERS, kind.values, strict=True):
            hits = mibvh.trace(trees[name], scene.triangles, rays, repeats=1)
            assert values["counted_cost"] == pytest.approx(hits.counted_cost(), rel=1e-12)
            assert values["hit_share"] == pytest.approx((closest.triangle >= 0).mean())
            if kind.occlusion:
                saved = saved_by_any_hit(trees[name], scene.triangles, rays, closest)
                assert values["saved"] == pytest.approx(saved, rel=1e-12)
                whole = mibvh.trace(trees[name], scene.triangles, rays, any_hit=False, repeats=1)
                assert values["counted_cost"] < whole.counted_cost()
    for row, values in zip(record.trees, result.sets[0].values, strict=True):
        assert values["counted_cost"] == row["counted_cost"]  # diffuse rays are the study's own


def test_tidy_rows_of_a_kind_say_how_many_of_its_rays(found):
    table = tidy_table(found.scenes).query("experiment == 'kinds'")
    rays = {kind.name: kind.rays for kind in found.scenes[0].result(KindResult).sets}
    assert len(set(rays.values())) > 1
    for name in ("counted_cost", "touched", "sah_lines"):  # so few that all lines are followed
        of = table[table["measurement"] == name]
        assert of["rays"].tolist() == of["kind"].map(rays).tolist()


@pytest.mark.parametrize("rays", [1, 9_999, 10_000, 10_001, 25_000])
def test_as_many_lines_are_followed_as_is_said(rays):
    step = len(range(0, rays, LINES))
    assert lines_of(rays) == len(range(0, rays, step)) <= LINES


def test_a_mixture_is_the_mean_over_its_rays(found):
    result = found.scenes[0].result(KindResult)
    samples = kind_samples(result)
    share = np.array([kind.rays for kind in result.sets], float)
    share /= share.sum()
    for name in ("counted_cost", "point_query", "length_ratio"):
        parts = [samples[kind].values[name] for kind in KINDS]
        np.testing.assert_allclose(samples[MIXED].values[name], share @ np.array(parts))
    r = kind_correlations(found.scenes).set_index(["kind", "predictor"])
    for kind in ("diffuse", "primary"):  # nothing ends at any hit
        assert r.loc[(kind, "any-hit rays"), "pearson"] == r.loc[(kind, "finite rays"), "pearson"]
    assert (
        r.loc[("shadow", "estimated, any hit"), "alpha"] < r.loc[("shadow", "estimated"), "alpha"]
    )


def test_weights_make_the_mixture(found, scene):
    asked = ("diffuse:1", "shadow:3")
    again = mibvh.study([scene], found.folder, kinds=asked, **CHOICES)
    samples = kind_samples(again.scenes[0].result(KindResult))
    costs = {name: samples[name].measured for name in ("diffuse", "shadow", MIXED)}
    np.testing.assert_allclose(costs[MIXED], 0.25 * costs["diffuse"] + 0.75 * costs["shadow"])


def test_kinds_without_rays_are_left_out(tmp_path):
    """From inside nothing is seen, and beyond one wall there is no second vertex."""
    wall = np.array([[[-9, -9, 0], [9, -9, 0], [0, 9, 0]]], np.float32)
    scene = mibvh.load(mibvh.Triangles(wall))
    result = mibvh.study(
        [scene], tmp_path, kinds=("diffuse", "bounce2"), **{**CHOICES, "builders": ("bbvh",)}
    )
    kinds = result.scenes[0].result(KindResult)
    assert [kind.name for kind in kinds.sets] == ["diffuse"]
    assert "vertex 2" in kinds.left_out["bounce2"]
