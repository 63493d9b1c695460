"""Scenes: Mitsuba XML or dicts, and mesh files, as triangles and viewpoints."""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from mibvh.errors import MibvhError
from mibvh.instances import placed_shapes
from mibvh.loading import printable, read_mesh, sandbox
from mibvh.loading.parser import Parsed, mitsuba_reason, parse_dict, parse_file
from mibvh.loading.shapes import (
    mesh_corners,
    see_through,
    shape_key,
    shape_kind,
    shape_triangles,
    transformed,
)
from mibvh.memory import require_memory
from mibvh.triangles import F32, F64, Triangles
from mibvh.variant import mitsuba, mitsuba_traces, reading_variant
from mibvh.viewpoints import automatic_viewpoints, camera_rays

__all__ = [
    "Scene",
    "find_scene_file",
    "load",
    "makes_rays",
    "mesh_corners",
    "mitsuba_geometry",
    "mitsuba_mesh",
    "mitsuba_reason",
    "scene_name",
    "shape_key",
    "shape_kind",
    "with_cameras_of",
    "with_defines",
]

#: Of every scene that is read where Mitsuba has a GPU's variant without OptiX.
NO_OPTIX = (
    "Mitsuba cannot trace rays in this variant, which takes OptiX: there are no viewpoints and no "
    "picture, rays have to be given, and hits are not compared with Mitsuba's"
)

#: Of scenes with more triangles, Mitsuba's own copy is loaded only where it is needed: it takes 170
#: bytes a triangle, of which its tree is most.
LARGE = 2_000_000


@dataclasses.dataclass(eq=False)
class Scene:
    """Triangles, and the viewpoints that rays start from.

    Attributes
    ----------
    name : str
    triangles : Triangles
        All meshes, instances flattened, transforms applied.
    sensors : list of mitsuba.Sensor
        The scene file's cameras, or automatic ones where it has none; empty on a GPU without OptiX.
    original : mitsuba.Scene or None
        The scene as Mitsuba loads it; None for a bare mesh, where instances are flattened, and
        above :data:`LARGE`: see :attr:`renderable`.
    notes : list of str
        What could not be taken over as triangles, in sentences.
    reload : callable, optional
        Loads ``original`` where that is not kept.
    """

    name: str
    triangles: Triangles
    sensors: list[Any]
    original: Any = None
    notes: list[str] = dataclasses.field(default_factory=list)
    reload: Callable[[], Any] | None = None

    def __repr__(self) -> str:
        cameras = f"{len(self.sensors)} viewpoint{'' if len(self.sensors) == 1 else 's'}"
        return f"Scene({self.name!r}, {len(self.triangles):,} triangles, {cameras})"

    @functools.cached_property
    def geometry(self) -> Any:
        """A Mitsuba scene of exactly these triangles: ``prim_index`` is the triangle id."""
        return mitsuba_geometry(self.triangles)

    @functools.cached_property
    def renderable(self) -> Any:
        """The scene as Mitsuba renders it, instances included; None for a bare mesh."""
        return self.reload() if self.reload else self.original

    def release(self) -> None:
        """Release what Mitsuba holds of the scene; it is made again where it is needed."""
        vars(self).pop("geometry", None)
        if self.reload:
            vars(self).pop("renderable", None)

    def few_rays(self, count: int, seed: int, kind: str = "diffuse") -> Any:
        """Path-trace rays of a kind from about so many camera rays, as many for each viewpoint.

        What the `finite` builder asks a scene for. Where camera rays miss, or a vertex may send
        none (``shadow``), there are fewer.

        Parameters
        ----------
        count, seed : int
        kind : str
            As for :func:`mibvh.make_rays`.

        Returns
        -------
        RaySet
        """
        import mibvh  # rays are made from scenes: this room does not know how

        pixels = max(1.0, count / len(self.sensors))
        height = max(1, round((pixels * 0.75) ** 0.5))
        width = max(1, round(pixels / height))
        return mibvh.make_rays(self, kind, width=width, height=height, samples=1, seed=seed)


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


