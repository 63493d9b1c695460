"""WideTree: collapsing, quantised boxes, other programs' nodes, files, invariants."""

import functools
import pickle

import numpy as np
import pytest
from conftest import soup

import mibvh
from mibvh.builders import registry
from mibvh.builders.wide import build_wide
from mibvh.collapsing import collapse, unfold
from mibvh.metrics.sah import node_costs
from mibvh.quantise import finest_step, grid, quantised
from mibvh.wide_tree import WideTree


def tree_of(builder="bbvh", count=300, seed=3):
    triangles = soup(count, seed, size=0.3)
    return triangles, mibvh.build(triangles, builder)


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "lbvh", "streelet"])
@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("method", ["optimal", "greedy"])
def test_collapsed_trees_are_sound_and_keep_what_is_in_the_leaves(builder, width, method):
    triangles, tree = tree_of(builder)
    wide = collapse(tree, width, method=method)
    assert wide.validate(triangles) == []
    assert wide.children.max() == width
    np.testing.assert_array_equal(wide.references, tree.references)
    leaves = np.sort(np.stack([tree.first, tree.count], 1)[tree.is_leaf], axis=0)
    kept = np.sort(np.stack([wide.first, wide.count], 1)[wide.is_leaf], axis=0)
    np.testing.assert_array_equal(kept, leaves)
    # Every node is one of the binary tree's, boxes and all.
    binary = {
        (*low, *high, f, c)
        for low, high, f, c in zip(
            tree.lower.tolist(), tree.upper.tolist(), tree.first, tree.count, strict=True
        )
    }
    found = {
        (*low, *high, f, c)
        for low, high, f, c in zip(
            wide.lower.tolist(), wide.upper.tolist(), wide.first, wide.count, strict=True
        )
    }
    assert found <= binary


@pytest.mark.parametrize("width", [2, 8])
def test_new_leaves_hold_no_triangle_twice(width):
    """Where the programme makes a leaf of several that have parts of one triangle."""
    triangles = mibvh.load("powerplant@2000").triangles
    tree = mibvh.build(triangles, "sbvh", max_leaf=1)
    wide = collapse(tree, width, max_leaf=8, c_inner=30.0)  # leaves are made wherever they may be
    assert wide.validate(triangles) == []
    assert wide.count[wide.is_leaf].max() > 1
    assert len(wide.references) < len(tree.references)
    assert set(wide.references) == set(range(len(triangles)))
    built, wide = mibvh.build_wide(triangles, "sbvh", width), collapse(tree, width, max_leaf=8)
    for name in ("lower", "upper", "child", "children", "first", "count", "references"):
        np.testing.assert_array_equal(getattr(built, name), getattr(wide, name))
    assert built.meta["options"]["max_leaf"] == 8


@pytest.mark.parametrize("builder", ["lbvh", "streelet"])
def test_width_two_is_the_binary_tree(builder):
    _, tree = tree_of(builder)
    for method in ("optimal", "greedy"):
        wide = collapse(tree, 2, method=method)
        np.testing.assert_array_equal(wide.child, tree.left)
        for name in ("lower", "upper", "first", "count", "references"):
            np.testing.assert_array_equal(getattr(wide, name), getattr(tree, name))
        np.testing.assert_array_equal(wide.parents, tree.parents)
        np.testing.assert_array_equal(wide.depths, tree.depths)
        np.testing.assert_array_equal(wide.binary.left, tree.left)
        np.testing.assert_array_equal(wide.binary.first, tree.first)


