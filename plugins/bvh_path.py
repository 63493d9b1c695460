"""The integrator ``bvh_path``."""

from __future__ import annotations

import warnings

import drjit as dr
import mitsuba as mi

from mibvh.errors import MibvhError
from mibvh.mitsuba.accelerator import Accelerator, check_style
from mibvh.mitsuba.parameters import plain_variant, read_tree_source, refuse_unknown
from mibvh.variant import mitsuba


class BvhPath(mi.SamplingIntegrator):
    r"""Path tracer that traces every ray through a tree.

    .. pluginparameters::

     * - builder
       - |string|
       - Builder of the tree: a name from ``mibvh builders``. (Default: ``sbvh``)
     * - tree
       - |string|
       - File of a tree of this scene, in the place of a builder.
     * - max_depth
       - |int|
       - Longest path; -1 for no limit. 1 shows emitters alone, 2 direct light. (Default: -1)
     * - rr_depth
       - |int|
       - Path length from which on Russian roulette may end a path. (Default: 5)
     * - hide_emitters
       - |bool|
       - Hide directly visible emitters. (Default: false)
     * - style
       - |string|
       - ``wide``: the tree is collapsed to nodes of eight children, as renderers have them.
         ``single``: it is walked as it is. (Default: ``wide``)
     * - max_leaf, c_inner, ...
       - |int| or |float|
       - Any option of the builder.

    The image is that of Mitsuba's ``path``: the algorithm is the same (next-event estimation and
    BSDF sampling, weighted by the power heuristic of Veach), and it takes the same random numbers
    in the same order. Like ``path`` it passes through participating media as if they were not
    there. Rays leave triangles nearer to them than those of ``path``: images of tiny scenes, and of
    scenes far from the origin, are those of the same scene elsewhere, which ``path``'s are not.
    Not differentiable.

    .. tabs::
        .. code-tab:: xml

            <integrator type="bvh_path">
                <string name="builder" value="sbvh"/>
                <integer name="max_leaf" value="4"/>
            </integrator>

        .. code-tab:: python

            'type': 'bvh_path',
            'builder': 'sbvh',
            'max_leaf': 4
    """

    def __init__(self, props: mi.Properties) -> None:
        mitsuba()
        plain_variant("bvh_path", mi.variant())
        super().__init__(props)
        depth = int(props.get("max_depth", -1))
        if depth < -1:
            raise MibvhError(f"max_depth must be at least 0, or -1 for no limit, not {depth}")
        self.max_depth = depth if depth >= 0 else 0xFFFFFFFF
        self.rr_depth = int(props.get("rr_depth", 5))
        if self.rr_depth < 1:
            raise MibvhError(f"rr_depth must be at least 1, not {self.rr_depth}")
        self.style = str(props.get("style", "wide"))
        check_style(self.style)
        self.source = read_tree_source(props, "builder", "sbvh")
        refuse_unknown(props, "bvh_path")

    def prepare(self, scene, sensor=None, progress=None) -> Accelerator:
        """Build the scene's tree, unless it is cached."""
        for shape in scene.shapes():
            if shape.is_medium_transition():
                warnings.warn(
                    f"bvh_path, like path, ignores the medium of shape {shape.id()!r}",
                    stacklevel=2,
                )
                break
        return Accelerator(scene, self.source, style=self.style, progress=progress)

    @dr.syntax
    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance along each ray; see ``mitsuba.SamplingIntegrator.sample``."""
        if dr.hint(self.max_depth == 0, mode="scalar"):
            return mi.Spectrum(0), mi.Bool(False), []
        tree = self.prepare(scene)
        context = mi.BSDFContext()

        ray = mi.Ray3f(ray)
        active = mi.Bool(active)
        β = mi.Spectrum(1)  # Throughput
        L = mi.Spectrum(0)  # Radiance so far
        η = mi.Float(1)  # Refractive index passed into
        depth = mi.UInt32(0)
        visible = mi.Bool(not self.hide_emitters and scene.environment() is not None)
        si_prev = dr.zeros(mi.Interaction3f)
        pdf_prev = mi.Float(1)
        delta_prev = mi.Bool(True)

        pi = tree.intersect(ray, active)
        if dr.hint(self.hide_emitters, mode="scalar"):
            pi = self._behind_emitters(tree, ray, pi, active)

        while dr.hint(active, label="bvh_path"):
            si = pi.compute_surface_interaction(ray, mi.RayFlags.All)

            # ---------------------- Direct emission ----------------------

            ds = mi.DirectionSample3f(scene, si, si_prev)
            emitter_pdf = scene.pdf_emitter_direction(si_prev, ds, ~delta_prev)
            L = dr.fma(β, ds.emitter.eval(si, pdf_prev > 0) * _mis(pdf_prev, emitter_pdf), L)

            # ---------------------- Emitter sampling ----------------------

            go_on = (depth + 1 < self.max_depth) & si.is_valid()
            bsdf = si.bsdf(ray)
            lit = go_on & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), False, lit)
            lit &= ds.pdf != 0
            wo = si.to_local(ds.d)

            # ------------------------ BSDF sampling -----------------------

            value, pdf, bsdf_sample, bsdf_weight = bsdf.eval_pdf_sample(
                context, si, wo, sampler.next_1d(), sampler.next_2d()
            )
            mis = dr.select(ds.delta, 1, _mis(ds.pdf, pdf))
            L_lit = dr.fma(β, value * weight * mis, L)

            # ------------- Loop variables for the next vertex -------------

            # Both rays before any is traced: what is known of the surface is then fetched once,
            # and need not be kept while the tree is walked.
            shadow = tree.spawn_ray_to(si, ds.p)
            ray = tree.spawn_ray(si, si.to_world(bsdf_sample.wo))
            β *= bsdf_weight
            η *= bsdf_sample.eta
            passed = mi.has_flag(bsdf_sample.sampled_type, mi.BSDFFlags.Null)
            visible |= si.is_valid() & ~passed
            si_prev = mi.Interaction3f(si)
            pdf_prev = bsdf_sample.pdf
            delta_prev = mi.has_flag(bsdf_sample.sampled_type, mi.BSDFFlags.Delta)

            # ---------------------- Stopping criterion --------------------

            depth[si.is_valid()] += 1
            β_max = dr.max(β)
            survival = β_max * dr.square(η)
            survival = dr.select(survival < 0.95, survival, 0.95)
            roulette = depth >= self.rr_depth
            survives = sampler.next_1d() < survival
            β[roulette] *= dr.rcp(survival)
            active = go_on & (~roulette | survives) & (β_max != 0)

            # --------------------------- Tracing --------------------------

            lit &= ~tree.occluded(shadow, lit)
            L = dr.select(lit, L_lit, L)
            pi = tree.intersect(ray, active)

        return dr.select(visible, L, 0), visible, []

    @dr.syntax
    def _behind_emitters(self, tree, ray, pi, active):
        """First hits of camera rays that pass through emitters."""
        passing = active & pi.is_valid() & (pi.shape.emitter() != None)  # noqa: E711 - lanes
        onward = mi.Ray3f(ray)
        while dr.hint(passing, label="behind emitters"):
            si = pi.compute_surface_interaction(onward, mi.RayFlags.Minimal, passing)
            onward = tree.spawn_ray(si, ray.d)
            pi = tree.intersect(onward, passing)
            passing &= pi.is_valid() & (pi.shape.emitter() != None)  # noqa: E711 - lanes
        return pi

    def to_string(self) -> str:
        """Describe the integrator, as Mitsuba's own do."""
        return (
            f"BvhPath[\n  tree = {self.source},\n  style = {self.style},\n"
            f"  max_depth = {self.max_depth},\n  rr_depth = {self.rr_depth}\n]"
        )


def _mis(a: mi.Float, b: mi.Float) -> mi.Float:
    """Power heuristic."""
    weight = dr.square(a) / (dr.square(a) + dr.square(b))
    return dr.select(dr.isfinite(weight), weight, 0)
