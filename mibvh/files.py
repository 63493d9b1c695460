"""Files appear whole or not at all, and damage to them is noticed."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError

#: Of the ``.npz`` files of trees and ray sets.
FORMAT_VERSION = 1


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that is moved into place if the block succeeds.

    Raises
    ------
    MibvhError
        If the folder is missing or cannot be written.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    except OSError as error:
        raise MibvhError(f"{path}: cannot be written ({error.strerror})") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes files private; give them the permissions a plain open() would have.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file atomically (UTF-8)."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def checksum(arrays: Mapping[str, npt.NDArray[Any]], meta: Mapping[str, Any]) -> str:
    """SHA-256 of arrays, in their order, and of JSON-able metadata."""
    digest = hashlib.sha256()
    for array in arrays.values():
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps(meta, sort_keys=True).encode())
    return digest.hexdigest()


def write_arrays(
    path: str | os.PathLike[str], arrays: Mapping[str, npt.NDArray[Any]], meta: Mapping[str, Any]
) -> None:
    """Write an ``.npz`` file: the arrays, the metadata, a format version and a checksum."""
    header = {"format": FORMAT_VERSION, "checksum": checksum(arrays, meta), "meta": meta}
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        contents: dict[str, Any] = {
            "header": np.array(json.dumps(header, sort_keys=True)),
            **arrays,
        }
        np.savez(file, **contents)


def read_arrays(
    path: str | os.PathLike[str], kind: str, names: tuple[str, ...]
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Read the arrays and the metadata of a file that :func:`write_arrays` wrote.

    Raises
    ------
    MibvhError
        If the file is missing, damaged, of another kind, or of a newer format.
    """
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
            header = json.loads(str(data["header"]))
            arrays = {name: data[name] for name in names}
    except FileNotFoundError:
        raise MibvhError(f"{path}: there is no such {kind} file") from None
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise MibvhError(f"{path}: not a {kind} file of mibvh, or damaged ({error})") from None
    if header.get("format") != FORMAT_VERSION:
        raise MibvhError(
            f"{path}: {kind} format {header.get('format')} is not the format {FORMAT_VERSION} "
            "that this mibvh reads"
        )
    if checksum(arrays, header["meta"]) != header["checksum"]:
        raise MibvhError(f"{path}: the {kind} file is damaged (its checksum does not match)")
    return arrays, header["meta"]
