"""mibvh: measures and predicts how fast a bounding volume hierarchy really is.

Everything below is loaded when first used, so that ``import mibvh`` is quick and touches
neither Mitsuba's variant nor a compiler.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from mibvh.version import __version__

if TYPE_CHECKING:
    from mibvh.builders import Context, Draft, Options, References, build, builder, option
    from mibvh.errors import MibvhError
    from mibvh.tree import Tree
    from mibvh.triangles import Triangles, rotation_about

_PUBLIC = {
    "Context": "mibvh.builders",
    "Draft": "mibvh.builders",
    "MibvhError": "mibvh.errors",
    "Options": "mibvh.builders",
    "References": "mibvh.builders",
    "Tree": "mibvh.tree",
    "Triangles": "mibvh.triangles",
    "build": "mibvh.builders",
    "builder": "mibvh.builders",
    "option": "mibvh.builders",
    "rotation_about": "mibvh.triangles",
}

__all__ = [
    "Context",
    "Draft",
    "MibvhError",
    "Options",
    "References",
    "Tree",
    "Triangles",
    "__version__",
    "build",
    "builder",
    "option",
    "rotation_about",
]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'mibvh' has no attribute {name!r}")
    value = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
