"""Figures of what ``bvh_cost`` and ``bvh_rays`` render: colour scales and legends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.mitsuba.costs import QUANTITIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Quantities that exist only for rays that hit something.
_OF_HITS = ("leaf_depth", "overlap")
_NOTHING = "#d9d9d9"
_UNITS = {
    "inner": "inner nodes per ray",
    "leaves": "leaves per ray",
    "triangles": "triangles per ray",
    "cost": "cost per ray",
    "leaf_depth": "levels below the root",
    "overlap": "cost per hit point",
}


def image_channels(image: Any, integrator: Any) -> dict[str, npt.NDArray[np.float32]]:
    """Name the channels of a rendered image.

    Parameters
    ----------
    image : (H, W, C) tensor
        What ``mi.render`` returns for the integrator.
    integrator : mitsuba.Integrator

    Returns
    -------
    dict of str to (H, W) float32
        One per name in ``integrator.aov_names()``.
    """
    pixels, names = np.array(image, dtype=np.float32), integrator.aov_names()
    first = pixels.shape[2] - len(names)
    return {name: pixels[:, :, first + i] for i, name in enumerate(names)}


def channel_means(channels: dict[str, npt.NDArray[np.float32]]) -> dict[str, float]:
    """Mean of each channel, with names that say whether it is per ray or per hit.

    Parameters
    ----------
    channels : dict
        From :func:`image_channels`.

    Returns
    -------
    dict of str to float
        The mean over all rays has the channel's own name. ``leaf_depth`` and ``overlap`` exist
        only for rays that hit something: ``NAME.overlap_per_hit`` is the mean over these rays,
        ``NAME.overlap_per_ray`` the mean over all rays, where misses count as 0.
    """
    means: dict[str, float] = {}
    for name, values in channels.items():
        mean = float(values.mean(dtype=np.float64))
        if name.rpartition(".")[2] not in _OF_HITS:
            means[name] = mean
            continue
        hits = float(channels["hit"].mean(dtype=np.float64))
        means[f"{name}_per_hit"] = mean / hits if hits else 0.0
        means[f"{name}_per_ray"] = mean
    return means


def cost_figure(
    channels: dict[str, npt.NDArray[np.float32]], quantities: Sequence[str] | None = None
) -> Figure:
    """Draw heat maps with their colour scales.

    Two trees are drawn side by side on one scale, with the difference beside them.

    Parameters
    ----------
    channels : dict
        From :func:`image_channels` for ``bvh_cost``.
    quantities : sequence of str, optional
        Any of ``inner``, ``leaves``, ``triangles``, ``cost``, ``leaf_depth``, ``overlap``. By
        default all for one tree, and cost and overlap for two.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    MibvhError
        For an unknown quantity.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    layers = list(dict.fromkeys(name.split(".")[0] for name in channels if "." in name))
    chosen = list(quantities or (QUANTITIES if len(layers) == 1 else ("cost", "overlap")))
    check_quantities(chosen)
    height, width = channels["hit"].shape
    columns = min(3, len(chosen)) if len(layers) == 1 else len(layers)
    rows = -(-len(chosen) * len(layers) // columns)
    figure = Figure(
        figsize=(3.2 * columns, (3.1 * height / width + 1.05) * rows + 0.25), layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False)
    for panel in axes.flat:
        panel.axis("off")
    means = channel_means(channels)
    for i, quantity in enumerate(chosen):
        maps = {layer: _map(channels, layer, quantity) for layer in layers}
        trees = [values for layer, values in maps.items() if layer != "difference"]
        top = max(float(np.nanpercentile(v, 99.5)) if np.isfinite(v).any() else 0 for v in trees)
        for k, (layer, values) in enumerate(maps.items()):
            panel = axes.flat[i * len(layers) + k]
            title = f"{layer}: {QUANTITIES[quantity]}"
            if layer == "difference":
                title = f"{layers[1]} less {layers[0]}"
            per = "_per_hit" if quantity in _OF_HITS else ""
            mean = means[f"{layer}.{quantity}{per}"]
            title += f"\nmean {mean:{'+' if layer == 'difference' else ''}.3g}"
            title += " per hit" if per else " per ray"
            _draw(figure, panel, title, values, None if layer == "difference" else top)
            figure.axes[-1].set_xlabel(_UNITS[quantity], fontsize=8)
    if any(quantity in _OF_HITS for quantity in chosen) and (channels["hit"] == 0).any():
        figure.legend(
            handles=[Patch(facecolor=_NOTHING, label="the rays hit nothing")],
            loc="outside lower center",
            frameon=False,
            fontsize=8,
        )
    return figure


def check_quantities(names: Sequence[str]) -> None:
    """Refuse unknown names of quantities.

    Raises
    ------
    MibvhError
        Naming the first of them.
    """
    for name in names:
        if name not in QUANTITIES:
            raise MibvhError(f"there is no quantity {name!r}; there are: {', '.join(QUANTITIES)}")


def _map(channels: dict[str, Any], layer: str, quantity: str) -> npt.NDArray[Any]:
    """One quantity per pixel. Quantities of hits are per hit, and NaN where no ray hits."""
    values, hit = channels[f"{layer}.{quantity}"], channels["hit"]
    if quantity not in _OF_HITS:
        return values
    return np.where(hit > 0, values / np.maximum(hit, 1e-6), np.nan)


def _draw(
    figure: Figure, panel: Any, title: str, values: npt.NDArray[Any], top: float | None
) -> None:
    """Draw one map with its colour scale, symmetric around zero if there is no top value."""
    import matplotlib as mpl

    from mibvh.plot.marks import SEQUENTIAL

    known = np.abs(values[np.isfinite(values)])
    reach = max(float(np.percentile(known, 99.5)) if len(known) else 0.0, 1e-6)
    low, high = (-reach, reach) if top is None else (0.0, max(top, 1e-6))
    colours = mpl.colormaps["RdBu_r" if top is None else SEQUENTIAL].with_extremes(bad=_NOTHING)
    image = panel.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    panel.set_title(title, fontsize=9)
    bar = figure.colorbar(image, ax=panel, location="bottom", shrink=0.9, aspect=30, pad=0.02)
    bar.ax.tick_params(labelsize=7)
