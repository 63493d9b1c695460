import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from conftest import closed_box, soup

import mibvh
from mibvh.metrics.points import weight_at
from mibvh.picture import picture

matplotlib.use("Agg")
from matplotlib import pyplot as plt


@pytest.fixture(autouse=True)
def _close_figures():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def triangles():
    return soup(400)


@pytest.fixture(scope="module")
def trees(triangles):
    return [mibvh.build(triangles, name) for name in ("bbvh", "sbvh", "lbvh")]


def test_import_leaves_matplotlib_out():
    code = "import sys, mibvh; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_by_depth(trees, triangles):
    totals = {
        "nodes": len,
        "leaves": lambda tree: tree.is_leaf.sum(),
        "sah": mibvh.sah,
        "epo": lambda tree: mibvh.epo(tree, triangles),
    }
    for quantity, total in totals.items():
        ax = mibvh.plot.by_depth(trees, quantity, triangles)
        for line, tree in zip(ax.lines, trees, strict=True):
            assert line.get_ydata().sum() == pytest.approx(total(tree))
            assert len(line.get_ydata()) == tree.depth + 1
            assert line.get_label().startswith(tree.meta["builder"])
    tree = trees[0]
    sizes = mibvh.plot.by_depth(tree, "leaf_size").lines[0].get_ydata()
    for depth, size in enumerate(sizes):
        at = tree.is_leaf & (tree.depths == depth)
        assert size == pytest.approx(tree.count[at].mean()) if at.any() else np.isnan(size)


def test_leaf_sizes(trees):
    ax = mibvh.plot.leaf_sizes(trees)
    for bars, tree in zip(ax.containers, trees, strict=True):
        heights = np.array([bar.get_height() for bar in bars])
        assert heights.sum() == pytest.approx(100)
        mean = (heights / 100 * np.arange(1, len(heights) + 1)).sum()
        assert mean == pytest.approx(tree.stats()["mean_leaf_size"])


def test_sah_epo(trees, triangles):
    fig, given = plt.subplots()
    ax = mibvh.plot.sah_epo(trees, triangles, ax=given)
    assert ax is given
    assert ax.figure is fig
    points = [tuple(line.get_xydata()[0]) for line in ax.lines if len(line.get_xydata()) == 1]
    assert points == [(mibvh.sah(tree), mibvh.epo(tree, triangles)) for tree in trees]


def test_predicted_measured():
    predicted, measured = {"a": 1.0, "b": 2.0, "c": 4.0}, {"c": 5.0, "a": 1.0, "b": 2.0}
    ax = mibvh.plot.predicted_measured(predicted, measured)
    r = np.corrcoef([1, 2, 4], [1, 2, 5])[0, 1]
    assert ax.get_title() == f"r = {r:.3f} over 3 trees"
    with pytest.raises(mibvh.MibvhError, match="d is predicted or measured"):
        mibvh.plot.predicted_measured({**predicted, "d": 1.0}, measured)


def holding(tree, points):
    """(P, M) bool: which closed boxes hold which points."""
    p = points[:, None]
    return ((p >= tree.lower) & (p <= tree.upper)).all(axis=2)


def test_weight_at(trees):
    points = np.random.default_rng(1).random((50, 3)) * [3, 1, 2]
    weights = np.random.default_rng(2).random(len(trees[0]))
    expected = holding(trees[0], points) @ weights
    np.testing.assert_allclose(weight_at(trees[0], points, weights), expected)


def test_slice_counts_boxes(trees, triangles):
    tree = trees[0]
    for quantity, chosen in (("nodes", np.ones(len(tree), bool)), ("leaves", tree.is_leaf)):
        image = mibvh.plot.overlap_slice(tree, triangles, quantity, axis="y", at=0.4).images[0]
        counts = np.ma.filled(image.get_array(), 0)
        left, right, bottom, top = image.get_extent()
        rng = np.random.default_rng(0)
        rows, columns = (rng.integers(0, n, 40) for n in counts.shape)
        x = left + (right - left) * (columns + 0.5) / counts.shape[1]
        z = bottom + (top - bottom) * (rows + 0.5) / counts.shape[0]
        held = holding(tree, np.stack([x, np.full(40, 0.4), z], axis=1))
        assert counts[rows, columns].tolist() == (held & chosen).sum(axis=1).tolist()
        assert counts.max() > 1


