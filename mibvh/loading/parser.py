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
from mibvh.loading import check_regular, ply, printable, serialized
from mibvh.loading.mesh import Refused
from mibvh.registration import register
from mibvh.triangles import F64
from mibvh.variant import mitsuba, spare_thread


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
            # In front, as Mitsuba has it: the working folder may hold files of the same names.
            resolver.prepend(str(folder.resolve()))
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
        with spare_thread():  # textures and skies may be OpenEXR files
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
    text = text.rpartition("while processing <include>: ")[2]  # each file above says it again
    before, ours, sentence = text.rpartition("MibvhError: ")
    if not ours:
        return text or type(error).__name__
    place = re.match(r"At .+?\(line \d+, col \d+\)", before)
    return f"{place.group()}: {sentence}" if place else sentence


# ------------------------------------------------------------------ before Mitsuba opens files


def _check_files(mi: Any, state: Any, resolver: Any) -> None:
    """Refuse pipes, which would be waited for, and meshes that name more than they hold."""
    for node in state.nodes:
        value = _peek(node.props, "filename")
        if not isinstance(value, str):
            continue
        path = Path(str(resolver.resolve(value)))
        if not path.exists():
            continue  # Mitsuba says which shape asked for it
        check_regular(path)
        try:
            if node.props.plugin_name() == "ply":
                ply.check_file(path)
            elif node.props.plugin_name() == "serialized":
                serialized.check_file(path, _peek(node.props, "shape_index") or 0)
        except Refused as error:
            raise MibvhError(f"{printable(path)}: {error}") from None


def _peek(props: Any, key: str) -> Any:
    """A property, None if there is none.

    Mitsuba refuses what no plugin has asked for, such as misspelt names: this asks for nothing.
    """
    if key not in props:
        return None
    asked = props.was_queried(key)
    value = props[key]
    props.mark_queried(key, asked)
    return value


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
    for child in _children(mi, state, 0):
        if state.nodes[child.index].type == mi.ObjectType.Integrator:
            del state.nodes[0].props[child.key]
    return _one(mi.parser.instantiate(config, state)), [note]


def _one(found: Any) -> Any:
    return found[0] if isinstance(found, list) else found


# ------------------------------------------------------------------ instances


@dataclasses.dataclass(frozen=True)
class _Child:
    """A node that another one refers to: by which property, and its place in the list of nodes."""

    key: str
    index: int


def _children(mi: Any, state: Any, index: int) -> list[_Child]:
    """The nodes that a node refers to, in order.

    By their places: a list of nodes that grows may move them.
    """
    props = state.nodes[index].props
    found = ((key, _peek(props, key)) for key in list(props.keys()))
    return [
        _Child(key, value.index())
        for key, value in found
        if isinstance(value, mi.Properties.ResolvedReference)
    ]


def _expand_instances(mi: Any, state: Any) -> dict[str, list[F64]]:
    """Let the members of instanced shape groups stand in the scene once, under known names.

    Instances that are not as Mitsuba wants them are left to it: it says what is wrong with them.

    Returns
    -------
    dict of str to list of (4, 4) float64
        For each such name, where its instances stand.
    """
    _open_merged_instances(mi, state)
    root = _children(mi, state, 0)
    used = set(_members(mi, state, 0))
    placed: dict[str, list[F64]] = {}
    for child in root:
        if _plugin(state, child.index) != "instance":
            continue
        group = _group_of(mi, state, child.index)
        if group not in {other.index for other in root}:
            continue
        del state.nodes[0].props[child.key]
        to_world = _peek(state.nodes[child.index].props, "to_world")
        matrix = np.eye(4) if to_world is None else _as_kept(to_world)
        for place, member in enumerate(_members(mi, state, group)):
            name = member_name(state.nodes[group].props.id(), place)
            if name not in placed:
                placed[name] = []
                state.nodes[0].props[name] = _named(mi, state, member, name, used)
            placed[name].append(matrix.reshape(4, 4))
    return placed


def _as_kept(to_world: Any) -> F64:
    """Return a transform as an instance keeps it, in single precision: as in a loaded scene."""
    with np.errstate(over="ignore"):
        return np.array(to_world.matrix, np.float64).astype(np.float32).astype(np.float64)


def _open_merged_instances(mi: Any, state: Any) -> None:
    """Let the shapes of merges that hold an instance stand in the scene themselves."""
    for child in _children(mi, state, 0):
        parts = _children(mi, state, child.index)
        members = list(_members(mi, state, child.index))
        if (
            _plugin(state, child.index) == "merge"
            and "instance" in {_plugin(state, member) for member in members}
            and len(parts) == len(state.nodes[child.index].props.keys())
        ):
            root = state.nodes[0].props
            del root[child.key]
            for place, member in enumerate(members):
                root[f"__{child.key}_{place}"] = mi.Properties.ResolvedReference(member)


def _members(mi: Any, state: Any, index: int) -> Iterator[int]:
    """Shapes that a node holds, those that are merged in it too."""
    for child in _children(mi, state, index):
        if _plugin(state, child.index) == "merge":
            yield from _members(mi, state, child.index)
        elif state.nodes[child.index].type == mi.ObjectType.Shape:
            yield child.index


def _group_of(mi: Any, state: Any, instance: int) -> int | None:
    """The group of an instance that has nothing beside it and its transform."""
    children = _children(mi, state, instance)
    names = {child.key for child in children} | {"to_world"}
    if len(children) != 1 or not names.issuperset(state.nodes[instance].props.keys()):
        return None
    group = children[0].index
    return group if _plugin(state, group) == "shapegroup" else None


def _named(mi: Any, state: Any, index: int, name: str, used: set[int]) -> Any:
    """Refer to a node under a name of its own: to a copy, if it stands elsewhere too."""
    if index in used:
        state.nodes.append(mi.parser.SceneNode(state.nodes[index]))
        index = len(state.nodes) - 1
    used.add(index)
    state.nodes[index].props.set_id(name)
    return mi.Properties.ResolvedReference(index)


def _plugin(state: Any, index: int) -> str:
    return str(state.nodes[index].props.plugin_name())
