"""`sbvh`: splits where it must, does not where it must not, valid, and equal on all threads."""

import dataclasses

import numpy as np
import pytest
from cuts import cut
from hypothesis import given, settings
from hypothesis import strategies as st

import mibvh
from mibvh import Triangles
from mibvh.builders import get
from mibvh.builders.finish import draft_sah
from mibvh.builders.registry import Context
from mibvh.builders.spatial import _Scratch

COSTS = {"c_inner": 1.2, "c_tri": 1.0, "max_leaf": 8}
ARRAYS = ("lower", "upper", "left", "first", "count", "references")


def draft(triangles, name="sbvh", **options):
    entry = get(name)
    return entry.draft(triangles, entry.options(**options), Context())


def sah(triangles, name="sbvh", **options):
    return draft_sah(draft(triangles, name, **options), **COSTS)


def quad(corner, u, v):
    corner, u, v = (np.asarray(x, float) for x in (corner, u, v))
    return np.stack([[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]])


def box_mesh(low, size, turn=0.0):
    """Twelve triangles, turned about z."""
    low, (a, b, c) = np.asarray(low, float), np.diag(size)
    cosine, sine = np.cos(turn), np.sin(turn)
    a, b = ([cosine * x[0] - sine * x[1], sine * x[0] + cosine * x[1], x[2]] for x in (a, b))
    a, b = np.array(a), np.array(b)
    faces = [
        (low, a, b),
        (low, a, c),
        (low, b, c),
        (low + c, a, b),
        (low + b, a, c),
        (low + a, b, c),
    ]
    return np.concatenate([quad(*face) for face in faces])


def town(buildings=150, seed=0):
    """Boxes of mixed sizes, some turned, with long beams leaning on them, on a large ground."""
    rng = np.random.default_rng(seed)
    parts = [quad([-10, -10, 0], [20, 0, 0], [0, 20, 0])]
    for i in range(buildings):
        low = np.append(rng.uniform(-9, 9, 2), 0)
        size = rng.uniform([0.2, 0.2, 0.3], [1.0, 1.0, 3.0])
        parts.append(box_mesh(low, size, 0.0 if i % 3 else rng.uniform(0, np.pi)))
        if i % 5 == 0:
            parts.append(
                box_mesh(low + np.array([0, 0, 1]), [4.0, 0.05, 0.05], rng.uniform(0, np.pi))
            )
    return Triangles(np.concatenate(parts).astype("f4"), "town")


def soup(n, seed, size=0.2):
    rng = np.random.default_rng(seed)
    return Triangles((rng.random((n, 1, 3)) + size * rng.normal(size=(n, 3, 3))).astype("f4"))


def same(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ARRAYS)


# ------------------------------------------------------------------ when to split


def test_two_crossing_diagonals_are_split():
    # Two needles cross in the middle of a cube, so that their boxes are the cube, of half area
    # 3, and the object split costs 6. Cut at x = 1/2, each side is 1/2 x 1 x 1/2 with half
    # area 1.25 and holds two: 5. Cheap inner nodes, or a leaf of both would be best.
    w = 1e-3
    needles = [[[0, 0, 0], [1, 1, 1], [1, 1, 1 - w]], [[0, 1, 0], [1, 0, 1], [1, 0, 1 - w]]]
    triangles = Triangles(np.array(needles, np.float32))
    split, whole = (draft(triangles, name, c_inner=0.05) for name in ("sbvh", "bbvh"))
    assert len(split.references) == 4  # all the budget allows
    assert split.report["spatial_made"] == 1
    costs = {**COSTS, "c_inner": 0.05}
    # Below the halves, each half of a needle has a cube of half area 0.75 to itself.
    expected = 4 * 0.75 / 3 + 0.05 * (1 + 2 * 1.25 / 3)
    assert draft_sah(split, **costs) == pytest.approx(expected, rel=0.01)
    assert draft_sah(whole, **costs) == pytest.approx(2.0, rel=0.01)
    assert mibvh.build(triangles, "sbvh", c_inner=0.05).validate(triangles) == []


