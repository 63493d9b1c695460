"""Two trees side by side."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import soup
from test_cli import cli  # noqa: F401 - a fixture

import mibvh
from mibvh.comparison import difference_figure


@pytest.fixture(scope="module")
def scene():
    return mibvh.load("cornell@1000")


@pytest.fixture(scope="module")
def rays(scene):
    return mibvh.diffuse_rays(scene, width=24, height=16, samples=1, bounces=2)


def test_a_comparison_is_of_the_trees_own_figures(scene, rays):
    tree = mibvh.build(scene, "sbvh", budget=2.0, c_inner=3.0)  # split, and of other constants
    found = mibvh.compare(scene, tree, "hill(sweeps=3)", rays=rays)
    assert found.names == ("sbvh", "hill(sweeps=3)")
    other = mibvh.build(scene, "hill", sweeps=3)
    hits = [mibvh.trace(t, scene, rays, repeats=1) for t in (tree, other)]
    for i, one in enumerate((tree, other)):
        plain = {name: pair[i] for name, pair in found.figures.items()}
        assert plain["sah"] == pytest.approx(mibvh.sah(one, 1.2, 1.0))
        assert plain["epo"] == pytest.approx(
            mibvh.epo(one.replace(meta={**one.meta, "c_inner": 1.2}), scene)
        )
        assert plain["lcv"] == hits[i].lcv
        assert plain["counted_cost"] == pytest.approx(hits[i].counted_cost())
        assert plain["nodes"] == len(one)
        assert sum(level.sah[i] for level in found.by_depth) == pytest.approx(plain["sah"])
        assert sum(level.epo[i] for level in found.by_depth) == pytest.approx(plain["epo"])
        mean = np.average(
            [o.cost[i] for o in found.by_origin], weights=[o.rays for o in found.by_origin]
        )
        assert mean == pytest.approx(plain["counted_cost"])
    a, b = (1.2 * h.inner.astype(float) + h.tests for h in hits)
    assert np.allclose(found.difference, b - a)
    assert found.quantiles[0.5] == pytest.approx(np.median(b - a))
    assert found.quantiles[1.0] == pytest.approx((b - a).max())
    assert sum(found.shares.values()) == pytest.approx(1.0)
    assert {o.bounce for o in found.by_origin} == {1, 2}


def test_a_tree_costs_no_ray_more_than_itself(scene, rays):
    found = mibvh.compare(scene, "lbvh", "lbvh", rays=rays)
    assert found.names == ("lbvh", "lbvh (second)")
    assert found.shares == {"cheaper": 0.0, "same": 1.0, "dearer": 0.0}
    assert set(found.quantiles.values()) == {0.0}


def test_the_picture_is_of_both_trees_and_the_difference(scene, rays, monkeypatch):
    from mibvh.mitsuba import heatmap

    drawn = {}
    kept = heatmap.cost_figure
    monkeypatch.setattr(heatmap, "cost_figure", lambda c, q: drawn.update(c) or kept(c, q))
    found = mibvh.compare(scene, "sbvh(budget=1.5)", "lbvh", rays=rays)
    figure = difference_figure(scene, found)
    assert list(drawn) == ["sbvh(budget=1·5).cost", "lbvh.cost", "difference.cost", "hit"]
    a, b, difference, hit = drawn.values()
    width, height = scene.sensors[0].film().size()
    assert a.shape[1] / a.shape[0] == pytest.approx(width / height, rel=0.01)
    assert np.allclose(difference, b - a, atol=1e-4)
    # The camera's own rays through the same places, one by one.
    primary = mibvh.make_rays(scene, "primary", viewpoints=1, width=64, height=48, samples=4)
    costs = [mibvh.trace(t, scene, primary, repeats=1) for t in found.trees]
    for image, hits in zip((a, b), costs, strict=True):
        assert image.mean() == pytest.approx(hits.counted_cost(), rel=0.02)
    assert hit.mean() == pytest.approx((costs[0].triangle >= 0).mean(), abs=0.02)
    assert len(figure.axes) >= 3
    with pytest.raises(mibvh.MibvhError, match="has 5 cameras; there is no 5"):
        difference_figure(scene, found, 5)


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ("sbhv", "did you mean 'sbvh'"),
        ("none.npz", r"none\.npz: there is no such file"),
        ("sbvh(bins=8..16:8)", "stands for 2 trees; name one"),
        (3, "a tree is a Tree, a file or a builder, not a int"),
    ],
)
def test_what_is_no_tree(second, said):
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.compare("nowhere.ply", "bbvh", second)  # refused before the scene is looked for


def test_a_tree_of_another_scene(scene, rays):
    with pytest.raises(mibvh.MibvhError, match="another geometry"):
        mibvh.compare(scene, mibvh.build(soup(50)), "bbvh", rays=rays)


def test_compare_on_the_command_line(cli, tmp_path, scene, rays):  # noqa: F811
    tree, file, picture = (tmp_path / name for name in ("t.npz", "r.npz", "p.png"))
    mibvh.build(scene, "sbvh").save(tree)
    rays.save(file)
    code, out, _ = cli(
        "compare", "cornell@1000", tree, "bbvh(max_leaf=4)", "--rays", file, "-o", picture, "--json"
    )
    assert code == 0
    found = json.loads(out)
    assert found["trees"] == ["t", "bbvh(max_leaf=4)"]
    assert found["rays"] == len(rays)
    told = mibvh.compare(scene, str(tree), "bbvh(max_leaf=4)", rays=rays).to_json()
    assert found == json.loads(json.dumps(told))
    assert picture.read_bytes().startswith(b"\x89PNG")
    code, out, _ = cli("compare", "cornell@1000", tree, "bbvh(max_leaf=4)", "--rays", file)
    assert code == 0
    assert "bbvh(max_leaf=4)" in out
    assert "of the rays are cheaper in B" in out
    code, _, err = cli("compare", "cornell@1000", tree, "bbvh", "-o", tmp_path / "p.exr")
    assert code == 2
    assert "the picture is a .png file" in err