def cheapest(tree, width, weight, c_inner, c_box, c_tri, max_leaf):
    """Cost of the cheapest wide tree, trying every set of children of every node."""

    @functools.cache
    def as_node(n):
        leaf = weight[n] * c_tri * tree.count[n]
        if tree.left[n] < 0:
            return leaf
        best = leaf if tree.count[n] <= max_leaf else np.inf
        for group in groups(tree.left[n]):
            for other in groups(tree.left[n] + 1):
                children = group + other
                if len(children) <= width:
                    cost = weight[n] * (c_inner + c_box * (len(children) - 2))
                    best = min(best, cost + sum(as_node(c) for c in children))
        return best

    @functools.cache
    def groups(n):
        """All ways to cut a subtree into at most ``width`` roots."""
        found = [(n,)]
        if tree.left[n] >= 0:
            found += [a + b for a in groups(tree.left[n]) for b in groups(tree.left[n] + 1)]
        return [g for g in found if len(g) < width]

    return as_node(0)


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("c_box", [0.0, 0.2, 2.0])
@pytest.mark.parametrize("max_leaf", [None, 3])
def test_the_programme_finds_the_cheapest_of_all_wide_trees(width, c_box, max_leaf):
    triangles, tree = tree_of("lbvh", 24, seed=1)
    tree = unfold(tree, triangles)
    for weights in (None, np.random.default_rng(5).random(len(tree))):
        wide = collapse(
            tree, width, weights=weights, c_inner=1.5, c_box=c_box, c_tri=0.9, max_leaf=max_leaf
        )
        weight = tree.half_areas if weights is None else weights
        best = cheapest(tree, width, weight, 1.5, c_box, 0.9, max_leaf or 0)
        # Ranges name the nodes: none of the tree's are alike.
        at = {(f, c): w for f, c, w in zip(tree.first, tree.count, weight, strict=True)}
        assert len(at) == len(tree)
        chosen = np.array([at[key] for key in zip(wide.first, wide.count, strict=True)])
        assert chosen @ node_costs(wide) == pytest.approx(best, rel=1e-6)
        if weights is None:
            assert mibvh.sah(wide) * wide.half_areas[0] == pytest.approx(best, rel=1e-6)
        greedy = collapse(tree, width, method="greedy", weights=weights)
        sizes = [at[key] for key in zip(greedy.first, greedy.count, strict=True)]
        assert sizes @ node_costs(greedy, 1.5, 0.9, c_box=c_box) >= best * (1 - 1e-6)


def test_greedy_opens_the_child_of_the_largest_area():
    _, tree = tree_of("lbvh", 200)
    wide = collapse(tree, 4, method="greedy")
    group = [tree.left[0], tree.left[0] + 1]
    while len(group) < 4:
        widest = max((n for n in group if tree.left[n] >= 0), key=lambda n: tree.half_areas[n])
        group.remove(widest)
        group += [tree.left[widest], tree.left[widest] + 1]
    assert sorted(tree.first[group]) == sorted(wide.first[1:5])
    assert sorted(tree.count[group]) == sorted(wide.count[1:5])


@pytest.mark.parametrize("builder", ["bbvh", "sbvh"])
def test_unfolding_gives_every_reference_a_leaf_and_a_box(builder):
    triangles, tree = tree_of(builder)
    assert tree.count[tree.is_leaf].max() > 1
    single = unfold(tree, triangles)
    assert single.validate(triangles) == []
    assert (single.count[single.is_leaf] == 1).all()
    np.testing.assert_array_equal(single.references, tree.references)
    if builder == "bbvh":
        ids = single.references[single.first[single.is_leaf]]
        np.testing.assert_array_equal(single.lower[single.is_leaf], triangles.lower[ids])


