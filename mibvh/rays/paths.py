"""Paths through a scene: what viewpoints see, and where rays that leave it begin."""

from __future__ import annotations

import dataclasses
from typing import Any

from mibvh.errors import MibvhError
from mibvh.rays.origins import clear_origin, corners_of, point_at
from mibvh.scene import Scene
from mibvh.traversal.geometry import triangle_hit
from mibvh.traversal.records import unit_scale
from mibvh.variant import mitsuba
from mibvh.viewpoints import camera_rays


@dataclasses.dataclass(frozen=True, eq=False)
class Vertices:
    """Where paths meet surfaces, one per lane; at the camera, where they begin.

    Attributes
    ----------
    origin : Point3f
        Of rays that leave, on the side that the path came from, clear of the triangle.
    normal : Vector3f
        Of the triangle, on that side.
    triangle : UInt32
    random : PCG32
        The paths' random numbers.
    incoming : Ray3f
        What arrives here. At the camera, vertex 0 of a path, what it sends, and nothing else but
        the random numbers.
    """

    origin: Any
    normal: Any
    triangle: Any
    random: Any
    incoming: Any

    def __len__(self) -> int:
        import drjit as dr

        return int(dr.width(self.incoming))


class Paths:
    """Traces paths with Mitsuba.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        mi = mitsuba()
        self.scene = scene
        self._scale = float(unit_scale(scene.triangles))
        # Zero-copy views of NumPy memory would keep gathers from being vectorised.
        self._corners = mi.Float(scene.triangles.corners.ravel())

    def camera(self, view: int, width: int, height: int, samples: int, seed: int) -> Vertices:
        """Vertex 0 of the paths: what a viewpoint sends through random points of each pixel.

        Raises
        ------
        MibvhError
            If that is NaN or infinite.
        """
        import drjit as dr

        mi = mitsuba()
        random = mi.PCG32(size=width * height * samples, initstate=seed, initseq=view)
        index = dr.arange(mi.UInt32, width * height * samples) // samples
        column, row = index % width, index // width
        place = mi.Point2f(
            (mi.Float(column) + random.next_float32()) / width,
            (mi.Float(row) + random.next_float32()) / height,
        )
        aperture = mi.Point2f(random.next_float32(), random.next_float32())
        rays = camera_rays(self.scene.sensors[view], place, aperture)
        if not dr.all(dr.all(dr.isfinite(rays.o) & dr.isfinite(rays.d))):
            raise MibvhError(
                f"{self.scene.name}: viewpoint {view} makes rays that are no numbers: its transform"
                " is none, or the scene is too small or large for Mitsuba's cameras"
            )
        return Vertices(rays.o, None, None, random, rays)

    def meet(self, rays: Any, random: Any) -> Vertices | None:
        """The next vertices: where rays hit surfaces, without those that hit none.

        Hits of triangles without area, which have no side, are left out too. None where nothing
        is left: Dr.Jit does not compute with arrays of no entries.
        """
        import drjit as dr

        mi = mitsuba()
        hit = self.scene.geometry.ray_intersect_preliminary(rays, coherent=False)
        abc = corners_of(self._corners, hit.prim_index, hit.is_valid())
        at = point_at(*abc, hit.prim_uv.x, hit.prim_uv.y)
        origin, normal = clear_origin(*abc, at, -mi.Vector3d(rays.d))
        went_on = dr.compress(hit.is_valid() & (dr.squared_norm(normal) > 0))
        if len(went_on) == 0:
            return None
        met = Vertices(
            dr.gather(mi.Point3f, origin, went_on),
            dr.gather(mi.Vector3f, mi.Vector3f(normal), went_on),
            dr.gather(mi.UInt32, hit.prim_index, went_on),
            dr.gather(mi.PCG32, random, went_on),
            dr.gather(mi.Ray3f, rays, went_on),
        )
        dr.eval(met.origin, met.normal, met.triangle, met.random)
        return met

    def self_hits(self, rays: Any, triangle: Any) -> int:
        """How many rays hit the triangle that they leave.

        Parameters
        ----------
        rays : Ray3f
        triangle : UInt32
            What each ray leaves.

        Returns
        -------
        int
            By Mitsuba's own intersection, or by the arithmetic of mibvh's kernels.
        """
        import drjit as dr

        mi = mitsuba()
        hit = self.scene.geometry.ray_intersect_preliminary(rays, coherent=False)
        theirs = hit.is_valid() & (hit.prim_index == triangle)
        a, b, c = (mi.Point3d(p * self._scale) for p in corners_of(self._corners, triangle))
        normal = dr.cross(b - a, c - a)
        normal = mi.Vector3f(normal / dr.max(dr.abs(normal)))
        row = [mi.Float(x) for p in (a, b, c, normal) for x in p]
        ours, _ = triangle_hit(row, rays.o * self._scale, rays.d, mi.Float(dr.inf))
        return int(dr.count(theirs | ours)[0])


def cosine_directions(vertices: Vertices) -> Any:
    """Vector3f: directions around the normals, cosine-distributed."""
    import drjit as dr

    mi = mitsuba()
    # Mitsuba's own warp has a maximum in it that LLVM 15 cannot compile on AVX-512 machines.
    u, phi = vertices.random.next_float32(), dr.two_pi * vertices.random.next_float32()
    local = mi.Vector3f(dr.sqrt(u) * dr.cos(phi), dr.sqrt(u) * dr.sin(phi), dr.sqrt(1 - u))
    return mi.Vector3f(mi.Frame3f(vertices.normal).to_world(local))
