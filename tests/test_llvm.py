"""Dr.Jit's libLLVM: what works is told from what does not, in one sentence."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mibvh.llvm import VARIABLE, usable, wheel_library


def run(*arguments, library):
    return subprocess.run(
        [sys.executable, "-m", "mibvh", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, VARIABLE: library},
        timeout=120,
        check=False,
    )


def test_what_is_in_use_is_usable():
    assert usable()


def test_a_library_that_is_none_is_not(monkeypatch, tmp_path):
    (tmp_path / "libLLVM.so").write_text("no library")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "libLLVM.so"))
    assert not usable()


def test_doctor_says_what_to_install_where_there_is_none(tmp_path):
    found = run("doctor", library=str(tmp_path / "none.so"))
    assert found.returncode == 2
    assert "mibvh[llvm]" in found.stdout.replace("\n", "")
    assert "Traceback" not in found.stderr


def test_a_command_without_llvm_ends_in_one_sentence(tmp_path):
    output = tmp_path / "rays.npz"
    found = run("rays", "cornell@500", "-o", str(output), library=str(tmp_path / "none.so"))
    assert found.returncode == 2
    assert "install LLVM 15 or newer" in found.stderr
    assert "Traceback" not in found.stderr
    assert not output.exists()


def test_the_wheel_is_named_only_where_it_is_installed():
    library = wheel_library()
    if library is None:
        import importlib.metadata

        with pytest.raises(importlib.metadata.PackageNotFoundError):
            importlib.metadata.version("karellen-llvm-core")
    else:
        assert usable(library)


def test_the_former_name_of_release_memory():
    from mibvh.variant import give_back_memory

    with pytest.warns(DeprecationWarning, match="is now called release_memory"):
        give_back_memory()