@pytest.mark.parametrize("place", [0.0, 7.0, -300.0, 1e-3])
@pytest.mark.parametrize("width", [4, 8])
def test_quantised_boxes_lie_on_grids_of_eight_bits(place, width):
    triangles, _ = tree_of()
    corners = triangles.corners * np.float32(0.01 if place else 1) + np.float32(place)
    triangles = mibvh.Triangles(np.concatenate([corners, corners[:9] * [1, 1, 0]]))
    wide = collapse(unfold(mibvh.build(triangles, "sbvh"), triangles), width)
    small = quantised(wide)
    assert small.quantised
    assert not wide.quantised
    assert small.validate(triangles) == []  # boxes are nested, among others
    assert (small.lower <= wide.lower).all()
    assert (small.upper >= wide.upper).all()
    for n in np.flatnonzero(small.child >= 0):
        group = slice(small.child[n], small.child[n] + small.children[n])
        for k in range(3):
            planes = np.concatenate([small.lower[group, k], small.upper[group, k]]).astype(float)
            finest = finest_step(small.lower[0], small.upper[0])
            origin, exponent = grid(planes.min(), planes.max(), finest)
            steps = (planes - origin) / 2.0**exponent
            assert (steps == np.round(steps)).all()
            assert steps.min() >= 0
            assert steps.max() <= 255
            assert not np.float32(origin).view(np.uint32) & 63
            former = np.ptp([wide.lower[group, k].min(), wide.upper[group, k].max()])
            assert np.ptp(planes) <= former + 2 * 2.0**exponent
    again = quantised(small)
    np.testing.assert_array_equal(again.lower, small.lower)
    np.testing.assert_array_equal(again.upper, small.upper)
    if not place:  # a grid step is no more than 1/127 of the node
        assert mibvh.sah(small) < 1.05 * mibvh.sah(wide)


def shuffled(wide, seed):
    """The nodes of a tree in random order and places, as another program might have them."""
    rng = np.random.default_rng(seed)
    name = rng.permutation(len(wide))  # of each node
    children = np.full((len(wide), wide.width), -1)
    lower, upper = np.zeros((2, len(wide), 3), np.float32)
    first, count = np.full((2, len(wide)), -77)
    references = np.full(len(wide.references) + 50, -5)
    begin = 20
    for n in rng.permutation(len(wide)):
        lower[name[n]], upper[name[n]] = wide.lower[n], wide.upper[n]
        if wide.child[n] >= 0:
            places = np.sort(rng.permutation(wide.width)[: wide.children[n]])
            children[name[n], places] = name[wide.child[n] + np.arange(wide.children[n])]
            continue
        first[name[n]], count[name[n]] = begin, wide.count[n]
        references[begin : begin + wide.count[n]] = wide.references[wide.first[n] :][
            : wide.count[n]
        ]
        begin += wide.count[n]
    return lower, upper, children, first, count, references, name[0]


@pytest.mark.parametrize("width", [4, 8])
def test_nodes_of_other_programs_in_any_order(width):
    triangles, tree = tree_of("sbvh")
    wide = collapse(tree, width)
    *arrays, root = shuffled(wide, 1)
    found = WideTree.from_nodes(*arrays, root=root, meta=wide.meta)
    assert found.validate(triangles) == []
    assert (found.width, len(found)) == (width, len(wide))
    np.testing.assert_array_equal(found.references, wide.references)
    assert mibvh.sah(found) == pytest.approx(mibvh.sah(wide), rel=1e-12)
    assert mibvh.epo(found, triangles) == pytest.approx(mibvh.epo(wide, triangles), rel=1e-12)


def test_boxes_of_wider_types_are_rounded_outwards():
    """As those of binary trees are: a box that is rounded to the nearest may lose its triangles."""
    triangles, tree = tree_of("sbvh")
    lower, upper, *arrays, root = shuffled(collapse(tree, 4), 1)
    tight = (
        np.nextafter(lower.astype(np.float64), -np.inf),
        np.nextafter(upper.astype(float), np.inf),
    )
    found = WideTree.from_nodes(*tight, *arrays, root=root)
    assert found.validate(triangles) == []
    assert (found.lower[0] < lower[root]).all()
    assert (found.upper[0] > upper[root]).all()


