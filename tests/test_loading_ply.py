"""PLY files: areas worked out by hand, and what the header declares."""

from __future__ import annotations

import itertools
import re
import struct

import numpy as np
import pytest

import mibvh

#: A triangle (0.5), a unit square (1) and a house: a unit square with a roof of height 1 (1.5).
POINTS = [
    (0, 0, 0),
    (1, 0, 0),
    (0, 1, 0),
    (2, 0, 0),
    (3, 0, 0),
    (3, 1, 0),
    (2, 1, 0),
    (4, 0, 0),
    (5, 0, 0),
    (5, 1, 0),
    (4.5, 2, 0),
    (4, 1, 0),
]
FACES = [(0, 1, 2), (3, 4, 5, 6), (7, 8, 9, 10, 11)]
U = [(0, 0, 0), (3, 0, 0), (3, 3, 0), (2, 3, 0), (2, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0)]
_CODES = {
    "uchar": "B",
    "char": "b",
    "ushort": "H",
    "short": "h",
    "int": "i",
    "uint": "I",
    "int32": "i",
    "uint8": "B",
    "float": "f",
    "double": "d",
}


def ply(
    points,
    faces,
    form="binary_little_endian",
    length="uchar",
    index="int",
    real="float",
    name="vertex_indices",
    before=(),
    after=(),
):
    """Write a PLY file by its specification; ``before`` and ``after``: properties of a face."""
    header = [
        "ply",
        f"format {form} 1.0",
        "comment by hand",
        f"element vertex {len(points)}",
        *(f"property {real} {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        *(f"property {kind} p{i}" for i, kind in enumerate(before)),
        f"property list {length} {index} {name}",
        *(f"property {kind} q{i}" for i, kind in enumerate(after)),
        "end_header",
        "",
    ]
    head = "\n".join(header).encode()
    if form == "ascii":
        rows = [" ".join(map(repr, map(float, p))) for p in points]
        for face in faces:
            words = [*(7 for _ in before), len(face), *face, *(9 for _ in after)]
            rows.append(" ".join(map(str, words)))
        return head + "\n".join(rows).encode() + b"\n"
    order = "<" if "little" in form else ">"
    body = b"".join(struct.pack(order + 3 * _CODES[real], *p) for p in points)
    for face in faces:
        body += b"".join(struct.pack(order + _CODES[kind], 7) for kind in before)
        body += struct.pack(f"{order}{_CODES[length]}", len(face))
        body += struct.pack(f"{order}{len(face)}{_CODES[index]}", *face)
        body += b"".join(struct.pack(order + _CODES[kind], 9) for kind in after)
    return head + body


@pytest.fixture
def load(tmp_path):
    def write_and_load(content):
        (tmp_path / "a.ply").write_bytes(content)
        return mibvh.load(tmp_path / "a.ply")

    return write_and_load


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extra", [((), ()), (("float",), ("uchar", "short"))])
def test_polygons_of_mixed_sizes(load, form, extra):
    scene = load(ply(POINTS, FACES, form, before=extra[0], after=extra[1]))
    assert len(scene.triangles) == 1 + 2 + 3
    assert scene.triangles.areas.sum() == pytest.approx(0.5 + 1 + 1.5)
    np.testing.assert_array_equal(scene.triangles.bounds, [[0, 0, 0], [5, 2, 0]])
    # In the order of the file.
    np.testing.assert_array_equal(scene.triangles.lower[:, 0] // 2, [0, 1, 1, 2, 2, 2])


@pytest.mark.parametrize(
    ("form", "length", "index", "real", "name"),
    [
        *itertools.product(
            ["binary_little_endian", "binary_big_endian"],
            ["uchar", "int"],
            ["uchar", "ushort", "short", "uint", "int32"],
            ["float", "double"],
            ["vertex_index"],
        ),
        ("ascii", "uint8", "int32", "double", "vertex_indices"),
    ],
)
def test_types_of_numbers(load, form, length, index, real, name):
    """Two triangles of one square, all faces alike: the fast path."""
    scene = load(ply(POINTS, [(3, 4, 5), (3, 5, 6)], form, length, index, real, name))
    assert scene.triangles.areas.tolist() == [0.5, 0.5]
    np.testing.assert_array_equal(scene.triangles.bounds, [[2, 0, 0], [3, 1, 0]])


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_concave_polygons_keep_their_area(load, form):
    """The U of 3 x 3 less a notch of 1 x 2."""
    assert load(ply(U, [tuple(range(8))], form)).triangles.areas.sum() == pytest.approx(7)


def test_strips(load):
    """A strip over five corners of a zigzag, an end, and a strip of one triangle: 4 x 0.5."""
    head = (
        "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    points = "0 0 0\n0 1 0\n1 0 0\n1 1 0\n2 0 0\n2 1 0\n"
    scene = load((head + points + "9 0 1 2 3 4 -1 3 4 5\n").encode())
    assert len(scene.triangles) == 4
    assert scene.triangles.areas.sum() == pytest.approx(2)


def test_strips_beside_faces(load):
    """The triangle of the first face, then the unit square as a strip."""
    head = TEXT[: TEXT.index(b"element face")].decode()
    rows = TEXT[TEXT.index(b"end_header\n") :].decode().split("\n")[1 : 1 + len(POINTS)]
    head += "element face 1\nproperty list int int vertex_indices\n"
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    scene = load((head + "\n".join([*rows, "3 0 1 2", "4 3 4 6 5", ""])).encode())
    assert scene.triangles.areas.tolist() == [0.5, 0.5, 0.5]
    np.testing.assert_array_equal(scene.triangles.lower[:, 0], [0, 2, 2])


def test_lines_of_old_macs(load):
    assert load(TEXT.replace(b"\n", b"\r")).triangles.areas.sum() == pytest.approx(3)
    end = WHOLE.index(b"end_header") + len(b"end_header\n")
    binary = WHOLE[:end].replace(b"\n", b"\r") + WHOLE[end:]
    assert load(binary).triangles.areas.sum() == pytest.approx(3)


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
def test_indices_of_any_kind_of_numbers(load, form):
    """Whole numbers in float32 are indices; anything else is none."""
    assert load(ply(POINTS, [(3, 4, 5, 6)], form, index="float")).triangles.areas.sum() == 1
    for wrong, said in ((1.5, "1.5"), (float("nan"), "nan"), (1e30, "1e+30"), (-1e30, "-1e+30")):
        with pytest.raises(mibvh.MibvhError, match=f"names vertex {re.escape(said)}, which is no"):
            load(ply(POINTS, [(3, 4, wrong)], form, index="float"))
    with pytest.raises(mibvh.MibvhError, match=r"names vertex 1\.5, which is no index"):
        load(ply(POINTS, [(3, 4, 1.5)], "ascii"))


def test_edges_beside_faces_are_not_taken_for_them(load):
    content = ply(POINTS, FACES, "ascii").replace(
        b"end_header", b"element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header"
    )
    assert load(content + b"0 1\n").triangles.areas.sum() == pytest.approx(3)


WHOLE = ply(POINTS, FACES)
TEXT = ply(POINTS, FACES, "ascii")
TWO_LISTS = ply(POINTS, [(0, 1, 2)], "ascii").replace(
    b"vertex_indices", b"vertex_index\nproperty list uchar int vertex_indices"
)
TWO_LISTS = TWO_LISTS.replace(b"3 0 1 2\n", b"3 0 1 2 3 3 4 5\n")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (WHOLE[:-1], "declares 3 rows of 'face', but it has fewer: cut short"),
        (ply(POINTS, [(0, 1, 2), (3, 4, 5)])[:-1], "cut short"),
        (TEXT[:-12], "a row of 'face' is not what is declared"),
        (TEXT[: TEXT.rindex(b"5 7")], "declares 3 rows of 'face', but it has fewer"),
        (TEXT + b"3 0 1 2\n", "1 rows more than its header declares"),
        (TEXT.replace(b"3 0 1 2\n", b"3 0 1 2 5\n"), "is not what is declared"),
        (TEXT.replace(b"3 0 1 2\n", b"3 0 1 99\n"), "names vertex 99, but there are 12 vertices"),
        (TEXT.replace(b"3 0 1 2\n", b"3 0 1 -1\n"), "names vertex -1"),
        (TEXT.replace(b"0.0 0.0 0.0", b"0.0 zero 0.0", 1), "a vertex that is not numbers"),
        (TEXT.replace(b"element face 3", b"element face 0"), "rows more"),
        (ply(POINTS, []), "there are no faces in it (12 of 'vertex', 0 of 'face')"),
        (WHOLE.replace(b"vertex 12", b"vertex 4000000000"), "for which its"),
        (WHOLE.replace(b"face 3", b"face 4000000000"), "for which its"),
        (TEXT.replace(b"face 3", b"face 4000000000"), "for which its"),
        (WHOLE.replace(b"float x", b"float u"), "have no x, y and z"),
        (WHOLE.replace(b"float x", b"real x"), "a line that says nothing: 'property real x'"),
        (WHOLE.replace(b"binary_little_endian 1.0", b"binary 1.0"), "says nothing"),
        (WHOLE.replace(b"list uchar", b"list float"), "a list of unknown type"),
        (ply(POINTS, [(0, 1, 2)], length="uint")[:-16] + b"\xff" * 16, "has fewer: cut short"),
        (WHOLE.replace(b"float y", b"float x"), "two properties of 'vertex' of the name 'x'"),
        (WHOLE.replace(b"element face", b"element vertex"), "two elements of the name 'vertex'"),
        (TWO_LISTS, "its 'face' has two lists of vertices; keep one"),
        (TEXT.replace(b"3 0 1 2\n", b"3 0 1 0_2\n"), "is not what is declared"),
        (b"ply\nformat ascii 1.0\n", "its header does not end"),
        (b"PLY\n", "does not begin with 'ply'"),
        (ply(POINTS, [(0, 0, 1)]), "its 1 triangles all have no area"),
    ],
)
def test_refusals(tmp_path, content, said):
    path = tmp_path / "a.ply"
    path.write_bytes(content)
    with pytest.raises(mibvh.MibvhError) as found:
        mibvh.load(path)
    assert str(found.value).startswith(f"{path}: ")
    assert said in str(found.value)


def test_points_alone_are_no_scene(tmp_path):
    path = tmp_path / "points.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n"
    )
    with pytest.raises(mibvh.MibvhError, match="there are no faces in it"):
        mibvh.load(path)


def test_bytes_after_the_end_are_named(load):
    assert "100 bytes after" in load(WHOLE + b"\0" * 100).notes[0]
    assert load(WHOLE + b"\n").notes == []
