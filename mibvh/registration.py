"""Registers the plugins of ``plugins/`` with Mitsuba, in each variant that is set.

This is below scene loading, because a scene that names a plugin needs no more than the name. The
plugin's file is executed when Mitsuba first creates an instance.
"""

from __future__ import annotations

import functools
import importlib.util
import sys
from typing import Any

from mibvh.bundled import folder
from mibvh.errors import MibvhError

#: The files in ``plugins/``, and the integrator class in each.
PLUGINS = {"bvh_cost": "BvhCost", "bvh_path": "BvhPath", "bvh_rays": "BvhRays"}
_done: set[str] = set()


def register() -> None:
    """Register the plugins with Mitsuba.

    A Mitsuba plugin belongs to one variant. The plugins are registered for the current variant,
    if any, and for every other one as soon as it is set. Called by
    ``import mibvh.mitsuba``; calling it again does nothing.
    """
    import mitsuba as mi

    if not _done:
        mi.detail.add_variant_callback(_variant_changed)
        _done.add("")
    if mi.variant() is not None:
        _variant_changed(None, mi.variant())


def _variant_changed(_old: str | None, new: str) -> None:
    import mitsuba as mi

    if new in _done:
        return
    _done.add(new)
    for name in PLUGINS:
        mi.register_integrator(name, functools.partial(_made, name, new))


def _made(name: str, variant: str, props: Any) -> Any:
    return getattr(_module(name, variant), PLUGINS[name])(props)


@functools.cache
def _module(name: str, variant: str) -> Any:
    """Execute a plugin's file, once per variant: its class inherits from that variant's.

    Raises
    ------
    MibvhError
        If the file is missing from the installation.
    """
    path = folder("plugins") / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"mibvh_plugins_{variant}_{name}", path)
    if spec is None or spec.loader is None or not path.exists():
        raise MibvhError(f"{path}: the plugins are missing from this installation")
    module: Any = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
