"""Trees of other programs: their arrays, and the files that they write.

A layout is one file and one line in :data:`LAYOUTS`.
"""

from __future__ import annotations

import dataclasses
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mibvh.errors import MibvhError
from mibvh.files import atomic_path
from mibvh.tree import Tree

#: Names of the layouts, and the modules that read and write them.
LAYOUTS = {
    "mibvh": "mibvh.layouts.plain",
    "tinybvh": "mibvh.layouts.tinybvh",
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
        From the file's bytes to what :meth:`mibvh.Tree.from_arrays` takes.
    pack : callable
        From a tree to the file's bytes.
    """

    summary: str
    parse: Callable[[bytes], dict[str, Any]]
    pack: Callable[[Tree], bytes]


def get(name: str) -> Any:
    """Look a layout up by name.

    Raises
    ------
    MibvhError
        If there is none of that name.
    """
    if name not in LAYOUTS:
        raise MibvhError(f"there is no layout {name!r}; there are: {', '.join(LAYOUTS)}")
    return importlib.import_module(LAYOUTS[name]).LAYOUT


def read_tree(path: str | os.PathLike[str], layout: str | None = None, name: str = "") -> Tree:
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
    Tree

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
        return Tree.load(path)
    if not path.is_file():
        raise MibvhError(f"{path}: there is no such file")
    try:
        arrays = chosen.parse(path.read_bytes())
        return Tree.from_arrays(**arrays, name=name or path.stem)
    except OSError as error:
        raise MibvhError(f"{path}: cannot be read ({error.strerror})") from None
    except MibvhError as error:
        raise MibvhError(f"{path}: {error}") from None


def write_tree(tree: Tree, path: str | os.PathLike[str], layout: str | None = None) -> None:
    """Write a tree for another program.

    Parameters
    ----------
    tree : Tree
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
    data = chosen.pack(tree)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
