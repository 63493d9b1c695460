"""A small picture of a scene, for the report."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np

from mibvh.scene import Scene
from mibvh.variant import mitsuba

_WIDTH, _SAMPLES = 360, 32


def picture(scene: Scene) -> str:
    """Render what the first viewpoint sees.

    Returns
    -------
    str
        A PNG, base64-encoded. Scenes that Mitsuba can render are rendered with their own
        integrator; bare meshes are lit from the camera.
    """
    mi = mitsuba()
    if scene.original is not None and scene.original.emitters() and _can_render():
        image = mi.render(scene.original, sensor=0, spp=_SAMPLES)
        pixels = np.array(mi.Bitmap(image).convert(mi.Bitmap.PixelFormat.RGB,
                                                   mi.Struct.Type.Float32, False))  # fmt: skip
        middle = np.quantile(pixels[np.isfinite(pixels)], 0.9)
        pixels = np.clip(np.nan_to_num(pixels) * (0.8 / max(middle, 1e-6)), 0, 1) ** (1 / 2.2)
    else:
        pixels = _headlight(mi, scene)
    from PIL import Image

    picture = Image.fromarray((pixels * 255).astype(np.uint8))
    picture.thumbnail((_WIDTH, _WIDTH))
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode()


def _can_render() -> bool:
    """Whether Mitsuba's integrators compile: LLVM 15 aborts on them on AVX-512 machines."""
    import drjit as dr

    return mitsuba().variant().startswith("cuda") or dr.detail.llvm_version()[0] > 15


def _headlight(mi: Any, scene: Scene) -> np.ndarray:
    """(H, W, 3) float in 0..1: surfaces shaded by their angle to the view, 4 samples a pixel."""
    import drjit as dr

    width, height = _WIDTH, _WIDTH * 2 // 3
    index = dr.arange(mi.UInt32, width * height)
    shade = dr.zeros(mi.Float, width * height)
    for dx, dy in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]:
        place = mi.Point2f((mi.Float(index % width) + dx) / width,
                           (mi.Float(index // width) + dy) / height)  # fmt: skip
        ray, _ = scene.sensors[0].sample_ray(mi.Float(0), mi.Float(0.5), place, mi.Point2f(0.5))
        hit = scene.geometry.ray_intersect(mi.Ray3f(ray))
        lit = 0.15 + 0.85 * dr.abs(dr.dot(hit.n, ray.d))
        shade += 0.25 * dr.select(hit.is_valid(), lit, 1.0)
    grey = np.array(shade).reshape(height, width, 1)
    return np.clip(np.repeat(grey, 3, axis=2), 0, 1) ** (1 / 1.5)
