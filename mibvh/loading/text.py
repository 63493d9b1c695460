"""Text of mesh files: numbers and English words, in whatever encoding the comments are."""

from __future__ import annotations

import codecs


def decode(data: bytes) -> str:
    """Text of a mesh file: by its byte order mark, otherwise byte by byte; lines end with LF.

    Only names and comments have other characters than ASCII's, and nobody reads those.
    """
    return _decoded(data).replace("\r\n", "\n").replace("\r", "\n")  # CR alone: an old Mac's


def _decoded(data: bytes) -> str:
    for mark, encoding in (
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if data.startswith(mark):
            return data.decode(encoding, errors="replace").lstrip("\ufeff")
    return data.decode("latin-1")