def test_nodes_that_are_no_tree_are_refused():
    _, tree = tree_of()
    lower, upper, children, first, count, references, root = shuffled(collapse(tree, 4), 1)

    def refused(match, **changes):
        arrays = {
            "lower": lower,
            "upper": upper,
            "children": children,
            "first": first,
            "count": count,
            "references": references,
            "root": root,
            **changes,
        }
        with pytest.raises(mibvh.MibvhError, match=match):
            WideTree.from_nodes(**arrays)

    leaf = int(np.flatnonzero((children == -1).all(axis=1))[0])
    refused(r"children need .* not float64", children=children.astype(float))
    refused("first is float32 .*not a row of whole numbers", first=lower)
    refused("count has 2 numbers for", count=count[:2])
    refused("a reference is negative, or does not fit", references=references + 2**32)
    refused("the root, -3, is none of the", root=-3)
    grown = children.copy()
    grown[root, :2] = [len(children), leaf]
    refused(f"node {root} has a child that is none of the nodes", children=grown)
    ring = children.copy()
    ring[root] = np.where(ring[root] == -1, root, ring[root])
    ring[root, np.flatnonzero(ring[root] >= 0)[-1]] = root
    refused(f"node {root} is reached twice", children=ring)
    lone = np.full_like(children, -1)
    lone[root, 2] = leaf
    refused(f"node {root} has one child only", children=lone)
    refused(f"node {leaf} is a leaf without references", root=leaf, count=count * 0)
    refused("is a leaf whose references are not all among", root=leaf, first=first * 0 - 1)


def test_the_order_of_children_is_the_priority():
    triangles, tree = tree_of("sbvh")
    wide = collapse(tree, 8)
    turned = wide.ordered(wide.half_areas)
    assert turned.validate(triangles) == []
    assert turned.meta["ordered"]
    for n in np.flatnonzero(turned.child >= 0):
        group = slice(turned.child[n], turned.child[n] + turned.children[n])
        assert (np.diff(turned.half_areas[group]) <= 0).all()
    assert (turned.first != wide.first).any()
    assert mibvh.sah(turned) == pytest.approx(mibvh.sah(wide), rel=1e-12)
    assert mibvh.epo(turned, triangles) == pytest.approx(mibvh.epo(wide, triangles), rel=1e-12)
    for bad in (np.ones(3), np.full(len(wide), np.nan)):
        with pytest.raises(mibvh.MibvhError, match=f"a priority needs {len(wide)} numbers"):
            wide.ordered(bad)


