"""No two files of the package import each other in a circle, not even inside functions."""

import ast
import graphlib
import importlib.util
from pathlib import Path

import pytest

import mibvh

ROOT = Path(mibvh.__file__).parent


def modules(root):
    """Name and file of each module below the folder of a package."""
    for path in root.rglob("*.py"):
        parts = path.relative_to(root.parent).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def for_types_only(node):
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def statements(node):
    """All that stands in a node, inside functions too, but for what only type checkers read."""
    for child in ast.iter_child_nodes(node):
        if not for_types_only(child):
            yield child
            yield from statements(child)


def imported(name, path, known):
    """Modules of the package that a file imports."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            base = importlib.util.resolve_name(relative, package)
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                yield from (m for m in [whole if whole in known else base] if m in known)


def check(root):
    known = dict(modules(root))
    graph = {m: set(imported(m, path, known)) - {m} for m, path in known.items()}
    graphlib.TopologicalSorter(graph).prepare()
    return graph


def test_no_files_import_each_other_in_a_circle():
    graph = check(ROOT)
    assert "mibvh.hierarchy" in graph["mibvh.tree"]
    assert "mibvh.validation" in graph["mibvh.tree"]  # imported inside a function


@pytest.mark.parametrize("late", ["def f():\n    ", ""])
def test_a_circle_is_noticed(late, tmp_path):
    package = tmp_path / "some"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "a.py").write_text("from some.b import g\n")
    (package / "b.py").write_text(f"{late}from .a import f\n")
    with pytest.raises(graphlib.CycleError):
        check(package)
