"""Mesh files of text: OBJ, OFF and STL. Right values are worked out by hand in the comments."""

from __future__ import annotations

import os
import struct

import numpy as np
import pytest

import mibvh

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
U = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 2 3 0\nv 2 1 0\nv 1 1 0\nv 1 3 0\nv 0 3 0\n"


@pytest.fixture
def load(tmp_path):
    """Write a file and load it: (triangles, area, notes)."""

    def write_and_load(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        scene = mibvh.load(path)
        return scene.triangles, scene.triangles.areas.sum(), " ".join(scene.notes)

    return write_and_load


@pytest.fixture
def refusal(tmp_path):
    """Write a file that is refused: the sentence, which names the file."""

    def write_and_fail(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(mibvh.MibvhError) as said:
            mibvh.load(path)
        text = str(said.value)
        assert text.startswith(f"{path}: ")
        assert "\n" not in text
        return text

    return write_and_fail


# ------------------------------------------------------------------ OBJ


def test_relative_indices_count_back_from_their_line(load):
    """Three unit squares at x = 0, 3 and 6, each right after its vertices."""
    body = "".join(
        f"v {x} 0 0\nv {x + 1} 0 0\nv {x + 1} 1 0\nv {x} 1 0\nf -4 -3 -2 -1\n" for x in (0, 3, 6)
    )
    triangles, area, _ = load("a.obj", body)
    assert len(triangles) == 6
    assert area == pytest.approx(3)
    np.testing.assert_array_equal(triangles.bounds, [[0, 0, 0], [7, 1, 0]])
    # In the order of the file: each pair of triangles is one square.
    np.testing.assert_array_equal(triangles.lower[:, 0], [0, 0, 3, 3, 6, 6])


@pytest.mark.parametrize("first", range(8))
def test_concave_polygons_keep_their_area(load, first):
    """A U of 3 x 3 less a notch of 1 x 2: 7, whichever corner it begins with."""
    corners = " ".join(str((first + i) % 8 + 1) for i in range(8))
    triangles, area, notes = load("u.obj", f"{U}f {corners}\n")
    assert area == pytest.approx(7)
    assert len(triangles) == 6
    assert notes == ""
    # No triangle reaches into the notch: 1 < x < 2, y > 1.
    center = triangles.corners.mean(axis=1)
    assert not ((center[:, 0] > 1) & (center[:, 0] < 2) & (center[:, 1] > 1)).any()


def test_a_concave_quad_is_cut_along_its_inner_diagonal(load):
    """A dart: the square of 4 x 4's lower right half (8) less (0,0) (4,4) (3,1): 4."""
    for turn in range(4):
        corners = " ".join(str((turn + i) % 4 + 1) for i in range(4))
        _, area, _ = load("dart.obj", f"v 0 0 0\nv 4 0 1\nv 4 4 2\nv 3 1 1\nf {corners}\n")
        # Tilted by z = y/4 + x/4 at all corners: areas grow by sqrt(1 + 2/16).
        assert area == pytest.approx(4 * np.sqrt(1 + 2 / 16))


def test_concave_polygons_in_any_plane(load):
    """The U, turned and scaled by 3: area 7 x 9."""
    turn = mibvh.rotation_about((1, 2, 3), 77) * 3
    points = np.array([line.split()[1:] for line in U.splitlines()], dtype=float) @ turn.T
    body = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    _, area, _ = load("u.obj", body + "f 1 2 3 4 5 6 7 8\n")
    assert area == pytest.approx(63, rel=1e-6)


def test_a_quad_that_is_not_flat_is_cut_from_its_first_corner(load):
    """Corners (0,0,0) (1,0,0) (1,1,1) (0,1,0): two triangles of area sqrt(2)/2 each."""
    _, area, _ = load("q.obj", "v 0 0 0\nv 1 0 0\nv 1 1 1\nv 0 1 0\nf 1 2 3 4\n")
    assert area == pytest.approx(np.sqrt(2))


def test_a_polygon_that_crosses_itself_is_named(load):
    _, _, notes = load("bow.obj", "v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n")
    assert "1 polygons cross themselves" in notes


@pytest.mark.parametrize(
    "faces",
    [
        "f 1//1 2//1 3//1 4//1\n",
        "f 1/1 2/2 3/3 4/4\n",
        "f 1/1/1 2/2/1 3/3/1 4/4/1\n",
        "f -4//-1 -3//-1 -2//-1 -1//-1\n",
        "f 1 2 \\\n 3 4\n",
        "f 1 2 \\\r\n 3 4\r\n",
        "fo 1 2 3 4\n",
        "\tf\t1  2\t3 4  # a square\n",
        "g a b\ns off\nusemtl x\nf 1 2 3\nf 1 3 4\n",
        "vt 0 0\nvn 0 0 1\nvp 0.5\nmtllib no.mtl\no q\nf 1 2 3 4",
        "# C:\\models\\\nf 1 2 3 4\n",
        "f 1 2 3 # from C:\\models\\\nf 1 3 4\n",
        "usemtl C:\\models\\\nf 1 2 3 4\n",
        "g a\\\ng b \\ \nf 1 2 3 4\n",
        "vt 0 \\\n0\nf 1 2 \\\n3 \\\n4\n",
        "f 1 2 3 4\\",
    ],
)
def test_ways_to_write_a_square(load, faces):
    triangles, area, notes = load("s.obj", SQUARE + faces)
    assert (len(triangles), area, notes) == (2, pytest.approx(1), "")


@pytest.mark.parametrize("behind", [" 1.0", " 2.5", " 0.1 0.2 0.3", " 255 0 0 # red"])
def test_weights_and_colours_behind_a_vertex_move_nothing(load, behind):
    body = SQUARE.replace("\n", f"{behind}\n") + "f 1 2 3 4\n"
    triangles, area, _ = load("s.obj", body)
    assert area == pytest.approx(1)
    np.testing.assert_array_equal(triangles.bounds, [[0, 0, 0], [1, 1, 0]])


def test_faces_may_stand_before_their_vertices(load):
    assert load("s.obj", "f 1 2 3 4\n" + SQUARE)[1] == pytest.approx(1)


def test_lines_and_points_are_counted(load):
    _, area, notes = load("s.obj", SQUARE + "f 1 2 3 4\nl 1 2 3\nl 2 3\np 1\n")
    assert area == pytest.approx(1)
    assert "2 lines were left out" in notes
    assert "1 points were left out" in notes


def test_lines_of_old_macs(load):
    assert load("s.obj", f"{SQUARE}f 1 2 3 4\n".replace("\n", "\r"))[1] == pytest.approx(1)


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-8-sig", "utf-16"])
def test_comments_in_any_encoding(load, encoding):
    body = f"# Größe\n{SQUARE}f 1 2 3\n".encode(encoding)
    triangles, area, _ = load("s.obj", body)
    assert (len(triangles), area) == (1, pytest.approx(0.5))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("cstype bezier\ndeg 3\nsurf 0 1 0 1 1 2 3 4\n", "free-form curves and surfaces (cstype)"),
        ("bzp 1 2 3 4\n", "free-form curves and surfaces (bzp)"),
        ("call other.obj\n", "calls another file"),
        (SQUARE + "f 1 2 5\n", "names vertex 5, but there are 4 vertices"),
        (SQUARE + "f 1 2 -5\n", "but there are 4 vertices"),
        ("v 0 0 0\nf -1 -2 -3\nv 1 0 0\nv 0 1 0\n", "but there are 3 vertices"),
        (SQUARE + "f 0 1 2\n", "names vertex 0, but OBJ counts from 1"),
        (SQUARE + "f a b c\n", "names vertex 'a', which is no whole number"),
        (SQUARE + "f 1 2 99999999999999999999\n", "which is no whole number"),
        (SQUARE + "f 1.5 2 3\n", "which is no whole number"),
        (SQUARE + "f 1 2 1_0\n", "names vertex '1_0', which is no whole number"),
        (f"\ufeff{SQUARE}f 1 2 \u0663\n", "names vertex '\u0663', which is no whole number"),
        (SQUARE.replace("1 0 0", "1_0 0 0") + "f 1 2 3\n", "a vertex that is not numbers"),
        ("v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a vertex that is not numbers"),
        ("v 0 0 x\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a vertex that is not numbers"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN, infinite or overlarge"),
        ("v 1e99 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "NaN, infinite or overlarge"),
        ("<html>\n", "line 1: '<html>' is no word of the OBJ format"),
        (SQUARE, "there is no triangle in it"),
        (SQUARE + "f 1 2\n", "there is no triangle in it (1 faces of fewer than three corners"),
        (SQUARE + "f 1 1 2\nf 3 3 3\n", "its 2 triangles all have no area"),
        ("", "there is no triangle in it"),
    ],
)
def test_obj_refusals(refusal, body, said):
    assert said in refusal("s.obj", body)


def test_triangles_that_single_precision_flattens_are_counted(load):
    """At five million the float32 grid is 0.5: a triangle of 0.1 falls into one point."""
    body = "v 5e6 0 0\nv 5000000.1 0 0\nv 5e6 0.1 0\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 4 5 6\n"
    _, area, notes = load("far.obj", body)
    assert area == pytest.approx(0.5)
    assert "1 triangles lose their area in single precision" in notes


# ------------------------------------------------------------------ OFF

OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize(
    "body",
    [
        OFF,
        OFF.replace("OFF\n4", "OFF 4"),
        "# made by hand\n" + OFF.replace("0 0 0\n1", "0 0 0 # a corner\n\n1"),
        "COFF\n4 1 0\n0 0 0 255 0 0 255\n1 0 0 0 0 0 1\n1 1 0 1 1 1 1\n0 1 0 1 1 1 1\n4 0 1 2 3\n",
        "NOFF\n4 1 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 1\n4 0 1 2 3\n",
        OFF.replace("3 0 1 2", "3 0 1 2 1.0 0.5 0.5"),
        OFF.replace("\n", "\r\n"),
        OFF.replace("\n", "\r"),
    ],
)
def test_off(load, body):
    triangles, area, _ = load("a.off", body)
    assert (len(triangles), area) == (2, pytest.approx(1))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (OFF.removesuffix("3 0 2 3\n"), "2 faces, but it has 5 rows"),
        (OFF.replace("4 2 0", "4 1 0"), "but it has 6 rows"),
        (OFF.removesuffix(" 3\n"), "declares 3 corners but has 2: cut short"),
        (OFF.replace("3 0 1 2", "3 0 1 9"), "names vertex 9"),
        (OFF.replace("3 0 1 2", "3 0 1 0_2"), "a face that is not whole numbers"),
        (OFF.replace("4 2 0", "0_4 2 0"), "no numbers of vertices and faces"),
        (OFF.replace("OFF", "4OFF"), "more than three dimensions"),
        (OFF.replace("OFF", "OFF BINARY"), "binary OFF is not read"),
        (OFF.replace("4 2 0", "4000000000 2 0"), "too few"),
        (OFF.replace("4 2 0", "-4 2 0"), "cut short, or damaged"),
        ("FOO\n", "does not begin with OFF"),
        ("", "it is empty"),
    ],
)
def test_off_refusals(refusal, body, said):
    assert said in refusal("a.off", body)


