"""Rays from files: mibvh's own, plain arrays, and points with directions."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.rays.rayset import RaySet

#: Arrays of an ``.npz`` that is not mibvh's, and properties of a PLY's points; the first names
#: that are all there are taken.
_ORIGINS = (("x", "y", "z"), ("ox", "oy", "oz"))
_DIRECTIONS = (("dx", "dy", "dz"), ("nx", "ny", "nz"))
_OTHERS = ("tmax", "viewpoint", "bounce", "source")


def read_rays(path: str | os.PathLike[str]) -> RaySet:
    """Read rays.

    Parameters
    ----------
    path : path
        ``.npz``: a ray set that mibvh wrote, or arrays ``o`` and ``d`` of shape (R, 3), as
        ``numpy.savez`` writes them, with any of ``tmax``, ``viewpoint``, ``bounce``, ``source``.
        ``.npy``: an array of shape (R, 6), origin and direction in each row.
        ``.ply``: points ``x, y, z`` with directions ``dx, dy, dz`` or normals ``nx, ny, nz``,
        and any of the others as properties.

    Returns
    -------
    RaySet

    Raises
    ------
    MibvhError
        If the file is missing, damaged or of another kind, or what is in it are no rays: see
        :class:`RaySet`.
    """
    path = Path(path)
    if not path.is_file():
        raise MibvhError(f"{path}: there is no such ray file")
    readers = {".npz": _read_npz, ".npy": _read_npy, ".ply": _read_ply}
    read = readers.get(path.suffix.lower())
    if read is None:
        raise MibvhError(f"{path}: rays are read from {', '.join(readers)} files")
    try:
        return read(path)
    except Exception as error:  # NumPy's and zipfile's readers raise whatever theirs raise
        reason = " ".join(str(error).split()) or type(error).__name__
        if reason.startswith(str(path)):
            raise MibvhError(reason) from None
        raise MibvhError(f"{path}: {reason}") from None


def _read_npz(path: Path) -> RaySet:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
        if "header" in data.files:
            return RaySet.load(path)
        missing = [name for name in ("o", "d") if name not in data.files]
        if missing:
            raise MibvhError(f"there is no array {missing[0]!r} in it")
        others = {name: data[name] for name in _OTHERS if name in data.files}
        return RaySet(data["o"], data["d"], **others, meta={"file": path.name})


def _read_npy(path: Path) -> RaySet:
    with path.open("rb") as file:
        rows = np.load(file, allow_pickle=False)
    if not isinstance(rows, np.ndarray) or rows.ndim != 2 or rows.shape[1] != 6:
        raise MibvhError(f"rays need an array of shape (R, 6), not {np.shape(rows)}")
    return RaySet(rows[:, :3], rows[:, 3:], meta={"file": path.name})


def _read_ply(path: Path) -> RaySet:
    points = _ply_points(path)
    others = {name: points[name] for name in _OTHERS if name in points}
    o, d = _columns(points, _ORIGINS), _columns(points, _DIRECTIONS)
    return RaySet(o, d, **others, meta={"file": path.name})


def _columns(points: dict[str, npt.NDArray[Any]], names: Any) -> npt.NDArray[Any]:
    for three in names:
        if all(name in points for name in three):
            return np.stack([points[name] for name in three], axis=1)
    wanted = " nor ".join(", ".join(three) for three in names)
    raise MibvhError(f"its points have neither {wanted}")


_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def _ply_points(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Properties of a PLY's vertices, which must be its first element and hold no lists."""
    whole = path.read_bytes()
    head, ended, body = whole.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines()]
    if not ended or lines[0] != ["ply"]:
        raise MibvhError("is not a PLY file")
    body = body[body.index(b"\n") + 1 :]
    kind = next((line[1] for line in lines if line[:1] == ["format"]), "")
    elements = [i for i, line in enumerate(lines) if line[:1] == ["element"]]
    if kind not in _ORDERS or not elements or lines[elements[0]][1] != "vertex":
        raise MibvhError("its first element must be vertices")
    count = int(lines[elements[0]][2])
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = [line for line in lines[elements[0] : end] if line[:1] == ["property"]]
    names = [line[-1] for line in properties]
    if any(line[1] == "list" or line[1] not in _TYPES for line in properties):
        raise MibvhError("its vertices have properties that are no numbers")
    if kind == "ascii":
        rows = [line.split() for line in body.decode("ascii").splitlines()[:count]]
        if len(rows) < count or any(len(row) < len(names) for row in rows):
            raise MibvhError(f"it ends before its {count} points do")
        table = np.array(rows, dtype=np.float64).reshape(count, -1)
        return {name: table[:, i] for i, name in enumerate(names)}
    layout = np.dtype([(line[-1], _ORDERS[kind] + _TYPES[line[1]]) for line in properties])
    if len(body) < count * layout.itemsize:
        raise MibvhError(f"it ends before its {count} points do")
    points = np.frombuffer(body, layout, count)
    return {name: points[name] for name in names}
