"""Bundled procedural scenes.

Each scene is a Mitsuba XML template (``<name>.xml`` beside this file) and a generator that makes
its meshes: `generate` returns them as arrays, `write` puts a renderable folder on the disk.

The package uses relative imports only, so that it can be imported under any name.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .generators import (
    cathedral,
    city,
    contrasts,
    cornell,
    foliage,
    hairball,
    industry,
    interiors,
    livingroom,
    statues,
)
from .generators.base import PartDict, Recipe, SceneInfo, build_to_size, thin

__all__ = ["CATALOGUE", "GENERATOR_VERSION", "SceneInfo", "generate", "write"]

# Goes into scene.json; raise it whenever a change makes other triangles for the same arguments.
GENERATOR_VERSION = 1

_MODULES = (
    cornell,
    livingroom,
    hairball,
    interiors,
    cathedral,
    city,
    foliage,
    industry,
    statues,
    contrasts,
)
_RECIPES: dict[str, Recipe] = {r.info.name: r for m in _MODULES for r in m.RECIPES}

CATALOGUE: dict[str, SceneInfo] = {name: r.info for name, r in _RECIPES.items()}


def _recipe(name: str) -> Recipe:
    try:
        return _RECIPES[name]
    except KeyError:
        known = ", ".join(_RECIPES)
        raise ValueError(f"unknown scene {name!r}; choose one of: {known}") from None


def _size(recipe: Recipe, triangles: int | None) -> int:
    if triangles is None:
        return recipe.info.triangles
    if triangles < 1:
        raise ValueError(f"triangles must be at least 1, not {triangles}")
    return int(triangles)


def generate(name: str, triangles: int | None = None, seed: int | None = None) -> PartDict:
    """Make the meshes of a bundled scene.

    Parameters
    ----------
    name
        A key of `CATALOGUE`.
    triangles
        Triangle count to come close to (about 25 %; each scene has a natural minimum, mostly
        below 3000); None for the scene's default.
    seed
        Chooses the random layout; None is seed 0.

    Returns
    -------
    dict
        For each part (one material of the XML template), float32 positions ``(n, 3)`` and int32
        corner indices ``(m, 3)``. The same arguments give bit-identical arrays.

    Raises
    ------
    ValueError
        If the name is not in the catalogue.
    """
    recipe = _recipe(name)
    target = _size(recipe, triangles)
    parts = build_to_size(recipe, target, 0 if seed is None else seed).result()
    if sum(len(f) for _, f in parts.values()) > 1.2 * target:
        parts = thin(parts, target)
    return parts


def write(name: str, folder: Path, triangles: int | None = None, seed: int | None = None) -> Path:
    """Write a bundled scene as a folder that Mitsuba can load.

    The folder gets ``scene.xml``, ``meshes/PART.ply`` and ``scene.json``. Files are written under
    temporary names and moved into place; ``scene.json`` is taken away first and written last, so
    that a folder with one is complete.

    Parameters
    ----------
    name, triangles, seed
        As for `generate`.
    folder
        Made if missing.

    Returns
    -------
    pathlib.Path
        The XML file.
    """
    recipe = _recipe(name)
    requested = _size(recipe, triangles)
    parts = generate(name, requested, seed)
    folder = Path(folder)
    meshes = folder / "meshes"
    meshes.mkdir(parents=True, exist_ok=True)
    record = folder / "scene.json"
    record.unlink(missing_ok=True)
    for part, (v, f) in parts.items():
        _write_ply(meshes / f"{part}.ply", v, f)
    xml = folder / "scene.xml"
    with _whole(xml) as temporary:
        shutil.copyfile(Path(__file__).parent / f"{name}.xml", temporary)
    info = {
        "name": name,
        "triangles": int(sum(len(f) for _, f in parts.values())),
        "requested": requested,
        "seed": 0 if seed is None else seed,
        "generator_version": GENERATOR_VERSION,
    }
    with _whole(record) as temporary:
        temporary.write_text(json.dumps(info, indent=2) + "\n", encoding="utf-8")
    return xml


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path that is moved to ``path``, or removed if the block fails."""
    temporary = path.with_name(path.name + ".tmp")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _write_ply(path: Path, v: NDArray[np.float32], f: NDArray[np.int32]) -> None:
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(v)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(f)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(f), dtype=[("n", "u1"), ("i", "<i4", 3)])
    faces["n"] = 3
    faces["i"] = f
    with _whole(path) as temporary, temporary.open("wb") as out:
        out.write(header.encode("ascii"))
        out.write(v.astype("<f4").tobytes())
        out.write(faces.tobytes())
