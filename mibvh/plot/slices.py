"""Slices: how many boxes contain each point of a plane through the scene."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

from mibvh.errors import MibvhError
from mibvh.metrics.points import point_costs, weight_at
from mibvh.plot.canvas import axes
from mibvh.plot.marks import SEQUENTIAL
from mibvh.tree import Tree
from mibvh.triangles import F64, I32, Triangles, as_triangles
from mibvh.wide_tree import WideTree

#: Points on the longer side of a slice.
_RESOLUTION = 512

SliceQuantity = Literal["leaves", "nodes", "foreign"]

_QUANTITIES: dict[str, tuple[str, str]] = {
    "leaves": ("leaf boxes that contain a point", "leaf boxes"),
    "nodes": ("boxes, inner and leaf, that contain a point", "boxes"),
    "foreign": ("end-point overlap on the surfaces", "extra cost to find the point"),
}


def overlap_slice(
    tree: Tree | WideTree,
    triangles: Any,
    quantity: SliceQuantity = "leaves",
    *,
    axis: Literal["x", "y", "z"] | None = None,
    at: float | None = None,
    vmax: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Colour a plane through the scene by the boxes that overlap there.

    Parameters
    ----------
    tree : Tree or WideTree
    triangles : Triangles, Scene or (N, 3, 3) array
        What it was built for.
    quantity : str
        ``leaves``: number of leaf boxes that contain each point of the plane. ``nodes``: the
        same for all boxes. ``foreign``: cost of the boxes that contain a point but not its
        triangle, drawn where the plane cuts a surface; its mean over all surfaces is the EPO.
    axis : str, optional
        Axis perpendicular to the plane. By default the shortest side of the scene, so that most
        scenes are seen from above.
    at : float, optional
        Position on that axis, in scene units; by default the median triangle.
    vmax : float, optional
        Upper end of the colour scale, to compare pictures; by default the largest value.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    MibvhError
        For an unknown quantity or axis, a plane outside the scene, or triangles of another tree.
    """
    triangles = as_triangles(triangles)
    tree.check_matches(triangles)
    if quantity not in _QUANTITIES:
        raise MibvhError(f"a slice is coloured by {', '.join(_QUANTITIES)}, not {quantity!r}")
    normal, place = _plane(triangles, axis, at)
    lower, upper = np.delete(triangles.bounds.astype(np.float64), normal, axis=1)
    across, up = upper - lower
    canvas = axes(ax, 4.8, float(np.clip(4.4 * up / max(across, 1e-30), 2.0, 5.0)))
    segments, ids = _section(triangles, normal, place)
    if quantity == "foreign":
        _draw_section(canvas, tree, triangles, segments, ids, normal, vmax)
    else:
        _draw_plane(canvas, tree, normal, place, (lower, upper), quantity, vmax)
        _lines(canvas, segments, normal, colors="black", linewidths=0.5, alpha=0.7)
    title = _QUANTITIES[quantity][0]
    letters = "xyz"[:normal] + "xyz"[normal + 1 :]
    canvas.set_title(
        f"{tree.meta.get('builder', 'tree')}, at {'xyz'[normal]} = {place:.3g}:\n{title}"
    )
    canvas.set(xlabel=f"{letters[0]} (scene units)", ylabel=f"{letters[1]} (scene units)")
    canvas.grid(False)
    canvas.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), aspect="equal")
    return canvas


def _plane(triangles: Triangles, axis: str | None, at: float | None) -> tuple[int, float]:
    """Index of the axis, and the position on it."""
    if axis not in (None, "x", "y", "z"):
        raise MibvhError(f"the axis of a slice is x, y or z, not {axis!r}")
    lower, upper = triangles.bounds.astype(np.float64)
    normal = int((upper - lower).argmin()) if axis is None else "xyz".index(axis)
    if at is None:
        centers = triangles.lower[:, normal] / 2 + triangles.upper[:, normal] / 2
        # Slightly off the median: there a symmetric scene has walls and box faces in common.
        place = min(float(np.median(centers)) + 3e-4 * (upper - lower)[normal], upper[normal])
    else:
        place = float(at)
    if not lower[normal] <= place <= upper[normal]:
        raise MibvhError(
            f"the plane at {'xyz'[normal]} = {place:g} is outside {triangles.name}, which extends "
            f"from {lower[normal]:g} to {upper[normal]:g}"
        )
    return normal, place