def with_cameras_of(triangles: Triangles, scene: Any) -> Scene:
    """Make a scene of triangles, with the cameras and the lights of a Mitsuba scene.

    Parameters
    ----------
    triangles : Triangles
    scene : mitsuba.Scene
        Where it has no camera, viewpoints are chosen.
    """
    sensors = [sensor for sensor in scene.sensors() if makes_rays(sensor)]
    return _with_viewpoints(Scene(triangles.name, triangles, sensors, scene))


def load(source: Any, defines: dict[str, Any] | None = None) -> Scene:
    """Load a scene.

    Parameters
    ----------
    source : path, dict, mitsuba.Scene or (N, 3, 3) array
        A Mitsuba 3 XML file or dict; a mesh file (PLY, OBJ, GLB, glTF, STL, OFF; ``docs/scenes.md``
        says what of them is read); the name of a bundled scene, with its size as in
        ``cornell@2000``; triangles, or a trimesh. ``FILE.xml[name=value,...]`` sets parameters of
        an XML file. Where there is no camera, viewpoints are chosen: in open space for interiors,
        around it for objects.
    defines : dict, optional
        Mitsuba's ``-D``: values for the ``$name`` in an XML file. They become part of the scene's
        name.

    Returns
    -------
    Scene

    Raises
    ------
    MibvhError
        If the file is missing or unreadable, or there is no triangle in it.
    """
    if not isinstance(source, str | os.PathLike):
        if defines:
            raise MibvhError("values for $names are for Mitsuba XML files")
        return _from_object(source)
    path, named = find_scene_file(source)
    defines = {**named, **{name: str(value) for name, value in (defines or {}).items()}}
    if sandbox.wanted():
        sandbox.try_to_load(with_defines(os.fspath(path), defines))
    if path.suffix.lower() == ".xml":
        name = with_defines(printable(_scene_name(path)), defines)
        return _from_parsed(name, functools.partial(parse_file, path, defines), printable(path))
    if defines:
        raise MibvhError(
            f"{printable(path)}: -D sets parameters of Mitsuba XML, which this file is not"
        )
    triangles, notes = read_mesh(path)
    return _with_viewpoints(Scene(triangles.name, triangles, [], None, notes))


def scene_name(source: Any) -> str:
    """Return the name that a scene has when it is loaded, without loading it.

    Parameters
    ----------
    source : Scene, or path as for :func:`load`

    Raises
    ------
    MibvhError
        If there is no such file.
    """
    if isinstance(source, Scene):
        return source.name
    path, defines = find_scene_file(source)
    if path.suffix.lower() == ".xml":
        return with_defines(printable(_scene_name(path)), defines)
    return printable(path.stem)


def find_scene_file(source: str | os.PathLike[str]) -> tuple[Path, dict[str, str]]:
    """Find the file that a scene's name stands for, and the parameters that are in the name.

    Parameters
    ----------
    source : path
        A file, the name of a bundled scene, or either with ``[name=value,...]`` behind it.

    Raises
    ------
    MibvhError
        If there is no such file or bundled scene, or it is a folder.
    """
    from mibvh.bundled import bundled_scene

    defines: dict[str, str] = {}
    text = os.fspath(source)
    path = Path(text)
    if not _exists(path) and (match := re.fullmatch(r"(.+)\[([^\[\]]*)\]", text)):
        for pair in match.group(2).split(","):
            name, equals, value = pair.partition("=")
            if not equals or not name:
                raise MibvhError(f"{printable(text)}: in the brackets, write name=value,...")
            defines[unquote(name)] = unquote(value)
        text = match.group(1)
        path = Path(text)
    if not _exists(path):
        path = bundled_scene(text)
    if path.is_dir():
        raise MibvhError(f"{printable(path)}: is a folder; name the scene file in it")
    return path, defines


def with_defines(source: str, defines: dict[str, str]) -> str:
    """Name a scene together with parameters: ``a.xml[n=2]``, which :func:`load` takes.

    >>> with_defines("a.xml", {"n": "2", "file": "b/c"})
    'a.xml[n=2,file=b%2Fc]'
    """
    if not defines:
        return source
    pairs = (f"{quote(k, safe='')}={quote(v, safe='')}" for k, v in defines.items())
    return f"{source}[{','.join(pairs)}]"


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long a name, or a zero byte in it
        return False


def _scene_name(path: Path) -> str:
    """``NAME.xml`` or ``NAME/scene.xml``."""
    if path.stem != "scene" or not path.resolve().parent.name:
        return path.stem
    return path.resolve().parent.name