# ------------------------------------------------------------------ STL

FACET = (
    "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)


def binary_stl(corners, header=b"", count=None):
    rows = b"".join(np.r_[0, 0, 0, np.ravel(c)].astype("<f4").tobytes() + b"\0\0" for c in corners)
    return (
        header.ljust(80, b" ") + struct.pack("<I", len(corners) if count is None else count) + rows
    )


CORNERS = [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 2], [2, 0, 2], [0, 2, 2]]]  # 0.5 and 2


@pytest.mark.parametrize("header", [b"", b"solid made by a program that begins so"])
def test_binary_stl_whatever_its_first_word(load, header):
    triangles, area, _ = load("a.stl", binary_stl(CORNERS, header))
    assert (len(triangles), area) == (2, pytest.approx(2.5))


@pytest.mark.parametrize(
    "body",
    [
        f"solid a\n{FACET}{FACET}endsolid a\n",
        f"solid\n{FACET}endsolid\nsolid b\n{FACET}endsolid b\n",
        f"  SOLID A\r\n{(FACET * 2).upper()}ENDSOLID\r\n",
        f"solid a\n{FACET}{FACET}endsolid a\n".replace("\n", "\r"),
        f"\ufeffsolid a\n{FACET}{FACET}endsolid a\n",
    ],
)
def test_stl_of_text(load, body):
    triangles, area, _ = load("a.stl", body)
    assert (len(triangles), area) == (2, pytest.approx(1))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (binary_stl(CORNERS)[:-1], "declares 2 triangles, which take 184 bytes, but it has 183"),
        (binary_stl(CORNERS) + b"\0", "but it has 185"),
        (binary_stl(CORNERS, count=4_000_000_000), "declares 4,000,000,000 triangles"),
        (binary_stl([]), "there is no triangle in it"),
        (f"solid a\n{FACET}", "does not end"),
        (f"solid a\n{FACET}{FACET[:60]}", "does not end"),
        (f"solid a\n{FACET.replace('vertex 0 1 0', '')}endsolid a\n", "not three each"),
        (f"solid a\n{FACET.replace('vertex 0 1 0', 'vertex 0 1')}endsolid\n", "not numbers"),
        (b"hello", "neither a text"),
    ],
)
def test_stl_refusals(refusal, body, said):
    assert said in refusal("a.stl", body)


