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
from typing import Any

from mibvh.errors import MibvhError, did_you_mean
from mibvh.files import atomic_path, kind_of
from mibvh.tree import Tree
from mibvh.wide_tree import WideTree

#: Names of the layouts, and the modules that read and write them; behind a colon, what they are
#: called there, if not LAYOUT.
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
    """How a tree stands in a file.

    Attributes
    ----------
    summary : str
        One line on what it is.
    parse : callable
        From the file's bytes to what :meth:`mibvh.Tree.from_arrays` takes, or, of a wide layout,
        :meth:`mibvh.WideTree.from_nodes`.
    pack : callable
        From a tree to the file's bytes.
    width : int
        Children that a node may have.
    magic : bytes
        What its files begin with; empty where that may be anything.
    """

    summary: str
    parse: Callable[[bytes], dict[str, Any]]
    pack: Callable[[Any], bytes]
    width: int = 2
    magic: bytes = b""


def get(name: str) -> Any:
    """Look a layout up by name.

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
    return getattr(importlib.import_module(module), called or "LAYOUT")


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
        What the tree is called where builders are named; by default the file's.

    Returns
    -------
    Tree or WideTree
        A wide one of the layouts of more than two children per node, and of a wide tree's file.

    Raises
    ------
    MibvhError
        If the file cannot be read, or holds no valid tree.
    """
    path = Path(path)
    if layout is None:
        layout = "npz" if path.suffix == ".npz" else "mibvh"
    chosen = get(layout)
    if layout == "npz":
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
    """Another layout whose files begin so, as the end of a sentence; empty if there is none."""
    marks = {name: get(name).magic for name in LAYOUTS if name != layout}
    fitting = [name for name, magic in marks.items() if magic and data.startswith(magic)]
    return f" (it begins like a file of the layout {fitting[0]})" if fitting else ""


def read_binary(path: str | os.PathLike[str], name: str = "") -> Tree:
    """Read a tree as :func:`read_tree` does, where only a binary one will do.

    Raises
    ------
    MibvhError
        As of that, or if it is a wide one.
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
        If the tree does not fit the layout, or the file cannot be written.
    """
    path = Path(path)
    if layout is None:
        layout = "npz" if path.suffix == ".npz" else "mibvh"
    chosen = get(layout)
    tree.check()
    if layout == "npz":
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
