"""The audit passes what is right, and finds each kind of fault once it is planted."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

import mibvh
from mibvh.audit import audit, check_self_hits
from mibvh.audit.hits import check_brute_force, check_mitsuba, wrong_hits
from mibvh.audit.overlap import check_epo, check_sah, estimates
from mibvh.audit.run import check_any_hit


@pytest.fixture(scope="module")
def rays(cornell):
    return mibvh.diffuse_rays(cornell, width=64, height=48, samples=1)


@pytest.fixture(scope="module", params=["bbvh", "sbvh", "streelet"])
def tree(request, cornell):
    return mibvh.build(cornell.triangles, request.param)


@pytest.fixture(scope="module")
def hits(cornell, tree, rays):
    return mibvh.trace(tree, cornell.triangles, rays, repeats=1)


def test_sah_from_boxes_is_exact(tree):
    assert check_sah(tree, mibvh.sah(tree)).passed
    assert not check_sah(tree, mibvh.sah(tree) * 1.001).passed


def test_epo_of_a_tree_counted_by_hand():
    """Two leaves of one triangle each, both triangles of area 1/2.

    The first leaf's box, [0, 1] x [0, 1], holds the half of the second triangle left of x = 1: an
    area of 1/4. The second's, [0.5, 1.5] x [0, 1], holds what the first has right of x = 0.5: 1/8.
    The total area is 1, and a leaf of one triangle costs 1: EPO is 3/8.
    """
    corners = np.array(
        [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0.5, 1, 0], [1.5, 1, 0], [1, 0, 0]]], np.float32
    )
    tree = mibvh.Tree(
        np.array([[0, 0, 0], [0, 0, 0], [0.5, 0, 0]], np.float32),
        np.array([[1.5, 1, 0], [1, 1, 0], [1.5, 1, 0]], np.float32),
        np.array([1, -1, -1], np.int32),
        np.array([0, 0, 1], np.int32),
        np.array([2, 1, 1], np.int32),
        np.array([0, 1], np.int32),
        {"c_inner": 1.2, "c_tri": 1.0, "triangles": 2},
    )
    expected = 3 / 8
    assert mibvh.epo(tree, mibvh.Triangles(corners)) == pytest.approx(expected, abs=1e-9)
    groups = estimates(tree, mibvh.Triangles(corners))
    error = groups.std(ddof=1) / np.sqrt(len(groups))
    assert groups.mean() == pytest.approx(expected, abs=5 * error + 1e-3)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_wrong_epo_is_found(cornell, tree, factor):
    exact = mibvh.epo(tree, cornell.triangles)
    assert check_epo(tree, cornell.triangles, exact).passed
    assert not check_epo(tree, cornell.triangles, exact * factor).passed


def test_an_epo_kept_of_another_tree_is_found(cornell, tree):
    kept = mibvh.epo(mibvh.build(cornell.triangles, "lbvh"), cornell.triangles)
    assert not check_epo(tree, cornell.triangles, kept).passed


def test_hits_are_right_by_brute_force_and_mitsuba(cornell, rays, hits):
    assert check_brute_force(cornell.triangles, rays, hits).passed
    assert check_mitsuba(cornell, rays, hits).passed


def test_missed_triangles_are_found(cornell, rays, hits):
    hit = np.flatnonzero(hits.triangle >= 0)
    lost = hit[::7]
    t, triangle = hits.t.copy(), hits.triangle.copy()
    t[lost], triangle[lost] = np.inf, -1
    planted = dataclasses.replace(hits, t=t, triangle=triangle)
    wrong = wrong_hits(cornell.triangles, rays.select(lost), t[lost], triangle[lost])
    assert wrong.mean() > 0.95  # but for rays that graze
    assert not check_mitsuba(cornell, rays, planted).passed


def test_hits_of_the_wrong_triangle_are_found(cornell, rays, hits):
    hit = np.flatnonzero(hits.triangle >= 0)[:200]
    shifted = (hits.triangle[hit] + 1) % len(cornell.triangles)
    assert wrong_hits(cornell.triangles, rays.select(hit), hits.t[hit], shifted).mean() > 0.9


def test_origins_on_the_wrong_side_are_found(cornell, tree, rays):
    triangle = cornell.triangles.corners[rays.source].astype(np.float64)
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.sign((normal * rays.d).sum(axis=1, keepdims=True))
    behind = rays.o - side * normal * 1e-3
    planted = dataclasses.replace(rays, o=behind.astype(np.float32))
    hits = mibvh.trace(tree, cornell.triangles, planted, repeats=1)
    assert not check_self_hits(planted, hits).passed
    assert check_self_hits(rays, mibvh.trace(tree, cornell.triangles, rays, repeats=1)).passed


def test_a_whole_audit_passes(cornell, tree, rays):
    found = audit(cornell, tree, rays)
    assert [check.name for check in found.failures] == []
    assert {"tree", "sah", "epo", "hits", "mitsuba", "self hits"} <= {c.name for c in found.checks}


@pytest.mark.parametrize("kind", ["shadow", "ao"])
def test_occlusion_rays_are_audited_by_what_they_ask(cornell, kind):
    """Any hit ends them: not the closest, and yet right. Blocked rays let through are not."""
    rays = mibvh.make_rays(cornell, kind, width=48, height=36, samples=1)
    tree = mibvh.build(cornell.triangles, "sbvh")
    for audited in (tree, mibvh.collapse(tree, 8)):
        found = audit(cornell, audited, rays)
        assert [check.name for check in found.failures] == []
        assert {"hits", "mitsuba", "blocked", "any hit"} <= {c.name for c in found.checks}
    hits = mibvh.trace(tree, cornell.triangles, rays, repeats=1)
    planted = dataclasses.replace(hits, triangle=np.full_like(hits.triangle, -1))
    closest = mibvh.trace(tree, cornell.triangles, rays, any_hit=False, repeats=1)
    faults = check_any_hit(tree, cornell.triangles, rays, planted, closest)
    assert [check.passed for check in faults] == [False, False]


def test_an_audit_without_rays_is_refused(cornell, rays):
    none = rays.select(slice(0, 0))
    with pytest.raises(mibvh.MibvhError, match="there are none in the set"):
        audit(cornell, mibvh.build(cornell.triangles, "bbvh"), none)
    with pytest.raises(mibvh.MibvhError, match="seed must be a whole number from 0"):
        audit(cornell, mibvh.build(cornell.triangles, "bbvh"), rays, seed=-1)


def _shrunk(tree):
    upper = tree.upper.copy()
    leaf = int(np.flatnonzero(tree.is_leaf)[3])
    middle = (tree.lower[leaf] + tree.upper[leaf]) / 2
    upper[leaf] = middle
    return tree.replace(upper=upper)


def _without_ranges(tree):
    inner = ~tree.is_leaf
    return tree.replace(
        first=np.where(inner, 0, tree.first).astype(np.int32),
        count=np.where(inner, 0, tree.count).astype(np.int32),
    )


def _with_a_cycle(tree):
    left = tree.left.copy()
    left[left[0]] = 1
    return tree.replace(left=left)


@pytest.mark.parametrize("plant", [_shrunk, _without_ranges, _with_a_cycle])
def test_an_unsound_tree_is_found_before_it_is_traced(cornell, tree, rays, plant):
    found = audit(cornell, plant(tree), rays)
    assert [check.name for check in found.failures] == ["tree"]


def test_the_command_fails_with_code_3(cornell, tmp_path, monkeypatch):
    tree = mibvh.build(cornell.triangles, "bbvh")
    tree.save(tmp_path / "right.npz")
    run = [sys.executable, "-m", "mibvh", "audit", "cornell@3000"]
    right = subprocess.run([*run, str(tmp_path / "right.npz")], capture_output=True, text=True)
    assert right.returncode == 0, right.stderr
    assert "passed" in right.stdout
    _shrunk(tree).save(tmp_path / "shrunk.npz")
    wrong = subprocess.run([*run, str(tmp_path / "shrunk.npz")], capture_output=True, text=True)
    assert wrong.returncode in (2, 3)
    assert "FAILED" in wrong.stdout or "shrunk.npz" in wrong.stderr
