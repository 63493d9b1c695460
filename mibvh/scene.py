"""Scenes: Mitsuba XML or dicts, and mesh files, as triangles and viewpoints."""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.triangles import F32, Triangles
from mibvh.variant import mitsuba


@dataclasses.dataclass(eq=False)
class Scene:
    """Triangles, and the viewpoints that rays start from.

    Attributes
    ----------
    name : str
    triangles : Triangles
        All meshes, instances flattened, transforms applied.
    sensors : list of mitsuba.Sensor
        The scene file's cameras, or automatic ones where it has none.
    original : mitsuba.Scene or None
        The scene as Mitsuba loads it, for rendering; None for a bare mesh.
    notes : list of str
        What could not be taken over as triangles, in sentences.
    """

    name: str
    triangles: Triangles
    sensors: list[Any]
    original: Any = None
    notes: list[str] = dataclasses.field(default_factory=list)

    @functools.cached_property
    def geometry(self) -> Any:
        """A Mitsuba scene of exactly these triangles: ``prim_index`` is the triangle id."""
        return mitsuba_geometry(self.triangles)

    def few_rays(self, count: int, seed: int) -> Any:
        """Path-trace about so many diffuse rays, as many for each viewpoint.

        What the `finite` builder asks a scene for.

        Parameters
        ----------
        count, seed : int

        Returns
        -------
        RaySet
        """
        from mibvh.rays import diffuse_rays  # which needs scenes

        pixels = max(1.0, count / len(self.sensors))
        height = max(1, round((pixels * 0.75) ** 0.5))
        width = max(1, round(pixels / height))
        return diffuse_rays(self, width=width, height=height, samples=1, seed=seed)


def mitsuba_geometry(triangles: Triangles) -> Any:
    """Make a Mitsuba scene of one mesh whose ``prim_index`` is the triangle id."""
    return mitsuba().load_dict({"type": "scene", "mesh": mitsuba_mesh(triangles)})


def mitsuba_mesh(triangles: Triangles) -> Any:
    """Make a Mitsuba mesh, grey on both sides, whose ``prim_index`` is the triangle id."""
    mi = mitsuba()
    count = len(triangles)
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse"}})
    mesh = mi.Mesh("triangles", vertex_count=3 * count, face_count=count, props=props)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(triangles.corners.ravel())
    params["faces"] = mi.UInt32(np.arange(3 * count, dtype=np.uint32))
    params.update()
    return mesh


def load(source: Any) -> Scene:
    """Load a scene.

    Parameters
    ----------
    source : path, dict, mitsuba.Scene or (N, 3, 3) array
        A Mitsuba 3 XML file or dict; any mesh file that trimesh reads (PLY, OBJ, GLB, STL,
        ...); the name of a bundled scene; or triangles. Where there is no camera, viewpoints
        are chosen: in open space for interiors, around it for objects.

    Returns
    -------
    Scene

    Raises
    ------
    MibvhError
        If the file is missing or unreadable, or there is no triangle in it.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Triangles | np.ndarray):
        triangles = source if isinstance(source, Triangles) else Triangles(source)
        return _with_viewpoints(Scene(triangles.name, triangles, []))
    if isinstance(source, dict):
        return _from_parser("dict", lambda mi, config: mi.parser.parse_dict(config, source))
    mi = mitsuba()
    if isinstance(source, mi.Scene):
        return _from_shapes("scene", source, source.shapes(), {})
    path = Path(source)
    if not path.exists():
        from mibvh.bundled import bundled_scene

        path = bundled_scene(os.fspath(source))
    if path.is_dir():
        raise MibvhError(f"{path}: is a folder; name the scene file in it")
    if path.suffix.lower() == ".xml":
        name = _scene_name(path)
        return _from_parser(
            name,
            lambda mi, config: mi.parser.parse_file(config, str(path)),
            str(path),
            path.parent,
        )
    return _with_viewpoints(Scene(path.stem, _read_mesh(path), []))


def _scene_name(path: Path) -> str:
    """``NAME.xml`` or ``NAME/scene.xml``."""
    if path.stem != "scene" or not path.resolve().parent.name:
        return path.stem
    return path.resolve().parent.name


# ------------------------------------------------------------------ Mitsuba scenes


def _from_parser(
    name: str, parse: Any, where: str | None = None, folder: Path | None = None
) -> Scene:
    """Parse, flatten instances, instantiate; Mitsuba's own error message on failure."""
    mi = mitsuba()
    where = where or name
    resolver = mi.file_resolver()
    saved = mi.FileResolver(resolver)
    try:
        if folder is not None:
            resolver.append(str(folder.resolve()))
        config = mi.parser.ParserConfig(mi.variant())
        config.merge_meshes = False
        state = parse(mi, config)
        if any(node.props.plugin_name().startswith("bvh_") for node in state.nodes):
            import mibvh.mitsuba  # noqa: F401 - registers the integrators that the scene names
        mi.parser.transform_all(config, state)
        instances = _expand_instances(mi, state)
        scene = mi.parser.instantiate(config, state)
        scene = scene[0] if isinstance(scene, list) else scene
        if not isinstance(scene, mi.Scene):
            raise MibvhError(f"{where}: describes no scene")
        return _from_shapes(name, scene, scene.shapes(), instances, where)
    except RuntimeError as error:
        raise MibvhError(f"{where}: Mitsuba cannot load it ({mitsuba_reason(error)})") from None
    finally:
        resolver.clear()
        for entry in saved:
            resolver.append(str(entry))


