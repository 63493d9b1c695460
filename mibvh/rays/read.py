"""Rays from files: mibvh's own, plain arrays, and points with directions."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.loading.ply import vertex_columns
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
    points = vertex_columns(path.read_bytes())
    others: dict[str, Any] = {name: points[name] for name in _OTHERS if name in points}
    o, d = _columns(points, _ORIGINS), _columns(points, _DIRECTIONS)
    return RaySet(o, d, **others, meta={"file": path.name})


def _columns(points: dict[str, npt.NDArray[Any]], names: Any) -> npt.NDArray[Any]:
    for three in names:
        if all(name in points for name in three):
            return np.stack([points[name] for name in three], axis=1)
    wanted = " nor ".join(", ".join(three) for three in names)
    raise MibvhError(f"its points have neither {wanted}")