def test_files_and_repr(tmp_path):
    triangles, tree = tree_of("sbvh")
    wide = quantised(collapse(tree, 4))
    assert repr(wide) == (
        f"WideTree(sbvh, width 4, {len(wide):,} nodes, {len(wide.references)} references, "
        "8-bit boxes)"
    )
    wide.save(tmp_path / "wide.npz")
    back = WideTree.load(tmp_path / "wide.npz")
    for name in ("lower", "upper", "child", "children", "first", "count", "references"):
        np.testing.assert_array_equal(getattr(back, name), getattr(wide, name))
    assert (back.width, back.quantised, back.meta) == (4, True, wide.meta)
    assert mibvh.epo(back, triangles) == mibvh.epo(wide, triangles)
    copied = pickle.loads(pickle.dumps(back))
    assert mibvh.epo(copied, triangles) == mibvh.epo(wide, triangles)
    with pytest.raises(ValueError, match="read-only"):
        copied.lower[0] = 0
    wide.save(tmp_path / "keyed.npz", key="a")
    assert len(WideTree.load(tmp_path / "keyed.npz", key="a")) == len(wide)
    with pytest.raises(mibvh.MibvhError, match="its key differs"):
        WideTree.load(tmp_path / "keyed.npz", key="b")
    set_at(wide, "child", 0, 0).save(tmp_path / "unsound.npz")
    with pytest.raises(mibvh.MibvhError, match=r"unsound.npz: invalid wide tree: node 0"):
        WideTree.load(tmp_path / "unsound.npz")
    tree.save(tmp_path / "tree.npz")
    with pytest.raises(mibvh.MibvhError, match="not a wide tree file"):
        WideTree.load(tmp_path / "tree.npz")
    with pytest.raises(mibvh.MibvhError, match="not a tree file"):
        mibvh.Tree.load(tmp_path / "wide.npz")
    damaged = bytearray((tmp_path / "wide.npz").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (tmp_path / "wide.npz").write_bytes(damaged)
    with pytest.raises(mibvh.MibvhError, match="damaged"):
        WideTree.load(tmp_path / "wide.npz")


def test_stats():
    triangles, tree = tree_of("sbvh")
    wide = collapse(tree, 8)
    stats = wide.stats()
    assert stats["triangles"] == len(triangles)
    assert stats["leaves"] == tree.is_leaf.sum()
    assert stats["mean_children"] == pytest.approx((len(wide) - 1) / (~wide.is_leaf).sum())
    assert stats["depth"] < tree.depth
    assert wide.splits_triangles
    alone = collapse(mibvh.build(soup(1), "bbvh"), 8)
    assert (len(alone), alone.depth, alone.stats()["mean_children"]) == (1, 0, 0.0)
    assert alone.validate(soup(1)) == []


def set_at(tree, name, node, value):
    array = getattr(tree, name).copy()
    array[node] = value
    return tree.replace(**{name: array})


def leaf_of(tree, count):
    return np.flatnonzero(tree.is_leaf & (tree.count == count))[0]


def inner_of(tree):
    return np.flatnonzero(tree.children > 2)[1]


FAULTS = {
    "node {n} has 9 children, not 2 to 8": lambda t, n: set_at(t, "children", n, 9),
    "node {n} has 1 children, not 2 to 8": lambda t, n: set_at(t, "children", n, 1),
    "node {n} has children that do not stand behind it": lambda t, n: set_at(t, "child", n, n),
    "node {c} is the child of more than one node": lambda t, n: set_at(t, "child", n, n + 1),
    "node {nodes} is the child of no node": lambda t, n: t.replace(
        **{
            name: np.concatenate([getattr(t, name), getattr(t, name)[-1:]])
            for name in ("lower", "upper", "child", "children", "first", "count")
        }
    ),
    "node {n} has no references": lambda t, n: set_at(t, "count", n, -1),
    "node 0 has a range of references that": lambda t, n: set_at(t, "count", 0, 3),
    "node 2 has a box that is inverted, NaN or beyond 1e15": lambda t, n: set_at(
        t, "lower", 2, np.nan
    ),
    "node 3 has a box that sticks out of its parent's": lambda t, n: set_at(t, "upper", 3, 99),
    "node {n} is a leaf that has children": lambda t, n: set_at(t, "child", n, -1),
    "node {two} is a leaf that holds a triangle twice": lambda t, n: set_at(
        t, "references", t.first[leaf_of(t, 2)], t.references[t.first[leaf_of(t, 2)] + 1]
    ),
    "reference 7 is negative": lambda t, n: set_at(t, "references", 7, -1),
    "the width is 3, not one of 2, 4, 8": lambda t, n: t.replace(width=3),
    "lower is float64 ({nodes}, 3), not float32": lambda t, n: t.replace(
        lower=t.lower.astype(float)
    ),
    "count is int32 (1,), not int32 ({nodes},)": lambda t, n: t.replace(count=t.count[:1]),
    "1 of 300 triangles are in no leaf": lambda t, n: set_at(
        t, "references", t.first[leaf_of(t, 1)], t.references[t.first[leaf_of(t, 2)]]
    ),
    "1 references stick out of their leaves": lambda t, n: set_at(
        t, "upper", leaf_of(t, 1), t.lower[leaf_of(t, 1)]
    ),
}


@pytest.mark.parametrize("sentence", FAULTS)
def test_the_first_fault_in_one_sentence(sentence):
    triangles, tree = tree_of("bbvh")
    wide = collapse(tree, 8)
    n = inner_of(wide)
    found = FAULTS[sentence](wide, n).validate(triangles)
    assert len(found) == 1
    assert found[0].startswith(sentence.format(n=n, c=n + 1, two=leaf_of(wide, 2), nodes=len(wide)))
    assert wide.validate(triangles) == []


def test_figures_of_an_unsound_tree_are_refused():
    triangles, tree = tree_of("bbvh")
    broken = set_at(collapse(tree, 8), "children", 0, 2000)
    with pytest.raises(mibvh.MibvhError, match="invalid wide tree: node 0 has 2000 children"):
        mibvh.epo(broken, triangles)
    with pytest.raises(mibvh.MibvhError, match="built for another geometry"):
        mibvh.epo(collapse(tree, 8), soup(300, 4))


def test_a_chain_deeper_than_the_stack():
    depth = 65
    child = np.full(2 * depth + 1, -1, np.int32)
    child[[0, *range(1, 2 * depth - 1, 2)]] = range(1, 2 * depth, 2)
    children = np.where(child >= 0, 2, 0).astype(np.int32)
    count = np.ones(len(child), np.int32)
    first = np.zeros(len(child), np.int32)
    count[child >= 0] = np.arange(depth + 1, 1, -1)
    first[2::2] = np.arange(depth, 0, -1)
    tree = WideTree(
        np.zeros((len(child), 3), np.float32),
        np.ones((len(child), 3), np.float32),
        child,
        children,
        first,
        count,
        np.arange(depth + 1, dtype=np.int32),
        4,
    )
    assert tree.validate() == ["node 129 is deeper than the traversal stack of 64"]


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"width": 3}, "width is one of 2, 4, 8, not 3"),
        ({"method": "best"}, "by optimal or greedy, not 'best'"),
        ({"max_leaf": 0}, "max_leaf must be at least 1"),
        ({"max_leaf": 4, "method": "greedy"}, "the method optimal"),
        ({"c_box": -1.0}, "costs are not negative"),
        ({"weights": np.ones(3)}, "weights need"),
        ({"weights": np.full(115, np.nan)}, "weights need"),
    ],
)
def test_impossible_options(options, match):
    _, tree = tree_of()
    with pytest.raises(mibvh.MibvhError, match=match):
        collapse(tree, **options)


