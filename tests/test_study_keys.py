"""What a study keeps goes by the code that made it and the bytes it was made from."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import soup

import mibvh
from mibvh.builders import registry
from mibvh.builders.chosen import parse
from mibvh.studies.measure import store as store_module
from mibvh.studies.measure.scene_digest import scene_digest
from mibvh.studies.measure.store import Store
from mibvh.studies.measure.trees import TreeSource

CHOICES = {"width": 24, "height": 16, "scalar_rays": 256, "seconds": 0.0}


@pytest.fixture
def halves():
    """Return a function that registers a builder and counts how often it is called."""
    calls = []

    def register(version, order=1):
        @mibvh.builder("halves", summary="halve the list of triangles", version=version)
        def build(triangles, options, context):
            calls.append(version)
            return np.arange(len(triangles))[::order]

        return calls

    yield register
    registry._registered.pop("halves", None)


def run(folder, *builders):
    return mibvh.study([soup(40)], folder, builders=builders, **CHOICES)


def test_a_users_builder_is_run_again_unless_it_declares_a_version(tmp_path, halves):
    calls = halves(None)
    first = run(tmp_path, "bbvh", "halves")
    halves(None, order=-1)  # what it reads or imports has changed; its own file need not have
    second = run(tmp_path, "bbvh", "halves")
    assert len(calls) == 2
    assert second.table["sah"].tolist()[0] == first.table["sah"].tolist()[0]
    halves("1")
    run(tmp_path, "bbvh", "halves")
    run(tmp_path, "bbvh", "halves")
    assert len(calls) == 3
    halves("2")
    run(tmp_path, "bbvh", "halves")
    assert len(calls) == 4


def test_a_users_metric_is_computed_in_every_run(tmp_path):
    from mibvh.metrics import registry as metrics
    from mibvh.metrics.registry import Metric, Quantity, add_metric

    def leaves_and(more):
        return Metric(
            name="mine",
            quantities=(Quantity(name="leaves_and_more", unit="count"),),
            compute=lambda subject: {"leaves_and_more": subject.tree.is_leaf.sum() + more},
        )

    run(tmp_path, "bbvh", "lbvh")
    try:
        add_metric(leaves_and(0))
        first = run(tmp_path, "bbvh", "lbvh").table["leaves_and_more"]
        add_metric(leaves_and(100))
        second = run(tmp_path, "bbvh", "lbvh").table["leaves_and_more"]
    finally:
        metrics._added.pop("mine")
    assert (second - first).tolist() == [100, 100]


def test_everything_is_made_anew_by_other_code(tmp_path, monkeypatch):
    run(tmp_path, "bbvh", "lbvh")
    again = run(tmp_path, "bbvh", "lbvh")
    pieces = {
        "rays": 1,
        "trees": 2,
        "metrics": 2,
        "counts": 2,
        "warps": 2,
        "audit": 2,
        "stopwatch": 2,
    }
    assert {name: again.scenes[0].reused[name] for name in pieces} == pieces
    monkeypatch.setattr(store_module, "code_digest", lambda *modules: "other code")
    other = run(tmp_path, "bbvh", "lbvh").scenes[0].reused
    assert not any(other.get(name, 0) for name in pieces)


@pytest.mark.parametrize("instanced", [False, True])
def test_lights_are_in_the_key_of_shadow_rays(instanced, tmp_path):
    """Those of a scene with instances, too, which is not kept as Mitsuba loads it."""
    cube = '<shape type="cube"/>'
    if instanced:
        cube = f'<shape type="shapegroup" id="g">{cube}</shape>'
        cube += '<shape type="instance"><ref id="g"/></shape>'
    digests, trees, others = set(), set(), set()
    for y in (5, 6):
        path = tmp_path / f"at{y}.xml"
        light = f'<emitter type="point"><point name="position" x="0" y="{y}" z="0"/></emitter>'
        path.write_text(f'<scene version="3.0.0">{cube}{light}</scene>')
        scene = mibvh.load(path)
        digests.add(scene_digest(scene))
        # A tree for shadow rays goes by them, too.
        trees.add(TreeSource.of(*parse("finite(kind=shadow)")).key(scene))
        others.add(TreeSource.of(*parse("bbvh")).key(scene))
    assert (len(digests), len(trees), len(others)) == (2, 2, 1)


def test_the_report_says_what_came_from_the_folder(tmp_path):
    run(tmp_path, "bbvh", "lbvh")
    assert "in the last run: nothing" in (tmp_path / "results.md").read_text()
    run(tmp_path, "bbvh", "lbvh")
    assert "trees (2)" in (tmp_path / "results.md").read_text()


def test_a_wrong_number_that_is_kept_fails_its_audit(tmp_path):
    """An EPO of old code that survives under a right key and checksum, as it did in 0.1."""
    assert run(tmp_path, "bbvh", "sbvh").failures == []
    store = Store(tmp_path / "cache")
    for path in (tmp_path / "cache").glob("metrics-*.json"):
        kept = store.read(path.stem)
        kept["values"]["epo"] *= 0.8
        store.write(path.stem, kept)
    found = run(tmp_path, "bbvh", "sbvh")
    assert [(tree, check.name) for _, tree, check in found.failures] == [
        ("bbvh", "epo"),
        ("sbvh", "epo"),
    ]
    text = (tmp_path / "report.html").read_text()
    assert "Numbers that failed the audit" in text
    assert 'class="alarm"' in text


def test_a_tree_of_another_builder_under_the_name_is_not_believed(tmp_path):
    run(tmp_path, "bbvh", "lbvh")
    first, second = sorted((tmp_path / "cache").glob("tree-*.npz"))
    kept = mibvh.Tree.load(first).digest
    first.write_bytes(second.read_bytes())
    again = run(tmp_path, "bbvh", "lbvh")
    assert again.failures == []
    assert mibvh.Tree.load(first).digest == kept
    assert again.scenes[0].reused["trees"] == 1


def test_a_tree_that_is_added_later_is_compared_with_the_first(tmp_path):
    """The first one's own checks are kept, so that it is traced for this alone."""
    run(tmp_path, "bbvh")
    later = run(tmp_path, "bbvh", "lbvh").scenes[0]
    first, second = ([check.name for check in tree.audit] for tree in later.trees)
    assert "trees" in second
    assert "trees" not in first
    at_once = run(tmp_path / "at once", "bbvh", "lbvh").scenes[0]
    assert second == [check.name for check in at_once.trees[1].audit]


def test_rays_too_few_to_be_timed_are_not(tmp_path, monkeypatch):
    from mibvh.studies.measure import times

    monkeypatch.setattr(times, "SHORTEST", 1e3)
    found = run(tmp_path, "bbvh", "lbvh", "hill", "treelet", "agglo")
    assert np.isnan(found.table["scalar_ns"]).all()
    assert found.scenes[0].timing["scalar"].portions == 0
    assert "none: too few rays" in (tmp_path / "results.md").read_text()
    assert np.isfinite(found.table["counted_cost"]).all()


def test_a_small_ray_set_fills_a_launch_by_repetition():
    from mibvh.studies.measure.times import repeated

    rays = mibvh.RaySet(np.zeros((3, 3)), np.eye(3))
    twice = repeated(rays, 2)
    assert twice.d.tolist() == [*np.eye(3).tolist(), *np.eye(3).tolist()]
