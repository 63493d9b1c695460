"""The outside of glTF: a GLB's chunks, buffers in files of their own and in data URIs."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

from mibvh.loading.mesh import Refused

_JSON, _BIN = 0x4E4F534A, 0x004E4942


def open_document(data: bytes, path: Path) -> tuple[dict[str, Any], list[bytes | None]]:
    """Return the JSON of a ``.gltf`` or ``.glb`` file, and its buffers.

    A buffer is None where the file has only a compressed form of it.

    Raises
    ------
    Refused
        If it is cut short, of another version, or a buffer is missing.
    """
    text, binary = _chunks(data) if data[:4] == b"glTF" else (data, None)
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise Refused(f"its JSON is damaged: {error}") from None
    if not isinstance(document, dict):
        raise Refused("its JSON is no object")
    version = str(document.get("asset", {}).get("version", ""))
    if not version.startswith("2."):
        raise Refused(f"glTF {version or 'of no version'} is not read, only 2.x")
    buffers = [
        _buffer(buffer, binary if i == 0 else None, path)
        for i, buffer in enumerate(document.get("buffers", []))
    ]
    return document, buffers


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    if len(data) < 20:
        raise Refused("a GLB of fewer than 20 bytes: cut short")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise Refused(f"GLB of version {version} is not read, only 2")
    if length > len(data):
        raise Refused(f"it declares {length:,} bytes but has {len(data):,}: cut short")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise Refused("a chunk is longer than the file: cut short, or damaged")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON not in found:
        raise Refused("a GLB without its JSON")
    return found[_JSON], found.get(_BIN)


def _buffer(buffer: dict[str, Any], binary: bytes | None, path: Path) -> bytes | None:
    size, uri = buffer.get("byteLength", 0), buffer.get("uri")
    if uri is None:
        if binary is None:
            return None
        data = binary
    elif uri.startswith("data:"):
        data = _data_uri(uri)
    else:
        if "://" in uri:
            raise Refused(f"a buffer is elsewhere: {uri[:80]}")
        file = path.parent / unquote(uri)
        if not file.is_file():
            raise Refused(f"its buffer {uri!r} is missing")
        data = file.read_bytes()
    if len(data) < size:
        raise Refused(f"a buffer declares {size:,} bytes but has {len(data):,}: cut short")
    return data


def _data_uri(uri: str) -> bytes:
    head, _, body = uri.partition(",")
    if not head.endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        return base64.b64decode(unquote(body), validate=True)
    except binascii.Error as error:
        raise Refused(f"a data URI is damaged: {error}") from None
