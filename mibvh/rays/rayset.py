"""Ray sets: rays as arrays, stored so that every tree traces the same rays."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.files import Stored, checksum
from mibvh.triangles import F32, F64, I32, Triangles

#: What stands in the arrays that are not given.
_DEFAULTS = {"tmax": np.inf, "viewpoint": 0, "bounce": 1, "source": -1}
_INTEGERS = ("viewpoint", "bounce", "source")


@dataclasses.dataclass(frozen=True, eq=False)
class RaySet(Stored):
    """Rays to trace through trees. Origins and directions are enough.

    Attributes
    ----------
    o, d : (R, 3) float32
        Origins in scene units, and directions. Of unit length where mibvh makes them; distances
        are in units of their length.
    tmax : (R,) float32
        Farthest hit that counts; infinite by default, and for diffuse rays.
    viewpoint : (R,) int32
        The camera that the path began at; 0 by default.
    bounce : (R,) int32
        1 for the rays that leave what the camera sees, 2 for those that leave what they hit,
        and so on; 1 by default.
    source : (R,) int32
        The triangle that the ray leaves; -1, the default, where that is not known.
    meta : dict
        JSON-able: scene, digest of the triangles, seed, film size, samples, order, the numbers
        of primary rays and hits, ``self_hits``, how many rays hit the triangle they leave, and
        ``kind`` and ``occlusion``: see the properties.

    Raises
    ------
    MibvhError
        If an array has another shape or type, a coordinate is not finite, a direction is zero,
        a ``tmax`` is negative or no number, or an id is negative.
    """

    _ARRAYS = ("o", "d", "tmax", "viewpoint", "bounce", "source")
    _KIND = "ray set"

    o: F32
    d: F32
    tmax: F32 = None  # type: ignore[assignment] # filled in below
    viewpoint: I32 = None  # type: ignore[assignment]
    bounce: I32 = None  # type: ignore[assignment]
    source: I32 = None  # type: ignore[assignment]
    meta: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        rays = np.shape(self.o)[0] if np.ndim(self.o) else 0
        for name in self._ARRAYS:
            given = getattr(self, name)
            if given is None:
                given = np.full(rays, _DEFAULTS[name])
            object.__setattr__(self, name, _column(name, given, rays))
        self._check_values()

    def __len__(self) -> int:
        return len(self.tmax)

    def __repr__(self) -> str:
        name = self.meta.get("scene")
        of = f" of {name!r}" if name else ""
        return f"RaySet({len(self):,} rays{of})"

    @property
    def kind(self) -> str:
        """The kind of the rays, such as ``diffuse`` or ``shadow``; see ``make_rays``."""
        return str(self.meta.get("kind", "diffuse"))

    @property
    def occlusion(self) -> bool:
        """Whether any hit ends a ray, as for shadow rays; otherwise the closest hit is needed."""
        return bool(self.meta.get("occlusion", False))

    def _check_values(self) -> None:
        sound = [
            ("o", np.isfinite(self.o).all(axis=1), "an origin that is not finite"),
            ("d", np.isfinite(self.d).all(axis=1), "a direction that is not finite"),
            ("d", (self.d != 0).any(axis=1), "a direction of no length"),
            ("tmax", self.tmax >= 0, "a tmax that is negative or no number"),
            ("viewpoint", self.viewpoint >= 0, "a viewpoint below 0"),
            ("bounce", self.bounce >= 0, "a bounce below 0"),
            ("source", self.source >= -1, "a source triangle below -1"),
        ]
        for name, good, wrong in sound:
            if not good.all():
                first = int(good.argmin())
                raise MibvhError(
                    f"{int((~good).sum())} of {len(self)} rays have {wrong} (first: ray {first}, "
                    f"{name} = {getattr(self, name)[first].tolist()})"
                )

    def check_matches(self, triangles: Triangles) -> None:
        """Raise if the rays were not made for these triangles.

        Raises
        ------
        MibvhError
            If they were made for another geometry, or leave triangles that are not there.
        """
        if self.meta.get("digest") not in (None, triangles.digest):
            raise MibvhError(
                f"the rays (of {self.meta.get('scene', 'another scene')}) were made for another "
                f"geometry than {triangles.name}"
            )
        if len(self) and int(self.source.max()) >= len(triangles):
            first = int((self.source >= len(triangles)).argmax())
            raise MibvhError(
                f"ray {first} leaves triangle {int(self.source[first])}, but {triangles.name} has "
                f"{len(triangles)} triangles"
            )

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the rays."""
        return checksum(self._arrays(), {})

    def select(self, chosen: Any) -> RaySet:
        """Keep some of the rays.

        Parameters
        ----------
        chosen : index array, boolean mask or slice
        """
        arrays = {name: array[chosen] for name, array in self._arrays().items()}
        return RaySet(**arrays, meta=self.meta)

    def rotated(self, rotation: F64, triangles: Triangles | None = None) -> RaySet:
        """Rotate about the origin, as :meth:`mibvh.Triangles.rotated` rotates the scene.

        Parameters
        ----------
        rotation : (3, 3) float64
        triangles : Triangles, optional
            The rotated ones. Rotation rounds both them and the origins: without them, rays may
            hit the triangle that they leave. With them, origins are moved clear of it again.
        """
        o = self.o.astype(np.float64) @ rotation.T
        d = (self.d.astype(np.float64) @ rotation.T).astype(np.float32)
        if triangles is not None:
            from mibvh.rays.origins import clear_origins

            leaving = np.flatnonzero(self.source >= 0)
            o[leaving] = clear_origins(triangles, self.source[leaving], o[leaving], d[leaving])
        meta = {**self.meta, "digest": triangles.digest if triangles else None, "rotated": True}
        return dataclasses.replace(self, o=o.astype(np.float32), d=d, meta=meta)


def _column(name: str, given: Any, rays: int) -> npt.NDArray[Any]:
    """Convert one of the arrays to its type, and check its shape."""
    try:
        array = np.asarray(given)
    except ValueError:
        raise MibvhError(f"rays: {name} is no array of numbers") from None
    shape: tuple[int, ...] = (rays, 3) if name in ("o", "d") else (rays,)
    if array.dtype.kind not in "fiu":
        raise MibvhError(f"rays: {name} is no array of numbers (its type is {array.dtype})")
    if array.shape != shape:
        raise MibvhError(f"rays: {name} must have the shape {shape}, not {array.shape}")
    if name not in _INTEGERS:
        with np.errstate(over="ignore"):
            return np.ascontiguousarray(array, dtype=np.float32)
    limits = np.iinfo(np.int32)
    if array.size and not (limits.min <= array.min() and array.max() <= limits.max):
        raise MibvhError(f"rays: {name} has numbers that do not fit into 32 bits")
    whole = np.ascontiguousarray(array, dtype=np.int32)
    if array.dtype.kind == "f" and (whole != array).any():
        raise MibvhError(f"rays: {name} has numbers that are not whole")
    return whole
