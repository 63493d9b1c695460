"""Object File Format (OFF) of Geomview, with polygons, colours and normals."""

from __future__ import annotations

import re

import numpy as np

from mibvh.loading.mesh import Mesh, Refused, check_room, corners_of, numbers, whole
from mibvh.loading.polygons import triangulate
from mibvh.loading.text import decode

_HEADER = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF$")


def read(data: bytes) -> Mesh:
    """Read an OFF file.

    Raises
    ------
    Refused
        If it holds fewer or more rows than its header declares, or is one of the variants that
        are not read: binary, or of four or more dimensions.
    """
    text = decode(data)
    rows = [row for line in text.split("\n") if (row := line.partition("#")[0].strip())]
    if not rows:
        raise Refused("it is empty")
    word, *rest = rows.pop(0).split()
    header = _HEADER.match(word)
    if header is None:
        raise Refused("it does not begin with OFF")
    if "BINARY" in rest:
        raise Refused("binary OFF is not read; export it as text")
    if header.group(4) or header.group(5):
        raise Refused(f"{word} has more than three dimensions")
    if rest:  # the counts may stand behind the word
        rows.insert(0, " ".join(rest))
    vertices, faces = _counts(rows)
    check_room("vertices and faces", vertices + faces, 2, len(data))
    if len(rows) - 1 != vertices + faces:
        raise Refused(
            f"its header declares {vertices:,} vertices and {faces:,} faces, but it has "
            f"{len(rows) - 1:,} rows of them: cut short, or damaged"
        )
    points = numbers(rows[1 : 1 + vertices], (0, 1, 2))
    corners = [_corners(row) for row in rows[1 + vertices :]]
    sizes = np.array([len(c) for c in corners], dtype=np.int64)
    indices = np.array([i for c in corners for i in c], dtype=np.int64)
    triangles, notes = triangulate(points, indices, sizes)
    return Mesh(corners_of(points, triangles), notes)


def _counts(rows: list[str]) -> tuple[int, int]:
    """Vertices and faces that the header declares; edges are not looked at."""
    try:
        vertices, faces = (whole(word) for word in rows[0].split()[:2])
    except (IndexError, ValueError):
        raise Refused("its header has no numbers of vertices and faces") from None
    return vertices, faces


def _corners(row: str) -> list[int]:
    """A face's corners; its colour, which may follow, is not looked at."""
    words = row.split()
    try:
        size = whole(words[0])
        corners = [whole(word) for word in words[1 : 1 + max(size, 0)]]
    except ValueError:
        raise Refused(f"a face that is not whole numbers: {row[:40]!r}") from None
    if len(corners) != size:
        raise Refused(f"a face declares {size} corners but has {len(corners)}: cut short")
    return corners