def _draw_plane(
    canvas: Axes,
    tree: Tree | WideTree,
    normal: int,
    place: float,
    window: tuple[F64, F64],
    quantity: str,
    vmax: float | None,
) -> None:
    import matplotlib as mpl

    lower, upper = window
    size = upper - lower
    columns, rows = np.maximum(1, np.round(_RESOLUTION * size / max(size.max(), 1e-30))).astype(int)
    x = lower[0] + size[0] * (np.arange(columns) + 0.5) / columns
    y = lower[1] + size[1] * (np.arange(rows) + 0.5) / rows
    points = np.stack([np.tile(x, rows), np.repeat(y, columns)], axis=1)
    points = np.insert(points, normal, place, axis=1)
    weights = np.ones(len(tree)) if quantity == "nodes" else tree.is_leaf.astype(np.float64)
    counts = weight_at(tree, points, weights).reshape(rows, columns)
    extent = (lower[0], upper[0], lower[1], upper[1])
    top = max(int(counts.max() if vmax is None else vmax), 1)
    few = top <= 12  # a colour for each number instead of a continuous scale
    norm = mpl.colors.BoundaryNorm(np.arange(-0.5, top + 1), 256) if few else None
    limits = {"norm": norm} if few else {"vmin": 0, "vmax": top}
    drawn = canvas.imshow(
        np.ma.masked_equal(counts, 0),
        origin="lower",
        extent=extent,
        cmap=SEQUENTIAL,
        interpolation="nearest",
        **limits,
    )
    bar = canvas.figure.colorbar(
        drawn, ax=canvas, label=f"{_QUANTITIES[quantity][1]} (white: none)"
    )
    if few:
        bar.set_ticks(list(range(top + 1)))
        bar.minorticks_off()


def _section(triangles: Triangles, normal: int, place: float) -> tuple[F64, I32]:
    """Segments in which the plane cuts the triangles.

    Returns
    -------
    segments : (S, 2, 3) float64
        Triangles in the plane have none.
    ids : (S,) int32
    """
    above = triangles.corners[:, :, normal] >= place
    ids = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1)).astype(np.int32)
    corners, above = triangles.corners[ids].astype(np.float64), above[ids]
    # First the corner that is alone on its side: the plane cuts the two edges that meet there.
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), above.argmin(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    apex, others = corners[:, :1], corners[:, 1:]
    share = (place - apex[:, :, normal]) / (others[:, :, normal] - apex[:, :, normal])
    return apex + share[:, :, None] * (others - apex), ids


def _draw_section(
    canvas: Axes,
    tree: Tree | WideTree,
    triangles: Triangles,
    segments: F64,
    ids: I32,
    normal: int,
    vmax: float | None,
) -> None:
    """Draw the section in pieces about as long as a pixel."""
    step = float(np.ptp(np.delete(triangles.bounds, normal, axis=1), axis=0).max()) / _RESOLUTION
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    pieces = np.clip(np.ceil(lengths / max(step, 1e-30)), 1, _RESOLUTION).astype(np.int64)
    which = np.repeat(np.arange(len(ids)), pieces)
    number = np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    start, run = segments[which, 0], segments[which, 1] - segments[which, 0]
    share = (number[:, None] + [0.0, 0.5, 1.0]) / pieces[which, None]
    begin, middle, end = (start + share[:, i : i + 1] * run for i in range(3))
    cost = point_costs(tree, triangles, middle, ids[which])[:, 0]
    order = np.argsort(cost, kind="stable")  # the costly ones on top
    lines = np.stack([begin, end], axis=1)[order]
    drawn = _lines(canvas, lines, normal, cmap=SEQUENTIAL, linewidths=1.6, capstyle="round")
    drawn.set_array(cost[order])
    drawn.set_clim(0, vmax if vmax is not None else max(float(cost.max(initial=0)), 1.0))
    canvas.figure.colorbar(drawn, ax=canvas, label=_QUANTITIES["foreign"][1])


def _lines(canvas: Axes, segments: F64, normal: int, **looks: Any) -> Any:
    from matplotlib.collections import LineCollection

    drawn = LineCollection(list(np.delete(segments, normal, axis=2)), **looks)
    return canvas.add_collection(drawn, autolim=False)
