"""The bundled scenes, plugins and notebooks, in a checkout or an installed wheel."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import platformdirs

from mibvh.errors import MibvhError, did_you_mean
from mibvh.files import make_folder, write_text
from mibvh.loading import printable
from mibvh.memory import BYTES, require_memory
from mibvh.ranges import check


def folder(name: str) -> Path:
    """Return a bundled folder, such as ``scenes``."""
    inside = Path(__file__).parent / "bundled" / name
    return inside if inside.is_dir() else Path(__file__).parent.parent / name


def cache_folder() -> Path:
    """Return the folder for generated scenes and results: ``MIBVH_CACHE``, or the user's cache."""
    asked = os.environ.get("MIBVH_CACHE")
    return Path(asked) if asked else Path(platformdirs.user_cache_dir("mibvh"))


def scenes_package() -> Any:
    """Import the generators of the bundled scenes."""
    return _import_folder("mibvh_scenes", folder("scenes"))


def _import_folder(name: str, path: Path) -> ModuleType:
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(
        name, path / "__init__.py", submodule_search_locations=[str(path)]
    )
    if spec is None or spec.loader is None:
        raise MibvhError(f"{path}: the bundled files are missing from this installation")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def copy_notebooks(target: Path) -> list[Path]:
    """Copy the bundled notebooks into a folder; return them.

    Parameters
    ----------
    target : Path
        Made if it is not there.

    Raises
    ------
    MibvhError
        If a file of that name is there, or the folder cannot be written.
    """
    sources = sorted(folder("notebooks").glob("*.ipynb"))
    if not sources:
        raise MibvhError("the notebooks are missing from this installation")
    copies = [make_folder(target) / source.name for source in sources]
    for copy in copies:
        if copy.exists():
            raise MibvhError(f"{copy}: exists already; name another folder")
    for source, copy in zip(sources, copies, strict=True):
        write_text(copy, source.read_text(encoding="utf-8"))
    return copies


def make_scene(
    name: str, target: Path, triangles: int | None = None, seed: int | None = None
) -> Path:
    """Generate a bundled scene into a folder; return its XML file.

    Parameters
    ----------
    name : str
        A name from the catalogue.
    target : Path
        Made if it is not there.
    triangles, seed : int, optional
        The scene's own defaults if not given.

    Raises
    ------
    MibvhError
        If there is no bundled scene of that name, or a number is out of range.
    """
    _check(name, triangles, seed)
    size = triangles or scenes_package().CATALOGUE[name].triangles
    require_memory(size * BYTES["generate"], f"{name}: the {size:,} triangles to be generated")
    make_folder(target)
    try:
        return Path(scenes_package().write(name, target, triangles, seed))
    except OSError as error:
        raise MibvhError(
            f"{target}: scene {name} cannot be written ({error.strerror or error})"
        ) from error


def _check(name: str, triangles: int | None, seed: int | None) -> None:
    """Refuse a name that is not in the catalogue, and numbers out of range."""
    known = scenes_package().CATALOGUE
    if name not in known:
        shown = name if len(name) < 200 else f"{name[:200]}..."
        raise MibvhError(
            f"{printable(shown)}: there is no such file, and no bundled scene of that name"
            f"{did_you_mean(name, known)}; bundled: {', '.join(known)}"
        )
    if triangles is not None:
        check(name, triangles=triangles)
    if seed is not None:
        check(name, seed=seed)


def bundled_scene(name: str, triangles: int | None = None, seed: int | None = None) -> Path:
    """Return the XML file of a bundled scene in the cache, generated if it is not there.

    Parameters
    ----------
    name : str
        A name from the catalogue, or ``name@triangles`` for another size.
    triangles, seed : int, optional
        The scene's own defaults if not given.

    Raises
    ------
    MibvhError
        As for :func:`make_scene`.
    """
    base, _, size = name.partition("@")
    if size:
        if not (size.isascii() and size.isdigit()):
            raise MibvhError(f"{name}: after the @, write the number of triangles")
        triangles = int(size)
    _check(base, triangles, seed)
    count = triangles or scenes_package().CATALOGUE[base].triangles
    require_memory(count * BYTES["load"], f"{name}: its {count:,} triangles")
    label = base + (f"@{triangles}" if triangles else "") + (f"+{seed}" if seed is not None else "")
    target = cache_folder() / "scenes" / label
    if _is_current(base, target):
        return target / "scene.xml"
    return make_scene(base, target, triangles, seed)


def _is_current(name: str, target: Path) -> bool:
    """Whether a cached folder is complete and was written by this version of mibvh."""
    package, template = scenes_package(), folder("scenes") / f"{name}.xml"
    try:
        # scene.json is written last.
        record = json.loads((target / "scene.json").read_text(encoding="utf-8"))
        same = (target / "scene.xml").read_bytes() == template.read_bytes()
        return same and bool(record["generator_version"] == package.GENERATOR_VERSION)
    except (OSError, ValueError, TypeError, KeyError):
        return False
