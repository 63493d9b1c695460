"""Mitsuba's XML and dicts: parsed, shape groups expanded, instantiated.

Mitsuba itself reads the meshes that a scene names, and its hits are what ours are compared with; so
what it makes of them is taken over as it is.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.instances import member_name
from mibvh.loading import check_regular, ply, printable
from mibvh.loading.mesh import Refused
from mibvh.registration import register
from mibvh.triangles import F64
from mibvh.variant import mitsuba


@dataclasses.dataclass(frozen=True, eq=False)
class Parsed:
    """A scene as Mitsuba instantiates it.

    Attributes
    ----------
    scene : mitsuba.Scene
    instances : dict of str to list of (4, 4) float64
        Where the shapes of that id stand; each of the others stands once, as it is.
    notes : list of str
    """

    scene: Any
    instances: dict[str, list[F64]]
    notes: list[str]


def parse_dict(source: dict[str, Any], flatten: bool = True) -> Parsed:
    """Instantiate a scene from a dict; see :func:`parse_file`.

    Raises
    ------
    MibvhError
        With Mitsuba's own message.
    """
    parse = lambda mi, config: mi.parser.parse_dict(config, source)  # noqa: E731
    return _parse("dict", parse, flatten=flatten)


def parse_file(path: Path, defines: dict[str, str], flatten: bool = True) -> Parsed:
    """Instantiate a scene from an XML file.

    Parameters
    ----------
    path : Path
    defines : dict
        Values for the ``$name`` in it.
    flatten : bool
        Whether members of shape groups are to stand in the scene, once each, in place of instances.

    Raises
    ------
    MibvhError
        With Mitsuba's own message, or if the file's name is one that Mitsuba cannot take.
    """
    check_regular(path)
    where, name = str(path), printable(path)
    resolved = str(path.resolve())
    if not (_is_utf8(where) and _is_utf8(resolved)):
        raise MibvhError(f"{name}: Mitsuba opens no file whose name is not UTF-8; rename it")
    return _parse(
        name,
        lambda mi, config: mi.parser.parse_file(config, where, **defines),
        path.parent,
        flatten,
    )


def _is_utf8(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _parse(
    where: str,
    parse: Callable[[Any, Any], Any],
    folder: Path | None = None,
    flatten: bool = True,
) -> Parsed:
    """Parse, expand shape groups, instantiate; Mitsuba's own error message on failure."""
    mi = mitsuba()
    resolver = mi.file_resolver()
    saved = mi.FileResolver(resolver)
    try:
        if folder is not None:
            resolver.append(str(folder.resolve()))
        config = mi.parser.ParserConfig(mi.variant())
        # Meshes that are merged would give the triangles other numbers; nodes that are merged, to
        # an integrator, be the same shape twice.
        config.merge_meshes = False
        config.merge_equivalent = flatten
        state = parse(mi, config)
        if any(node.props.plugin_name().startswith("bvh_") for node in state.nodes):
            register()
        mi.parser.transform_all(config, state)
        _check_files(mi, state, resolver)
        instances = _expand_instances(mi, state) if flatten else {}
        scene, notes = _instantiate(mi, config, state)
    except MibvhError as error:
        raise MibvhError(f"{where}: {error}") from None
    except MemoryError:
        raise MibvhError(f"{where}: there is too little memory for it") from None
    except Exception as error:  # RuntimeError, and what bytes that are no text make of it
        reason = mitsuba_reason(error)
        raise MibvhError(f"{where}: Mitsuba cannot load it ({reason})") from error
    finally:
        resolver.clear()
        for entry in saved:
            resolver.append(str(entry))
    if not isinstance(scene, mi.Scene):
        raise MibvhError(f"{where}: describes no scene")
    return Parsed(scene, instances, notes)


