import dataclasses

import numpy as np
import pytest
from test_traversal import random_rays

import mibvh
from mibvh.traversal import styles
from mibvh.traversal.agreement import lane_faults
from mibvh.traversal.records import make_records, unit_scale
from mibvh.traversal.styles import STYLES, find_style
from mibvh.traversal.trace import Tracer
from mibvh.traversal.visits import Visits


@pytest.fixture(scope="module")
def traced(small_soup):
    return mibvh.build(small_soup, "sbvh"), small_soup, random_rays(500, 4)


def test_a_former_name_still_works_and_says_so(traced):
    with pytest.warns(DeprecationWarning, match="'postponed' is now called 'speculative'"):
        old = mibvh.trace(*traced, style="postponed", repeats=1)
    new = mibvh.trace(*traced, style="speculative", repeats=1)
    assert old.style == "speculative"
    np.testing.assert_array_equal(old.inner, new.inner)


def test_an_unknown_style_is_refused(traced):
    with pytest.raises(mibvh.MibvhError, match="must be one of single, while-while"):
        mibvh.trace(*traced, style="fast")
    with pytest.raises(mibvh.MibvhError, match="wide style does not re-test"):
        mibvh.trace(*traced, style="wide", cull=True)


@pytest.mark.parametrize("name", STYLES)
def test_a_launch_names_what_it_returns(traced, name):
    tree, triangles, rays = traced
    tracer = Tracer(rays, float(unit_scale(triangles)), style=name)
    visits, seconds = tracer.run(make_records(tree, triangles, tracer.layout), count=True)
    assert isinstance(visits, Visits)
    assert seconds.kernel > 0
    hits = mibvh.trace(tree, triangles, rays, style=name, repeats=1)
    for column in ("inner", "leaves", "tests"):  # t is in the kernel's unit
        np.testing.assert_array_equal(tracer.fetch(getattr(visits, column)), getattr(hits, column))
    counted = [key for key in hits.counters() if key.endswith("inner_per_ray")]
    assert counted == [find_style(name).prefix + "inner_per_ray"]


def test_a_new_style_is_an_entry(traced, monkeypatch):
    mine = dataclasses.replace(STYLES["single"], name="mine", summary="a copy")
    monkeypatch.setitem(styles.STYLES, "mine", mine)
    hits = mibvh.trace(*traced, style="mine", repeats=1)
    single = mibvh.trace(*traced, repeats=1)
    assert hits.style == "mine"
    assert hits.issued == single.issued
    np.testing.assert_array_equal(hits.t, single.t)


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "streelet"])
def test_lanes_agree(builder):
    scene = mibvh.load("powerplant@1500")
    rays = mibvh.diffuse_rays(scene, viewpoints=1, width=32, height=24)
    tree = mibvh.build(scene, builder)
    assert lane_faults(tree, scene, rays) == []
    simd = mibvh.trace(tree, scene, rays, repeats=1)
    assert lane_faults(tree, scene, rays, simd=simd, rays_checked=100) == []


@pytest.mark.parametrize("column", ["t", "triangle", "inner", "leaves", "tests"])
def test_lanes_that_differ_are_told(traced, column):
    tree, triangles, rays = traced
    simd = mibvh.trace(tree, triangles, rays, repeats=1)
    wrong = getattr(simd, column).copy()
    wrong[137] += 1
    if column == "t":
        wrong[137] = 0.5
    planted = dataclasses.replace(simd, **{column: wrong})
    faults = lane_faults(tree, triangles, rays, simd=planted)
    assert len(faults) == 2
    assert all(f.startswith(f"{column}: SIMD lanes and ") and "ray 137:" in f for f in faults)
