"""Imports go one way: no circles, and rooms in their order. Those inside functions count too."""

import ast
import graphlib
import importlib.util
from pathlib import Path

import pytest

import mibvh

ROOT = Path(mibvh.__file__).parent
#: A room uses only itself, those before it, and files that are in none. A module is in the room
#: with the longest prefix of its name.
ROOMS = [
    ["triangles"],
    ["tree", "nodes", "hierarchy", "validation", "layouts.arrays"],
    ["wide_tree", "wide_validation", "quantise", "layouts"],
    ["measures"],
    ["collapsing"],
    ["builders"],
    ["metrics"],
    ["rays.rayset", "rays.read", "rays.order", "rays.mixture"],
    ["traversal"],
    ["rays"],
    ["studies.record"],
    ["studies.measure"],
    ["studies.analyse"],
    ["studies.paper"],
    ["studies.report"],
    ["studies.experiments"],
    ["studies"],
    ["cli"],
]


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


def room(module):
    """Place of a module's room; None if it is in none."""
    prefixes = [(f"mibvh.{prefix}", i) for i, room in enumerate(ROOMS) for prefix in room]
    fitting = [(len(p), i) for p, i in prefixes if module == p or module.startswith(p + ".")]
    return max(fitting, default=(0, None))[1]


def test_rooms_use_those_before_them():
    backwards = [
        f"{module} imports {other}"
        for module, others in check(ROOT).items()
        for other in others
        if None not in (room(module), room(other)) and room(module) < room(other)
    ]
    # Inside a function: rays that are rotated with their scene are moved clear of it again.
    assert backwards == ["mibvh.rays.rayset imports mibvh.rays.origins"]


@pytest.mark.parametrize("late", ["def f():\n    ", ""])
def test_a_circle_is_noticed(late, tmp_path):
    package = tmp_path / "some"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "a.py").write_text("from some.b import g\n")
    (package / "b.py").write_text(f"{late}from .a import f\n")
    with pytest.raises(graphlib.CycleError):
        check(package)
