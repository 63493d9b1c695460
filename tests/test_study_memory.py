"""A study has one tree of a large scene in memory at a time, and of its records what rays read."""

from __future__ import annotations

import gc
import itertools
import weakref

import numpy as np
import pytest
from conftest import soup
from cuts import cut
from test_split_trees_traced import rays_through

import mibvh
from mibvh import memory
from mibvh import scene as scenes
from mibvh.builders import sharing
from mibvh.studies.measure import memory as measured_memory
from mibvh.studies.measure import shelf as shelves
from mibvh.studies.measure import times
from mibvh.studies.measure.given import Given
from mibvh.studies.measure.memory import predicted_memory
from mibvh.studies.measure.shelf import Shelf
from mibvh.studies.measure.trees import sources_of
from mibvh.studies.record.options import StudyOptions
from mibvh.traversal.pages import ROW
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.trace import Tracer
from mibvh.traversal.trimmed import trimmed

CHOICES = {"width": 24, "height": 16, "scalar_rays": 256, "seconds": 0.0}


def never():
    pytest.fail("a tree was read that is in memory")


def test_a_shelf_holds_what_there_is_room_for():
    scene = soup(200)
    made = {name: mibvh.build(scene, name) for name in ("lbvh", "bbvh", "sbvh")}
    digests = {name: tree.digest for name, tree in made.items()}
    shelf = Shelf(room=1e9)
    for name in list(made):
        shelf.put(name, made.pop(name), never)
    assert {name: tree.digest for name, tree in shelf.items()} == digests
    assert [shelf.digest(name) for name in shelf] == list(digests.values())


def test_without_room_one_tree_is_there_at_a_time():
    scene = soup(200)
    shelf, alive, read = Shelf(room=0.0), weakref.WeakSet(), []

    def again(name):
        read.append(name)
        gc.collect()
        assert len(alive) == 0  # the one before is gone before the next is read
        tree = mibvh.build(scene, name)
        alive.add(tree)
        return tree

    for name in ("lbvh", "bbvh"):
        tree = mibvh.build(scene, name)
        alive.add(tree)
        shelf.put(name, tree, lambda name=name: again(name))
        del tree
    assert len(alive) == 1
    for name in ("lbvh", "bbvh"):
        assert shelf[name].meta["builder"] == name
    assert read == ["lbvh", "bbvh"]
    # What somebody else has is taken from there.
    mine = shelf["lbvh"]
    shelf.tidy()
    assert shelf["lbvh"] is mine
    assert read == ["lbvh", "bbvh", "lbvh"]


def test_another_tree_is_not_taken_for_the_one_that_was_put():
    scene = soup(50)
    shelf = Shelf(room=0.0)
    shelf.put("mine", mibvh.build(scene, "lbvh"), lambda: mibvh.build(scene, "bbvh"))
    shelf.tidy()
    gc.collect()
    with pytest.raises(mibvh.MibvhError, match="the tree mine was changed while it was studied"):
        shelf["mine"]


@pytest.mark.parametrize("kind", ["sbvh, all splits", "streelet, many splits"])
@pytest.mark.parametrize("lanes", ["simd", "scalar"])
def test_trimmed_records_hold_what_rays_read(kind, lanes):
    triangles, tree = cut("pipes", kind)
    rays = rays_through(triangles, 6, 7)
    tracer = Tracer(rays, float(unit_scale(triangles)), lanes)
    whole = make_records(tree, triangles)
    found = trimmed(whole, tracer)
    for before, after in zip(
        tracer.run(whole, count=True)[0], tracer.run(found, count=True)[0], strict=True
    ):
        if before is not None:
            np.testing.assert_array_equal(np.array(before), np.array(after))
    rows = [np.array(records.rows).view(np.uint32).reshape(-1, ROW) for records in (whole, found)]
    written = rows[1].any(axis=1)
    assert 0.0 < written.mean() < 0.9
    np.testing.assert_array_equal(rows[1][written], rows[0][written])
    # Parts of the rays find all they need; others do not, and are told.
    Tracer(rays.select(slice(2, 4)), float(unit_scale(triangles)), lanes).run(found)
    assert found.size == whole.size


def study(folder, progress=None):
    """Trees that share a start, one with split triangles, in most experiments."""
    return mibvh.study(
        "cornell@1000",
        folder,
        builders="lbvh,bbvh,hill,sbvh",
        experiments=("depth", "rotation", "sensitivity"),
        widths=(4,),
        progress=progress,
        **CHOICES,
    )


def test_a_study_without_room_finds_the_same(tmp_path, monkeypatch):
    """Trees, drafts and records in files or in part; Mitsuba's scenes made anew."""
    expected = study(tmp_path / "all")
    monkeypatch.setattr(shelves, "ROOM", 0.0)
    monkeypatch.setattr(times, "LARGE", 0.0)
    monkeypatch.setattr(sharing, "LARGE", 0.0)
    monkeypatch.setattr(scenes, "LARGE", 0)
    monkeypatch.setattr(measured_memory, "LARGE", 0)
    alive, most, alone = weakref.WeakSet(), [], []
    put = Shelf.put

    def counted(self, name, tree, again):
        alive.add(tree)
        put(self, name, tree, lambda: alive.add(found := again()) or found)

    monkeypatch.setattr(Shelf, "put", counted)

    def progress(step):
        gc.collect()
        (most if step.experiment == "rotation" else alone).append(len(alive))

    found = study(tmp_path / "one", progress)
    # A tree goes when the next one is asked for; of the rotated ones, there is one beside it.
    assert max(most) <= 2
    assert max(alone) == 1
    timed = [name for name in expected.table if name.endswith(("_ns", "_error", "_seconds"))]
    timed += [name for name in expected.table if "_ns_" in name]
    same = [name for name in expected.table.select_dtypes("number") if name not in timed]
    assert len(same) > 20
    np.testing.assert_array_equal(found.table[same], expected.table[same])
    for kind in ("sensitivity", "depth"):
        assert getattr(found, kind).equals(getattr(expected, kind))
    assert (found.table["scalar_ns"] > 0).all()
    assert found.failures == []
    names = {path.name for path in (tmp_path / "one" / "cache").iterdir()}
    assert not any(name.startswith("tmp") for name in names)


def test_the_prediction_counts_one_tree_and_all_records(monkeypatch):
    """Of a large scene; of a small one, all trees stay."""
    small = mibvh.load("cornell@1000")
    options = StudyOptions(experiments=("rotation",))
    needs = {}
    for count, room in itertools.product((3, 9), (0.0, 1e9)):
        monkeypatch.setattr(shelves, "ROOM", room)
        sources = sources_of([f"lbvh(max_leaf={n + 1})" for n in range(count)], {})
        needs[count, room] = predicted_memory(small, options, sources, Given())
    assert needs[9, 0.0]["trees"] == needs[3, 0.0]["trees"] < needs[9, 1e9]["trees"]
    whole = needs[9, 0.0]["stopwatch"] - needs[3, 0.0]["stopwatch"]
    assert whole == pytest.approx(6 * memory.BYTES["records"] * len(small.triangles))
    assert needs[9, 0.0]["rotation"] > needs[9, 0.0]["stopwatch"]
    monkeypatch.setattr(times, "LARGE", 0.0)
    part = predicted_memory(small, options, sources, Given())["stopwatch"]
    assert part < needs[9, 1e9]["stopwatch"]
