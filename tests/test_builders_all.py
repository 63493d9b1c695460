"""What holds for every builder in the registry, the ones that users add included."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import mibvh
from mibvh.builders import Draft, all_names, get, names
from mibvh.builders import build as build_with
from mibvh.errors import MibvhError
from mibvh.metrics.sah import sah
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import Triangles

#: `embree` has tests of its own.
BUILDERS = [name for name in all_names() if name != "embree"]
#: What makes a builder quick enough to be called hundreds of times.
QUICK = {"finite": {"count": 300, "planes": 12}}
ARRAYS = ("lower", "upper", "left", "first", "count", "references")


def build(triangles, name, **options):
    """Build with what makes it quick."""
    return build_with(triangles, name, **{**QUICK.get(name, {}), **options})


def soup(kind: str, n: int, seed: int) -> np.ndarray:
    """(n, 3, 3) float32: triangles of a named degenerate kind."""
    rng = np.random.default_rng(seed)
    corners = rng.random((n, 1, 3)) + 0.1 * rng.standard_normal((n, 3, 3))
    if kind == "duplicates":
        corners = np.repeat(corners[:1], n, axis=0)
    elif kind == "few distinct":
        corners = corners[rng.integers(0, max(1, n // 8), n)]
    elif kind == "coplanar":
        corners[:, :, 2] = 0.25
    elif kind == "grid":
        corners = np.round(4 * corners)
    elif kind == "points":
        corners[:, 1:] = corners[:, :1]
    elif kind == "one point":
        corners[:] = 0.5
    elif kind == "segments":
        corners[:, 2] = corners[:, 1]
    elif kind == "line":
        corners[:, :, 1:] = 0
    elif kind == "needles":
        corners[:, 2] = corners[:, 1] + 1e-7
        corners[:, 1] += 100 * rng.standard_normal((n, 3))
    elif kind == "huge":
        corners *= 1e15 / np.abs(corners).max()
    elif kind == "tiny":
        corners *= 1e-20
    elif kind == "minute":
        corners *= 1e-36
    elif kind == "same centre":
        size = rng.random((n, 1, 3))
        corners = np.concatenate([-size, size, size * [1, -1, 1]], axis=1)
    elif kind == "mixed scale":
        corners *= 10.0 ** rng.integers(-30, 15, (n, 1, 1))
    elif kind == "far away":
        corners = 1e7 + corners
    return corners.astype(np.float32)


KINDS = [
    "random",
    "duplicates",
    "few distinct",
    "coplanar",
    "grid",
    "points",
    "one point",
    "segments",
    "line",
    "needles",
    "huge",
    "tiny",
    "minute",
    "same centre",
    "mixed scale",
    "far away",
]


def room(n: int, seed: int = 5) -> np.ndarray:
    """(n, 3, 3) float32: large walls, long beams and small clutter, as in a building."""
    rng = np.random.default_rng(seed)
    sizes = np.where(rng.random((n, 1, 1)) < 0.05, 3.0, 0.05)
    corners = 10 * rng.random((n, 1, 3)) + sizes * rng.standard_normal((n, 3, 3))
    flat = rng.integers(0, 4, n)
    for axis in range(3):
        corners[flat == axis, :, axis] = np.round(corners[flat == axis, :1, axis])
    return corners.astype(np.float32)


def same(a: Tree, b: Tree) -> bool:
    return all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ARRAYS)


@pytest.fixture
def threads(monkeypatch):
    """Set the number of threads for one test."""
    return lambda count: monkeypatch.setenv("MIBVH_THREADS", str(count))


@pytest.mark.parametrize("name", BUILDERS)
@pytest.mark.parametrize("n", [1, 2, 3, 4, 9, 40, 1500])
def test_tree_is_sound(name, n):
    triangles = Triangles(room(n))
    tree = build(triangles, name)
    assert tree.validate(triangles) == []
    assert set(tree.references.tolist()) == set(range(n))
    assert tree.count[tree.is_leaf].max() <= 8
    assert tree.meta["digest"] == triangles.digest
    json.dumps(tree.meta)


@pytest.mark.parametrize("name", BUILDERS)
@pytest.mark.parametrize("kind", KINDS)
def test_degenerate_soup(name, kind):
    for n in (1, 2, 7, 120):
        triangles = Triangles(soup(kind, n, seed=n))
        assert build(triangles, name).validate(triangles) == []


@pytest.mark.parametrize("name", BUILDERS)
@settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    parts=st.lists(st.tuples(st.sampled_from(KINDS), st.integers(1, 30)), min_size=1, max_size=4),
    seed=st.integers(0, 2**31),
    max_leaf=st.integers(1, 16),
)
def test_any_soup(name, parts, seed, max_leaf):
    """Mixtures of degenerate soups, with any leaf size."""
    triangles = Triangles(np.concatenate([soup(kind, n, seed + n) for kind, n in parts]))
    tree = build(triangles, name, max_leaf=max_leaf)
    assert tree.validate(triangles) == []
    assert tree.count[tree.is_leaf].max() <= max_leaf


@pytest.mark.parametrize("name", BUILDERS)
def test_same_bits_on_any_number_of_threads(name, threads):
    triangles = Triangles(room(12_000))
    trees = []
    for count in (1, 2, 1):
        threads(count)
        trees.append(build(triangles, name))
    assert same(trees[0], trees[1])
    assert same(trees[0], trees[2])


@pytest.mark.parametrize("name", BUILDERS)
def test_optimiser_never_raises_sah(name):
    entry = get(name)
    if "start" not in entry.describe()["options"]:
        pytest.skip("starts from the triangles, not from a tree")
    for corners in (room(1500), soup("grid", 200, 1), soup("same centre", 100, 2)):
        triangles = Triangles(corners)
        for start in (entry.options().start, "lbvh"):
            before = build(triangles, start)
            tree = build(triangles, name, start=start)
            report = tree.meta["report"]
            assert report["end_sah"] <= report["start_sah"]
            assert report["start_sah"] == pytest.approx(sah(before), rel=1e-5)
            assert report["end_sah"] == pytest.approx(sah(tree), rel=1e-5)
            assert report["iterations"] >= 0


@pytest.mark.parametrize("name", BUILDERS)
def test_options_are_checked(name):
    triangles = Triangles(room(4))
    with pytest.raises(
        MibvhError, match=f"builder {name} has no option 'colour'.*; it has: .*max_leaf"
    ):
        build(triangles, name, colour=1)
    for key, entry in get(name).describe()["options"].items():
        low, high, default = entry["low"], entry["high"], entry["default"]
        assert entry["help"], key
        wrong = 7 if isinstance(default, str) else "seven"
        with pytest.raises(
            MibvhError, match=f"option {key} must be of type {type(default).__name__}"
        ):
            build(triangles, name, **{key: wrong})
        for bound, beyond in ((low, -1), (high, 1)):
            if bound is not None:
                with pytest.raises(MibvhError, match=f"option {key} must be from .* to .*, not"):
                    build(triangles, name, **{key: type(default)(bound + beyond)})


@pytest.mark.parametrize("name", BUILDERS)
def test_progress_goes_forward_and_can_stop(name):
    """Builders that report progress do so in [0, 1], and stop when the callback raises."""
    triangles = Triangles(room(3000))
    seen: list[tuple[str, float]] = []
    build(triangles, name, progress=lambda stage, done: seen.append((stage, done)))
    assert all(isinstance(stage, str) and 0 <= done <= 1 for stage, done in seen)
    if seen:

        def stop(stage: str, done: float) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            build(triangles, name, progress=stop)


def test_unknown_builder():
    with pytest.raises(MibvhError, match="there is no builder 'best'; there are: bbvh, "):
        build(Triangles(room(4)), "best")


def test_user_builder_is_treated_like_the_others():
    @mibvh.builder("test-halves", summary="halve the list")
    def halves(triangles, options, context):
        return np.arange(len(triangles))

    try:
        triangles = Triangles(room(100))
        assert "test-halves" in names()
        tree = build(triangles, "test-halves", max_leaf=3)
        assert tree.validate(triangles) == []
        assert sah(tree) > sah(build(triangles, "bbvh", max_leaf=3))
    finally:
        mibvh.builders.registry._registered.pop("test-halves")


@pytest.mark.parametrize(
    ("nested", "said"),
    [
        (([0, 1, 2], []), "ids of triangles, not"),
        ((0, 1, 2), "a pair, not 3 parts"),
        (([0, 1],), "a pair, not 1 parts"),
        (([0], [1]), "one place in the tree; there are 2 places, and 1 triangles have none"),
        (([0, 1], [1, 2]), "there are 4 places, and 0 triangles have none"),
        (([0, 1], 3), "there are 3 places, and 1 triangles have none"),
        (([0, 1], -1), "there are 3 places, and 1 triangles have none"),
        (([0, 1], 2.0), "ids of triangles, not 2.0"),
        (([0, 1], True), "ids of triangles, not True"),
        (None, "ids of triangles, not None"),
        ([[0], [1, 2]], "ids of triangles, not "),
    ],
    ids=[
        "empty",
        "triple",
        "single",
        "lost",
        "twice",
        "beyond",
        "negative",
        "float",
        "bool",
        "none",
        "ragged",
    ],
)
def test_nested_pairs_that_are_no_tree_are_refused(nested, said):
    with pytest.raises(MibvhError, match=said):
        Draft.from_nested(nested, Triangles(room(3)))


def test_user_builder_that_loses_triangles_is_refused():
    @mibvh.builder("test-loser")
    def loser(triangles, options, context):
        return Draft.from_nested(np.arange(9), Triangles(triangles.corners[:9]))

    try:
        with pytest.raises(MibvhError, match="builder test-loser made an invalid tree: "):
            build(Triangles(room(10)), "test-loser")
    finally:
        mibvh.builders.registry._registered.pop("test-loser")


def clustered() -> np.ndarray:
    """(4063, 3, 3) float32: points on the axes, each twice as near to the origin as the last.

    Every one of the 63 bits of the Morton codes cuts off one of them; then come 4000
    duplicates in the origin, which are halved twelve times.
    """
    points = np.zeros((4063, 3), np.float32)
    for i in range(63):
        points[i, i % 3] = 0.5 ** (i // 3)
    return np.repeat(points[:, None], 3, axis=1)


@pytest.mark.parametrize("name", BUILDERS)
def test_depth_is_repaired(name):
    triangles = Triangles(clustered())
    tree = build(triangles, name, max_leaf=1)
    assert tree.validate(triangles) == []
    assert tree.depth <= MAX_DEPTH
    if name == "lbvh":
        assert tree.meta["depth_repaired"]
