"""Wireframes: the boxes at a depth of a tree, drawn over a view of the scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from mibvh.errors import MibvhError
from mibvh.picture import picture
from mibvh.plot.canvas import axes
from mibvh.plot.marks import COLOURS, SEQUENTIAL
from mibvh.scene import Scene
from mibvh.tree import Tree
from mibvh.triangles import F64, I32
from mibvh.variant import mitsuba
from mibvh.wide_tree import WideTree

#: Points per edge at which visibility is tested.
_PIECES = 96
#: Corners of a box, as bits x, y, z for the upper end; edges join those that differ in one bit.
_EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])


def wireframe(
    tree: Tree | WideTree,
    scene: Scene,
    depth: int = 6,
    *,
    viewpoint: int = 0,
    values: npt.ArrayLike | None = None,
    label: str = "value",
    hidden: bool = True,
    width: int = 480,
    samples: int = 0,
    ax: Axes | None = None,
) -> Axes:
    """Draw the boxes at a depth over a render of the scene.

    Parameters
    ----------
    tree : Tree or WideTree
    scene : Scene
        What it was built for, with a perspective camera.
    depth : int
        Depth of the nodes drawn. Leaves above it are drawn as well, so that every triangle is in
        a box.
    viewpoint : int
        Index of ``scene.sensors``.
    values : (M,) array, optional
        A number per node that sets its colour, for instance from :func:`mibvh.epo_per_node`. By
        default neighbours have different colours.
    label : str
        Label of the values, with the unit.
    hidden : bool
        Whether edges behind surfaces are drawn as well, faintly.
    width, samples : int
        Of the render, as for :func:`mibvh.picture.picture`; by default it is lit from the camera.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    MibvhError
        If the depth is negative, the tree was built for another scene, there is no such
        viewpoint, or its camera is not perspective.
    """
    if depth < 0:
        raise MibvhError(f"the depth of a wireframe must not be negative, not {depth}")
    tree.check_matches(scene.triangles)
    image = picture(scene, viewpoint, width, samples)
    rows, columns = image.shape[:2]
    nodes = np.flatnonzero((tree.depths == depth) | (tree.is_leaf & (tree.depths < depth)))
    camera = _Camera(scene, viewpoint)
    segments, owner, seen = camera.edges(tree, nodes.astype(np.int32))
    segments = segments * (columns, rows) - 0.5
    canvas = axes(ax, 4.8, 4.8 * rows / columns + 0.3)
    # Paler and without colour, so that the lines stand out.
    canvas.imshow(0.35 + 0.65 * image.mean(axis=2), cmap="gray", vmin=0, vmax=1)
    layers = [(seen, {"linewidths": 1.2})]
    if hidden:
        layers.insert(0, (~seen, {"linewidths": 0.5, "alpha": 0.3}))
    for shown, looks in layers:
        drawn = _lines(canvas, segments[shown], owner[shown], values, nodes, looks)
    if values is not None:
        canvas.figure.colorbar(drawn, ax=canvas, label=label)
    name = tree.meta.get("builder", "tree")
    canvas.set_title(f"{name}: {len(nodes):,} boxes at depth {depth}")
    canvas.set_axis_off()
    return canvas


def _lines(
    canvas: Axes,
    segments: F64,
    owner: I32,
    values: npt.ArrayLike | None,
    nodes: npt.NDArray[np.int64],
    looks: dict[str, Any],
) -> Any:
    from matplotlib.collections import LineCollection

    if values is None:
        colours = np.array(COLOURS)[np.searchsorted(nodes, owner) % len(COLOURS)]
        drawn = LineCollection(list(segments), colors=list(colours), **looks)
    else:
        of_nodes = np.asarray(values, np.float64)
        order = np.argsort(of_nodes[owner], kind="stable")  # the greatest on top
        drawn = LineCollection(list(segments[order]), cmap=SEQUENTIAL, **looks)
        drawn.set_array(of_nodes[owner[order]])
        drawn.set_clim(0, max(float(of_nodes[nodes].max()), 1e-30))
    return canvas.add_collection(drawn, autolim=False)


class _Camera:
    """A perspective camera: its position and frame, and its projection onto the film."""

    def __init__(self, scene: Scene, viewpoint: int) -> None:
        mi = mitsuba()
        self.scene, sensor = scene, scene.sensors[viewpoint]
        matrix = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)
        frame = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=0)
        self.origin, self.frame = matrix[:3, 3], frame
        reach = max(scene.triangles.diagonal, 1e-20)
        self.near = 1e-4 * reach
        # Where points to the right, above and straight ahead fall on the film gives the rest.
        local = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]) * reach
        place = mi.Interaction3f()
        place.p = mi.Point3f((self.origin + local @ frame.T).T.astype(np.float32))
        try:
            sampled, _ = sensor.sample_direction(place, mi.Point2f(0.5))
        except RuntimeError:
            raise MibvhError(
                f"{scene.name}: viewpoint {viewpoint} is no perspective camera, so boxes "
                "cannot be drawn over its view"
            ) from None
        film = np.array(sensor.film().crop_size(), dtype=np.float64)
        right, up, self.center = np.array(sampled.uv, dtype=np.float64).T / film
        self.scale = np.array([(right - self.center)[0], (up - self.center)[1]])

    def edges(self, tree: Tree | WideTree, nodes: I32) -> tuple[F64, I32, npt.NDArray[np.bool_]]:
        """Edges of boxes inside the film, cut where surfaces hide them.

        Returns
        -------
        segments : (S, 2, 2) float64
            End points on the film, from 0 to 1.
        owner : (S,) int32
            The node.
        seen : (S,) bool
        """
        bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
        corners = np.where(bits, tree.upper[nodes, None], tree.lower[nodes, None])
        ends = ((corners.astype(np.float64) - self.origin) @ self.frame)[:, _EDGES].reshape(
            -1, 2, 3
        )
        owner = np.repeat(nodes, len(_EDGES))
        ends, kept = self._before(ends)
        owner = owner[kept]
        film = self.center + self.scale * ends[:, :, :2] / ends[:, :, 2:]
        low, high = _inside_unit_square(film)
        on = low < high
        ends, film, owner, low, high = ends[on], film[on], owner[on], low[on], high[on]
        # Uniform on the film; in space, reciprocal depths are interpolated.
        at = np.linspace(low, high, _PIECES + 1, axis=1)
        middle = (at[:, 1:] + at[:, :-1]) / 2
        z0, z1 = ends[:, :1, 2], ends[:, 1:, 2]
        share = middle * z0 / (z1 + middle * (z0 - z1))
        local = ends[:, :1] + share[:, :, None] * (ends[:, 1:] - ends[:, :1])
        return _runs(film, at, self._visible(local @ self.frame.T + self.origin), owner)

    def _before(self, ends: F64) -> tuple[F64, npt.NDArray[np.bool_]]:
        """Cut edges off behind the camera; also returns which edges remain."""
        kept = np.any(ends[:, :, 2] > self.near, axis=1)
        ends = ends[kept]
        for i in (0, 1):
            behind = ends[:, i, 2] <= self.near
            a, b = ends[behind, i], ends[behind, 1 - i]
            share = (self.near - a[:, 2]) / (b[:, 2] - a[:, 2])
            ends[behind, i] = a + share[:, None] * (b - a)
        return ends, kept

    def _visible(self, points: F64) -> npt.NDArray[np.bool_]:
        """Whether no surface is between the camera and each point of (E, K, 3)."""
        mi = mitsuba()
        way = points.reshape(-1, 3) - self.origin
        # Boxes touch the surfaces inside them: a point just before a surface counts as seen.
        ray = mi.Ray3f(mi.Point3f(self.origin.tolist()), mi.Vector3f(way.T.astype(np.float32)))
        ray.maxt = mi.Float(1.0 - 2e-3)
        hit = self.scene.geometry.ray_intersect_preliminary(ray)
        hidden: npt.NDArray[np.bool_] = np.array(hit.is_valid(), dtype=np.bool_)
        return np.logical_not(hidden).reshape(points.shape[:2])


def _inside_unit_square(film: F64) -> tuple[F64, F64]:
    """Parameters between which (E, 2, 2) lines are inside the film (Liang and Barsky 1984)."""
    start, run = film[:, 0], film[:, 1] - film[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = -start / run, (1 - start) / run
    # A line parallel to a border stays on its side.
    inside = (start >= 0) & (start <= 1)
    enter = np.where(run != 0, np.minimum(a, b), np.where(inside, -np.inf, np.inf))
    leave = np.where(run != 0, np.maximum(a, b), np.where(inside, np.inf, -np.inf))
    return np.maximum(enter.max(axis=1), 0), np.minimum(leave.min(axis=1), 1)


def _runs(
    film: F64, at: F64, visible: npt.NDArray[np.bool_], owner: I32
) -> tuple[F64, I32, npt.NDArray[np.bool_]]:
    """Join adjacent pieces of an edge that are both visible or both hidden."""
    starts = np.ones_like(visible)
    starts[:, 1:] = visible[:, 1:] != visible[:, :-1]
    edge, piece = np.nonzero(starts)
    last = np.append(edge[1:] != edge[:-1], True)
    stop = np.where(last, _PIECES, np.append(piece[1:], _PIECES))
    share = np.stack([at[edge, piece], at[edge, stop]], axis=1)[:, :, None]
    line = film[edge]
    return line[:, :1] + share * (line[:, 1:] - line[:, :1]), owner[edge], visible[edge, piece]
