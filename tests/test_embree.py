import numpy as np
import pytest
from conftest import soup

import mibvh
import mibvh.builders.embree as embree_builder
from mibvh.builders import names

QUALITIES = ("low", "medium", "high")
DEGENERATE = {
    "one": soup(1).corners,
    "two": soup(2).corners,
    "copies": np.repeat(soup(1).corners, 500, axis=0),
    "points": np.zeros((100, 3, 3)),
    "flat": soup(300).corners * [1, 1, 0],
    "tiny": soup(300).corners * 1e-20,
    "huge": soup(300).corners * 1e14,
    "far": soup(300).corners + 1e6,
    "growing": np.float32(1.3) ** np.arange(300)[:, None, None] * soup(300).corners * 1e-20,
}


@pytest.fixture(scope="module")
def pipes():
    return mibvh.load("powerplant@2000").triangles


@pytest.mark.parametrize("quality", QUALITIES)
def test_trees_are_sound_and_the_same_every_time(pipes, quality):
    tree = mibvh.build(pipes, "embree", quality=quality)
    assert tree.validate(pipes) == []
    again = mibvh.build(pipes, "embree", quality=quality)
    for name in ("lower", "upper", "left", "first", "count", "references"):
        np.testing.assert_array_equal(getattr(tree, name), getattr(again, name))
    assert tree.splits_triangles == (quality == "high")


def test_quality_is_what_it_says(pipes):
    """Binned SAH comes near the full sweep, spatial splits below it; Morton codes do not."""
    low, medium, high = (mibvh.build(pipes, "embree", quality=q) for q in QUALITIES)
    sweep = mibvh.sah(mibvh.build(pipes, "bbvh"))
    assert mibvh.sah(low) > 1.15 * sweep
    assert mibvh.sah(medium) == pytest.approx(sweep, rel=0.1)
    assert mibvh.sah(high) < sweep
    assert mibvh.epo(high, pipes) < mibvh.epo(medium, pipes)


def test_budget_bounds_the_references(pipes):
    for budget in (0.0, 0.1):
        tree = mibvh.build(pipes, "embree", quality="high", budget=budget)
        assert tree.meta["report"]["references"] <= (1 + budget) * len(pipes)
        assert tree.splits_triangles == (budget > 0)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("corners", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_input(corners, quality):
    triangles = mibvh.Triangles(np.asarray(corners, np.float32))
    assert mibvh.build(triangles, "embree", quality=quality).validate(triangles) == []


def test_hits_are_those_of_other_trees(cornell):
    rays = mibvh.diffuse_rays(cornell, width=16, height=12, samples=1)
    wanted = mibvh.trace(mibvh.build(cornell, "bbvh"), cornell, rays, repeats=1).t
    for quality in QUALITIES:
        tree = mibvh.build(cornell, "embree", quality=quality)
        np.testing.assert_array_equal(mibvh.trace(tree, cornell, rays, repeats=1).t, wanted)


@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("quality", QUALITIES)
def test_wide_trees(pipes, quality, width):
    """Every triangle is kept, nodes are of the width, and leaves of the asked size."""
    wide = mibvh.build_wide(pipes, "embree", width, quality=quality, max_leaf=4)
    assert wide.validate(pipes) == []
    assert wide.width == wide.children.max() == width
    assert wide.count[wide.is_leaf].max() <= 4
    kept = np.bincount(wide.references, minlength=len(pipes))
    assert kept.min() == 1
    assert (kept.max() > 1) == wide.splits_triangles == (quality == "high")
    again = mibvh.build_wide(pipes, "embree", width, quality=quality, max_leaf=4)
    for name in ("lower", "upper", "child", "children", "first", "count", "references"):
        np.testing.assert_array_equal(getattr(wide, name), getattr(again, name))


def test_wide_trees_are_as_good_as_their_quality(pipes):
    """By the wide figures; a tree of single nodes of eight is no tree of two."""
    low, medium, high = (mibvh.build_wide(pipes, "embree", quality=q) for q in QUALITIES)
    binary = mibvh.build(pipes, "embree")
    assert mibvh.sah(medium) < 0.7 * mibvh.sah(low)
    assert mibvh.sah(medium) < mibvh.sah(binary)
    assert mibvh.epo(high, pipes) < 0.8 * mibvh.epo(medium, pipes)
    collapsed = mibvh.build_wide(pipes, "bbvh")
    assert mibvh.sah(medium) == pytest.approx(mibvh.sah(collapsed), rel=0.25)
    assert medium.meta["c_box"] == collapsed.meta["c_box"] > 0


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("corners", DEGENERATE.values(), ids=DEGENERATE)
def test_wide_trees_of_degenerate_input(corners, quality):
    triangles = mibvh.Triangles(np.asarray(corners, np.float32))
    wide = mibvh.build_wide(triangles, "embree", quality=quality)
    assert wide.validate(triangles) == []
    assert set(wide.references) == set(range(len(triangles)))


def test_hits_in_wide_trees_are_those_of_the_binary_one(cornell):
    rays = mibvh.diffuse_rays(cornell, width=16, height=12, samples=1)
    binary = mibvh.build(cornell, "embree", quality="high")
    wanted = mibvh.trace(binary, cornell, rays, style="wide", repeats=1)
    for width in (4, 8):
        wide = mibvh.build_wide(cornell, "embree", width, quality="high")
        found = mibvh.trace(wide, cornell, rays, style="wide", repeats=1)
        np.testing.assert_array_equal(found.t, wanted.t)
        assert (found.triangle >= 0).sum() == (wanted.triangle >= 0).sum() > 0


def test_it_is_none_of_the_defaults():
    assert "embree" not in names()


def test_refusals(small_soup, monkeypatch):
    with pytest.raises(mibvh.MibvhError, match="quality must be one of low, medium, high, not 'x'"):
        mibvh.build(small_soup, "embree", quality="x")
    mibvh.build(small_soup, "embree")
    monkeypatch.setattr(embree_builder, "_NAMES", {"rtcBuildBVH": "rtcNoSuchFunction"})
    embree_builder._library.cache_clear()
    with pytest.raises(mibvh.MibvhError, match="builder embree cannot use libembree"):
        mibvh.build(small_soup, "embree")
    monkeypatch.setattr("importlib.machinery.PathFinder.find_spec", lambda *_: None)
    with pytest.raises(mibvh.MibvhError, match="it is not there"):
        mibvh.build(small_soup, "embree")
    embree_builder._library.cache_clear()
