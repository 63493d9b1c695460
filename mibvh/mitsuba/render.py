"""Rendering from the command line: any scene, any integrator, to EXR or PNG."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mibvh.errors import MibvhError
from mibvh.files import atomic_path
from mibvh.loading.parser import parse_file
from mibvh.mitsuba.coverage import coverage_figure
from mibvh.mitsuba.heatmap import (
    channel_means,
    check_quantities,
    cost_figure,
    image_channels,
)
from mibvh.ranges import check
from mibvh.registration import PLUGINS
from mibvh.scene import find_scene_file, load, makes_rays, mitsuba_mesh, mitsuba_reason
from mibvh.variant import mitsuba, two_threads

#: Samples that one pass takes at most: what keeps memory small and the progress bar moving.
_PASS = 1 << 21
#: Samples per pixel where nothing asks for any number.
_SAMPLES = 16
Progress = Callable[[str, float], None]


def render(
    source: str,
    output: str | os.PathLike[str],
    integrator: str | None = None,
    *,
    parameters: dict[str, Any] | None = None,
    defines: dict[str, str] | None = None,
    spp: int | None = None,
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    seed: int = 0,
    quantities: Sequence[str] = (),
    progress: Progress | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """Render a scene to a file.

    Parameters
    ----------
    source : str
        Mitsuba XML, a mesh file, or a bundled scene's name. A mesh file is lit by an even sky and
        a lamp at the first of its automatic viewpoints.
    output : path
        ``.exr`` holds all channels as they are; ``.png`` an sRGB picture, or the figure of a heat
        map with its scale and legend.
    integrator : str, optional
        One of mibvh's, or any of Mitsuba's. By default the scene's own if that is one of
        mibvh's, with the parameters it has there; ``bvh_path`` otherwise.
    parameters : dict, optional
        Of the integrator.
    defines : dict, optional
        Mitsuba's ``-D``: values for the ``$name`` in the XML file.
    spp : int, optional
        Samples per pixel; by default the ``sample_count`` that the scene gives its camera, or 16
        where it has none of its own.
    size : (int, int), optional
        Width and height in pixels; the scene's by default.
    sensor : int
        Which of the scene's cameras.
    seed : int
    quantities : sequence of str
        What a PNG of ``bvh_cost`` shows; see :func:`mibvh.mitsuba.cost_figure`.
    progress : callable, optional
        Called as ``progress(stage, done)``.

    Returns
    -------
    facts : dict
        What was rendered, JSON-able.
    notes : list of str
        What was said in warnings, such as what a tree cannot hold.

    Raises
    ------
    MibvhError
        If the scene cannot be loaded, or anything is out of range.
    """
    mi = mitsuba()
    tell = progress or (lambda stage, done: None)
    kind = Path(output).suffix.lower()
    if kind not in (".exr", ".png"):
        raise MibvhError(f"{output}: an image is an .exr or a .png file")
    # Before the work, rather than after it.
    if not Path(output).parent.is_dir():
        raise MibvhError(f"{output}: there is no folder {str(Path(output).parent)!r}")
    check(sensor=sensor, seed=seed)
    if spp is not None:
        check(spp=spp)
    if size:
        check(width=size[0], height=size[1])
    check_quantities(quantities)
    given = _instantiate(integrator or "bvh_path", parameters or {})
    scene = _mitsuba_scene(source, defines or {})
    plugin = given if integrator or parameters else _own_integrator(scene) or given
    integrator = integrator or _plugin_name(plugin) or "bvh_path"
    camera = _camera(source, scene, sensor, defines or {})
    own = any(camera == one for one in scene.sensors())
    if spp is None:
        spp = _samples(source, camera, own)
    if size:
        params = mi.traverse(camera)
        params["film.size"] = list(size)
        params.update()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", UserWarning)
        if integrator in PLUGINS:
            plugin.prepare(scene, camera, progress=tell)
        image = _in_passes(plugin, scene, camera, seed, spp, tell)
    notes = list(dict.fromkeys(str(w.message) for w in said if w.category is UserWarning))
    if not own:
        notes.append("it has no camera that can be used; the viewpoint was chosen for it")
    with atomic_path(output) as path:
        if kind == ".exr":
            _write_exr(mi, image, plugin, path)
        else:
            _write_png(mi, image, plugin, integrator, quantities, path)
    height, width = image.shape[:2]
    means = channel_means(image_channels(image, plugin))
    facts = {
        "image": str(output),
        "integrator": integrator,
        "width": width,
        "height": height,
        "spp": spp,
        "seed": seed,
        "variant": mi.variant(),
        "means": means,
    }
    return facts, notes


def _instantiate(integrator: str, parameters: dict[str, Any]) -> Any:
    mi = mitsuba()
    try:
        return mi.load_dict({"type": integrator, **parameters})
    except (RuntimeError, TypeError) as error:
        raise MibvhError(f"integrator {integrator}: {mitsuba_reason(error)}") from None


def _plugin_name(plugin: Any) -> str | None:
    """Which of mibvh's integrators this is, if it is one."""
    return next((name for name in PLUGINS if type(plugin).__module__.endswith(name)), None)


