import copy
import pickle

import numpy as np
import pytest
from conftest import clipped, soup

import mibvh
from mibvh.validation import structure_violations

ARRAYS = ("lower", "upper", "left", "first", "count", "references")


@pytest.fixture(scope="module")
def pipes():
    """Cuts of real geometry with long triangles, and trees that split them."""
    triangles = mibvh.load("powerplant@1500").triangles
    return triangles, {name: mibvh.build(triangles, name) for name in ("bbvh", "sbvh", "streelet")}


def spoilt(tree, **changes):
    """A tree with some elements exchanged: ``left={3: 5}``."""
    arrays = {}
    for name, values in changes.items():
        arrays[name] = getattr(tree, name).copy()
        for index, value in values.items():
            arrays[name][index] = value
    return tree.replace(**arrays)


def slowly_sound(tree):
    """Whether a tree without repeated or missing triangles is one, node by node from the root."""
    todo, seen = [(0, 0)], set()
    while todo:
        n, depth = todo.pop()
        if not 0 <= n < len(tree) or n in seen or depth > 64:
            return False
        seen.add(n)
        first, count = int(tree.first[n]), int(tree.count[n])
        if count < 1 or first < 0 or first + count > len(tree.references):
            return False
        if not (tree.lower[n] <= tree.upper[n]).all():
            return False
        ids = tree.references[first : first + count].tolist()
        left = int(tree.left[n])
        if left == -1:
            if len(set(ids)) < len(ids):
                return False
            continue
        if left <= n or left + 1 >= len(tree):
            return False
        ends = [
            (int(tree.first[c]), int(tree.first[c]) + int(tree.count[c])) for c in (left, left + 1)
        ]
        if ends[0][0] != first or ends[0][1] != ends[1][0] or ends[1][1] != first + count:
            return False
        for c in (left, left + 1):
            if (tree.lower[c] < tree.lower[n]).any() or (tree.upper[c] > tree.upper[n]).any():
                return False
            todo.append((c, depth + 1))
    whole = int(tree.first[0]) == 0 and int(tree.count[0]) == len(tree.references)
    ids = set(tree.references.tolist())
    return whole and len(seen) == len(tree) and ids == set(range(tree.meta["triangles"]))


@pytest.mark.parametrize("name", ["bbvh", "sbvh"])
def test_against_a_slow_twin(name):
    """Three thousand trees with one to three elements changed: sound or not, as the twin says."""
    tree = mibvh.build(soup(40, size=0.4), name)
    rng = np.random.default_rng(3)
    verdicts = []
    for _ in range(3000):
        changes = {}
        for _ in range(rng.integers(1, 4)):
            array = ARRAYS[rng.integers(6)]
            index = int(rng.integers(len(getattr(tree, array))))
            old = getattr(tree, array)
            new = old[rng.integers(len(old))]
            if array in ("left", "first", "count", "references") and rng.random() < 0.5:
                new = rng.choice([old[index] + rng.integers(-2, 3), -1, len(tree), 2**30])
            changes[array] = {index: new}
        changed = spoilt(tree, **changes)
        verdicts.append(slowly_sound(changed))
        assert (structure_violations(changed) == []) == verdicts[-1], changes
    assert 50 < sum(verdicts) < 2950


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"left": {0: 0}}, "node 0 has left = 0"),
        ({"left": {1: -7}}, "left = -7: neither -1 nor a child"),
        ({"left": {0: 2**30}}, "are not among the"),
        ({"first": {0: 1}}, "the root's range is not all"),
        ({"first": {3: -1000000}}, "joined"),
        ({"count": {1: 0}}, "node 1 has no references"),
        ({"count": {2: -(2**31)}}, "node 2 has no references"),
        ({"references": {0: -5}}, "reference 0 is -5"),
        ({"references": {7: 2**31 - 1}}, "reference 7 is 2147483647"),
        ({"lower": {(4, 1): np.nan}}, "inverted or NaN"),
        ({"upper": {(0, 0): np.inf}}, "inverted or NaN, or beyond"),
        ({"upper": {(1, 2): 1e9}}, "stick out of their parents"),
    ],
)
def test_every_function_says_the_first_fault(small_soup, changes, said):
    tree = spoilt(mibvh.build(small_soup, "bbvh"), **changes)
    rays = mibvh.RaySet(
        np.zeros((4, 3), np.float32),
        np.ones((4, 3), np.float32),
        np.ones(4, np.float32),
        *np.zeros((3, 4), np.int32),
    )
    for use in (
        lambda: mibvh.sah(tree),
        lambda: mibvh.epo(tree, small_soup),
        lambda: mibvh.estimate_epo(tree, small_soup, 8),
        lambda: mibvh.trace(tree, small_soup, rays),
        lambda: tree.depth,
        lambda: tree.parents,
        lambda: tree.half_areas,
        lambda: tree.stats(),
        lambda: mibvh.plot.leaf_sizes(tree),
    ):
        with pytest.raises(mibvh.MibvhError, match="invalid tree") as error:
            use()
        assert said in str(error.value)
        assert "\n" not in str(error.value)


