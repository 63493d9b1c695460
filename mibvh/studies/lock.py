"""One study at a time on a folder."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from mibvh.errors import MibvhError

#: Folders of a study's folder that files are written to.
PARTS = ("cache", "tables", "figures")
#: A file that a killed process was writing; see :func:`mibvh.files.atomic_path`.
_UNFINISHED = re.compile(
    r"\.(?:[^/]+\.(?:json|npz|csv|tex|svg|png)|report\.html|results\.(?:md|parquet))\.[a-z0-9_]{8}"
)


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other studies out of a folder, and clear away what a killed one was writing.

    The lock is the system's, so that one whose holder was killed is free at once.

    Raises
    ------
    MibvhError
        If another study is at work there, or the folder cannot be written, or a part of it is
        somewhere else: a folder of somebody else's must not make us write there.
    """
    for part in PARTS:
        if (folder / part).is_symlink():
            raise MibvhError(f"{folder / part}: is a link, and might lead out of the study")
    path = folder / "cache" / "lock"
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        raise MibvhError(f"{path}: cannot be written ({error.strerror})") from None
    with os.fdopen(handle, "r+") as file:
        if not _locked(file.fileno()):
            raise MibvhError(f"{folder}: another study is at work in this folder{_whose(path)}")
        with contextlib.suppress(OSError):  # who holds it is only told
            file.truncate(0)
            file.write(str(os.getpid()))
            file.flush()
        _clear(folder)
        yield


def _locked(handle: int) -> bool:
    """Lock an open file, unless another holds it; where there are no such locks, say yes."""
    try:
        import fcntl
    except ImportError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems have none
        return True
    return True


def _whose(path: Path) -> str:
    try:
        said = path.read_text(encoding="ascii", errors="replace")[:20]
    except OSError:
        return ""
    return f" (process {said})" if said.isdigit() else ""


def _clear(folder: Path) -> None:
    """Remove unfinished files."""
    for part in (folder, *(folder / name for name in PARTS)):
        if part.is_dir():
            for path in part.iterdir():
                if _UNFINISHED.fullmatch(path.name) and not path.is_dir():
                    with contextlib.suppress(OSError):
                        path.unlink()
