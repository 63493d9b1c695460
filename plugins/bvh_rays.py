"""The integrator ``bvh_rays``."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mibvh.mitsuba.coverage import Coverage, coverage_colours
from mibvh.mitsuba.parameters import plain_variant, positive, refuse_unknown
from mibvh.rays import RaySet, diffuse_rays
from mibvh.scene import load
from mibvh.studies.measure.cameras import cameras
from mibvh.variant import mitsuba


class BvhRays(mi.SamplingIntegrator):
    r"""Traces diffuse rays into a ray set, and shows on which surfaces they end.

    .. pluginparameters::

     * - viewpoints
       - |int|
       - Number of the scene's cameras to start rays from; 0 for all. (Default: 0)
     * - width, height
       - |int|
       - Pixels per viewpoint for the rays, not for the image. (Default: 320, 240)
     * - samples
       - |int|
       - Paths per pixel. (Default: 4)
     * - bounces
       - |int|
       - Largest number of diffuse rays per path. (Default: 1)
     * - seed
       - |int|
       - Seed of the rays. (Default: 0)
     * - filename
       - |string|
       - File for the rays, for ``mibvh trace`` and ``mibvh.RaySet.load``. (Default: none)

    The rays are those of :func:`mibvh.diffuse_rays`, and stay in the integrator's attribute
    ``rays`` with the viewpoint and bounce of each. The film's channels: the colour shows how
    densely rays end on the surface that is seen, from violet (16 times sparser than if they were
    spread evenly over all surfaces) over green to yellow (16 times denser), and grey where hardly
    any does; ``bounce1.density`` (and so on) is that ratio for the rays of one bounce,
    ``all.density`` for all of them; ``shade`` is the cosine to the view, ``hit`` the share of
    rays that hit anything.

    Shapes other than meshes are tessellated or left out, and named in warnings.

    .. tabs::
        .. code-tab:: xml

            <integrator type="bvh_rays">
                <integer name="bounces" value="2"/>
                <string name="filename" value="rays.npz"/>
            </integrator>

        .. code-tab:: python

            'type': 'bvh_rays',
            'bounces': 2,
            'filename': 'rays.npz'
    """

    def __init__(self, props: mi.Properties) -> None:
        mitsuba()
        plain_variant("bvh_rays", mi.variant())
        super().__init__(props)
        self.how = {
            "viewpoints": int(props.get("viewpoints", 0)) or None,
            "width": positive(props, "width", 320),
            "height": positive(props, "height", 240),
            "samples": positive(props, "samples", 4),
            "bounces": positive(props, "bounces", 1),
            "seed": int(props.get("seed", 0)),
        }
        self.filename = props.get("filename", "")
        refuse_unknown(props, "bvh_rays")
        self.rays: RaySet | None = None
        self._coverage: Coverage | None = None
        #: What the rays depend on besides the parameters: triangles and cameras.
        self._depends: tuple[Any, ...] = ()

    @property
    def layers(self) -> list[str]:
        """Prefixes of the channels: each bounce, and ``all`` first if there are several."""
        bounces = [f"bounce{i + 1}" for i in range(self.how["bounces"])]
        return bounces if len(bounces) == 1 else ["all", *bounces]

    def aov_names(self) -> list[str]:
        """Names of the film's channels beside the colour."""
        return [f"{layer}.density" for layer in self.layers] + ["shade", "hit"]

    def prepare(self, scene, sensor=None, progress=None) -> Coverage:
        """Trace the diffuse rays, unless those of this scene exist already."""
        loaded = load(scene)
        for note in loaded.notes:
            warnings.warn(note, stacklevel=2)
        depends = loaded.triangles.digest, cameras(loaded)
        if self._coverage is None or self._depends != depends:
            tell = (lambda done: progress("rays", done)) if progress else None
            self.rays = diffuse_rays(loaded, **self.how, progress=tell)
            if self.filename:
                self.rays.save(self.filename)
            self._coverage, self._depends = Coverage(loaded, self.rays), depends
        return self._coverage

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Coverage of what each ray sees; see ``mitsuba.SamplingIntegrator.sample``."""
        coverage = self.prepare(scene)
        si = coverage.scene.geometry.ray_intersect(mi.Ray3f(ray), mi.Bool(active))
        hit = np.array(si.is_valid())
        shade = np.where(hit, np.array(dr.abs(dr.dot(si.n, ray.d))), 0)
        points = np.array(si.p).T
        densities = [np.zeros(len(hit)) for _ in self.layers]
        for density, layer in zip(densities, self.layers, strict=True):
            density[hit] = coverage.density(points[hit], layer)
        colours = np.where(hit[:, None], coverage_colours(densities[0], shade), 1)
        rgb = mi.Color3f(np.ascontiguousarray(colours.T, dtype=np.float32))
        colour = mi.Spectrum(rgb if mi.is_rgb else mi.luminance(rgb))
        channels = [mi.Float(v.astype(np.float32)) for v in (*densities, shade, hit)]
        return colour, mi.Bool(hit), channels

    def to_string(self) -> str:
        """Describe the integrator, as Mitsuba's own do."""
        return f"BvhRays[{', '.join(f'{k} = {v}' for k, v in self.how.items())}]"