def chain(levels):
    """A chain: node 2 i has the leaf 2 i + 1 and the rest; triangle i is a copy of the others."""
    left = np.full(2 * levels + 1, -1, np.int32)
    left[: 2 * levels : 2] = np.arange(1, 2 * levels, 2)
    first = np.zeros(2 * levels + 1, np.int32)
    first[1::2], first[::2] = np.arange(levels), np.arange(levels + 1)
    count = np.ones(2 * levels + 1, np.int32)
    count[::2] = levels + 1 - np.arange(levels + 1)
    lower, upper = (
        np.zeros((2 * levels + 1, 3), np.float32),
        np.ones((2 * levels + 1, 3), np.float32),
    )
    triangles = mibvh.Triangles(np.tile(np.eye(3), (levels + 1, 1, 1)))
    ids = np.arange(levels + 1, dtype=np.int32)
    return mibvh.Tree(lower, upper, left, first, count, ids), triangles


def test_deep_trees():
    """Up to the traversal's stack all is well; beyond it metrics alone; much deeper, nothing."""
    rays = mibvh.RaySet(np.full((4, 3), 2.0), np.full((4, 3), -1.0))
    tree, triangles = chain(64)
    assert tree.validate(triangles) == []
    assert np.isfinite(mibvh.trace(tree, triangles, rays, repeats=1).t).all()
    tree, triangles = chain(65)
    assert tree.validate(triangles) == ["depth 65 is beyond the traversal stack of 64"]
    assert mibvh.epo(tree, triangles) > 0
    with pytest.raises(mibvh.MibvhError, match="65 levels deep; the traversal stack has 64"):
        mibvh.trace(tree, triangles, rays)
    tree, triangles = chain(1024)
    assert mibvh.sah(tree) == pytest.approx(1.2 * 1024 + 1025)
    assert mibvh.epo(tree, triangles) > 0
    tree, triangles = chain(1025)
    with pytest.raises(mibvh.MibvhError, match="node 2049 is deeper than 1024"):
        mibvh.sah(tree)


def test_a_tree_with_children_of_two_parents():
    box = np.zeros((5, 3), np.float32)
    left = np.array([1, 3, 3, -1, -1], np.int32)
    tree = mibvh.Tree(
        box,
        box,
        left,
        np.array([0, 0, 1, 0, 1], np.int32),
        np.array([2, 1, 1, 1, 1], np.int32),
        np.arange(2, dtype=np.int32),
    )
    assert len(tree.validate()) == 1


@pytest.mark.parametrize(
    ("meta", "said"),
    [
        ({"c_inner": float("nan")}, "c_inner = 'nan'"),
        ({"c_tri": "1"}, "c_tri = '1'"),
        ({"c_tri": 10**400}, "c_tri"),
        ({"triangles": 0}, "'0' triangles"),
        ({"triangles": 10**12}, "are in no leaf"),
        ({"digest": 3}, "digest"),
    ],
)
def test_metadata(small_soup, meta, said):
    tree = mibvh.build(small_soup, "bbvh")
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.sah(tree.replace(meta={**tree.meta, **meta}))


def test_boxes_smaller_than_their_triangles_are_noticed_where_the_triangles_are(pipes):
    triangles, trees = pipes
    tree = trees["bbvh"]
    leaf = int(np.flatnonzero(tree.is_leaf & (tree.upper > tree.lower).all(axis=1))[3])
    shrunk = spoilt(tree, upper={leaf: tree.lower[leaf]})
    assert shrunk.validate() == []
    with pytest.raises(mibvh.MibvhError, match=f"leaves .first: in node {leaf}"):
        mibvh.epo(shrunk, triangles)


