import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import soup
from typer.testing import CliRunner

import mibvh
from mibvh.cli import app
from mibvh.layouts import LAYOUTS, get

ROOT = Path(__file__).parents[1]
ARRAYS = ("lower", "upper", "left", "first", "count", "references")


def equal(a, b):
    """Whether two trees are the same, numbers of nodes included."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ARRAYS)


def leaves(tree):
    """The leaves of a tree in any order: boxes and references."""
    return sorted(
        (
            tree.lower[n].tolist(),
            tree.upper[n].tolist(),
            tree.references[tree.first[n] : tree.first[n] + tree.count[n]].tolist(),
        )
        for n in np.flatnonzero(tree.is_leaf)
    )


@pytest.fixture(scope="module")
def split():
    triangles = mibvh.load("powerplant@1500").triangles
    return triangles, mibvh.build(triangles, "sbvh")


def shuffled(tree, seed=0, unused=5):
    """The arrays of a tree with nodes in random order, children apart, and unused nodes."""
    rng = np.random.default_rng(seed)
    total = len(tree) + unused
    at = rng.permutation(total)[: len(tree)]
    arrays = tree.to_arrays()
    out = {}
    for name in ("lower", "upper"):
        out[name] = np.full((total, 3), np.nan, np.float32)
        out[name][at] = arrays[name]
    for name in ("left", "right"):
        out[name] = np.full(total, -1, np.int32)
        out[name][at] = np.where(arrays[name] >= 0, at[arrays[name]], -1)
    for name in ("first", "count"):
        out[name] = np.full(total, -99, np.int32)
        leaf = tree.is_leaf
        out[name][at[leaf]] = arrays[name][leaf]
    return {**out, "references": arrays["references"], "root": int(at[0])}


@pytest.mark.parametrize("name", ["bbvh", "sbvh", "streelet", "lbvh"])
def test_nodes_in_any_order_become_the_same_tree(name, split):
    triangles, _ = split
    tree = mibvh.build(triangles, name)
    again = mibvh.Tree.from_arrays(**tree.to_arrays(), name=name)
    assert equal(again, tree)
    arrays = shuffled(tree)
    again = mibvh.Tree.from_arrays(**arrays)
    assert leaves(again) == leaves(tree)
    assert equal(again, tree)
    assert again.validate(triangles) == []
    assert mibvh.sah(again) == mibvh.sah(tree)
    assert mibvh.epo(again, triangles) == mibvh.epo(tree, triangles)


def test_ways_to_tell_leaves(small_soup):
    tree = mibvh.build(small_soup, "bbvh", max_leaf=1)
    a = tree.to_arrays()
    leaf = tree.is_leaf
    plain = {"lower": a["lower"], "upper": a["upper"]}
    order = tree.references
    # One triangle per leaf: its place in the references as a negative code, or the id itself.
    codes = np.where(leaf, ~a["first"], a["left"])
    assert equal(mibvh.Tree.from_arrays(**plain, left=codes, references=order), tree)
    by_id = np.where(leaf, ~order[a["first"]], a["left"])
    assert equal(mibvh.Tree.from_arrays(**plain, left=by_id), tree)
    unsigned = codes.astype(np.int32).view(np.uint32)
    assert equal(mibvh.Tree.from_arrays(**plain, left=unsigned, references=order), tree)
    # The first child or the first reference in one number, told apart by the count.
    tree = mibvh.build(small_soup, "bbvh")
    a, leaf = tree.to_arrays(), tree.is_leaf
    plain = {"lower": a["lower"], "upper": a["upper"], "references": tree.references}
    either, count = np.where(leaf, a["first"], a["left"]), np.where(leaf, a["count"], 0)
    assert equal(mibvh.Tree.from_arrays(**plain, left=either, count=count), tree)
    codes = np.where(leaf, ~a["first"], a["left"])
    assert equal(mibvh.Tree.from_arrays(**plain, left=codes, count=a["count"]), tree)


def test_the_root_may_be_the_last_node(small_soup):
    tree = mibvh.build(small_soup, "bbvh")
    a = tree.to_arrays()
    last = len(tree) - 1
    flipped = {name: a[name][::-1] for name in ("lower", "upper", "first", "count")}
    for name in ("left", "right"):
        flipped[name] = np.where(a[name] >= 0, last - a[name], -1)[::-1]
    assert equal(mibvh.Tree.from_arrays(**flipped, references=a["references"]), tree)


@pytest.mark.parametrize(
    ("root", "left", "said"),
    [(None, {0: 0}, "its own ancestor"), ("0", {}, "the number of a node, not '0'")],
)
def test_a_root_that_is_none_is_refused(small_soup, root, left, said):
    a = mibvh.build(small_soup, "bbvh").to_arrays()
    changed = a["left"].copy()
    changed[list(left)] = list(left.values())
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.Tree.from_arrays(**{**a, "left": changed}, root=root)


def test_wider_boxes_are_rounded_outwards(small_soup):
    tree = mibvh.build(small_soup, "bbvh")
    a = tree.to_arrays()
    inside = {**a, "lower": a["lower"] - 1e-12, "upper": a["upper"] + 1e-12}
    again = mibvh.Tree.from_arrays(**inside)
    assert (again.lower.astype(np.float64) <= inside["lower"]).all()
    assert (again.upper.astype(np.float64) >= inside["upper"]).all()
    assert (again.lower >= np.nextafter(tree.lower, np.float32(-np.inf))).all()
    assert again.validate(small_soup) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"left": {0: 99999}}, "node 0 has the children 99999 and 2"),
        ({"right": {0: -3}}, "and -3, which are not among"),
        ({"right": {0: 1}}, "node 1 is reached twice"),
        ({"left": {1: 0}}, "its own ancestor"),
        ({"count": {"leaf": 0}}, "has no references"),
        ({"first": {"leaf": 10**6}}, "there are 60"),
        ({"first": {"leaf": 2**40}}, "there are 60"),
        ({"count": {"leaf": 40}}, "have more references than there are|there are 60"),
        ({"references": {0: -1}}, "a reference is negative"),
        ({"references": {0: 2**33}}, "does not fit into 31 bits"),
        ({"references": {0: 1}}, "triangles"),
        ({"upper": {(1, 0): np.nan}}, "inverted or NaN"),
        ({"left": np.zeros(3)}, "not a row of whole numbers"),
        ({"left": []}, "not a row of whole numbers"),
        ({"right": np.zeros(3, int)}, "right has 3 numbers"),
        ({"lower": np.zeros((3, 3))}, "lower is float64"),
        ({"lower": np.zeros(3, int)}, "lower is int64"),
        ({"count": None}, "first needs count"),
        ({"root": 1000}, "the root, 1000, is not among"),
    ],
)
def test_what_is_no_tree(small_soup, change, said):
    tree = mibvh.build(small_soup, "bbvh")
    arrays = {
        name: array.astype(np.int64) if array.dtype.kind == "i" else array.copy()
        for name, array in tree.to_arrays().items()
    }
    leaf = int(np.flatnonzero(tree.is_leaf)[0])
    for name, values in change.items():
        if isinstance(values, dict):
            for index, value in values.items():
                arrays[name][leaf if index == "leaf" else index] = value
        else:
            arrays[name] = values
    with pytest.raises(mibvh.MibvhError, match=said) as error:
        mibvh.Tree.from_arrays(**arrays).check_matches(small_soup)
    assert "\n" not in str(error.value)


def test_a_split_triangle_that_is_not_covered_is_refused(split):
    triangles, tree = split
    arrays = tree.to_arrays()
    twice = np.flatnonzero(np.bincount(tree.references) > 1)
    n = next(
        n
        for n in np.flatnonzero(tree.is_leaf)
        if np.isin(tree.references[tree.first[n] : tree.first[n] + tree.count[n]], twice).all()
    )
    lower = arrays["lower"].copy()
    lower[n] = arrays["upper"][n]
    gap = mibvh.Tree.from_arrays(**{**arrays, "lower": lower})
    with pytest.raises(mibvh.MibvhError, match="split triangles are not covered"):
        gap.check_matches(triangles)


@pytest.mark.parametrize("layout", [name for name in LAYOUTS if not name.startswith("mbvh")])
def test_out_and_in_again(layout, split, tmp_path):
    _, tree = split
    path = tmp_path / "tree"
    mibvh.write_tree(tree, path, layout)
    again = mibvh.read_tree(path, layout, name="mine")
    assert equal(again, tree)
    if layout != "npz":
        assert repr(again).startswith("Tree('mine', 1,")
        with pytest.raises(mibvh.MibvhError, match="tree: "):
            mibvh.read_tree(path, layout="npz")
    one = mibvh.build(soup(3), "bbvh", c_inner=100.0)
    assert len(one) == 1
    mibvh.write_tree(one, path, layout)
    assert equal(mibvh.read_tree(path, layout), one)


@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_damaged_files_of_others(layout, small_soup, tmp_path):
    """Never anything but a sentence, or the tree."""
    width = getattr(get(layout), "width", 2)
    tree = mibvh.build(small_soup, "bbvh")
    path = tmp_path / "tree"
    mibvh.write_tree(tree if width == 2 else mibvh.collapse(tree, width), path, layout)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for case in range(600):
        data = bytearray(whole)
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(data)))
            match case % 4:
                case 0:
                    data[at] ^= 1 << int(rng.integers(8))
                case 1:
                    data[at : at + 4] = int(rng.choice([0, 1, 2**31, 2**32 - 1])).to_bytes(
                        4, "little"
                    )
                case 2:
                    del data[at : at + int(rng.integers(1, 50))]
                case _:
                    data[at:at] = rng.bytes(int(rng.integers(1, 50)))
            if not data:
                break
        path.write_bytes(data)
        try:
            mibvh.epo(mibvh.read_tree(path, layout), small_soup)
        except mibvh.MibvhError:
            refused += 1
    assert refused > 300


def test_refusals(small_soup, tmp_path):
    tree = mibvh.build(small_soup, "bbvh")
    with pytest.raises(mibvh.MibvhError, match="there is no layout 'x'; there are: mibvh, tinybvh"):
        mibvh.read_tree(tmp_path / "t", "x")
    with pytest.raises(mibvh.MibvhError, match="there is no such file"):
        mibvh.read_tree(tmp_path / "t", "tinybvh")
    (tmp_path / "t").write_bytes(b"")
    with pytest.raises(mibvh.MibvhError, match="does not begin with MIBVH"):
        mibvh.read_tree(tmp_path / "t")
    big = mibvh.build(np.repeat(small_soup.corners[:1], 20, axis=0), "bbvh", max_leaf=20)
    with pytest.raises(mibvh.MibvhError, match="a leaf has 20 triangles; madmann91"):
        mibvh.write_tree(big, tmp_path / "t", "madmann91")
    with pytest.raises(mibvh.MibvhError, match="cannot be written"):
        mibvh.write_tree(tree, tmp_path / "absent" / "t", "tinybvh")


@pytest.mark.parametrize(("written", "asked"), [("mibvh", "tinybvh"), ("npz", "mibvh")])
def test_files_of_another_layout_are_recognised(written, asked, small_soup, tmp_path):
    path = tmp_path / "t.bin"
    mibvh.write_tree(mibvh.build(small_soup, "bbvh"), path, written)
    with pytest.raises(mibvh.MibvhError, match=rf"begins like a file of the layout {written}\)$"):
        mibvh.read_tree(path, asked)


def compiled(folder, source):
    """Compile a program with g++ alone."""
    compiler = shutil.which("g++")
    assert compiler, "this test needs g++"
    options = ["-std=c++11", "-O1", "-Wall", "-Werror"]
    subprocess.run([compiler, *options, "-o", folder / "program", ROOT / source], check=True)
    return folder / "program"


def run(*words):
    """Run a command of mibvh; return what it prints as JSON."""
    result = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_the_example_in_cpp(tmp_path, cornell):
    """A program's own BVH: dumped, imported, measured; its SAH to six digits."""
    program = compiled(tmp_path, "docs/examples/median_bvh.cpp")
    told = run("triangles", "cornell@3000", "-o", tmp_path / "triangles")
    assert told["digest"] == cornell.triangles.digest
    ran = subprocess.run(
        [program, tmp_path / "triangles", tmp_path / "tree"],
        capture_output=True,
        text=True,
        check=True,
    )
    nodes, sah = ran.stdout.replace("nodes, SAH", "").split()
    found = run("import", tmp_path / "tree", "-o", tmp_path / "tree.npz", "--scene", "cornell@3000")
    assert found["nodes"] == int(nodes)
    assert found["triangles"] == len(cornell.triangles)
    assert found["sah"] == pytest.approx(float(sah), rel=5e-7)
    measured = run("metrics", "cornell@3000", tmp_path / "tree.npz")
    assert measured["sah"] == found["sah"]
    assert measured["epo"] > 0
    run(
        "rays",
        "cornell@3000",
        "--width",
        16,
        "--height",
        12,
        "--samples",
        1,
        "-o",
        tmp_path / "r.npz",
    )
    traced = run("trace", "cornell@3000", tmp_path / "tree.npz", tmp_path / "r.npz", "--repeats", 1)
    own = mibvh.trace(
        mibvh.build(cornell, "bbvh"), cornell, mibvh.RaySet.load(tmp_path / "r.npz"), repeats=1
    )
    assert traced["hits"] == int((own.triangle >= 0).sum())