def mitsuba_reason(error: Exception) -> str:
    """What an error of Mitsuba's parser says, on one line.

    Where a plugin of mibvh's refused, its sentence with the place in the file, not the Python
    traceback that Mitsuba puts around it.
    """
    text = " ".join(re.sub(r"\[parser\.cpp:\d+\] ", "", str(error)).split())
    before, ours, sentence = text.rpartition("MibvhError: ")
    if not ours:
        return text
    place = re.match(r"At .+?\(line \d+, col \d+\)", before)
    return f"{place.group()}: {sentence}" if place else sentence


def _expand_instances(mi: Any, state: Any) -> dict[str, list[np.ndarray]]:
    """Let the members of instanced shape groups stand in the scene once, under known names.

    Returns
    -------
    dict of str to list of (4, 4) float64
        For each such name, where its instances stand.
    """
    root = state.nodes[0].props
    placed: dict[str, list[np.ndarray]] = {}
    for key in list(root.keys()):
        node = _referenced(state, root, key)
        if node is None or node.plugin_name() != "instance":
            continue
        matrix = np.eye(4)
        if "to_world" in node.keys():  # noqa: SIM118 - Properties has no __contains__ for keys
            matrix = np.array(node["to_world"].matrix, dtype=np.float64)
        group = next(
            (
                (node[k].index(), member)
                for k in node.keys()  # noqa: SIM118
                if (member := _referenced(state, node, k)) is not None
                and member.plugin_name() == "shapegroup"
            ),
            None,
        )
        del root[key]
        if group is None:
            continue
        index, members = group
        for k in members.keys():  # noqa: SIM118
            shape = _referenced(state, members, k)
            if shape is None:
                continue
            name = f"__instanced_{index}_{k}"
            if name not in placed:
                placed[name] = []
                shape.set_id(name)
                root[name] = members[k]
            placed[name].append(matrix)
    return placed


def _referenced(state: Any, props: Any, key: str) -> Any:
    """The properties of the node that a property refers to, or None."""
    value = props[key]
    return state.nodes[value.index()].props if hasattr(value, "index") else None


def _from_shapes(
    name: str, scene: Any, shapes: list[Any], instances: dict[str, list[Any]], where: str = ""
) -> Scene:
    parts: list[F32] = []
    notes: list[str] = []
    # The order of shapes() may differ between loads; triangle ids must not.
    for shape in sorted(shapes, key=shape_key):
        corners, note = _shape_triangles(shape)
        if note:
            notes.append(note)
        if corners is None:
            continue
        for matrix in instances.get(shape.id(), [None]):
            parts.append(corners if matrix is None else _transformed(corners, matrix))
    if not parts:
        detail = f" ({'; '.join(notes)})" if notes else ""
        raise MibvhError(f"{where or name}: there is no triangle in it{detail}")
    triangles = Triangles(np.concatenate(parts), name)
    original = None if instances else scene
    return _with_viewpoints(Scene(name, triangles, list(scene.sensors()), original, notes))


def shape_key(shape: Any) -> tuple[Any, ...]:
    """Sort key of a Mitsuba shape, the same in every load."""
    box = shape.bbox()
    return (shape.id(), shape.primitive_count(), *np.array(box.min), *np.array(box.max))


def shape_kind(shape: Any) -> str:
    """Mitsuba's name of a shape's class, such as ``Sphere``."""
    return str(shape).split("[")[0].strip()


def mesh_corners(mesh: Any) -> F32:
    """(N, 3, 3) float32: the triangles of a Mitsuba mesh, in the order of its faces."""
    vertices = np.array(mesh.vertex_positions_buffer(), dtype=np.float32).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), dtype=np.int64).reshape(-1, 3)
    return vertices[faces]


def _transformed(corners: F32, matrix: np.ndarray) -> F32:
    points = corners.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return points.astype(np.float32).reshape(-1, 3, 3)


def _shape_triangles(shape: Any) -> tuple[F32 | None, str]:
    """Triangles of a shape, and a note where it is no mesh."""
    from mibvh.tessellate import tessellate

    kind = shape_kind(shape)
    if shape.is_mesh():
        if shape.face_count() == 0:
            return None, f"{kind} {shape.id()!r} has no faces"
        return mesh_corners(shape), ""
    corners = tessellate(kind, shape)
    if corners is None:
        return None, f"{kind} {shape.id()!r} is not made of triangles and was left out"
    return corners, f"{kind} {shape.id()!r} was tessellated into {len(corners)} triangles"


# ------------------------------------------------------------------ mesh files


def _read_mesh(path: Path) -> Triangles:
    import trimesh

    kind = path.suffix.lower().lstrip(".")
    if kind not in trimesh.available_formats():
        raise MibvhError(f"{path}: neither Mitsuba XML nor a mesh format that trimesh reads")
    try:
        loaded = trimesh.load(path, process=False)
        mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        corners = np.asarray(mesh.triangles, dtype=np.float32)
    except Exception as error:  # trimesh's readers raise whatever their parsers raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MibvhError(f"{path}: cannot be read as a mesh ({reason})") from None
    return Triangles(corners, path.stem)


def _with_viewpoints(scene: Scene) -> Scene:
    if not scene.sensors:
        from mibvh.viewpoints import automatic_viewpoints

        scene.sensors = automatic_viewpoints(scene.triangles, scene.geometry)
    return scene