def test_nothing_is_split_where_object_splits_separate():
    # A grid of small triangles that share no box: children never overlap.
    x, y, z = np.meshgrid(*[np.arange(6.0)] * 3)
    corner = np.stack([x, y, z], axis=-1).reshape(-1, 1, 3)
    triangles = Triangles((corner + 0.3 * np.eye(3)).astype("f4"))
    result = draft(triangles)
    assert len(result.references) == len(triangles)
    assert result.report["spatial_tried"] == 0


@pytest.mark.parametrize("options", [{"budget": 0.0}, {"alpha": 1.0}])
def test_without_spatial_splits_it_is_bbvh(options):
    triangles = town(40)
    a, b = mibvh.build(triangles, "sbvh", **options), mibvh.build(triangles, "bbvh")
    assert same(a, b)


def test_town_is_better_than_object_splits_alone():
    triangles = town()
    best, whole = sah(triangles), sah(triangles, "bbvh")
    assert best <= 1.01 * whole
    assert best < 0.97 * whole  # beams and ground are what spatial splits are for
    assert sah(triangles, bins=16) < whole


@pytest.mark.parametrize("budget", [0.01, 0.1, 0.5])
def test_budget_bounds_the_references(budget):
    triangles = town(60)
    n = len(triangles)
    result = draft(triangles, budget=budget)
    assert n < len(result.references) <= n * (1 + budget)
    assert len(result.references) < len(draft(triangles, budget=4.0).references)


