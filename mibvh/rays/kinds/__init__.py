"""Kinds of rays: a registry, in which a new kind is one file and one line."""

from __future__ import annotations

import dataclasses
import importlib
import re
from typing import Any

from mibvh.errors import MibvhError


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of rays.

    Attributes
    ----------
    name : str
    summary : str
    occlusion : bool
        Whether any hit answers what the ray asks; otherwise the closest is wanted.
    first : int
        The vertex of its path that it leaves unless a number says otherwise: 0 is the camera, 1
        what the camera sees, 2 what a diffuse ray from there hits.
    """

    name: str
    summary: str
    occlusion: bool = False
    first: int = 1

    def leave(self, paths: Any, vertices: Any, options: Any) -> tuple[Any, Any]:
        """Rays that leave vertices, and which of these they leave.

        Parameters
        ----------
        paths : Paths
        vertices : Vertices
        options : KindOptions

        Returns
        -------
        rays : Ray3f
            With the farthest hit that counts as ``maxt``.
        valid : Bool
            A vertex may send no ray, as to a light below its horizon.
        """
        leave = importlib.import_module(f"mibvh.rays.kinds.{self.name}").leave
        rays, valid = leave(paths, vertices, options)
        return rays, valid


@dataclasses.dataclass(frozen=True)
class KindOptions:
    """What kinds can be told.

    Attributes
    ----------
    radius : float, optional
        How far ``ao`` rays reach, in scene units; by default the share below.
    radius_share : float
        How far ``ao`` rays reach, as a share of the diagonal of the scene's box.
    """

    radius: float | None = None
    radius_share: float = 0.1

    def __post_init__(self) -> None:
        for name in ("radius", "radius_share"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise MibvhError(f"{name} must be above 0 and finite, not {value}")


KINDS = {
    kind.name: kind
    for kind in (
        Kind("primary", "from the camera through random points of each pixel", first=0),
        Kind("diffuse", "in a cosine-distributed direction"),
        Kind("shadow", "towards a point of a light, or of the sky", occlusion=True),
        Kind("ao", "in a cosine-distributed direction, of limited length", occlusion=True),
    )
}
#: The usual name of the diffuse rays of a later vertex.
_ALIASES = {"bounce": "diffuse"}


def kind_named(name: str) -> tuple[Kind, int]:
    """Look a kind up.

    Parameters
    ----------
    name : str
        A key of :data:`KINDS` or ``bounce``; a number behind it names the vertex that the rays
        leave: ``bounce2``, ``shadow3``.

    Returns
    -------
    kind : Kind
    vertex : int

    Raises
    ------
    MibvhError
        If there is no such kind.
    """
    parsed = re.fullmatch(r"([a-z]+)([1-9][0-9]?)?", name)
    word = _ALIASES.get(parsed.group(1), parsed.group(1)) if parsed else ""
    if parsed is None or word not in KINDS or (word == "primary" and parsed.group(2)):
        known = ", ".join(KINDS)
        raise MibvhError(
            f"there is no kind of rays {name!r}; there are: {known}, and with the number of the "
            "vertex they leave, such as bounce2 or shadow2"
        )
    kind = KINDS[word]
    return kind, int(parsed.group(2) or kind.first)
