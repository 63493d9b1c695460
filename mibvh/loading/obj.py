"""Wavefront OBJ: vertices and polygons.

The format as Alias|Wavefront documented it (*Object Files (.obj)*, appendix B1 of the Advanced
Visualizer manual): relative indices count back from the line they stand on, a backslash goes on
with the next line, and a vertex may carry a weight or a colour after its position. Comments and
names end with their line, as in Mitsuba: many of them are paths that end in a backslash.
"""

from __future__ import annotations

import re

import numpy as np

from mibvh.loading.mesh import I64, Mesh, Refused, corners_of, numbers, whole
from mibvh.loading.polygons import triangulate
from mibvh.loading.text import decode

#: What says nothing of the surface: names, materials, smoothing, texture and parameter space.
_NOTHING = re.compile(
    "vt|vn|vp|g|o|s|mg|usemtl|mtllib|usemap|maplib|bevel|c_interp|d_interp|lod|shadow_obj|"
    "trace_obj|end|#.*|"
)
#: A line of numbers that goes on with the next.
_GOES_ON = re.compile(
    r"^(?![ \t]*(?:g|o|usemtl|mtllib|usemap|maplib|shadow_obj|trace_obj)[ \t])"
    r"([^#\n]*)\\[ \t]*(?:\n|\Z)",
    re.MULTILINE,
)
#: Free-form curves and surfaces, and their obsolete forms.
_FREE_FORM = re.compile(
    "cstype|deg|bmat|step|curv2?|surf|parm|trim|hole|scrv|sp|con|ctech|stech|bsp|bzp|cdc|cdp|res"
)


def read(data: bytes) -> Mesh:
    """Read the polygons of an OBJ file.

    Raises
    ------
    Refused
        If it has free-form surfaces, or lines that are none of the format's.
    """
    text = decode(data)
    if "\\" in text:
        text = _GOES_ON.sub(r"\1 ", text)
    positions: list[str] = []
    faces: list[str] = []
    seen: list[int] = []  # vertices above each face: what relative indices count back from
    lines = points = 0
    for number, line in enumerate(text.split("\n"), 1):
        word, _, rest = line.strip().replace("\t", " ").partition(" ")
        if word == "v":
            positions.append(rest)
        elif word in ("f", "fo"):
            faces.append(rest.partition("#")[0])
            seen.append(len(positions))
        elif word in ("l", "p"):
            lines += word == "l"
            points += word == "p"
        elif _FREE_FORM.fullmatch(word):
            raise Refused(
                f"line {number}: free-form curves and surfaces ({word}) are not triangles; "
                "export it as polygons"
            )
        elif word in ("call", "csh"):
            raise Refused(f"line {number}: calls another file ({word}), which is not followed")
        elif not _NOTHING.fullmatch(word):
            raise Refused(f"line {number}: {word[:20]!r} is no word of the OBJ format")
    vertices = numbers([p.partition("#")[0] for p in positions], (0, 1, 2))
    indices, sizes = _indices(faces, np.array(seen, dtype=np.int64))
    triangles, notes = triangulate(vertices, indices, sizes, first_is=1)
    for count, what in ((lines, "lines"), (points, "points")):
        if count:
            notes.append(f"{count:,} {what} were left out: they have no area")
    return Mesh(corners_of(vertices, triangles, first_is=1), notes)


def _indices(faces: list[str], seen: I64) -> tuple[I64, I64]:
    """Vertex indices from 0 of all faces in a row, and how many each has."""
    words = [face.split() for face in faces]
    sizes = np.array([len(w) for w in words], dtype=np.int64)
    named = [word.partition("/")[0] for face in words for word in face]
    try:
        indices = np.array([whole(word) for word in named], dtype=np.int64)
    except ValueError as error:
        bad = str(error)[:20]
        raise Refused(f"a face names vertex {bad!r}, which is no whole number") from None
    if (indices == 0).any():
        raise Refused("a face names vertex 0, but OBJ counts from 1")
    relative = np.repeat(seen, sizes) + indices
    return np.where(indices < 0, relative, indices - 1), sizes