@pytest.mark.parametrize("seed", [1, 2])
def test_room_goes_to_the_triangles_that_need_it(seed):
    """A deck of small triangles, hung on a few long ones: these take nearly all of the room."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 0.1, 5), indexing="ij")
    p = np.stack([x, y, 0 * x], -1)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    deck = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3, 3)
    foot = rng.random((60, 1, 3)) * [1, 0.1, 0]
    top = [0.5, 0.05, 0.6] + 0.02 * rng.standard_normal((60, 1, 3))
    bridge = Triangles(np.concatenate([deck, np.hstack([foot, top, foot + [0.002, 0, 0]])]))
    assert sah(bridge, budget=1.0) < 1.02 * sah(bridge, budget=8.0)


def test_alpha_decides_where_spatial_splits_are_tried():
    triangles = town(60)
    tried = [draft(triangles, alpha=a).report["spatial_tried"] for a in (1e-6, 1e-3, 1e-1)]
    assert tried[0] > tried[1] > tried[2]


# ------------------------------------------------------------------ soundness


def test_references_lie_in_their_triangles_boxes_and_drafts_are_whole():
    triangles = town(60)
    result = draft(triangles)
    refs, n = result.references, len(result.references)
    assert n > len(triangles)
    assert len(result.left) == len(result.right) == len(result.reference) == 2 * n - 1
    assert sorted(result.reference[result.left < 0].tolist()) == list(range(n))
    children = np.concatenate([result.left[result.left >= 0], result.right[result.right >= 0]])
    assert sorted(children.tolist()) == list(range(1, 2 * n - 1))
    assert set(refs.triangle.tolist()) == set(range(len(triangles)))
    scale = np.float32(refs.scale)
    assert (refs.lower >= triangles.lower[refs.triangle] * scale).all()
    assert (refs.upper <= triangles.upper[refs.triangle] * scale).all()
    assert (refs.lower <= refs.upper).all()


@pytest.mark.parametrize("options", [{}, {"budget": 0.2, "bins": 8}, {"alpha": 0.0, "budget": 4.0}])
def test_trees_are_valid(options):
    for triangles in (town(30), soup(300, 2), soup(300, 3, size=2.0)):
        tree = mibvh.build(triangles, "sbvh", **options)
        assert tree.splits_triangles or triangles.name != "town"
        assert tree.validate(triangles) == []


coordinate = st.one_of(st.integers(-2, 2).map(float), st.floats(-2, 2, width=32))


@settings(max_examples=80, deadline=None)
@given(
    st.lists(
        st.lists(st.tuples(*[coordinate] * 3), min_size=3, max_size=3), min_size=1, max_size=24
    ),
    st.sampled_from([1e-20, 1.0, 4e14]),
    st.booleans(),
)
def test_any_soup_gives_a_valid_tree(corners, scale, twice):
    corners = np.array(corners) * scale
    if twice:
        corners = np.concatenate([corners, corners])
    triangles = Triangles(corners.astype("f4"))
    tree = mibvh.build(triangles, "sbvh", alpha=0.0, budget=2.0)
    assert tree.validate(triangles) == []


def degenerate():
    rng = np.random.default_rng(4)
    base = rng.normal(size=(64, 3, 3))
    yield "one", base[:1]
    yield "duplicates", np.repeat(base[:1], 64, axis=0)
    yield "coplanar", base * [1, 1, 0]
    yield "points", np.repeat(base[:, :1], 3, axis=1)
    yield "needles", base[:, [0, 1, 1]]
    yield "equal centers", np.concatenate([base[:, :1], -base[:, :1], 0 * base[:, :1]], axis=1)


@pytest.mark.parametrize(("name", "corners"), list(degenerate()))
def test_degenerate_input(name, corners):
    triangles = Triangles(corners.astype("f4"), name)
    tree = mibvh.build(triangles, "sbvh", alpha=0.0)
    assert tree.validate(triangles) == []


# ------------------------------------------------------------------ threads, progress, options


def test_equal_on_one_and_two_threads(monkeypatch):
    monkeypatch.setattr("mibvh.builders.spatial._TASK", 64)  # many small tasks
    triangles = town(80)
    trees = []
    for threads in ("1", "2", "2"):
        monkeypatch.setenv("MIBVH_THREADS", threads)
        trees.append(mibvh.build(triangles, "sbvh"))
    assert trees[0].splits_triangles
    assert same(trees[0], trees[1])
    assert same(trees[1], trees[2])


def test_the_size_of_tasks_does_not_matter(monkeypatch):
    triangles = town(50)
    whole = mibvh.build(triangles, "sbvh")
    monkeypatch.setattr("mibvh.builders.spatial._TASK", 10)
    assert same(whole, mibvh.build(triangles, "sbvh"))


@pytest.mark.parametrize("name", ["pipes", "needles"])
@pytest.mark.parametrize("share", [10**9, 20])
def test_large_nodes_that_outgrow_their_lists_are_built_apart(monkeypatch, name, share):
    """Without room in the lists, or with little, the tree is the same."""
    triangles, _ = cut(name, "sbvh")
    whole, sizes, make = mibvh.build(triangles, "sbvh"), [], _Scratch.of
    assert whole.splits_triangles
    monkeypatch.setattr("mibvh.builders.spatial._TASK", 10)
    monkeypatch.setattr("mibvh.builders.spatial._FREE_SHARE", share)
    monkeypatch.setattr(_Scratch, "of", lambda *size: sizes.append(size[1]) or make(*size))
    assert same(whole, mibvh.build(triangles, "sbvh"))
    assert max(sizes) > 10


def test_progress_grows_to_one_and_may_interrupt(monkeypatch):
    monkeypatch.setattr("mibvh.builders.spatial._TASK", 64)
    triangles, seen = town(80), []
    mibvh.build(triangles, "sbvh", progress=lambda stage, done: seen.append((stage, done)))
    done = [d for stage, d in seen if stage == "split"]
    assert done == sorted(done)
    assert 0.5 < done[-1] <= 1

    def interrupt(stage, done):
        if stage == "split":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mibvh.build(triangles, "sbvh", progress=interrupt)


def test_options_say_what_they_do():
    described = get("sbvh").describe()["options"]
    assert {"alpha", "bins", "budget"} <= set(described)
    assert described["alpha"]["default"] == 1e-5
    assert described["bins"] == {**described["bins"], "default": 128, "low": 8, "high": 256}
    assert all(field.metadata["help"] for field in dataclasses.fields(get("sbvh").options))
