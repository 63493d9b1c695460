"""Triangles: the geometry every other room works on."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]

#: Coordinates beyond this overflow the float32 products of a ray-triangle test.
MAX_COORDINATE = 1e15


@dataclasses.dataclass(frozen=True, eq=False)
class Triangles:
    """A triangle soup.

    Attributes
    ----------
    corners : (N, 3, 3) float32
        Triangle, corner, xyz, in scene units. Read-only.
    name : str
        What messages and reports call it.

    Raises
    ------
    MibvhError
        If the array has another shape, is empty, or holds NaN, infinite or overlarge
        (beyond 1e15) coordinates.
    """

    corners: F32
    name: str = "triangles"

    def __post_init__(self) -> None:
        corners = np.ascontiguousarray(self.corners, dtype=np.float32)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise MibvhError(
                f"{self.name}: triangles need an array of shape (N, 3, 3), not {corners.shape}"
            )
        if len(corners) == 0:
            raise MibvhError(f"{self.name}: there are no triangles in it")
        if not (np.abs(corners) <= MAX_COORDINATE).all():  # false for NaN too
            bad = ~(np.abs(corners) <= MAX_COORDINATE).all(axis=(1, 2))
            raise MibvhError(
                f"{self.name}: {int(bad.sum())} of {len(corners)} triangles have NaN, infinite or "
                f"overlarge coordinates (first: triangle {int(bad.argmax())})"
            )
        if corners is self.corners or corners.base is not None:  # else it was made just now
            corners = read_only(corners)
        corners.flags.writeable = False
        object.__setattr__(self, "corners", corners)

    def __len__(self) -> int:
        return len(self.corners)

    def __repr__(self) -> str:
        return f"Triangles({self.name!r}, {len(self):,} triangles)"

    @functools.cached_property
    def lower(self) -> F32:
        """(N, 3) float32: lower corners of the triangles' boxes."""
        a, b, c = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        return np.minimum(np.minimum(a, b), c)

    @functools.cached_property
    def upper(self) -> F32:
        """(N, 3) float32: upper corners of the triangles' boxes."""
        a, b, c = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        return np.maximum(np.maximum(a, b), c)

    @functools.cached_property
    def bounds(self) -> F32:
        """(2, 3) float32: the box of all triangles, lower corner first."""
        return np.stack([self.lower.min(axis=0), self.upper.max(axis=0)])

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the box of all triangles."""
        lower, upper = self.bounds.astype(np.float64)
        return float(np.linalg.norm(upper - lower))

    @functools.cached_property
    def areas(self) -> F64:
        """(N,) float64: the triangles' areas."""
        a, b, c = (self.corners[:, i].astype(np.float64) for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the coordinates: trees and ray sets name the geometry they belong to."""
        return hashlib.sha256(self.corners.tobytes()).hexdigest()

    def rotated(self, rotation: F64) -> Triangles:
        """Rotate about the origin.

        Parameters
        ----------
        rotation : (3, 3) float64
            A rotation matrix, e.g. from :func:`rotation_about`.
        """
        rotated = self.corners.reshape(-1, 3).astype(np.float64) @ rotation.T
        return Triangles(rotated.reshape(-1, 3, 3).astype(np.float32), f"{self.name} (rotated)")


def read_only(array: Any) -> npt.NDArray[Any]:
    """The array if nobody can write to it, or else a copy in C order.

    Arrays that are hashed and checked once must stay as they are.
    """
    array = np.asarray(array)
    base: Any = array
    while isinstance(base, np.ndarray) and not base.flags.writeable:
        base = base.base
    if isinstance(base, np.ndarray) or not array.flags.c_contiguous:
        array = array.copy(order="C")
        array.flags.writeable = False
    return array


def rotation_about(axis: tuple[float, float, float], degrees: float) -> F64:
    """Matrix of a rotation about an axis through the origin (Rodrigues' formula).

    Parameters
    ----------
    axis : (3,) float
        Need not have unit length. The paper rotates its scenes about (1, 1, 1).
    degrees : float
        The paper uses 45.

    Returns
    -------
    (3, 3) float64
    """
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def as_triangles(triangles: Any) -> Triangles:
    """Take :class:`Triangles`, what has ``.triangles`` (a Scene, a trimesh), an array, or a name.

    A name or file of a scene is loaded.
    """
    if isinstance(triangles, Triangles):
        return triangles
    if isinstance(triangles, str | os.PathLike):
        import mibvh  # which knows who loads scenes: this room does not

        loaded: Triangles = mibvh.load(triangles).triangles
        return loaded
    inner = getattr(triangles, "triangles", triangles)
    return inner if isinstance(inner, Triangles) else Triangles(np.asarray(inner))
