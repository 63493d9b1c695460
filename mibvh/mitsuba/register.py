"""Registers the plugins with Mitsuba, in each variant that is set."""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

import mitsuba as mi

from mibvh.bundled import folder
from mibvh.errors import MibvhError

#: The files in ``plugins/``; each registers what it is named after.
PLUGINS = ("bvh_cost", "bvh_path", "bvh_rays")
_done: set[str] = set()


def register() -> None:
    """Make the plugins known to Mitsuba.

    A Mitsuba plugin belongs to one variant. The plugins are registered for the variant that is
    set now, if any, and for every other one as soon as it is set. Called by
    ``import mibvh.mitsuba``; calling it again does nothing.

    Raises
    ------
    MibvhError
        If the plugins are missing from the installation.
    """
    if not _done:
        mi.detail.add_variant_callback(_variant_changed)
        _done.add("")
    if mi.variant() is not None:
        _variant_changed(None, mi.variant())


def _variant_changed(_old: str | None, new: str) -> None:
    if new in _done:
        return
    _done.add(new)
    for name in PLUGINS:
        path = folder("plugins") / f"{name}.py"
        # A module per variant: the class in it inherits from that variant's integrator.
        spec = importlib.util.spec_from_file_location(f"mibvh_plugins_{new}_{name}", path)
        if spec is None or spec.loader is None or not path.exists():
            raise MibvhError(f"{path}: the plugins are missing from this installation")
        module: Any = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