def _from_object(source: Any) -> Scene:
    """A scene of what is no file."""
    if isinstance(source, Scene):
        return source
    if isinstance(source, dict):
        return _from_parsed("dict", functools.partial(parse_dict, source), "dict")
    mi = mitsuba()
    if isinstance(source, mi.Scene):
        found = _from_shapes("scene", Parsed(source, {}, []), "scene")
        found.original = source
        return _with_viewpoints(found)
    corners = getattr(source, "triangles", source)
    if not isinstance(corners, Triangles | np.ndarray):
        raise MibvhError(
            "a scene is a file, a bundled scene's name, a Mitsuba scene or dict, or triangles; not "
            f"a {type(source).__name__}"
        )
    triangles = corners if isinstance(corners, Triangles) else Triangles(corners)
    return _with_viewpoints(Scene(triangles.name, triangles, []))


def _from_parsed(name: str, parse: Callable[..., Parsed], where: str) -> Scene:
    """A scene that Mitsuba parses, with its instances flattened; again, as it is, to render it."""
    if not mitsuba_traces():
        with reading_variant():
            parsed = parse(flatten=True)
            found = _from_shapes(name, parsed, where)
        found.sensors, found.original = [], None  # they are of the variant that has read them
        return _with_viewpoints(found)
    parsed = parse(flatten=True)
    found = _with_viewpoints(_from_shapes(name, parsed, where))
    if parsed.instances or len(found.triangles) > LARGE:
        found.reload = lambda: parse(flatten=False).scene
        found.original = None
    return found


def _from_shapes(name: str, parsed: Parsed, where: str) -> Scene:
    """Triangles and cameras of a scene that Mitsuba has instantiated; there may be no camera."""
    shapes: list[tuple[F32, list[F64] | None]] = []
    notes = list(parsed.notes)
    try:
        # The order of shapes() may differ between loads; triangle ids must not.
        placed = placed_shapes(parsed.scene, parsed.instances)
        placed.sort(key=lambda found: shape_key(found.shape, found.name))
        for found in placed:
            corners, note = shape_triangles(found.shape)
            if note:
                notes.append(note)
            if corners is not None:
                shapes.append((corners, found.at))
    except UnicodeDecodeError:
        raise MibvhError(f"{where}: the id of a shape, or of a part of it, is not UTF-8") from None
    except MibvhError as error:
        raise MibvhError(f"{where}: {error}") from None
    if note := see_through([found.shape for found in placed]):
        notes.append(note)
    if not shapes:
        detail = f" ({'; '.join(notes)})" if notes else ""
        raise MibvhError(f"{where}: there is no triangle in it{detail}")
    total = sum(len(corners) * (1 if at is None else len(at)) for corners, at in shapes)
    require_memory(total * (36 + 36), f"{where}: its {total:,} triangles")
    parts = [
        part
        for corners, at in shapes
        for part in ([corners] if at is None else (transformed(corners, m) for m in at))
    ]
    try:
        triangles = Triangles(np.concatenate(parts), name)
    except MibvhError as error:
        raise MibvhError(f"{where}: {str(error).removeprefix(f'{name}: ')}") from None
    if not triangles.areas.any():
        raise MibvhError(f"{where}: its {len(triangles):,} triangles all have no area")
    sensors = []
    for sensor in parsed.scene.sensors():
        if makes_rays(sensor):
            sensors.append(sensor)
        else:
            kind = shape_kind(sensor)
            notes.append(f"{kind} makes no rays from the points of an image and was left out")
    original = None if parsed.instances else parsed.scene
    return Scene(name, triangles, sensors, original, notes)


def makes_rays(sensor: Any) -> bool:
    """Whether a sensor is a camera."""
    mi = mitsuba()
    try:
        camera_rays(sensor, mi.Point2f(0.5), mi.Point2f(0.5))
    except MibvhError:
        return False
    return True


def _with_viewpoints(scene: Scene) -> Scene:
    if not mitsuba_traces():
        scene.notes.append(NO_OPTIX)
    elif not scene.sensors:
        scene.sensors = automatic_viewpoints(scene.triangles, scene.geometry)
    return scene
