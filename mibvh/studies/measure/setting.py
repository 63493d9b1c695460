"""What an experiment of a study is given to work on."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.shelf import Shelf
from mibvh.studies.measure.store import Store
from mibvh.studies.measure.trees import TreeSource
from mibvh.studies.record.options import StudyOptions


@dataclasses.dataclass(frozen=True)
class Setting:
    """A scene that the base study has finished, as an experiment gets it.

    Attributes
    ----------
    scene : Scene
    rays : RaySet
    trees : Shelf
        Trees by name: those of ``options.builders`` in their order, then the given ones.
    options : StudyOptions
    machine : dict
        Hardware and software (:func:`mibvh.environment.environment`), which times depend on.
    store : Store
        Keeps what the experiment finishes.
    sources : dict of str to TreeSource
        Where each tree comes from, by the same names.
    rays_given : bool
        Whether the user gave the rays; otherwise they were made from the scene's cameras.
    """

    scene: Scene
    rays: RaySet
    trees: Shelf
    options: StudyOptions
    machine: dict[str, Any]
    store: Store
    sources: dict[str, TreeSource]
    rays_given: bool = False

    @property
    def own_rays(self) -> bool:
        """Deprecated name of ``rays_given``."""
        warnings.warn("own_rays is now rays_given", DeprecationWarning, stacklevel=2)
        return self.rays_given
