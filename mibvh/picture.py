"""Small images of a scene, for the report and as backgrounds of plots."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from mibvh.errors import MibvhError
from mibvh.scene import Scene
from mibvh.triangles import F64
from mibvh.variant import mitsuba
from mibvh.viewpoints import camera_rays

#: A pixel is dark below this share of the bright ones' value, and a picture where more than so
#: many are: closed rooms, of which few paths find the light, come out as white dots on black.
_DARK, _MOSTLY = 0.02, 0.4


def picture(scene: Scene, viewpoint: int = 0, width: int = 360, samples: int = 32) -> F64:
    """Render the view of one camera.

    Parameters
    ----------
    scene : Scene
    viewpoint : int
        Index of ``scene.sensors``.
    width : int
        Pixels of the longer side.
    samples : int
        Paths per pixel; 0 to light the surfaces from the camera, which needs none.

    Returns
    -------
    (H, W, 3) float64
        From 0 to 1, as shown on a screen. Scenes that Mitsuba can render are rendered with their
        own integrator, or ``path`` where they name none, as Mitsuba has them: with instances,
        and spheres that are round. Bare meshes are lit from the camera, and so is what their own
        light hardly gets to.

    Raises
    ------
    MibvhError
        If there is no such viewpoint.
    """
    mi = mitsuba()
    if not 0 <= viewpoint < len(scene.sensors):
        raise MibvhError(
            f"{scene.name} has {len(scene.sensors)} viewpoints, counted from 0, none of them "
            f"number {viewpoint}"
        )
    sensor = scene.sensors[viewpoint]
    columns, rows = (int(n) for n in sensor.film().crop_size())
    shrink = width / max(columns, rows)
    size = max(1, round(columns * shrink)), max(1, round(rows * shrink))
    if samples == 0 or not _can_render():
        return _headlight(mi, scene, sensor, *size)
    whole = scene.renderable
    if whole is None or not whole.emitters():
        return _headlight(mi, scene, sensor, *size)
    integrator = whole.integrator() or mi.load_dict({"type": "path", "max_depth": 8})
    with _film_of(mi, sensor, size):
        image = mi.render(whole, sensor=sensor, integrator=integrator, spp=samples)
    pixels = np.array(
        mi.Bitmap(image).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    )
    middle = np.quantile(pixels[np.isfinite(pixels)], 0.9)
    if (pixels.max(axis=2) <= _DARK * middle).mean() > _MOSTLY:
        return _headlight(mi, scene, sensor, *size)
    return np.clip(np.nan_to_num(pixels) * (0.8 / max(middle, 1e-6)), 0, 1).astype(float) ** (
        1 / 2.2
    )


def png(pixels: F64) -> bytes:
    """Return (H, W, 3) values from 0 to 1 as a PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray((pixels * 255).astype(np.uint8)).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _can_render() -> bool:
    """Whether Mitsuba's integrators compile: LLVM 15 aborts on them on AVX-512 machines."""
    import drjit as dr

    return mitsuba().variant().startswith("cuda") or dr.detail.llvm_version()[0] > 15


@contextmanager
def _film_of(mi: Any, sensor: Any, size: tuple[int, int]) -> Iterator[None]:
    """Give the sensor a film of another size for a while; a cropped film is left as it is."""
    names = ("film.size", "film.crop_size")
    params = mi.traverse(sensor)
    before = {name: mi.ScalarVector2u(params[name]) for name in names if name in params}
    whole = len(before) == 2 and list(before[names[0]]) == list(before[names[1]])
    try:
        if whole:
            for name in names:
                params[name] = mi.ScalarVector2u(size)
            params.update()
        yield
    finally:
        if whole:
            for name in names:
                params[name] = before[name]
            params.update()


def _headlight(mi: Any, scene: Scene, sensor: Any, width: int, height: int) -> F64:
    """Surfaces shaded by their angle to the view, 4 samples a pixel."""
    import drjit as dr

    index = dr.arange(mi.UInt32, width * height)
    shade = dr.zeros(mi.Float, width * height)
    for dx, dy in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]:
        place = mi.Point2f(
            (mi.Float(index % width) + dx) / width, (mi.Float(index // width) + dy) / height
        )
        ray = camera_rays(sensor, place, mi.Point2f(0.5))
        hit = scene.geometry.ray_intersect(ray)
        lit = 0.15 + 0.85 * dr.abs(dr.dot(hit.n, ray.d))
        shade += 0.25 * dr.select(hit.is_valid(), lit, 1.0)
    grey = np.array(shade, dtype=np.float64).reshape(height, width, 1)
    return np.clip(np.repeat(grey, 3, axis=2), 0, 1) ** (1 / 1.5)