def test_slice_of_the_surfaces(trees, triangles):
    """Pieces lie on the triangles, and their colour is the cost of boxes of other triangles."""
    tree = trees[0]
    drawn = mibvh.plot.overlap_slice(tree, triangles, "foreign", axis="y", at=0.4).collections[0]
    pieces, cost = np.array(drawn.get_segments()), drawn.get_array()
    # Two corners above and one below, or the other way round; the length by a plainer formula.
    length = 0.0
    for corners in triangles.corners.astype(np.float64):
        cuts = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            p, q = corners[a], corners[b]
            if (p[1] >= 0.4) != (q[1] >= 0.4):
                cuts.append(p + (0.4 - p[1]) / (q[1] - p[1]) * (q - p))
        length += np.linalg.norm(cuts[0] - cuts[1]) if cuts else 0.0
    assert np.linalg.norm(pieces[:, 0] - pieces[:, 1], axis=1).sum() == pytest.approx(length)
    # The costliest piece: at most what all boxes there cost, less the path to its own leaf.
    middle = np.insert(pieces[-1].mean(axis=0), 1, 0.4)
    costs = np.where(tree.is_leaf, tree.count, 1.2)
    assert 0 < cost.max() == cost[-1] < holding(tree, middle[None])[0] @ costs
    # A partition of space has no overlap.
    apart = closed_box(0, 1, 1)[:2]
    apart = mibvh.Triangles(np.concatenate([apart, apart + np.float32(2)]))
    tree = mibvh.build(apart, "bbvh")
    drawn = mibvh.plot.overlap_slice(tree, apart, "foreign", axis="y", at=0.3).collections[0]
    assert drawn.get_array().max() == 0


def test_wireframe_hides_three_edges_of_a_cube():
    import mitsuba as mi

    scene = mibvh.load(closed_box())
    view = mi.ScalarTransform4f().look_at([3, 4, 5], [0.5, 0.5, 0.5], [0, 1, 0])
    scene.sensors = [mi.load_dict({"type": "perspective", "to_world": view})]
    tree = mibvh.build(scene, "bbvh")
    ax = mibvh.plot.wireframe(tree, scene, 0, width=64)
    lengths = [
        np.linalg.norm(np.diff(found.get_segments(), axis=1)[:, 0], axis=1)
        for found in ax.collections
    ]
    # Where a hidden edge meets a seen one, its last bit counts as seen.
    longest = np.concatenate(lengths).max()
    assert [int((length > 0.1 * longest).sum()) for length in lengths] == [3, 9]
    assert len(mibvh.plot.wireframe(tree, scene, 0, width=64, hidden=False).collections) == 1


def test_wireframe_is_where_mitsuba_sees_the_boxes(cornell):
    """A camera ray through an end of any line drawn passes an edge of the root's box."""
    import mitsuba as mi

    tree = mibvh.build(cornell, "bbvh")
    ax = mibvh.plot.wireframe(tree, cornell, 0, width=200)
    rows, columns = ax.images[0].get_array().shape
    ends = np.concatenate([found.get_segments() for found in ax.collections]).reshape(-1, 2)
    film = (ends + 0.5) / [columns, rows]
    assert len(film) > 4
    sensor = cornell.sensors[0]
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(film.T.astype(np.float32)), mi.Point2f(0.5))
    o, d = np.array(ray.o).T.astype(float), np.array(ray.d).T.astype(float)
    lower, upper = tree.lower[0].astype(float), tree.upper[0].astype(float)
    gap = np.full(len(d), np.inf)
    for axis in range(3):
        along = np.eye(3)[axis]
        for ends in np.ndindex(2, 2):
            corner = np.insert(
                np.where(ends, np.delete(upper, axis), np.delete(lower, axis)), axis, 0
            )
            across = np.cross(d, along)
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            gap = np.minimum(gap, np.abs(((corner - o) * across).sum(axis=1)))
    assert gap.max() < 1e-3 * cornell.triangles.diagonal


