"""`finite`: fewer steps for rays it has not seen, and no rays of its own in the measurement."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import mibvh
from mibvh.builders import names
from mibvh.builders.finite import FiniteOptions, finite
from mibvh.builders.registry import Context
from mibvh.errors import MibvhError

FEW = {"count": 3000, "planes": 32}


@pytest.fixture(scope="module")
def scene():
    return mibvh.load("cornell@6000")


@pytest.fixture(scope="module")
def held_out(scene):
    """Rays of another seed than those of training."""
    return mibvh.diffuse_rays(scene, width=48, height=36, samples=2, seed=5)


@pytest.fixture(scope="module")
def trees(scene):
    return {
        "sbvh": mibvh.build(scene, "sbvh"),
        "bittner": mibvh.build(scene, "bittner", start="sbvh"),
        "finite": mibvh.build(scene, "finite", **FEW),
    }


def cost(tree, scene, rays):
    return mibvh.trace(tree, scene, rays, repeats=1).counted_cost()


def test_held_out_rays_cost_less(scene, trees, held_out):
    costs = {name: cost(tree, scene, held_out) for name, tree in trees.items()}
    assert costs["finite"] < 0.97 * min(costs["sbvh"], costs["bittner"])


def test_hits_are_those_of_the_other_trees(scene, trees, held_out):
    a, b = (mibvh.trace(trees[n], scene, held_out, repeats=1) for n in ("sbvh", "finite"))
    assert trees["finite"].validate(scene.triangles) == []
    np.testing.assert_array_equal(a.t, b.t)


def test_the_report_says_what_it_was_built_for(trees, scene):
    report = trees["finite"].meta["report"]
    assert report["rays"] == f"diffuse rays of {len(scene.sensors)} viewpoints"
    assert 0.9 * FEW["count"] <= report["ray_count"] <= 1.1 * FEW["count"]
    assert report["cost"] < report["start_cost"]
    json.dumps(trees["finite"].meta)


def test_large_scenes_are_built_for_more_rays(monkeypatch, scene):
    """A tree for too few rays knows where these go, and not where others do."""
    monkeypatch.setattr("mibvh.builders.finite._FEWEST", 100)
    tree = mibvh.build(scene, "finite", planes=32, effort=1)
    assert tree.meta["report"]["ray_count"] == pytest.approx(len(scene.triangles) / 4, rel=0.1)
    few = mibvh.build(scene, "finite", planes=32, effort=1, count=3)
    assert few.validate(scene.triangles) == []


def test_without_a_scene_rays_go_between_surfaces_and_it_says_so(scene):
    tree = mibvh.build(scene.triangles, "finite", **FEW)
    assert tree.meta["report"]["rays"].startswith("rays between surfaces, as there is no scene")
    assert tree.validate(scene.triangles) == []


def test_rays_of_a_file_are_taken(scene, held_out, tmp_path):
    path = tmp_path / "rays.npz"
    held_out.save(path)
    tree = mibvh.build(scene.triangles, "finite", rays=str(path), **FEW)
    assert tree.meta["report"]["rays"] == f"rays of {path}"
    assert tree.meta["report"]["ray_count"] <= FEW["count"]
    with pytest.raises(MibvhError, match="no such ray set file"):
        mibvh.build(scene.triangles, "finite", rays=str(tmp_path / "none.npz"))
    other = mibvh.Triangles(scene.triangles.corners[1:])
    with pytest.raises(MibvhError, match="made for another geometry"):
        mibvh.build(other, "finite", rays=str(path))


def test_rays_of_a_file_that_end_before_their_hits_count_up_to_there(scene, held_out, tmp_path):
    """What the builder chooses by is what the kernel counts."""
    short = np.full(len(held_out), 0.05 * scene.triangles.diagonal, np.float32)
    rays = dataclasses.replace(held_out, tmax=short)
    rays.save(tmp_path / "rays.npz")
    few = {"count": len(rays), "planes": 16, "effort": 1}
    tree = mibvh.build(scene, "finite", rays=str(tmp_path / "rays.npz"), **few)
    assert tree.meta["report"]["cost"] == pytest.approx(cost(tree, scene, rays), rel=1e-3)
    assert cost(tree, scene, rays) < 0.8 * cost(tree, scene, held_out)


def test_training_rays_are_not_the_default_ones(scene):
    """A study measures with seed 0 upwards; no origin of theirs is one of training."""
    options = mibvh.builders.get("finite").options()
    training = scene.few_rays(2000, options.seed)
    assert len(np.unique(training.viewpoint)) == len(scene.sensors)
    measured = mibvh.diffuse_rays(scene, width=40, height=30, samples=1, seed=0)
    both = np.concatenate([np.unique(training.o, axis=0), np.unique(measured.o, axis=0)])
    assert len(np.unique(both, axis=0)) == len(both)


@pytest.mark.parametrize("kind", ["ao", "shadow"])
def test_rays_that_any_hit_ends_cost_less_in_the_tree_for_them(scene, trees, kind):
    tree = mibvh.build(scene, "finite", kind=kind, **FEW)
    assert tree.meta["report"]["rays"].startswith(f"{kind} rays of")
    assert tree.validate(scene.triangles) == []
    rays = mibvh.make_rays(scene, kind, width=48, height=36, samples=2, seed=5)
    assert rays.occlusion
    assert cost(tree, scene, rays) < 0.97 * cost(trees["bittner"], scene, rays)
    with pytest.raises(MibvhError, match="there is no kind of rays 'nothing'"):
        mibvh.build(scene, "finite", kind="nothing", **FEW)


@pytest.mark.parametrize("effort", [1, 3])
def test_efforts(scene, held_out, effort, trees):
    tree = mibvh.build(scene, "finite", effort=effort, **FEW)
    assert tree.validate(scene.triangles) == []
    assert cost(tree, scene, held_out) < cost(trees["bittner"], scene, held_out)


def test_for_unseen_viewpoints_it_is_no_worse_than_the_area_tree():
    scene = mibvh.load("clutter@4000")
    assert len(scene.sensors) >= 3
    seen, other = mibvh.load("clutter@4000"), mibvh.load("clutter@4000")
    seen.sensors, other.sensors = scene.sensors[::2], scene.sensors[1::2]
    tree = mibvh.build(seen, "finite", unseen=True, **FEW)
    rays = mibvh.diffuse_rays(other, width=32, height=24, samples=1)
    area = mibvh.build(scene, "bittner", start="sbvh")
    assert cost(tree, scene, rays) <= 1.01 * cost(area, scene, rays)
    report = tree.meta["report"]
    assert report["area_weight"] in (0.6, 1.2, "area alone")
    assert [len(found) for found in report["left_out"].values()] == [len(seen.sensors)] * 2


def test_where_nothing_can_be_left_out_it_is_the_area_tree():
    scene = mibvh.load("cornell@1500")
    scene.sensors = scene.sensors[:1]
    tree = mibvh.build(scene, "finite", unseen=True, **FEW)
    area = mibvh.build(scene, "bittner", start="sbvh")
    assert tree.meta["report"]["area_weight"] == "area alone"
    arrays = area.to_arrays()
    for name, found in tree.to_arrays().items():
        np.testing.assert_array_equal(found, arrays[name])


def test_the_weight_for_unseen_viewpoints_goes_by_what_is_left_out():
    """A gain within its error keeps the area tree; one beyond it does not."""
    from mibvh.builders.finite import _Search
    from mibvh.measures import Segments

    class Told(_Search):
        def __init__(self, relative):
            self.options, self.relative = FiniteOptions(), relative

        def area_tree(self):
            return None

        def best(self, measure, segments, options):
            assert options.effort == 1
            left_out = ({0, 1, 2} - set(segments.viewpoint)).pop()
            return self.relative[measure.area_weight][left_out], {}

        def cost(self, draft, segments):
            assert len(np.unique(segments.viewpoint)) == 1
            return 50.0 * (1.0 if draft is None else draft)

    at = np.random.default_rng(0).random((30, 3)).astype(np.float32)
    segments = Segments(at, at[::-1].copy(), np.repeat(np.arange(3), 10).astype(np.int32))
    for relative, wanted in (
        ({0.6: [0.90, 0.92, 0.91], 1.2: [0.95, 0.95, 0.95]}, 0.6),
        ({0.6: [0.80, 0.82, 1.10], 1.2: [0.95, 0.96, 0.94]}, 1.2),
        ({0.6: [0.80, 0.95, 1.20], 1.2: [0.99, 1.00, 1.02]}, np.inf),
    ):
        weight, said = Told(relative).weight_for_unseen(segments)
        assert weight == wanted
        np.testing.assert_allclose(said["0.6"], relative[0.6])
    weight, said = Told({}).weight_for_unseen(segments.select(segments.viewpoint == 0))
    assert weight == np.inf
    assert said == {}


def test_foliage_is_built_without_spatial_splits():
    """Rays cost less in `bbvh` than in `sbvh` there, and so does the tree that starts from it."""
    plants = mibvh.load("vegetation@6000")
    rays = mibvh.diffuse_rays(plants, width=32, height=24, seed=3)
    cost = {
        name: mibvh.trace(mibvh.build(plants, name), plants, rays).counted_cost()
        for name in ("bbvh", "sbvh", "bittner")
    }
    tree = mibvh.build(plants, "finite")
    assert cost["bbvh"] < cost["sbvh"]
    assert tree.meta["report"]["start"] in ("area, bbvh", "flux, bbvh")
    assert mibvh.trace(tree, plants, rays).counted_cost() < cost["bittner"]


def test_where_most_camera_rays_miss_more_are_traced():
    """A small thing in front of far cameras: a few hundred rays would not tell where they go."""
    rng = np.random.default_rng(7)
    at, size = rng.random((1200, 1, 3)) * 10, rng.normal(size=(1200, 3, 3)) * 0.1
    soup = mibvh.load((at + size).astype(np.float32))
    few = soup.few_rays(30_000, FiniteOptions().seed)
    assert len(few) < 0.25 * 30_000
    found = mibvh.build(soup, "finite").meta["report"]["ray_count"]
    assert found > 3 * len(few)
    assert mibvh.build(soup, "finite", count=30_000).meta["report"]["ray_count"] == len(few)


def test_no_training_ray_at_all_is_a_sentence(scene):
    class Dark:
        """No vertex sends a ray, as where all lights are below the horizon."""

        def few_rays(self, count, seed, kind):
            rays = scene.few_rays(count, seed)
            return rays.select(np.zeros(len(rays), bool))

    with pytest.raises(MibvhError):
        finite(scene.triangles, FiniteOptions(), Context(source=Dark()))


def test_scenes_of_mixed_scale_give_the_area_more_weight():
    """Fine bubbles in a coarse room: they are finer than the tables, whose planes are few."""
    bubbles = mibvh.load("clusters@6000")
    rays = mibvh.diffuse_rays(bubbles, width=64, height=48, seed=3)

    tree = mibvh.build(bubbles, "finite")
    assert tree.meta["report"]["area_weight"] == pytest.approx(0.4)
    others = (mibvh.build(bubbles, "finite", effort=1), mibvh.build(bubbles, "bittner"))
    assert cost(tree, bubbles, rays) < 0.99 * min(cost(t, bubbles, rays) for t in others)


def test_finite_is_asked_for_by_name_alone():
    assert "finite" not in names()
    assert mibvh.builders.get("finite").describe()["options"]["budget"]["default"] == 1.0


def test_optimize_finds_the_cheapest_tree_and_says_what_it_saves(scene, tmp_path):
    from typer.testing import CliRunner

    from mibvh.cli import app

    found = mibvh.optimize(scene, **FEW)
    assert set(found.costs) == {"finite", "sbvh", "bittner_sbvh", "bittner"}
    assert found.costs[found.tree.meta["builder"]] == min(found.costs.values())
    own, sbvh = found.costs["finite"], found.costs["sbvh"]
    assert f"cost {own:.1f} in this tree" in found.sentence()
    assert f"{1 - own / sbvh:.0%} of what they cost in sbvh ({sbvh:.1f})" in found.sentence()
    path = tmp_path / "tree.npz"
    options = [f"--option={name}={value}" for name, value in FEW.items()]
    ran = CliRunner().invoke(app, ["optimize", "cornell@6000", "-o", str(path), *options])
    assert ran.exit_code == 0, ran.output
    assert "counted on" in ran.output
    assert mibvh.Tree.load(path).validate(scene.triangles) == []


def test_optimize_measures_with_rays_of_another_seed(monkeypatch, tmp_path):
    """Rays of the same film and seed are the rays that the tree was built for."""
    scene = mibvh.load("cornell@500")
    measured = []

    def traced(tree, scene, rays, **how):
        measured.append(rays)
        return mibvh.trace(tree, scene, rays, **how)

    monkeypatch.setattr("mibvh.optimised.trace", traced)
    film = {"width": 120, "height": 90, "samples": 1}
    training = mibvh.diffuse_rays(scene, seed=1, **film)
    training.save(tmp_path / "rays.npz")
    same_film = 120 * 90 * len(scene.sensors)
    for options in ({"seed": 1, "count": same_film}, {"rays": str(tmp_path / "rays.npz")}):
        measured.clear()
        mibvh.optimize(scene, planes=8, effort=1, **options)
        rays = np.concatenate([np.hstack([r.o, r.d]) for r in (measured[0], training)])
        assert len(np.unique(rays, axis=0)) == len(rays)


def test_optimize_measures_with_enough_rays():
    """What is small on the film makes few rays, and these would choose a tree by chance."""
    far = np.concatenate([mibvh.load("cornell@500").triangles.corners, np.zeros((1, 3, 3))])
    far[-1] = [[0, 0, 30], [0.1, 0, 30], [0, 0.1, 30]]  # the orbit is around all of it
    scene = mibvh.load(far.astype(np.float32))
    few = mibvh.diffuse_rays(scene, width=120, height=90, samples=1, seed=1)
    assert 0 < len(few) < 2500
    assert 5000 <= mibvh.optimize(scene, **FEW).rays < 10_000


def test_optimize_asks_rays_of_the_kind_that_it_builds_for():
    scene = mibvh.load("cornell@500")
    found = mibvh.optimize(scene, kind="shadow", **FEW)
    rays = mibvh.make_rays(scene, "shadow", width=120, height=90, samples=1, seed=1)
    tree = mibvh.build(scene, "sbvh")
    assert found.costs["sbvh"] == mibvh.trace(tree, scene, rays, repeats=1).counted_cost()
    assert found.sentence().startswith("shadow rays of these cameras cost")
    assert found.rays == len(rays)


def test_optimize_is_no_worse_than_insertion_without_splits():
    """A soup with every triangle four times: splits, and 400 rays, are worth nothing there."""
    rng = np.random.default_rng(0)
    soup = rng.random((300, 1, 3)) * 10 + 0.1 * rng.standard_normal((300, 3, 3))
    scene = mibvh.load(np.concatenate([soup] * 4).astype(np.float32))
    found = mibvh.optimize(scene, **FEW)
    assert found.tree.meta["builder"] == "bittner"
    others = [found.costs[name] for name in ("finite", "sbvh", "bittner_sbvh")]
    assert found.costs["bittner"] < 0.995 * min(others)
