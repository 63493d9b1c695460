"""The audit of wide trees passes what is right, and finds each kind of fault once it is planted."""

import numpy as np
import pytest
from cuts import tiles
from typer.testing import CliRunner

import mibvh
from mibvh.audit import audit
from mibvh.audit.overlap import check_epo, check_sah, estimates
from mibvh.audit.run import audit_hits
from mibvh.cli import app
from mibvh.traversal.agreement import lane_faults


@pytest.fixture(scope="module")
def room():
    """A scene with its rays, and a tree that splits triangles."""
    scene = mibvh.load("livingroom@2000")
    rays = mibvh.diffuse_rays(scene, width=40, height=30, samples=1)
    tree = mibvh.build(scene, "sbvh")
    assert tree.splits_triangles
    return scene, rays, tree


@pytest.fixture(scope="module", params=[(2, False), (4, False), (8, False), (8, True)])
def wide(request, room):
    width, small = request.param
    found = mibvh.collapse(room[2], width)
    return mibvh.quantised(found) if small else found


def test_a_whole_audit_passes(room, wide):
    scene, rays, _ = room
    found = audit(scene, wide, rays)
    assert [check for check in found.checks if not check.passed] == []
    names = {check.name for check in found.checks}
    assert {"tree", "sah", "epo", "hits", "mitsuba", "self hits", "counts", "lanes"} <= names


def test_wrong_figures_are_found(room, wide):
    triangles = room[0].triangles
    sah, epo = mibvh.sah(wide), mibvh.epo(wide, triangles)
    assert check_sah(wide, sah).passed
    assert not check_sah(wide, sah * 1.0001).passed
    assert check_epo(wide, triangles, epo).passed
    assert not check_epo(wide, triangles, epo * 0.9).passed
    if wide.width > 2:  # the binary tree's figure, kept by mistake
        assert not check_epo(wide, triangles, mibvh.epo(room[2], triangles)).passed


def test_points_agree_with_exact_overlap_on_thin_tiles():
    """Nodes of four and eight over a deep tree that splits what lies in one plane."""
    triangles = mibvh.Triangles(tiles())
    tree = mibvh.build(triangles, "sbvh")
    for width in (4, 8):
        wide = mibvh.collapse(tree, width)
        groups = estimates(wide, triangles)
        error = groups.std(ddof=1) / np.sqrt(len(groups))
        assert groups.mean() == pytest.approx(mibvh.epo(wide, triangles), abs=5 * error + 1e-6)


def test_wrong_counts_and_hits_are_found(room, wide):
    scene, rays, _ = room
    hits = mibvh.trace(wide, scene.triangles, rays, repeats=1)
    right = audit_hits(scene, wide, rays, hits, counted_cost=hits.counted_cost())
    assert all(check.passed for check in right)
    wrong = audit_hits(scene, wide, rays, hits, counted_cost=hits.counted_cost() * 1.0001)
    assert [check.name for check in wrong if not check.passed] == ["counts"]
    hits.boxes.flags.writeable = True
    hits.boxes[7] += 1
    said = lane_faults(wide, scene.triangles, rays, simd=hits)
    assert len(said) == 2  # scalar lanes, and the walk without Dr.Jit
    assert all(fault.startswith("boxes") for fault in said)


def _shrunk(wide):
    upper = wide.upper.copy()
    leaf = int(
        np.flatnonzero(wide.is_leaf & (np.ptp([wide.lower, wide.upper], axis=0) > 0).all(axis=1))[3]
    )
    upper[leaf] = (wide.lower[leaf] + wide.upper[leaf]) / 2
    return wide.replace(upper=upper)


def test_an_unsound_tree_is_found_before_it_is_traced(room, wide):
    found = audit(room[0], _shrunk(wide), room[1])
    assert [check.name for check in found.failures] == ["tree"]


def test_commands_take_wide_trees(room, tmp_path):
    _, rays, tree = room
    names = {name: str(tmp_path / f"{name}.npz") for name in ("tree", "wide", "rays")}
    tree.save(names["tree"])
    rays.save(names["rays"])
    run = CliRunner().invoke
    made = run(app, ["collapse", names["tree"], "-o", names["wide"], "--width", "4"])
    assert made.exit_code == 0, made.output
    wide = mibvh.read_tree(names["wide"])
    assert isinstance(wide, mibvh.WideTree)
    assert wide.width == 4
    assert isinstance(mibvh.read_tree(names["tree"]), mibvh.Tree)
    told = run(app, ["metrics", "livingroom@2000", names["wide"], "--json"])
    assert f'"sah": {mibvh.sah(wide)}' in told.output
    audited = run(app, ["audit", "livingroom@2000", names["wide"], names["rays"], "--json"])
    assert audited.exit_code == 0
    assert '"passed": true' in audited.output
    of_rays = ["trace", "livingroom@2000", names["wide"], names["rays"], "--repeats", "1", "--json"]
    for more in ([], ["--any-hit", "--child-order", "worth"]):
        traced = run(app, [*of_rays, *more])
        assert traced.exit_code == 0
        assert '"style": "wide"' in traced.output