@pytest.mark.parametrize("scene", ["cornell@3000", "hairball@2000"])
def test_dumps_of_other_programs(tmp_path, scene):
    program = compiled(tmp_path, "tests/programs/dump_tree.cpp")
    triangles = mibvh.load(scene).triangles
    (tmp_path / "triangles").write_bytes(triangles.corners.tobytes())
    trees = {}
    for dump in (
        "tinybvh",
        "tinybvh-save",
        "madmann91",
        "madmann91-double",
        "madmann91-old",
        "madmann91-old-double",
    ):
        path = tmp_path / dump
        ran = subprocess.run(
            [program, tmp_path / "triangles", dump, path],
            capture_output=True,
            text=True,
            check=True,
        )
        tree = trees[dump] = mibvh.read_tree(path, dump.partition("-")[0])
        tree.check_matches(triangles)
        assert mibvh.sah(tree) == pytest.approx(float(ran.stdout), rel=5e-7)
        assert leaves(tree) == leaves(trees["tinybvh"])
        assert equal(tree, trees["tinybvh"])


def dump_of_mbvh(tree, width):
    """A dump of tinybvh's MBVH, byte by byte as its source has it, and the SAH of what is dumped.

    Like there, each node of the binary tree has its place, node 1 is nobody's, and where a node
    took its grandchildren, their parent stays behind unreached.
    """
    half = tree.half_areas
    place = np.arange(len(tree)) + (np.arange(len(tree)) > 0)
    data = bytearray((len(tree) + 1) * (48 + 4 * width))
    sah = 0.0
    waiting = [0]
    for n in range(len(tree)):  # all, also those that nothing will reach
        struct.pack_into("<3f", data, int(place[n]) * (48 + 4 * width), *tree.lower[n])
        struct.pack_into("<3f", data, int(place[n]) * (48 + 4 * width) + 16, *tree.upper[n])
    while waiting:
        n = waiting.pop()
        at = int(place[n]) * (48 + 4 * width)
        if tree.left[n] < 0:
            struct.pack_into("<I", data, at + 12, tree.first[n])
            struct.pack_into("<I", data, at + 28, tree.count[n])
            sah += half[n] / half[0] * tree.count[n]
            continue
        children = [int(tree.left[n]), int(tree.left[n]) + 1]
        while len(children) < width:
            inner = [c for c in children if tree.left[c] >= 0]
            if not inner:
                break
            largest = max(inner, key=lambda c: half[c])
            children.remove(largest)
            children += [int(tree.left[largest]), int(tree.left[largest]) + 1]
        struct.pack_into(f"<{len(children)}I", data, at + 32, *place[children])
        struct.pack_into("<I", data, at + 32 + 4 * width, len(children))
        sah += half[n] / half[0] * (1.2 + 0.2 * (len(children) - 2))
        waiting += children
    sizes = struct.pack("<2I", len(tree) + 1, len(tree.references))
    ids = struct.pack(f"<{len(tree.references)}I", *tree.references)
    return sizes + data + ids, sah


