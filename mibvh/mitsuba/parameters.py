"""Parameters that the plugins read from a scene file: a builder and its options."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

from mibvh.builders import build
from mibvh.builders.chosen import Chosen
from mibvh.builders.registry import BuildFunction, get
from mibvh.errors import MibvhError
from mibvh.scene import Scene
from mibvh.studies.measure.cameras import cameras
from mibvh.traversal.child_order import child_priority
from mibvh.traversal.records import Layout, Records, make_records
from mibvh.traversal.wide_rows import as_wide
from mibvh.tree import Tree
from mibvh.triangles import Triangles, as_triangles
from mibvh.variant import mitsuba
from mibvh.wide_tree import WideTree


@dataclasses.dataclass(frozen=True)
class Builder:
    """A builder and its options, as given in a plugin's parameters.

    Attributes
    ----------
    name : str
    options : tuple of (str, value)
    """

    name: str
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def asks_scene(self) -> bool:
        """Whether the tree may depend on more of a scene than the triangles."""
        return Chosen(self.name, self.options).asks_scene

    def build(
        self, scene: Scene | Triangles, progress: Any = None, layout: Layout = "binary"
    ) -> tuple[Tree, Records]:
        """Build the tree and its records in a layout, or return cached ones.

        In the wide layout, children have an order for rays that any hit ends.

        Parameters
        ----------
        scene : Scene or Triangles
            A scene where :attr:`asks_scene`: the builder gets rays of its cameras.
        progress : callable, optional
            Called as ``progress(stage, done)``.
        layout : "binary" or "wide"
        """
        triangles = as_triangles(scene)
        seen_from = cameras(scene) if isinstance(scene, Scene) and self.asks_scene else []
        # A user's own builder may be registered anew under its name.
        key = (triangles.digest, self, get(self.name).function, str(seen_from))
        if key not in _trees:
            while len(_trees) >= _KEPT:
                del _trees[next(iter(_trees))]
            _trees[key] = build(scene, self.name, progress=progress, **dict(self.options)), {}
        tree, records = _trees[key]
        # Records are in the memory of the variant's backend.
        kind = (mitsuba().variant(), layout)
        if kind not in records:
            chosen: Tree | WideTree = tree
            if layout == "wide":
                wide = as_wide(tree, triangles)
                chosen = wide.ordered(child_priority(wide, triangles, "worth"))
            records[kind] = make_records(chosen, triangles, layout)
        return tree, records[kind]


#: Cached trees of the last renders: frames of an animation and passes of a render share them.
_trees: dict[
    tuple[str, Builder, BuildFunction, str], tuple[Tree, dict[tuple[str, Layout], Records]]
] = {}
_KEPT = 4


def read_builder(props: Any, key: str, default: str, prefix: str = "") -> Builder:
    """Read a builder and its given options.

    Parameters
    ----------
    props : mitsuba.Properties
    key : str
        The parameter that names the builder.
    default : str
        The builder if the parameter is not given.
    prefix : str
        Prefix of the options' names.

    Raises
    ------
    MibvhError
        For an unknown builder, or an option out of range.
    """
    name = props.get(key, default)
    entry = get(name)
    given = {}
    for field in dataclasses.fields(entry.options):
        if prefix + field.name in props.keys():  # noqa: SIM118 - keys only
            value = props[prefix + field.name]
            given[field.name] = value
    entry.options(**given)
    return Builder(name, tuple(sorted(given.items())))


def refuse_unknown(props: Any, plugin: str) -> None:
    """Refuse parameters that were not read, as Mitsuba does for its own plugins.

    Raises
    ------
    MibvhError
        Naming the first of them.
    """
    unknown = list(props.unqueried())
    if unknown:
        # bvh_rays builds no tree.
        also = "" if plugin == "bvh_rays" else ", and neither has the builder it names"
        raise MibvhError(f"{plugin} has no parameter {unknown[0]!r}{also}")


def positive(props: Any, key: str, default: int) -> int:
    """Read a positive integer.

    Raises
    ------
    MibvhError
        If it is smaller.
    """
    value = int(props.get(key, default))
    if value < 1:
        raise MibvhError(f"{key} must be at least 1, not {value}")
    return value


@functools.cache
def plain_variant(plugin: str, variant: str) -> None:
    """Refuse variants whose spectra are Mueller matrices.

    Raises
    ------
    MibvhError
        In a polarized variant.
    """
    if "polarized" in variant:
        raise MibvhError(f"{plugin} does not support polarization (variant {variant})")
