"""Instances of a Mitsuba scene: the members of their groups, and their transforms."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.triangles import F64
from mibvh.variant import mitsuba

#: The group's name in an instance's description, the only place that has it.
_GROUP = re.compile(r'shapegroup = ShapeGroup\[\s*name = "(.*)",')


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """A shape, and where it stands.

    Attributes
    ----------
    shape : mitsuba.Shape
    name : str
        Its id, or what :func:`member_name` makes of its place in a group.
    at : list of (4, 4) float64, or None
        Where its instances stand; None for a shape that stands once, as it is.
    """

    shape: Any
    name: str
    at: list[F64] | None


def member_name(group: str, place: int) -> str:
    """Name of a group's member: the same for a scene from a file and one in memory."""
    return f"__instanced_{group}_{place:06d}"


def placed_shapes(scene: Any, known: dict[str, list[F64]]) -> list[Placed]:
    """Shapes of a scene, with the members of shape groups for the instances.

    A shape that several groups hold, or a group and the scene, is there once for each.

    Parameters
    ----------
    scene : mitsuba.Scene
    known : dict of str to list of (4, 4) float64
        Where the shapes of these ids stand, if not as they are.

    Raises
    ------
    MibvhError
        If the group of an instance cannot be told.
    """
    mi = mitsuba()
    shapes = list(scene.shapes())
    instances = [shape for shape in shapes if shape.class_name() == "Instance"]
    placed = [
        Placed(shape, shape.id(), known.get(shape.id()))
        for shape in shapes
        if shape.class_name() != "Instance"
    ]
    groups = _groups(mi, scene) if instances else {}
    where: dict[str, list[F64]] = {}
    for instance in instances:
        told = _GROUP.search(str(instance))
        called = groups.get(told.group(1), []) if told else []
        if told is None or len(called) != 1:
            raise MibvhError(
                f"the shape group of instance {instance.id()!r} cannot be told: "
                f"{len(called)} groups have its name"
            )
        matrix = np.array(mi.traverse(instance)["to_world"].matrix, np.float64).reshape(4, 4)
        where.setdefault(told.group(1), []).append(matrix)
    for name, matrices in where.items():
        members = _objects(mi, groups[name][0])
        placed += [Placed(m, member_name(name, i), matrices) for i, m in enumerate(members)]
    return placed


def _groups(mi: Any, scene: Any) -> dict[str, list[Any]]:
    """Shape groups of a scene by their names, which need not differ."""
    found: dict[str, list[Any]] = {}
    for group in _objects(mi, scene):
        if group.class_name().startswith("ShapeGroup"):
            called = found.setdefault(group.id(), [])
            if group not in called:
                called.append(group)
    return found


def _objects(mi: Any, parent: Any) -> list[Any]:
    """What an object holds, in order, each as often as it does: mi.traverse names it once."""
    found: list[Any] = []

    class Listed(mi.TraversalCallback):
        def put(self, name: str, value: Any, flags: int, cpptype: Any = None) -> None:
            if isinstance(value, mi.Object):
                found.append(value)

        def put_object(self, name: str, value: Any, flags: int) -> None:
            found.append(value)

        def put_value(self, name: str, value: Any, flags: int, cpptype: Any) -> None:
            pass

    parent.traverse(Listed())
    return found