def test_wide_trees_are_drawn():
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    scene = mibvh.load("cornell@300")
    tree = mibvh.build(scene, "sbvh")
    wide = collapse(tree, 8)
    figure = mibvh.plot.overview(wide, scene, depth=2)
    assert f"{len(wide):,} nodes, {wide.depth} levels" in figure.get_suptitle()
    ax = mibvh.plot.by_depth([tree, wide], "epo", scene)
    assert [line.get_label().split(":")[0] for line in ax.lines] == ["sbvh", "sbvh, 8 wide"]
    assert ax.lines[1].get_ydata().sum() == pytest.approx(mibvh.epo(wide, scene))
    plt.close("all")


@pytest.mark.parametrize("width", [2, 4, 8])
def test_leaves_made_of_several_hold_each_triangle_once(width):
    """Parts of a split triangle that come into one leaf are one reference there."""
    triangles = soup(300, 4, size=0.4)
    tree = unfold(mibvh.build(triangles, "sbvh"), triangles)
    wide = mibvh.collapse(tree, width, max_leaf=16, c_inner=30.0)
    assert len(wide.references) < len(tree.references)
    assert wide.validate(triangles) == []
    for n in np.flatnonzero(wide.is_leaf):
        held = wide.references[wide.first[n] :][: wide.count[n]]
        assert len(set(held.tolist())) == len(held)


def test_a_users_wide_builder_that_makes_no_wide_tree_is_refused(monkeypatch):
    monkeypatch.setattr(registry, "_registered", registry._registered.copy())

    @mibvh.builder("mine", summary="forgets to return", wide=lambda triangles, options, width: None)
    def mine(triangles, options, context):
        return np.arange(len(triangles))

    with pytest.raises(mibvh.MibvhError, match="builder mine made a NoneType for a wide tree"):
        build_wide(soup(20), "mine", 4)
