"""A hash of the code behind a result, followed through the package's imports.

A kept result is believed only if the code that would make it today is the code that made it. A
version number says less: it stays the same while the code changes.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import importlib.util
from collections.abc import Iterable
from pathlib import Path

_PACKAGE = "mibvh"
#: Libraries that compute, trace or compile: another version may give other numbers.
_LIBRARIES = ("drjit", "mitsuba", "numba", "numpy", "scipy", "trimesh")
#: What a module is named by in code.
_NAMING = (ast.Import, ast.ImportFrom, ast.Constant, ast.JoinedStr)


@functools.cache
def code_digest(*modules: str) -> str:
    """Hash the code of modules of this package, and of all that they import from it.

    Parameters
    ----------
    *modules : str
        Dotted names, such as ``mibvh.metrics.epo``. Imports within functions are followed too,
        and modules that a registry names in a string.

    Returns
    -------
    str
        Changes with the code of any of these modules and with the versions of the libraries that
        compute; comments, docstrings and the layout of the code do not count.
    """
    digest = hashlib.sha256()
    for name in sorted(_reached(modules)):
        digest.update(f"{name} {_module(name)[0]}\n".encode())
    for library in _LIBRARIES:
        digest.update(f"{library} {importlib.metadata.version(library)}\n".encode())
    return digest.hexdigest()


def _reached(modules: Iterable[str]) -> set[str]:
    """Return the names of modules and of all that they import, directly or not."""
    reached: set[str] = set()
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting.extend(_module(name)[1])
    return reached


@functools.cache
def _module(name: str) -> tuple[str, frozenset[str]]:
    """Return the hash of a module's code, and the modules of the package that it imports."""
    path = _path(name)
    assert path is not None, f"{name} is no module of {_PACKAGE}"
    tree = ast.parse(path.read_bytes())
    nodes = list(ast.walk(tree))
    imported = frozenset(
        found
        for node in nodes
        if isinstance(node, _NAMING)
        for found in (*_imported(node), *_named(node))
        # The package itself names all of its modules, and computes nothing.
        if found.startswith(f"{_PACKAGE}.") and _path(found) is not None
    )
    _drop_docstrings(nodes)
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest(), imported


def _imported(node: ast.AST) -> list[str]:
    """Return the possible modules that an import statement names."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return []


def _named(node: ast.AST) -> list[str]:
    """Return the modules that a string names; an f-string may stand for all of a package."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value] if node.value.startswith(f"{_PACKAGE}.") else []
    if isinstance(node, ast.JoinedStr) and isinstance(node.values[0], ast.Constant):
        package, dot, rest = str(node.values[0].value).rpartition(".")
        path = _path(package) if dot and not rest and package.startswith(_PACKAGE) else None
        return [f"{package}.{file.stem}" for file in path.parent.glob("*.py")] if path else []
    return []


def _drop_docstrings(nodes: Iterable[ast.AST]) -> None:
    for node in nodes:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
            node, clean=False
        ):
            node.body[0] = ast.Pass()


@functools.cache
def _path(name: str) -> Path | None:
    """Return the file of a module of this package, or None if there is no such module."""
    if not all(part.isidentifier() for part in name.split(".")):
        return None
    place = Path(__file__).parent.joinpath(*name.split(".")[1:])
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None
