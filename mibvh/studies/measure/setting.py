"""What an experiment is made on."""

from __future__ import annotations

import dataclasses
from typing import Any

from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.studies.measure.store import Store
from mibvh.studies.record.options import StudyOptions
from mibvh.tree import Tree


@dataclasses.dataclass(frozen=True)
class Setting:
    """A scene that experiments are made on.

    Attributes
    ----------
    scene : Scene
    rays : RaySet
    trees : dict of str to Tree
        By name, in the order of ``options.builders``.
    options : StudyOptions
    machine : dict
        What times depend on besides.
    store : Store
    """

    scene: Scene
    rays: RaySet
    trees: dict[str, Tree]
    options: StudyOptions
    machine: dict[str, Any]
    store: Store
