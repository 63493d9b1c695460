"""STL: binary and text."""

from __future__ import annotations

import codecs
import re
import struct

import numpy as np

from mibvh.loading.mesh import Mesh, Refused, numbers
from mibvh.loading.text import decode

_HEADER, _RECORD = 84, 50


def read(data: bytes) -> Mesh:
    """Read an STL file.

    A file is binary if its length is what the count in a binary header makes it, whatever its
    first word is: many binary files begin with ``solid``.

    Raises
    ------
    Refused
        If a binary file has another length than its count says, or a text is cut short.
    """
    if len(data) >= _HEADER:
        count = struct.unpack_from("<I", data, 80)[0]
        if len(data) == _HEADER + _RECORD * count:
            return _binary(data, count)
        if not _is_text(data):
            raise Refused(
                f"its header declares {count:,} triangles, which take "
                f"{_HEADER + _RECORD * count:,} bytes, but it has {len(data):,}: cut short, or "
                "damaged"
            )
    elif not _is_text(data):
        raise Refused("neither a text that begins with 'solid' nor long enough to be binary")
    return _text(decode(data))


def _is_text(data: bytes) -> bool:
    return data.removeprefix(codecs.BOM_UTF8).lstrip()[:5].lower() == b"solid" and b"\0" not in data


def _binary(data: bytes, count: int) -> Mesh:
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
    rows = np.frombuffer(data, dtype=record, count=count, offset=_HEADER)
    return Mesh(rows["corners"].astype(np.float64))


def _text(text: str) -> Mesh:
    words = re.findall(r"^[ \t]*(\w+)", text, flags=re.MULTILINE)
    kept = [word.lower() for word in words]
    loops, ends, facets = kept.count("outer"), kept.count("endloop"), kept.count("facet")
    vertices = re.findall(r"^[ \t]*vertex[ \t]+(.*)$", text, flags=re.MULTILINE | re.IGNORECASE)
    if kept.count("solid") != kept.count("endsolid") or not loops == ends == facets:
        raise Refused("its last facet or solid does not end: cut short, or damaged")
    if len(vertices) != 3 * facets:
        raise Refused(f"its {facets:,} facets have {len(vertices):,} vertices, not three each")
    return Mesh(numbers(vertices, (0, 1, 2)).reshape(-1, 3, 3))
