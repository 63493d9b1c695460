"""What a mesh file gives, and the checks that all formats share."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.memory import require_memory
from mibvh.triangles import F64

I64 = npt.NDArray[np.int64]
#: What no index or count is longer than.
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}").fullmatch


class Refused(Exception):
    """A file that cannot be read rightly; the message says why, without the file's name."""


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles as a file has them.

    Attributes
    ----------
    corners : (N, 3, 3) float64
        Triangle, corner, xyz.
    notes : list of str
        What was left out or done on the way, in sentences.
    """

    corners: F64
    notes: list[str] = dataclasses.field(default_factory=list)


def corners_of(vertices: F64, faces: I64, first_is: int = 0) -> F64:
    """(N, 3, 3) float64: look up the corners of faces.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (N, 3) int64
    first_is : int
        What the file calls its first vertex, for messages.

    Raises
    ------
    Refused
        If an index names no vertex.
    """
    check_indices(faces, len(vertices), first_is)
    return vertices[faces]


def check_indices(indices: I64, vertices: int, first_is: int = 0) -> None:
    """Refuse indices that name no vertex."""
    bad = (indices < 0) | (indices >= vertices)
    if bad.any():
        index = int(indices[bad][0]) + first_is
        raise Refused(f"a face names vertex {index}, but there are {vertices:,} vertices")


def check_room(what: str, count: int, bytes_each: float, bytes_there: int) -> None:
    """Refuse a count that a file of this size cannot hold, before memory is asked for."""
    if count < 0 or count * bytes_each > bytes_there:
        raise Refused(
            f"it declares {count:,} {what}, for which its {bytes_there:,} bytes are too few: "
            "cut short, or damaged"
        )


def check_memory(triangles: int) -> None:
    """Refuse more triangles than can be loaded: instances make them of small files.

    Corners in float64 as they are placed and joined, and in float32.
    """
    require_memory(triangles * (72 + 72 + 36), f"{triangles:,} triangles")


def numbers(rows: list[str], columns: tuple[int, ...]) -> F64:
    """(N, C) float64: columns of lines of text.

    Raises
    ------
    Refused
        If a line has too few words, or one that is no number.
    """
    if not rows:
        return np.zeros((0, len(columns)))
    try:
        found = np.loadtxt(rows, usecols=columns, ndmin=2, comments=None)
    except ValueError as error:
        raise Refused(f"a vertex that is not numbers: {error}") from None
    if len(found) != len(rows):
        raise Refused(f"{len(rows) - len(found)} of {len(rows)} vertices are empty lines")
    return found


def whole(word: str) -> int:
    """A whole number of a text; Python's int() takes 1_0, and the digits of all scripts.

    Raises
    ------
    ValueError
    """
    if not _WHOLE(word):
        raise ValueError(word)
    return int(word)


def indices_of(values: npt.NDArray[Any]) -> I64:
    """(N,) int64: indices of vertices that a file has as any kind of numbers.

    Raises
    ------
    Refused
        If one is no whole number.
    """
    if values.dtype.kind == "f":
        bad = ~((np.abs(values) < 2.0**53) & (values == np.floor(values)))  # NaN too
        if bad.any():
            raise Refused(f"a face names vertex {values[bad][0]:g}, which is no index")
    return values.astype(np.int64)


def collapsed(corners: F64, rounded: npt.NDArray[np.float32]) -> int:
    """How many triangles lose their area when coordinates are rounded to float32."""
    return int(((_doubled_area(corners) > 0) & (_doubled_area(rounded) == 0)).sum())


def _doubled_area(corners: npt.NDArray[Any]) -> F64:
    a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
    return np.abs(np.cross(b - a, c - a)).max(axis=1)
