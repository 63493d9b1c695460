"""The documentation is true: its Python runs, its links lead somewhere, its API is complete."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import mibvh
from tools import docs_site

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\(([^)\s]+)\)")


def blocks(page: Path) -> str:
    """Return the page's Python, one block after the other, each at the line it has in the page."""
    text = page.read_text()
    lines = [""] * (text.count("\n") + 1)
    for block in _BLOCK.finditer(text):
        first = text.count("\n", 0, block.start(1))
        for i, line in enumerate(block[1].splitlines()):
            lines[first + i] = line
    return "\n".join(lines)


def titled(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p).strip()], ids=titled)
def test_python_runs(page, tmp_path, monkeypatch, cornell):
    """Every block of a page in turn, in one namespace and an empty folder.

    Blocks may use ``scene``, ``triangles``, ``tree`` and ``rays`` of a small bundled scene
    without making them.
    """
    monkeypatch.chdir(tmp_path)
    tree = mibvh.build(cornell, "bbvh")
    known = {
        "mibvh": mibvh,
        "scene": cornell,
        "triangles": cornell.triangles,
        "tree": tree,
        "rays": mibvh.diffuse_rays(cornell, width=16, height=12),
        **tree.to_arrays(),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        try:
            exec(compile(blocks(page), page.name, "exec"), known)
        finally:
            plt.close("all")


@pytest.mark.parametrize("page", PAGES, ids=titled)
def test_links_lead_somewhere(page):
    for target in _LINK.findall(page.read_text()):
        if "://" not in target and not target.startswith("#"):
            assert (page.parent / target.split("#")[0]).exists(), target


def test_api_reference_is_complete():
    text = "\n".join(docs_site.api_pages().values())
    named = {line[4:].rpartition(".")[2] for line in text.splitlines() if line.startswith("::: ")}
    assert {*mibvh.__all__, *mibvh.plot.__all__} - {"__version__", "plot"} <= named
