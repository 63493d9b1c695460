"""Where the bundled scenes and plugins are: in a checkout, or inside an installed wheel."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import platformdirs

from mibvh.errors import MibvhError


def folder(name: str) -> Path:
    """Return the bundled folder ``scenes`` or ``plugins``."""
    inside = Path(__file__).parent / "bundled" / name
    return inside if inside.is_dir() else Path(__file__).parent.parent / name


def cache_folder() -> Path:
    """Where generated scenes and cached results go: ``MIBVH_CACHE``, or the user's cache."""
    asked = os.environ.get("MIBVH_CACHE")
    return Path(asked) if asked else Path(platformdirs.user_cache_dir("mibvh"))


def scenes_package() -> Any:
    """Import the bundled scenes' generators, wherever they are."""
    return _import_folder("mibvh_scenes", folder("scenes"))


def _import_folder(name: str, path: Path) -> ModuleType:
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(
        name, path / "__init__.py", submodule_search_locations=[str(path)]
    )
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def bundled_scene(name: str, triangles: int | None = None, seed: int | None = None) -> Path:
    """Generate a bundled scene into the cache, unless it is there; return its XML file.

    Parameters
    ----------
    name : str
        A name from the catalogue, or ``name@triangles`` for another size.
    triangles, seed : int, optional
        The scene's own defaults if not given.

    Raises
    ------
    MibvhError
        If there is neither a file nor a bundled scene of that name.
    """
    base, _, size = name.partition("@")
    package = scenes_package()
    if base not in package.CATALOGUE or (size and not size.isdigit()):
        raise MibvhError(
            f"{name}: there is no such file, and no bundled scene of that name "
            f"(bundled: {', '.join(package.CATALOGUE)})"
        )
    triangles = int(size) if size else triangles
    info = package.CATALOGUE[base]
    label = f"{base}-{triangles or info.triangles}" + ("" if seed is None else f"-{seed}")
    target = cache_folder() / "scenes" / label
    if not (target / "scene.json").exists() or not (target / "scene.xml").exists():
        target.mkdir(parents=True, exist_ok=True)
        package.write(base, target, triangles, seed)
    return target / "scene.xml"
