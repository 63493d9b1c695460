"""Instances of a Mitsuba scene: the members of their groups, and their transforms."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.variant import mitsuba

#: The group's name in an instance's description, the only place that has it.
_GROUP = re.compile(r'shapegroup = ShapeGroup\[\s*name = "(.*)",')


def member_name(group: str, place: int) -> str:
    """Name of a group's member: the same for a scene from a file and one in memory."""
    return f"__instanced_{group}_{place:06d}"


@contextlib.contextmanager
def members_named(scene: Any) -> Iterator[tuple[list[Any], dict[str, list[Any]]]]:
    """Let the members of instanced shape groups stand for the instances, under known names.

    Parameters
    ----------
    scene : mitsuba.Scene

    Yields
    ------
    shapes : list of mitsuba.Shape
        The scene's shapes without its instances, and the groups' members.
    placed : dict of str to list of (4, 4) float64
        Transforms of the instances of each member, by the member's name. The members have these
        names inside the ``with`` block.

    Raises
    ------
    MibvhError
        If the group of an instance cannot be found.
    """
    mi = mitsuba()
    shapes = [shape for shape in scene.shapes() if shape.class_name() != "Instance"]
    instances = [shape for shape in scene.shapes() if shape.class_name() == "Instance"]
    groups = _groups(mi, scene) if instances else {}
    placed: dict[str, list[Any]] = {}
    members: dict[str, Any] = {}
    for instance in instances:
        told = _GROUP.search(str(instance))
        if told is None or told.group(1) not in groups:
            raise MibvhError(f"the shape group of instance {instance.id()!r} cannot be found")
        matrix = np.array(mi.traverse(instance)["to_world"].matrix, np.float64).reshape(4, 4)
        for place, member in enumerate(groups[told.group(1)]):
            name = member_name(told.group(1), place)
            members[name] = member
            placed.setdefault(name, []).append(matrix)
    before = {name: member.id() for name, member in members.items()}
    try:
        for name, member in members.items():
            member.set_id(name)
        yield [*shapes, *members.values()], placed
    finally:
        for name, member in members.items():
            member.set_id(before[name])


def _groups(mi: Any, scene: Any) -> dict[str, list[Any]]:
    """Shapes of each shape group, in order, by the group's name."""
    found: dict[str, list[Any]] = {}
    for node, (parent, _) in mi.traverse(scene).hierarchy.items():
        if parent is not None and parent.class_name().startswith("ShapeGroup"):
            found.setdefault(parent.id(), []).append(node)
    return found
