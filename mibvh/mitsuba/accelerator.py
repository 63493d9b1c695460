"""A tree that takes the place of a Mitsuba scene's own acceleration structure."""

from __future__ import annotations

import warnings
from typing import Any, Literal, get_args

import numpy as np

from mibvh.errors import MibvhError
from mibvh.mitsuba.trees import Builder, TreeFile
from mibvh.rays.origins import clear_origin, onto_plane
from mibvh.scene import mesh_corners, shape_key, shape_kind, with_cameras_of
from mibvh.traversal.kernel import walk
from mibvh.traversal.pages import ROW, own_memory
from mibvh.traversal.wide import walk_wide_lanes
from mibvh.tree import Tree
from mibvh.triangles import F32, Triangles
from mibvh.variant import mitsuba

_NONE = 0xFFFFFFFF

Style = Literal["wide", "single"]


class Accelerator:
    """Intersects the rays of a Mitsuba scene with a tree.

    Its methods take and return what those of ``mitsuba.Scene`` do, and may be called inside
    Dr.Jit's symbolic loops. Meshes and rectangles are in the tree. Mitsuba traces every other shape
    (spheres, curves, SDF grids, instances, ...) beside the tree, and a warning names it.

    Parameters
    ----------
    scene : mitsuba.Scene
    builder : str, Builder or TreeFile
        A name from ``mibvh builders``, or what a plugin's parameters say.
    style : "wide" or "single"
        Walk the tree collapsed to nodes of eight children, or as it is. The hits are the same.
    progress : callable, optional
        Called as ``progress(stage, done)`` while the tree is built.
    **options
        The builder's.

    Attributes
    ----------
    triangles : Triangles
    tree : Tree

    Raises
    ------
    MibvhError
        If there is no triangle in the scene, or for an unknown builder or option.
    """

    def __init__(
        self,
        scene: Any,
        builder: str | Builder | TreeFile = "sbvh",
        *,
        style: Style = "wide",
        progress: Any = None,
        **options: Any,
    ) -> None:
        import drjit as dr

        check_style(style)
        mi = mitsuba()
        shapes = sorted(scene.shapes(), key=shape_key)
        shapes = [s for s in shapes if not (s.is_mesh() and s.face_count() == 0)]
        meshes = [shape for shape in shapes if holds(shape)]
        others = [shape for shape in shapes if not holds(shape)]
        if not meshes:
            raise MibvhError("there is no mesh in the scene to build a tree for")
        # Instances cannot be taken out of their scene. Mitsuba then traces the whole scene, and its
        # hits on meshes of the tree are ignored.
        self._all_traced = any(shape_kind(shape) == "Instance" for shape in others)
        parts = [mesh_corners(shape) for shape in meshes]
        name = "the scene without its instances" if self._all_traced else "scene"
        self.triangles = Triangles(np.concatenate(parts), name)
        self.tree: Tree
        if isinstance(builder, str):
            builder = Builder(builder, tuple(sorted(options.items())))
        self.tree, self._records = builder.tree(
            with_cameras_of(self.triangles, scene) if builder.asks_scene else self.triangles,
            progress,
            "wide" if style == "wide" else "binary",
        )
        # -- from triangle ids to Mitsuba's shapes and primitives, and to corners
        counts = [len(part) for part in parts]
        first = np.cumsum([0, *counts[:-1]])
        pointers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in meshes]
        self._rows = own_memory(_rows(self.triangles.corners, pointers, counts))
        # and back: the first triangle of the shape with each pointer, -1 for those beside the tree
        first_of = np.full(max(pointers) + 1, -1, np.int32)
        first_of[pointers] = first
        self._first_of = mi.Int32(first_of)
        dr.eval(self._first_of)
        self._others = scene if self._all_traced else _scene_of(others) if others else None
        if others:
            warnings.warn(
                f"a tree of triangles cannot hold {_named(others)}: Mitsuba traces that beside "
                "the tree",
                stacklevel=2,
            )

    def intersect(self, ray: Any, active: Any = True) -> Any:
        """Find the closest hit of each ray.

        Parameters
        ----------
        ray : mitsuba.Ray3f
        active : Bool

        Returns
        -------
        mitsuba.PreliminaryIntersection3f
        """
        import drjit as dr

        mi = mitsuba()
        o, d, tmax, active = self._spread(ray, active)
        if self._others is not None:
            other = self._others.ray_intersect_preliminary(ray, coherent=False, active=active)
            if self._all_traced:
                other.valid &= (other.instance != None) | ~_in_tree(other.shape)  # noqa: E711
                other.t = dr.select(other.valid, other.t, dr.inf)
            tmax = dr.select(other.is_valid(), other.t, tmax)
        t, triangle = self._walk(o, d, tmax, active, any_hit=False)
        valid = active & (triangle != _NONE)
        pi = dr.zeros(mi.PreliminaryIntersection3f, dr.width(o))
        pi.valid = valid
        pi.t = dr.select(valid, t, dr.inf)
        row = self._row(triangle, valid)
        shape, primitive = (
            dr.select(valid, dr.reinterpret_array(mi.UInt32, row[i]), 0) for i in (9, 10)
        )
        pi.prim_index = primitive
        pi.shape = dr.reinterpret_array(mi.ShapePtr, shape)
        pi.prim_uv = dr.select(valid, _barycentric(o, d, _corners(row)), 0)
        if self._others is not None:
            pi = dr.select(valid, pi, other)
        return pi

    def occluded(self, ray: Any, active: Any = True) -> Any:
        """Find out which rays hit anything. They end at the first hit found, as shadow rays do.

        Parameters
        ----------
        ray : mitsuba.Ray3f
        active : Bool

        Returns
        -------
        Bool
        """
        o, d, tmax, active = self._spread(ray, active)
        _, triangle = self._walk(o, d, tmax, active, any_hit=True)
        hit = active & (triangle != _NONE)
        if self._others is not None:
            hit |= self._others.ray_test(ray, active & ~hit)
        return hit

    def spawn_ray(self, si: Any, d: Any) -> Any:
        """Ray that leaves a surface, clear of it and no farther than it must be.

        Mitsuba's own moves by 1e-4 and 1e-4 of the coordinates: through a scene that is small, or
        far from the origin. That still serves for shapes beside the tree.

        Parameters
        ----------
        si : mitsuba.SurfaceInteraction3f
        d : mitsuba.Vector3f

        Returns
        -------
        mitsuba.Ray3f
            See :func:`mibvh.rays.origins.clear_origin`.
        """
        import drjit as dr

        mi = mitsuba()
        ray = si.spawn_ray(d)
        pointer = dr.reinterpret_array(mi.UInt32, si.shape)
        known = si.is_valid() & (pointer < dr.width(self._first_of))
        first = dr.gather(mi.Int32, self._first_of, pointer, known)
        known &= first >= 0
        row = self._row(mi.UInt32(first) + si.prim_index, known)
        a, b, c = (mi.Point3d(corner) for corner in _corners(row))
        at = onto_plane(a, b, c, mi.Point3d(si.p))
        origin, normal = clear_origin(a, b, c, at, mi.Vector3d(d))
        ray.o = dr.select(known & (dr.squared_norm(normal) > 0), origin, ray.o)
        return ray

    def spawn_ray_to(self, si: Any, target: Any) -> Any:
        """Ray that leaves a surface for a point, and ends short of it; see :meth:`spawn_ray`."""
        import drjit as dr

        mi = mitsuba()
        ray = self.spawn_ray(si, target - si.p)
        way = target - ray.o
        distance = dr.norm(way)
        ray.d = way / distance
        ray.maxt = distance * (1 - mi.math.ShadowEpsilon)
        return ray

    def _walk(self, o: Any, d: Any, tmax: Any, active: Any, any_hit: bool) -> tuple[Any, Any]:
        scale = self._records.scale
        rays = o * scale, d, tmax * scale, active
        if self._records.layout == "binary":
            t, triangle, *_ = walk(self._records, *rays, cull=True, count=False, any_hit=any_hit)
        else:
            t, triangle = walk_wide_lanes(self._records, *rays, any_hit=any_hit)
        return t / scale, triangle

    @staticmethod
    def _spread(ray: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """Give all parts of a ray the same width, as the kernel's stack needs it."""
        import drjit as dr

        mi = mitsuba()
        n = max(dr.width(ray), dr.width(active))
        o, d = mi.Point3f(ray.o), mi.Vector3f(ray.d)
        tmax, active = mi.Float(ray.maxt), mi.Bool(active)
        if n > 1:
            every = dr.arange(mi.UInt32, n) < n
            o, d = dr.select(every, o, 0), dr.select(every, d, 0)
            tmax, active = dr.select(every, tmax, 0), active & every
        return o, d, tmax, active

    def _row(self, triangle: Any, active: Any) -> Any:
        """What is known of a triangle, fetched at once; see :func:`_rows`."""
        import drjit as dr

        mi = mitsuba()
        n = max(dr.width(triangle), dr.width(active))
        return dr.gather(mi.ArrayXf, self._rows, triangle, active, shape=(ROW, n))


def _rows(corners: F32, pointers: list[int], counts: list[int]) -> F32:
    """A row per triangle: corners, pointer to its shape, its number there, five spare."""
    rows = np.zeros((len(corners), ROW), np.float32)
    rows[:, :9] = corners.reshape(-1, 9)
    bits = rows.view(np.uint32)
    bits[:, 9] = np.repeat(pointers, counts)
    bits[:, 10] = np.concatenate([np.arange(count) for count in counts])
    return rows


def _corners(row: Any) -> list[Any]:
    """Three Point3f: the corners in a row."""
    mi = mitsuba()
    return [mi.Point3f(row[i], row[i + 1], row[i + 2]) for i in (0, 3, 6)]


def _barycentric(o: Any, d: Any, corners: list[Any]) -> Any:
    """Barycentric coordinates of the hit (Moeller and Trumbore 1997)."""
    import drjit as dr

    a, b, c = corners
    e1, e2, s = b - a, c - a, o - a
    p, q = dr.cross(d, e2), dr.cross(s, e1)
    return mitsuba().Point2f(dr.dot(s, p), dr.dot(d, q)) * dr.rcp(dr.dot(e1, p))


def check_style(style: str) -> None:
    """Refuse styles that an accelerator does not have.

    Raises
    ------
    MibvhError
    """
    if style not in get_args(Style):
        raise MibvhError(f"style must be one of {', '.join(get_args(Style))}, not {style!r}")


def holds(shape: Any) -> bool:
    """Whether a tree of triangles represents a shape exactly as Mitsuba traces it."""
    return bool(shape.is_mesh() and _in_tree(shape))


def _in_tree(shape: Any) -> Any:
    """Whether a shape, or each lane's shape, is of a type that trees can hold."""
    mi = mitsuba()
    kind = shape.shape_type()
    return (kind == int(mi.ShapeType.Mesh)) | (kind == int(mi.ShapeType.Rectangle))


def _scene_of(shapes: list[Any]) -> Any:
    """Make a Mitsuba scene of existing shapes."""
    mi = mitsuba()
    ids = [shape.id() for shape in shapes]
    scene = mi.load_dict({"type": "scene", **{f"shape_{i}": s for i, s in enumerate(shapes)}})
    for shape, name in zip(shapes, ids, strict=True):
        shape.set_id(name)  # load_dict replaced it
    return scene


def _named(shapes: list[Any]) -> str:
    """Name the first few of some shapes."""
    names = ", ".join(f"{shape_kind(s)} {s.id()!r}" for s in shapes[:5])
    return names + (f" and {len(shapes) - 5} more" if len(shapes) > 5 else "")