def _own_integrator(scene: Any) -> Any:
    """The integrator that a scene names, if it is one of mibvh's."""
    own = scene.integrator()
    return own if own is not None and _plugin_name(own) else None


def _camera(source: str, scene: Any, sensor: int, defines: dict[str, str]) -> Any:
    """One of the scene's cameras, or of those that are chosen where it has none."""
    sensors = scene.sensors()
    if not any(makes_rays(found) for found in sensors):
        sensors = load(source, defines).sensors
    if not 0 <= sensor < len(sensors):
        raise MibvhError(
            f"{source} has {len(sensors)} cameras, numbered from 0; there is no {sensor}"
        )
    return sensors[sensor]


def _samples(source: str, camera: Any, own: bool) -> int:
    """Samples per pixel that a scene file asks for; 16 where the camera is not its own."""
    path, _ = find_scene_file(source)
    asked = own and path.suffix.lower() == ".xml"
    return int(camera.sampler().sample_count()) if asked else _SAMPLES


def _mitsuba_scene(source: str, defines: dict[str, str]) -> Any:
    """Load a scene as Mitsuba renders it: not flattened, with its own lights."""
    mi = mitsuba()
    path, named = find_scene_file(source)
    if path.suffix.lower() == ".xml":
        return parse_file(path, {**named, **defines}, flatten=False).scene
    loaded = load(source, defines)
    matrix = np.array(loaded.sensors[0].world_transform().matrix, dtype=float).reshape(4, 4)
    # The sky does not shine into a closed room, a lamp at the first camera does.
    lamp = {
        "type": "point",
        "position": matrix[:3, 3].tolist(),
        "intensity": float(loaded.triangles.diagonal) ** 2,
    }
    return mi.load_dict(
        {
            "type": "scene",
            "mesh": mitsuba_mesh(loaded.triangles),
            "sky": {"type": "constant"},
            "lamp": lamp,
            **{f"sensor_{i}": sensor for i, sensor in enumerate(loaded.sensors)},
        }
    )


def _in_passes(
    plugin: Any, scene: Any, camera: Any, seed: int, spp: int, tell: Progress
) -> npt.NDArray[np.float32]:
    """Average of passes of equally many samples, and a last one of what is left."""
    width, height = camera.film().size()
    each = min(spp, max(1, _PASS // (width * height)))
    total: Any = 0.0
    done = 0
    tell("render", 0.0)
    while done < spp:
        samples = min(each, spp - done)
        # The number of the pass counts as a seed: other paths each time.
        image = plugin.render(scene, camera, seed=seed * 65536 + done // each, spp=samples)
        total = total + np.array(image, dtype=np.float64) * samples
        done += samples
        tell("render", done / spp)
    return (total / spp).astype(np.float32)


def _write_exr(mi: Any, image: npt.NDArray[np.float32], plugin: Any, path: Path) -> None:
    names = plugin.aov_names()
    colours = image.shape[2] - len(names)
    channels = [*(["Y"] if colours == 1 else "RGBA"[:colours]), *names]
    bitmap = mi.Bitmap(image, mi.Bitmap.PixelFormat.MultiChannel, channels)
    with two_threads():
        path.write_bytes(_encoded(mi, bitmap, mi.Bitmap.FileFormat.OpenEXR))


def _write_png(
    mi: Any,
    image: npt.NDArray[np.float32],
    plugin: Any,
    integrator: str,
    quantities: Sequence[str],
    path: Path,
) -> None:
    if integrator in ("bvh_cost", "bvh_rays"):
        channels = image_channels(image, plugin)
        figure = (
            cost_figure(channels, quantities or None)
            if integrator == "bvh_cost"
            else coverage_figure(channels, plugin.rays)
        )
        figure.savefig(path, format="png", dpi=120, facecolor="white")
        return
    colours = image.shape[2] - len(plugin.aov_names())
    shown = image[..., : 3 if colours >= 3 else 1]
    bitmap = mi.util.convert_to_bitmap(np.ascontiguousarray(shown))
    path.write_bytes(_encoded(mi, bitmap, mi.Bitmap.FileFormat.PNG))


def _encoded(mi: Any, bitmap: Any, kind: Any) -> bytes:
    """Return an image file's bytes. Mitsuba itself does not say why a disk takes no more."""
    stream = mi.MemoryStream()
    bitmap.write(stream, kind)
    return bytes(stream.raw_buffer())