@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize("builder", ["bbvh", "sbvh"])
@pytest.mark.parametrize("scene", ["powerplant@1500", "hairball@1000"])
def test_wide_dumps_of_tinybvh(tmp_path, scene, builder, width):
    triangles = mibvh.load(scene).triangles
    tree = mibvh.build(triangles, builder)
    data, sah = dump_of_mbvh(tree, width)
    (tmp_path / "dump").write_bytes(data)
    found = run(
        "import",
        tmp_path / "dump",
        "--layout",
        f"mbvh{width}",
        "-o",
        tmp_path / "w.npz",
        "--scene",
        scene,
        "--name",
        "theirs",
    )
    wide = mibvh.read_tree(tmp_path / "w.npz")
    assert isinstance(wide, mibvh.WideTree)
    assert wide.width == wide.children.max() == width
    assert wide.validate(triangles) == []
    assert leaves(wide) == leaves(tree)
    assert found["builder"] == wide.meta["builder"] == "theirs"
    assert found["sah"] == mibvh.sah(wide) == pytest.approx(sah, rel=5e-7)
    assert run("metrics", scene, tmp_path / "w.npz")["epo"] == mibvh.epo(wide, triangles) > 0
    mibvh.write_tree(wide, tmp_path / "again", f"mbvh{width}")
    again = mibvh.read_tree(tmp_path / "again", f"mbvh{width}")
    for name in ("lower", "upper", "child", "children", "first", "count", "references"):
        np.testing.assert_array_equal(getattr(again, name), getattr(wide, name))


