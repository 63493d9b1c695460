"""The figures of the paper and its slides, read from ``published.toml``."""

from __future__ import annotations

import dataclasses
import functools
import tomllib
from pathlib import Path
from typing import NamedTuple


class Spread(NamedTuple):
    """Mean, minimum and maximum of a figure over the paper's scenes."""

    mean: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class PaperScene:
    """A scene of the paper; unknown values are None.

    Attributes
    ----------
    name, credit : str
        As on the slides.
    files : tuple of str
        Other names a file or folder of it may have.
    where, url : str or None
        Where the model is to be had.
    triangles : int or None
        Of the file that is available there; the paper's own count may differ.
    r_sah, r_sah_epo : float or None
        Pearson's r with scalar ns/ray over nine builders, for SAH and for SAH + EPO.
    alpha : float or None
        The fitted alpha, as other codes quote it from the paper.
    bbvh_sah : float or None
        SAH of the sweep over the best known: at least this.
    """

    name: str
    credit: str
    files: tuple[str, ...] = ()
    where: str | None = None
    url: str | None = None
    triangles: int | None = None
    r_sah: float | None = None
    r_sah_epo: float | None = None
    alpha: float | None = None
    bbvh_sah: float | None = None


@dataclasses.dataclass(frozen=True)
class Published:
    """All published figures.

    Attributes
    ----------
    scenes : int
        How many scenes they are over.
    r : dict of str to Spread
        Pearson's r of predictors with scalar time, by their names.
    epo : dict of str to float
        Of builders, relative to lbvh.
    rotation : dict of str to float
        By what rotating the scenes raises costs, by quantity or predictor.
    known_scenes : tuple of PaperScene
        In alphabetical order.
    """

    scenes: int
    r: dict[str, Spread]
    epo: dict[str, float]
    rotation: dict[str, float]
    known_scenes: tuple[PaperScene, ...]


@functools.cache
def published() -> Published:
    """Return the published figures."""
    text = Path(__file__).with_name("published.toml").read_text(encoding="utf-8")
    data = tomllib.loads(text)
    scenes = (PaperScene(**{**e, "files": tuple(e.get("files", ()))}) for e in data["scene"])
    return Published(
        scenes=data["scenes"],
        r={name: Spread(*values) for name, values in data["r"].items()},
        epo=data["epo"],
        rotation=data["rotation"],
        known_scenes=tuple(scenes),
    )