def mitsuba_reason(error: Exception) -> str:
    """What an error of Mitsuba's parser says, on one line.

    Where a plugin of mibvh's refused, its sentence with the place in the file, not the Python
    traceback that Mitsuba puts around it.
    """
    if isinstance(error, UnicodeError):
        return "its message, or the file, has bytes that are not UTF-8"
    text = " ".join(re.sub(r"\[parser\.cpp:\d+\] ", "", str(error)).split())
    before, ours, sentence = text.rpartition("MibvhError: ")
    if not ours:
        return text or type(error).__name__
    place = re.match(r"At .+?\(line \d+, col \d+\)", before)
    return f"{place.group()}: {sentence}" if place else sentence


# ------------------------------------------------------------------ before Mitsuba opens files


def _check_files(mi: Any, state: Any, resolver: Any) -> None:
    """Refuse pipes, which would be waited for, and meshes that declare more than they hold."""
    for node in state.nodes:
        for name in node.props.keys():  # noqa: SIM118 - Properties is no dict
            value = node.props[name]
            if name != "filename" or not isinstance(value, str):
                continue
            path = Path(str(resolver.resolve(value)))
            if not path.exists():
                continue  # Mitsuba says which shape asked for it
            check_regular(path)
            if node.props.plugin_name() == "ply":
                try:
                    ply.check_file(path)
                except Refused as error:
                    raise MibvhError(f"{printable(path)}: {error}") from None


def _instantiate(mi: Any, config: Any, state: Any) -> tuple[Any, list[str]]:
    """Instantiate a scene, without its integrator if that is what stands in the way.

    Only the geometry and the cameras are needed: an integrator for another variant does not matter.
    """
    try:
        return _one(mi.parser.instantiate(config, state)), []
    except RuntimeError as error:
        found = re.search(r"instantiate integrator plugin of type \"(\w+)\"", str(error))
        if found is None or found.group(1).startswith("bvh_"):  # ours: a mistake in the scene
            raise
        note = (
            f"its integrator {found.group(1)!r} does not fit the variant {mi.variant()} and was "
            "left out"
        )
    root = state.nodes[0].props
    for key, node in list(_children(mi, state, root)):
        if node.type == mi.ObjectType.Integrator:
            del root[key]
    return _one(mi.parser.instantiate(config, state)), [note]


def _one(found: Any) -> Any:
    return found[0] if isinstance(found, list) else found


# ------------------------------------------------------------------ instances


def _children(mi: Any, state: Any, props: Any) -> Iterator[tuple[str, Any]]:
    """The nodes that a node refers to, with the names of the properties that do."""
    for key in list(props.keys()):
        value = props[key]
        if isinstance(value, mi.Properties.ResolvedReference):
            yield key, state.nodes[value.index()]


def _expand_instances(mi: Any, state: Any) -> dict[str, list[F64]]:
    """Let the members of instanced shape groups stand in the scene once, under known names.

    Returns
    -------
    dict of str to list of (4, 4) float64
        For each such name, where its instances stand.
    """
    root = state.nodes[0].props
    placed: dict[str, list[F64]] = {}
    for key, node in list(_children(mi, state, root)):
        if node.props.plugin_name() != "instance":
            continue
        matrix = np.eye(4)
        if "to_world" in node.props.keys():  # noqa: SIM118 - Properties has no __contains__
            matrix = np.array(node.props["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        group = next(
            (
                member
                for k, member in _children(mi, state, node.props)
                if member.props.plugin_name() == "shapegroup"
            ),
            None,
        )
        del root[key]
        if group is None:
            continue
        for place, (reference, shape) in enumerate(_members(mi, state, group.props)):
            name = member_name(group.props.id(), place)
            if name not in placed:
                placed[name] = []
                shape.props.set_id(name)
                root[name] = reference
            placed[name].append(matrix)
    return placed


def _members(mi: Any, state: Any, props: Any) -> Iterator[tuple[Any, Any]]:
    """Shapes of a group, those that are merged in it too: reference and node."""
    for key, node in _children(mi, state, props):
        if node.type != mi.ObjectType.Shape:
            continue
        if node.props.plugin_name() == "merge":
            yield from _members(mi, state, node.props)
        else:
            yield props[key], node