def test_wide_dumps_that_are_refused(tmp_path, small_soup):
    data, _ = dump_of_mbvh(mibvh.build(small_soup, "bbvh"), 4)
    path = tmp_path / "dump"
    for damaged, said in (
        (data[:4], "is too short for a tree of tinybvh's MBVH<4>"),
        (data[:-1], r"has \d+ bytes, and \d+ nodes and 60 ids of tinybvh's MBVH<4> take"),
        (data[:56] + b"\x09\0\0\0" + data[60:], "node 0 has 9 children, more than 4"),
        (data[:40] + b"\xff\xff\0\0" + data[44:], "node 0 has a child that is none of the nodes"),
        (data[:40] + b"\0\0\0\0" + data[44:], "node 0 is reached twice"),
        (data[:-4] + b"\xff\xff\xff\xff", "a reference is negative"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(mibvh.MibvhError, match=f"dump: .*{said}"):
            mibvh.read_tree(path, "mbvh4").check_matches(small_soup)
    path.write_bytes(data)
    wide = mibvh.read_tree(path, "mbvh4")
    with pytest.raises(mibvh.MibvhError, match="layout mbvh8 is for trees of 8 children per node"):
        mibvh.write_tree(wide, path, "mbvh8")
    with pytest.raises(mibvh.MibvhError, match="layout tinybvh is for trees of 2 children"):
        mibvh.write_tree(wide, path, "tinybvh")
    wide.save(tmp_path / "wide.npz")
    for refused in (
        lambda: mibvh.study(small_soup, tmp_path / "out", trees={"w": tmp_path / "wide.npz"}),
        lambda: mibvh.compare(small_soup, tmp_path / "wide.npz", "bbvh"),
    ):
        with pytest.raises(mibvh.MibvhError, match="has up to 4 children per node; only binary"):
            refused()
    with pytest.raises(mibvh.MibvhError, match="is a wide tree file, not a tree file"):
        mibvh.Tree.load(tmp_path / "wide.npz")


def test_reprs(split, small_soup):
    _, tree = split
    assert len(repr(tree)) < 100
    assert repr(mibvh.build(small_soup, "lbvh")).startswith("Tree('lbvh', 60 triangles, ")
    assert "references" in repr(tree)
    assert repr(tree.replace(left=np.zeros_like(tree.left))) == "Tree('sbvh', invalid)"
    shown = tree.replace(meta={**tree.meta, "builder": "<b>"})._repr_html_()
    assert shown.startswith("<table>")
    assert "&lt;b&gt;" in shown
    assert f"<td style='text-align:right'>{len(tree):,}</td>" in shown
    assert repr(small_soup) == "Triangles('soup60', 60 triangles)"
    assert repr(mibvh.load("powerplant@1500")).startswith("Scene('powerplant")