# ------------------------------------------------------------------ any file


@pytest.mark.parametrize("kind", ["zip", "gz", "xz", "dxf", "xyz"])
def test_packed_files_and_what_is_no_mesh_are_refused_by_name(refusal, kind):
    assert f".{kind} files are not read" in refusal(f"a.{kind}", b"PK\3\4")


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "off", "glb", "gltf", "xml"])
def test_a_pipe_is_not_waited_for(tmp_path, kind):
    path = tmp_path / f"pipe.{kind}"
    os.mkfifo(path)
    with pytest.raises(mibvh.MibvhError, match="is no regular file"):
        mibvh.load(path)


def test_a_mesh_whose_name_is_not_utf8(tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/gr\xf6sse.obj")
    with open(path, "w") as file:
        file.write(SQUARE + "f 1 2 3 4\n")
    scene = mibvh.load(path)
    assert scene.name == "gr\\xf6sse"
    assert scene.name.encode("utf-8")
    assert scene.triangles.areas.sum() == pytest.approx(1)


def test_a_name_cannot_write_on_the_terminal(tmp_path):
    path = tmp_path / "a\x1b[31mb\n.obj"
    path.write_text("nonsense")
    with pytest.raises(mibvh.MibvhError) as said:
        mibvh.load(path)
    assert "a\\x1b[31mb\\n.obj: " in str(said.value)


def test_formats_that_trimesh_reads_say_so(tmp_path, monkeypatch):
    """As with 3MF, where its packages are installed."""
    import trimesh

    def reader(file_obj, **_):
        return {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}

    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, "zzz", reader)
    (tmp_path / "a.zzz").write_text("x")
    scene = mibvh.load(tmp_path / "a.zzz")
    assert scene.triangles.areas.sum() == pytest.approx(0.5)
    assert "read by trimesh" in scene.notes[0]