def test_wireframe_colours_by_value(cornell):
    tree = mibvh.build(cornell, "lbvh")
    values = mibvh.epo_per_node(tree, cornell)
    ax = mibvh.plot.wireframe(tree, cornell, 3, values=values, label="EPO", width=64)
    drawn = {float(v) for found in ax.collections for v in found.get_array()}
    cut = (tree.depths == 3) | (tree.is_leaf & (tree.depths < 3))
    assert drawn == set(values[cut].tolist())
    assert len(drawn) > 4
    assert ax.figure.axes[-1].get_ylabel() == "EPO"


def test_overview(cornell):
    figure = mibvh.plot.overview(mibvh.build(cornell, "bbvh"), cornell)
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    for title, said in zip(
        titles,
        ("boxes at depth", "that contain a point", "end-point", "leaves", "SAH by", "EPO by"),
        strict=True,
    ):
        assert said in title
    figure.canvas.draw()
    tree = mibvh.build(cornell, "bbvh")
    assert f"{len(cornell.triangles):,} triangles, {len(tree):,} nodes" in figure.get_suptitle()


def test_picture_keeps_the_film(cornell):
    size = list(cornell.sensors[0].film().size())
    for samples in (0, 1):
        pixels = picture(cornell, width=30, samples=samples)
        assert max(pixels.shape[:2]) == 30
        assert 0 <= pixels.min() < pixels.max() <= 1
    assert list(cornell.sensors[0].film().size()) == size


def test_a_room_that_its_light_does_not_get_into_is_lit_from_the_camera():
    import mitsuba as mi

    room = mibvh.load(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "sky": {"type": "constant"},
            "walls": {"type": "cube", "bsdf": {"type": "twosided", "b": {"type": "diffuse"}}},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at(
                    origin=[0, 0.1, 0.9], target=[0.2, 0, 0], up=[0, 1, 0]
                ),
            },
        }
    )
    assert np.array_equal(picture(room, width=20, samples=4), picture(room, width=20, samples=0))


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda plot, t, s: plot.by_depth(t, "width"), "by_depth draws nodes"),
        (lambda plot, t, s: plot.by_depth(t, "epo"), "EPO by depth needs the triangles"),
        (lambda plot, t, s: plot.by_depth([]), "no tree to draw"),
        (lambda plot, t, s: plot.by_depth([t, t]), "two of the trees are named bbvh"),
        (lambda plot, t, s: plot.leaf_sizes({"mine": 3}), "mine: is of type int, not a Tree"),
        (lambda plot, t, s: plot.overlap_slice(t, s, "trees"), "coloured by leaves"),
        (lambda plot, t, s: plot.overlap_slice(t, s, axis="w"), "is x, y or z, not 'w'"),
        (lambda plot, t, s: plot.overlap_slice(t, s, axis="x", at=1e9), "is outside cornell"),
        (lambda plot, t, s: plot.overlap_slice(t, soup(5)), "built for another geometry"),
        (lambda plot, t, s: plot.wireframe(t, s, -1), "must not be negative, not -1"),
        (lambda plot, t, s: plot.wireframe(t, s, viewpoint=99), "none of them number 99"),
    ],
)
def test_mistakes(cornell, draw, message):
    tree = mibvh.build(cornell, "bbvh")
    with pytest.raises(mibvh.MibvhError, match=message):
        draw(mibvh.plot, tree, cornell)


def test_wireframe_needs_a_perspective_camera():
    import mitsuba as mi

    scene = mibvh.load(closed_box())
    scene.sensors = [mi.load_dict({"type": "orthographic"})]
    with pytest.raises(mibvh.MibvhError, match="viewpoint 0 is no perspective camera"):
        mibvh.plot.wireframe(mibvh.build(scene), scene, width=32)
