"""The hash of code changes with what computes, however deep, and with nothing else."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mibvh


@pytest.fixture
def copy(tmp_path):
    """Return a copy of the package's sources, to be edited."""
    source = Path(mibvh.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__", "bundled*")
    return Path(shutil.copytree(source, tmp_path / "mibvh", ignore=ignored))


def digest(package: Path, module: str) -> str:
    code = f"from mibvh.code import code_digest; print(code_digest({module!r}))"
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=package.parent,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": str(package.parent), "PATH": ""},
        check=True,
    )
    return run.stdout


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_a_change_in_what_is_imported_counts(copy):
    before = digest(copy, "mibvh.metrics.epo")
    edit(copy / "errors.py", "class MibvhError(ValueError):", "class MibvhError(RuntimeError):")
    assert digest(copy, "mibvh.metrics.epo") != before


def test_a_change_elsewhere_does_not(copy):
    before = digest(copy, "mibvh.metrics.epo")
    edit(copy / "picture.py", "import io\n", "import io\nimport math\n")
    assert digest(copy, "mibvh.metrics.epo") == before


def test_comments_docstrings_and_layout_do_not(copy):
    before = digest(copy, "mibvh.metrics.epo")
    edit(copy / "errors.py", "The exception that mistakes", "An exception that mistakes")
    edit(copy / "errors.py", "class MibvhError", "# a comment\n\n\nclass MibvhError")
    assert digest(copy, "mibvh.metrics.epo") == before
