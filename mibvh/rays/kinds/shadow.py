"""Shadow rays: light sampling, as in a path tracer's next-event estimation."""

from __future__ import annotations

from typing import Any

from mibvh.scene import Scene
from mibvh.variant import mitsuba

#: The least cosine to the normal, as that of cosine-distributed directions is: nearer to the
#: horizon, hardly any light arrives.
_GRAZING = 2.0**-11.5


def leave(paths: Any, vertices: Any, options: Any) -> tuple[Any, Any]:
    """One ray per vertex towards what Mitsuba's light sampling chooses.

    Lights are chosen as Mitsuba's integrators do, evenly unless they have weights. Rays to the
    environment and to distant lights are endless; those to other lights end short of these by
    Mitsuba's own share. No ray goes to lights below the horizon, nor to the back of area lights.
    A scene without lights has a white sky all around. See
    :meth:`mibvh.rays.kinds.Kind.leave`.
    """
    import drjit as dr

    mi = mitsuba()
    lit = _lit(mi, paths.scene)
    here = dr.zeros(mi.SurfaceInteraction3f, len(vertices))
    here.p, here.n = vertices.origin, vertices.normal
    sample = mi.Point2f(vertices.random.next_float32(), vertices.random.next_float32())
    chosen, weight = lit.sample_emitter_direction(here, sample, False)
    endless = mi.has_flag(chosen.emitter.flags(), mi.EmitterFlags.Infinite)
    way = chosen.p - vertices.origin
    length = dr.norm(way)
    rays = mi.Ray3f(vertices.origin, dr.select(endless, chosen.d, way / length))
    rays.maxt = dr.select(endless, dr.inf, length * (1 - mi.math.ShadowEpsilon))
    seen = (chosen.pdf > 0) & (dr.max(mi.unpolarized_spectrum(weight)) > 0) & (length > 0)
    return rays, seen & (dr.dot(rays.d, vertices.normal) > _GRAZING)


def _lit(mi: Any, scene: Scene) -> Any:
    """The scene with its lights, or a white sky if it has none."""
    whole = scene.renderable
    if whole is not None and whole.emitters():
        return whole
    return mi.load_dict({"type": "scene", "sky": {"type": "constant"}})