def grid_says_uncovered(tree, triangles, steps=24):
    """Split triangles with a point of a barycentric grid in none of their leaves' boxes."""
    u, v = (g.ravel() for g in np.meshgrid(np.arange(steps + 1), np.arange(steps + 1)))
    u, v = u[u + v <= steps] / steps, v[u + v <= steps] / steps
    missed = set()
    times = np.bincount(tree.references, minlength=len(triangles))
    for t in np.flatnonzero(times > 1):
        a, b, c = triangles.corners[t].astype(np.float64)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        slack = 5e-7 * np.abs(triangles.corners[t]).max()
        held = np.zeros(len(points), bool)
        for n in np.flatnonzero(tree.is_leaf):
            if t in tree.references[tree.first[n] : tree.first[n] + tree.count[n]]:
                low, high = tree.lower[n] - slack, tree.upper[n] + slack
                held |= ((points >= low) & (points <= high)).all(axis=1)
        if not held.all():
            missed.add(int(t))
    return missed


@pytest.mark.parametrize("name", ["sbvh", "streelet"])
def test_coverage_of_split_triangles_against_a_grid_of_points(pipes, name):
    """A leaf's box is made smaller: what a grid finds uncovered is found."""
    triangles, trees = pipes
    tree = trees[name]
    assert tree.validate(triangles) == []
    times = np.bincount(tree.references, minlength=len(triangles))
    rng = np.random.default_rng(1)
    leaves = [
        n
        for n in np.flatnonzero(tree.is_leaf)
        if (times[tree.references[tree.first[n] : tree.first[n] + tree.count[n]]] > 1).all()
    ]
    found = 0
    for n in rng.choice(leaves, 12, replace=False):
        axis = int((tree.upper[n] - tree.lower[n]).argmax())
        cut = tree.lower[n, axis] + np.float32(0.6) * (tree.upper[n, axis] - tree.lower[n, axis])
        gap = spoilt(tree, upper={(n, axis): cut})
        missed = grid_says_uncovered(gap, triangles)
        said = gap.validate(triangles)
        if missed:
            found += 1
            assert len(said) == 1
            assert int(said[0].split()[0]) >= len(missed)
        # What lies beyond the cut and in no other leaf, by clipping in plain Python.
        elif said:
            ids = tree.references[tree.first[n] : tree.first[n] + tree.count[n]]
            beyond = tree.lower[n].copy()
            beyond[axis] = cut
            parts = [
                clipped(list(triangles.corners[t].astype(float)), beyond, tree.upper[n])
                for t in ids
            ]
            assert any(len(part) >= 3 for part in parts)
    assert found >= 4


def test_arrays_cannot_be_written_to(small_soup):
    built = mibvh.build(small_soup, "bbvh")
    left = built.left.copy()
    tree = built.replace(left=left)
    tree.check_matches(small_soup)
    left[0] = 0  # the caller's own array
    assert tree.left[0] == 1
    window = left[:]
    window.flags.writeable = False
    assert built.replace(left=window).left is not window  # its base can be written to
    assert built.replace(meta={}).lower is built.lower
    for copied in (tree, copy.deepcopy(tree), pickle.loads(pickle.dumps(tree))):
        for name in ARRAYS:
            with pytest.raises(ValueError, match="read-only"):
                getattr(copied, name)[0] = 0
        assert copied.validate(small_soup) == []


@pytest.mark.parametrize("count", [32, 33, 500])
def test_a_triangle_twice_in_a_leaf_of_any_size(count):
    """Small leaves are searched by compiled code, large ones by NumPy."""
    triangles = soup(count)
    whole = mibvh.Tree.from_arrays(
        triangles.corners.min((0, 1))[None],
        triangles.corners.max((0, 1))[None],
        left=np.array([-1]),
        first=np.array([0]),
        count=np.array([count]),
        references=np.arange(count),
    )
    assert structure_violations(whole) == []
    references = np.append(whole.references, whole.references[7])
    twice = whole.replace(references=references, count=np.array([count + 1], np.int32))
    assert structure_violations(twice) == ["a leaf, node 0, holds a triangle twice"]


def test_the_check_is_made_once(small_soup, monkeypatch):
    import mibvh.validation

    tree = mibvh.build(small_soup, "bbvh")
    value = mibvh.epo(tree, small_soup)
    monkeypatch.setattr(mibvh.validation, "_structure", None)
    monkeypatch.setattr(mibvh.validation, "_leaf_boxes", None)
    assert mibvh.epo(tree, small_soup) == value
    with pytest.raises(TypeError):
        mibvh.epo(tree.replace(), small_soup)
