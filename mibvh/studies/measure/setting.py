"""What an experiment is made on."""

from __future__ import annotations

import dataclasses
from typing import Any

from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.shelf import Shelf
from mibvh.studies.measure.store import Store
from mibvh.studies.measure.trees import TreeSource
from mibvh.studies.record.options import StudyOptions


@dataclasses.dataclass(frozen=True)
class Setting:
    """A scene that experiments are made on.

    Attributes
    ----------
    scene : Scene
    rays : RaySet
    trees : Shelf
        By name: those of ``options.builders`` in their order, then those that were given.
    options : StudyOptions
    machine : dict
        What times depend on besides.
    store : Store
    sources : dict of str to TreeSource
        Where the trees come from, by the same names.
    own_rays : bool
        Whether the rays were given, rather than made from the scene's cameras.
    """

    scene: Scene
    rays: RaySet
    trees: Shelf
    options: StudyOptions
    machine: dict[str, Any]
    store: Store
    sources: dict[str, TreeSource]
    own_rays: bool = False
