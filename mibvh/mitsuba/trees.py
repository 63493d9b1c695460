"""Trees that the plugins trace: built, or read from a file; the last ones are kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

from mibvh.builders import build
from mibvh.builders.chosen import Chosen
from mibvh.builders.registry import get
from mibvh.errors import MibvhError
from mibvh.layouts import read_tree
from mibvh.scene import Scene
from mibvh.studies.measure.cameras import cameras
from mibvh.studies.measure.scene_digest import lights_digest
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

    def __str__(self) -> str:
        return Chosen(self.name, self.options).name

    @property
    def asks_scene(self) -> bool:
        """Whether the tree may depend on more of a scene than the triangles."""
        return Chosen(self.name, self.options).asks_scene

    def tree(
        self, scene: Scene | Triangles, progress: Any = None, layout: Layout = "binary"
    ) -> tuple[Tree, Records]:
        """Build the tree and its records in a layout, or return kept ones.

        Parameters
        ----------
        scene : Scene or Triangles
            A scene where :attr:`asks_scene`: the builder gets rays of its cameras.
        progress : callable, optional
            Called as ``progress(stage, done)``.
        layout : "binary" or "wide"
            In the wide one, children have an order for rays that any hit ends.
        """
        made_for: tuple[Any, ...] = ()
        if isinstance(scene, Scene) and self.asks_scene:
            made_for = cameras(scene), lights_digest(scene)
        # A file that an option names may be written anew.
        written = tuple(_changed(value) for _, value in self.options if isinstance(value, str))
        # A user's own builder may be registered anew under its name.
        depends = (self, get(self.name).function, str(made_for), written)
        return _kept(
            depends,
            lambda: build(scene, self.name, progress=progress, **dict(self.options)),
            as_triangles(scene),
            layout,
        )


@dataclasses.dataclass(frozen=True)
class TreeFile:
    """A tree that was built before, as given in a plugin's parameters in a builder's place.

    Attributes
    ----------
    path : str
        Of a file that ``mibvh build``, ``optimize`` or ``import`` wrote.
    """

    path: str
    asks_scene: ClassVar[bool] = False

    def __str__(self) -> str:
        return self.path

    @property
    def name(self) -> str:
        """What the tree is called."""
        return Path(self.path).stem

    def tree(
        self, scene: Scene | Triangles, progress: Any = None, layout: Layout = "binary"
    ) -> tuple[Tree, Records]:
        """Read the tree and make its records in a layout, or return kept ones.

        Raises
        ------
        MibvhError
            If the file cannot be read, or holds no binary tree of these triangles.
        """
        triangles = as_triangles(scene)
        return _kept((self, _changed(self.path)), lambda: self._read(triangles), triangles, layout)

    def _read(self, triangles: Triangles) -> Tree:
        found = read_tree(self.path, "npz")
        if isinstance(found, WideTree):
            raise MibvhError(
                f"{self.path}: a tree with nodes of {found.width} children; name a binary one"
            )
        try:
            found.check_matches(triangles)
        except MibvhError as error:
            raise MibvhError(f"{self.path}: {error}") from None
        return found


def _changed(path: str) -> int:
    """When a file was last written, in nanoseconds; 0 where there is none."""
    try:
        return Path(path).stat().st_mtime_ns
    except OSError:
        return 0  # reading it says what is wrong


#: Frames of an animation and passes of a render share their trees.
_trees: dict[tuple[Any, ...], tuple[Tree, dict[tuple[str, Layout], Records]]] = {}
_KEPT = 4


def _kept(
    depends: tuple[Any, ...], make: Callable[[], Tree], triangles: Triangles, layout: Layout
) -> tuple[Tree, Records]:
    key = (triangles.digest, *depends)
    if key not in _trees:
        while len(_trees) >= _KEPT:
            del _trees[next(iter(_trees))]
        _trees[key] = make(), {}
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
