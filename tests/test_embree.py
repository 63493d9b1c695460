import numpy as np
import pytest
from conftest import soup

import mibvh
import mibvh.builders.embree as embree_builder
from mibvh.builders import names

QUALITIES = ("low", "medium", "high")


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
@pytest.mark.parametrize(
    "corners",
    [
        soup(1).corners,
        soup(2).corners,
        np.repeat(soup(1).corners, 500, axis=0),
        np.zeros((100, 3, 3)),
        soup(300).corners * [1, 1, 0],
        soup(300).corners * 1e-20,
        soup(300).corners * 1e14,
        soup(300).corners + 1e6,
        np.float32(1.3) ** np.arange(300)[:, None, None] * soup(300).corners * 1e-20,
    ],
    ids=["one", "two", "copies", "points", "flat", "tiny", "huge", "far", "growing"],
)
def test_degenerate_input(corners, quality):
    triangles = mibvh.Triangles(np.asarray(corners, np.float32))
    assert mibvh.build(triangles, "embree", quality=quality).validate(triangles) == []


def test_hits_are_those_of_other_trees(cornell):
    rays = mibvh.diffuse_rays(cornell, width=16, height=12, samples=1)
    wanted = mibvh.trace(mibvh.build(cornell, "bbvh"), cornell, rays, repeats=1).t
    for quality in QUALITIES:
        tree = mibvh.build(cornell, "embree", quality=quality)
        np.testing.assert_array_equal(mibvh.trace(tree, cornell, rays, repeats=1).t, wanted)


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
