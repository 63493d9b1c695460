"""Mesh files: one module per format, and the checks that every mesh has to pass."""

from __future__ import annotations

import importlib
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.loading.mesh import Mesh, Refused, collapsed
from mibvh.triangles import Triangles

#: The module that reads a format, by the file's ending.
_FORMATS = {"obj": "obj", "ply": "ply", "stl": "stl", "off": "off", "glb": "gltf", "gltf": "gltf"}
#: Formats that trimesh opens too, but that are archives or no surfaces of triangles.
_NOT_MESHES = frozenset(["bz2", "tar.bz2", "tar.gz", "zip", "xyz", "dxf", "stl_ascii"])
#: What trimesh needs to open some more.
_PACKAGES = {
    "dae": "pycollada",
    "zae": "pycollada",
    "3mf": "lxml and networkx",
    "xaml": "lxml",
    "step": "cascadio",
    "stp": "cascadio",
}


def mesh_formats() -> frozenset[str]:
    """Return the supported file endings, without the dot.

    Besides mibvh's own formats these are the ones that trimesh supports with further packages, such
    as 3MF and Collada.
    """
    import trimesh

    return frozenset(_FORMATS) | (frozenset(trimesh.available_formats()) - _NOT_MESHES)


def read_mesh(path: Path) -> tuple[Triangles, list[str]]:
    """Read a mesh file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    triangles : Triangles
        In the order of the file.
    notes : list of str
        Sentences on what was left out or changed.

    Raises
    ------
    MibvhError
        If it cannot be read correctly; the message says why.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind in _NOT_MESHES | {"gz", "xz", "7z", "rar", "zst"}:
        raise MibvhError(f"{printable(path)}: .{kind} files are not read; unpack or convert it")
    if kind not in mesh_formats() and kind in _PACKAGES:
        raise MibvhError(
            f"{printable(path)}: .{kind} files are read once the packages that trimesh needs for "
            f"them are installed: {_PACKAGES[kind]}"
        )
    if kind not in mesh_formats():
        raise MibvhError(
            f"{printable(path)}: neither Mitsuba XML nor a mesh format that is read "
            f"({', '.join(sorted(mesh_formats()))})"
        )
    check_regular(path)
    name = printable(path.stem)
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # damaged numbers are refused below
            mesh = _reader(kind)(path)
            return _checked(mesh, name), mesh.notes
    except Refused as error:
        raise MibvhError(f"{printable(path)}: cannot be read as {kind.upper()}: {error}") from None
    except MibvhError as error:
        reason = str(error).removeprefix(f"{name}: ")
        raise MibvhError(f"{printable(path)}: {reason}") from None
    except MemoryError:
        raise MibvhError(f"{printable(path)}: there is too little memory for it") from None
    except OSError as error:
        raise MibvhError(f"{printable(path)}: cannot be read ({error.strerror})") from error
    except Exception as error:  # whatever a damaged file makes of a parser
        reason = " ".join(str(error).split())[:200]
        raise MibvhError(
            f"{printable(path)}: cannot be read as {kind.upper()}: damaged "
            f"({type(error).__name__}{': ' + reason if reason else ''})"
        ) from error


def check_regular(path: Path) -> None:
    """Refuse anything but a regular file: opening a pipe would block for ever.

    Raises
    ------
    MibvhError
    """
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        raise MibvhError(f"{printable(path)}: cannot be read ({error.strerror})") from None
    if not stat.S_ISREG(mode):
        raise MibvhError(f"{printable(path)}: is no regular file")


def printable(text: str | os.PathLike[str]) -> str:
    r"""Return a file's name with unprintable characters and invalid bytes as ``\xNN``."""
    plain = os.fspath(text).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in plain)


def _reader(kind: str) -> Callable[[Path], Mesh]:
    if kind not in _FORMATS:
        return _by_trimesh
    module: Any = importlib.import_module(f"mibvh.loading.{_FORMATS[kind]}")
    if kind in ("glb", "gltf"):
        return lambda path: module.read(path.read_bytes(), path)
    return lambda path: module.read(path.read_bytes())


def _by_trimesh(path: Path) -> Mesh:
    import trimesh

    loaded = trimesh.load(path, process=False)
    mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
    note = "it was read by trimesh; nothing in it tells whether all of it was"
    return Mesh(np.asarray(mesh.triangles, dtype=np.float64), [note])


def _checked(mesh: Mesh, name: str) -> Triangles:
    """Convert to float32, and refuse a mesh without a surface."""
    rounded = mesh.corners.astype(np.float32)
    if len(rounded) == 0:
        detail = f" ({'; '.join(mesh.notes)})" if mesh.notes else ""
        raise Refused(f"there is no triangle in it{detail}")
    triangles = Triangles(rounded, name)
    if not triangles.areas.any():
        raise Refused(f"its {len(triangles):,} triangles all have no area")
    lost = collapsed(mesh.corners, rounded)
    if lost:
        mesh.notes.append(
            f"{lost:,} triangles lose their area in single precision: they are too thin, or too "
            "far from the origin for their size (then move them there first)"
        )
    return triangles
