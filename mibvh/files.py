"""Atomic writing of files, and ``.npz`` files with a checksum."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import re
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError

#: Of the ``.npz`` files of trees, ray sets and hits; files of format 1 are read too.
FORMAT_VERSION = 2


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that is moved into place if the block succeeds.

    Raises
    ------
    MibvhError
        If the folder is missing or cannot be written, the disk is full, or ``path`` is a folder,
        a pipe or a device. What was there before stays as it was.
    """
    target = Path(path)
    try:
        if target.exists() and not target.is_file():
            # Moved into place, a file would take the place of a device such as /dev/null.
            raise MibvhError(f"{path}: cannot be written (it exists, and is no file)")
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
    except OSError as error:  # the disk is full, or a file may not be that large
        raise MibvhError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file atomically; characters that cannot be encoded are escaped."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Create a folder and its parents if they do not exist; return it.

    Raises
    ------
    MibvhError
        If it cannot be made.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MibvhError(f"{path}: cannot be made a folder ({error.strerror})") from None
    return Path(path)


def file_name(name: str) -> str:
    """Turn any name into a safe file name.

    Letters, digits and ``@ + - . _`` stay. A name that has others, begins with a dot or is long
    gets a mark at its end, so that two names never share a file.

    >>> file_name("cornell@3000"), file_name("../../etc/passwd")
    ('cornell@3000', '_.._etc_passwd~3754d6cb')
    """
    safe = re.sub(r"[^\w@+.-]", "_", name).lstrip(".")
    if safe and safe == name and len(name.encode()) <= 100:
        return name
    mark = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{safe.encode()[:90].decode(errors='ignore')}~{mark}"


def plain(text: str) -> str:
    """Replace characters that a text file must not contain.

    Control characters and lone surrogates become question marks.
    """
    return re.sub("[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]", "?", text)


def checksum(arrays: Mapping[str, npt.NDArray[Any]], meta: Mapping[str, Any]) -> str:
    """Return the SHA-256 of arrays (names, types, byte orders, shapes) and of JSON-able data."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(json.dumps(meta, sort_keys=True).encode())
    return digest.hexdigest()


def write_arrays(
    path: str | os.PathLike[str],
    arrays: Mapping[str, npt.NDArray[Any]],
    meta: Mapping[str, Any],
    *,
    kind: str | None = None,
    key: str | None = None,
) -> None:
    """Write arrays and a header with metadata to an ``.npz`` file.

    Parameters
    ----------
    path : path
    arrays : mapping of str to array
    meta : mapping
        JSON-able.
    kind : str, optional
        Such as ``tree``.
    key : str, optional
        What the arrays were made from: a file that was moved or renamed is not taken for
        another.
    """
    facts = {"format": FORMAT_VERSION, "kind": kind, "key": key, "meta": meta}
    header = {**facts, "checksum": checksum(arrays, facts)}
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        contents: dict[str, Any] = {
            "header": np.array(json.dumps(header, sort_keys=True)),
            **arrays,
        }
        np.savez(file, **contents)


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """Return the kind of a file of :func:`write_arrays`; None if it has none or is another file."""
    try:
        with zipfile.ZipFile(path) as archive:
            kind = json.loads(str(_member(archive, "header"))).get("kind")
    except Exception:  # as in read_arrays, which says what is the matter
        return None
    return kind if isinstance(kind, str) else None


def read_arrays(
    path: str | os.PathLike[str], kind: str, names: tuple[str, ...], *, key: str | None = None
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Read the arrays and the metadata of a file that :func:`write_arrays` wrote.

    Parameters
    ----------
    path : path
    kind : str
        What it must hold.
    names : tuple of str
        The arrays wanted.
    key : str, optional
        What it must have been made from.

    Returns
    -------
    arrays : dict of str to array
        Read-only, for good.
    meta : dict

    Raises
    ------
    MibvhError
        If the file is missing, damaged, of another kind or key, or of a newer format; whatever
        is the matter with it, nothing else.
    """
    if not Path(path).exists():
        raise MibvhError(f"{path}: there is no such {kind} file")
    if not Path(path).is_file():
        raise MibvhError(f"{path}: is no file")  # to open a pipe would wait for its other end
    if (told := kind_of(path)) not in (None, kind):
        raise MibvhError(f"{path}: is a {told} file, not a {kind} file")
    try:
        with zipfile.ZipFile(path) as archive:
            header = json.loads(str(_member(archive, "header")))
            arrays = {name: _member(archive, name) for name in names}
        version = header["format"]
        sound = isinstance(header["meta"], dict) and _sound(header, arrays)
    # Damage can make zipfile, NumPy and json raise nearly anything: NotImplementedError,
    # RuntimeError, struct.error, MemoryError, RecursionError, tokenize.TokenError and more.
    except Exception as error:
        reason = " ".join((str(error) or type(error).__name__).split())[:120]
        raise MibvhError(f"{path}: not a {kind} file of mibvh, or damaged ({reason})") from None
    if version not in (1, FORMAT_VERSION):
        raise MibvhError(
            f"{path}: {kind} format {version} is none that this mibvh reads (1 to {FORMAT_VERSION})"
        )
    if not sound:
        raise MibvhError(f"{path}: the {kind} file is damaged (its checksum does not match)")
    if key is not None and header.get("key") != key:
        raise MibvhError(f"{path}: the {kind} file was made from something else (its key differs)")
    return arrays, header["meta"]


