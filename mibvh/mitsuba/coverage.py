"""Which surfaces rays end on, and how densely."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mibvh.parallel import thread_count
from mibvh.rays import RaySet
from mibvh.scene import Scene
from mibvh.variant import mitsuba

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Number of nearest ends for a density estimate, as in photon maps (Jensen 1996).
_NEAREST = 16
#: Range of the colour scale: sparser and denser than uniform by this factor.
_SCALE = 16.0
#: Below this density, a surface counts as not reached.
_UNREACHED = 1 / 64
_GREY = 0.75


class Coverage:
    """The ends of a ray set's rays.

    Parameters
    ----------
    scene : Scene
    rays : RaySet
    """

    def __init__(self, scene: Scene, rays: RaySet) -> None:
        from scipy.spatial import cKDTree

        mi = mitsuba()
        self.scene = scene
        ray = mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T))
        hit = scene.geometry.ray_intersect_preliminary(ray, coherent=False)
        t, valid = np.array(hit.t), np.array(hit.is_valid())
        ends = rays.o[valid] + rays.d[valid] * t[valid, None]
        bounce = rays.bounce[valid]
        self._area = float(scene.triangles.areas.sum())
        self._ends = {f"bounce{b}": cKDTree(ends[bounce == b]) for b in np.unique(bounce)}
        self._ends["all"] = cKDTree(ends)

    def density(self, points: Any, layer: str) -> npt.NDArray[np.float64]:
        """How densely rays end around points.

        Parameters
        ----------
        points : (P, 3) float
            On surfaces.
        layer : str
            ``all``, or ``bounce1`` and so on.

        Returns
        -------
        (P,) float64
            Ends per area within the circle of the 16 nearest, relative to the mean over all
            surfaces.
        """
        ends = self._ends.get(layer)
        if ends is None or not len(points):
            return np.zeros(len(points))
        nearest = min(_NEAREST, ends.n)
        distance, _ = ends.query(points, k=[nearest], workers=thread_count())
        circle = np.pi * np.maximum(distance[:, 0], 1e-30) ** 2
        return nearest / circle * self._area / ends.n


def coverage_colours(density: Any, shade: Any) -> npt.NDArray[np.float64]:
    """Colour relative densities on a logarithmic scale; surfaces that turn away are darker.

    Parameters
    ----------
    density : (...) float
        From :meth:`Coverage.density`.
    shade : (...) float
        Cosine to the view.

    Returns
    -------
    (..., 3) float64
        Linear RGB; grey where hardly any ray ends.
    """
    import matplotlib as mpl

    place = np.log(np.maximum(density, 1e-30)) / np.log(_SCALE) / 2 + 0.5
    colour = mpl.colormaps["viridis"](np.clip(place, 0, 1))[..., :3] ** 2.2
    colour = np.where((density < _UNREACHED)[..., None], _GREY**2.2, colour)
    return colour * (0.3 + 0.7 * shade)[..., None]


def coverage_figure(channels: dict[str, npt.NDArray[np.float32]], rays: RaySet) -> Figure:
    """Draw which surfaces rays end on, with a colour scale.

    Parameters
    ----------
    channels : dict
        From :func:`mibvh.mitsuba.image_channels` for ``bvh_rays``.
    rays : RaySet
        The integrator's.

    Returns
    -------
    matplotlib.figure.Figure
    """
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    layers = [name.split(".")[0] for name in channels if name.endswith(".density")]
    height, width = channels["hit"].shape
    across = 4.2 if len(layers) == 1 else 3.2
    figure = Figure(
        figsize=(across * len(layers), across * height / width + 1.3), layout="constrained"
    )
    hit = channels["hit"][..., None]
    axes = figure.subplots(1, len(layers), squeeze=False)[0]
    for panel, layer in zip(axes, layers, strict=True):
        density = channels[f"{layer}.density"] / np.maximum(channels["hit"], 1e-6)
        shade = channels["shade"] / np.maximum(channels["hit"], 1e-6)
        colour = coverage_colours(density, np.clip(shade, 0, 1)) * hit + (1 - hit)
        panel.imshow(np.clip(colour, 0, 1) ** (1 / 2.2), interpolation="nearest")
        panel.axis("off")
        bounce = layer.removeprefix("bounce")
        count = len(rays) if layer == "all" else int((rays.bounce == int(bounce)).sum())
        title = "all bounces" if layer == "all" else f"bounce {bounce}"
        panel.set_title(f"{title}: {count:,} rays", fontsize=9)
    scale = ScalarMappable(mpl.colors.LogNorm(1 / _SCALE, _SCALE), mpl.colormaps["viridis"])
    bar = figure.colorbar(scale, ax=list(axes), location="bottom", shrink=0.9, aspect=40, pad=0.02)
    bar.set_ticks([1 / 16, 1 / 4, 1, 4, 16], labels=["1/16", "1/4", "1", "4", "16"])
    bar.ax.minorticks_off()
    bar.ax.tick_params(labelsize=7)
    bar.set_label("ray ends per area; 1 is uniform over all surfaces", fontsize=8)
    figure.legend(
        handles=[Patch(facecolor=str(_GREY), label="hardly any ray ends here")],
        loc="outside lower center",
        frameon=False,
        fontsize=8,
    )
    return figure
