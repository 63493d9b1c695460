"""Mitsuba's serialized meshes: read by Mitsuba, which does not look at their indices.

The format is that of Mitsuba 0.6's manual (section 8.2.5): zlib streams, and where they begin.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mibvh.loading.mesh import check_indices

#: Values of a vertex that a flag announces behind its position: a normal, texture coordinates, a
#: colour.
_MORE = {0x1: 3, 0x2: 2, 0x8: 3}
_DOUBLE = 0x2000
#: Bytes of flags, name and counts.
_LONGEST_HEAD = 1 << 16
#: Bytes that zlib makes of one.
_MOST = 1032


def check_file(path: Path, index: int) -> None:
    """Refuse a mesh whose faces name vertices that it does not have.

    Mitsuba says what else is wrong with it.

    Parameters
    ----------
    path : Path
    index : int
        Which of the file's meshes.

    Raises
    ------
    Refused
    """
    try:
        vertices, indices = _faces(np.memmap(path, np.uint8, "r").data, index)
    except (struct.error, zlib.error, ValueError, OverflowError, TypeError):
        return
    check_indices(indices.astype(np.int64), vertices)


def _faces(data: memoryview, index: int) -> tuple[int, npt.NDArray[np.uint32]]:
    """Number of vertices, and the corners of all faces."""
    _, version = struct.unpack_from("<HH", data)
    (count,) = struct.unpack_from("<I", data, len(data) - 4)
    kind = "<Q" if version > 3 else "<I"
    table = len(data) - 4 - struct.calcsize(kind) * (count - index)
    (start,) = struct.unpack_from(kind, data, table)
    stream = data[start + 4 :]
    head = zlib.decompressobj().decompress(stream, _LONGEST_HEAD)
    (flags,) = struct.unpack_from("<I", head)
    at = head.index(b"\0", 4) + 1 if version > 3 else 4  # its name
    vertices, faces = struct.unpack_from("<QQ", head, at)
    values = 3 + sum(more for flag, more in _MORE.items() if flags & flag)
    at += 16 + vertices * values * (8 if flags & _DOUBLE else 4)
    if at + 12 * faces > _MOST * len(stream):
        raise ValueError
    raw = zlib.decompressobj().decompress(stream, at + 12 * faces)
    return vertices, np.frombuffer(raw, "<u4", 3 * faces, at)