class Stored:
    """Base class of values with arrays and JSON-able metadata, saved as ``.npz`` files."""

    #: The arrays' names, and what the value is called in messages.
    _ARRAYS: ClassVar[tuple[str, ...]]
    _KIND: ClassVar[str]

    meta: dict[str, Any]

    def save(self, path: str | os.PathLike[str], key: str | None = None) -> None:
        """Write an ``.npz`` file; see :func:`mibvh.files.write_arrays`.

        Parameters
        ----------
        path : path
        key : str, optional
            What the value was made from, to be asked for by :meth:`load`.
        """
        write_arrays(path, self._arrays(), self._header(), kind=self._KIND, key=key)

    @classmethod
    def load(cls, path: str | os.PathLike[str], key: str | None = None) -> Self:
        """Read back what :meth:`save` wrote.

        Parameters
        ----------
        path : path
        key : str, optional
            Refuse a file that was not saved with this key.

        Raises
        ------
        MibvhError
            If the file is missing, of another kind, damaged, holds an invalid value, carries
            another key, or comes from a newer format.
        """
        arrays, header = read_arrays(path, cls._KIND, cls._ARRAYS, key=key)
        try:
            return cls._restored(arrays, header)
        except MibvhError as error:
            raise MibvhError(f"{path}: {error}") from None

    def _arrays(self) -> dict[str, npt.NDArray[Any]]:
        return {name: getattr(self, name) for name in self._ARRAYS}

    def _header(self) -> dict[str, Any]:
        """Return the metadata to write beside the arrays."""
        return self.meta

    @classmethod
    def _restored(cls, arrays: dict[str, npt.NDArray[Any]], header: dict[str, Any]) -> Self:
        """Make the value from a file's contents; refuse an invalid one."""
        return cls(**arrays, meta=header)  # type: ignore[call-arg] # a subclass is a dataclass


def check_columns(
    path: str | os.PathLike[str],
    kind: str,
    arrays: Mapping[str, npt.NDArray[Any]],
    columns: Mapping[str, str],
) -> None:
    """Refuse arrays that are not the columns of one table.

    Parameters
    ----------
    path : path
    kind : str
        Of the file.
    arrays : mapping of str to array
    columns : mapping of str to str
        The type of each; each has a row for each of the first's.

    Raises
    ------
    MibvhError
        If one is of another type or shape.
    """
    rows = next((arrays[name].shape[:1] for name in columns), ())
    for name, dtype in columns.items():
        array = arrays[name]
        if array.dtype != dtype or array.shape != rows or not rows:
            raise MibvhError(
                f"{path}: not a {kind} file of mibvh ({name} is {array.dtype} {array.shape}, not "
                f"{dtype} {rows or '(N,)'})"
            )


def _member(archive: zipfile.ZipFile, name: str) -> npt.NDArray[Any]:
    """Read one array, without trusting its header's size: memory is bounded by the file's bytes."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} is compressed")
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version != (1, 0):
            raise ValueError(f"{name} is an array of format {version}")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        data = file.read()
    if fortran or dtype.hasobject or len(data) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"{name} is not the array that its header tells of")
    return np.frombuffer(data, dtype).reshape(shape)


def _sound(header: dict[str, Any], arrays: dict[str, npt.NDArray[Any]]) -> bool:
    """Whether the checksum fits the arrays and the rest of the header."""
    if header["format"] == 1:  # covers the bytes alone
        digest = hashlib.sha256()
        for array in arrays.values():
            digest.update(array.tobytes())
        digest.update(json.dumps(header["meta"], sort_keys=True).encode())
        return bool(header["checksum"] == digest.hexdigest())
    facts = {name: header.get(name) for name in ("format", "kind", "key", "meta")}
    return bool(header["checksum"] == checksum(arrays, facts))
