"""Trees of other programs: their arrays, and the files that they write.

A layout is one file and one line in :data:`LAYOUTS`.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from mibvh.errors import MibvhError, did_you_mean
from mibvh.files import atomic_path, kind_of
from mibvh.layouts.npz import NativeLayout
from mibvh.tree import Tree
from mibvh.wide_tree import WideTree

#: Names of the layouts, and the modules that read and write them. A module with several layouts
#: names the object after a colon; otherwise it is LAYOUT.
LAYOUTS = {
    "mibvh": "mibvh.layouts.plain",
    "tinybvh": "mibvh.layouts.tinybvh",
    "mbvh4": "mibvh.layouts.mbvh:FOUR",
    "mbvh8": "mibvh.layouts.mbvh:EIGHT",
    "madmann91": "mibvh.layouts.madmann91",
    "npz": "mibvh.layouts.npz",
}


@dataclasses.dataclass(frozen=True)
class Layout:
    """The file format of another program's trees.

    Attributes
    ----------
    summary : str
        One line on what it is.
    parse : callable
        ``parse(data)`` turns a file's bytes into the keyword arguments of
        :meth:`mibvh.Tree.from_arrays`, or, for a wide layout, :meth:`mibvh.WideTree.from_nodes`.
    pack : callable
        ``pack(tree)`` returns the bytes of a file.
    width : int
        Largest number of children per node.
    magic : bytes
        First bytes of every file; empty if the format has no such mark.
    """

    summary: str
    parse: Callable[[bytes], dict[str, Any]]
    pack: Callable[[Any], bytes]
    width: int = 2
    magic: bytes = b""


def get(name: str) -> Layout | NativeLayout:
    """Look up a layout by name.

    Raises
    ------
    MibvhError
        If there is none of that name.
    """
    if name not in LAYOUTS:
        raise MibvhError(
            f"there is no layout {name!r}{did_you_mean(name, LAYOUTS)}; there are: "
            f"{', '.join(LAYOUTS)}"
        )
    module, _, called = LAYOUTS[name].partition(":")
    return cast(Layout | NativeLayout, getattr(importlib.import_module(module), called or "LAYOUT"))


def _layout_of(path: Path, layout: str | None) -> str:
    """Name of the layout of a file: as given, or by the file's ending."""
    if layout is not None:
        return layout
    return "npz" if path.suffix == ".npz" else "mibvh"


def read_tree(
    path: str | os.PathLike[str], layout: str | None = None, name: str = ""
) -> Tree | WideTree:
    """Read a tree that another program wrote. No box, leaf or reference is changed.

    Parameters
    ----------
    path : path
    layout : str, optional
        A name of :data:`LAYOUTS`; by default ``npz`` for a file of that ending, or else ``mibvh``.
    name : str, optional
        Name of the tree, used where other trees show their builder; by default the file's.

    Returns
    -------
    Tree or WideTree
        A WideTree for layouts with more than two children per node, and for a WideTree's file.

    Raises
    ------
    MibvhError
        If the file cannot be read, or holds no valid tree.
    """
    path = Path(path)
    layout = _layout_of(path, layout)
    chosen = get(layout)
    if isinstance(chosen, NativeLayout):
        if path.is_file() and not zipfile.is_zipfile(path):
            raise MibvhError(
                f"{path}: no tree file of mibvh, or a damaged one; a tree of another program is "
                "converted first, by mibvh import FILE --layout NAME -o TREE.npz"
            )
        return WideTree.load(path) if kind_of(path) == "wide tree" else Tree.load(path)
    if not path.is_file():
        raise MibvhError(f"{path}: there is no such file")
    data = b""
    try:
        data = path.read_bytes()
        arrays = chosen.parse(data)
        if chosen.width == 2:
            return Tree.from_arrays(**arrays, name=name or path.stem)
        wide = WideTree.from_nodes(**arrays, meta={"builder": name or path.stem})
        wide.check()
        return wide
    except OSError as error:
        raise MibvhError(f"{path}: cannot be read ({error.strerror})") from None
    except MibvhError as error:
        raise MibvhError(f"{path}: {error}{_hint(data, layout)}") from None


def _hint(data: bytes, layout: str) -> str:
    """Name another layout whose files begin like this one, to end a message with; or nothing."""
    marks = {name: get(name).magic for name in LAYOUTS if name != layout}
    fitting = [name for name, magic in marks.items() if magic and data.startswith(magic)]
    return f" (it begins like a file of the layout {fitting[0]})" if fitting else ""


def read_binary(path: str | os.PathLike[str], name: str = "") -> Tree:
    """Read a tree like :func:`read_tree`, and refuse a wide one.

    Raises
    ------
    MibvhError
        As for :func:`read_tree`, or if the tree is wide.
    """
    tree = read_tree(path, name=name)
    if isinstance(tree, WideTree):
        raise MibvhError(
            f"{path}: has up to {tree.width} children per node; only binary trees can be taken here"
        )
    return tree


def write_tree(
    tree: Tree | WideTree, path: str | os.PathLike[str], layout: str | None = None
) -> None:
    """Write a tree for another program.

    Parameters
    ----------
    tree : Tree or WideTree
    path : path
    layout : str, optional
        As for :func:`read_tree`.

    Raises
    ------
    MibvhError
        If the tree is invalid or does not fit the layout, or the file cannot be written.
    """
    path = Path(path)
    layout = _layout_of(path, layout)
    chosen = get(layout)
    tree.check()
    if isinstance(chosen, NativeLayout):
        tree.save(path)
        return
    width = tree.width if isinstance(tree, WideTree) else 2
    if width != chosen.width:
        raise MibvhError(
            f"layout {layout} is for trees of {chosen.width} children per node, not {width}"
        )
    data = chosen.pack(tree)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
