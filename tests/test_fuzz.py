"""The mutators of soups and pieces find what they are for: some cases, and planted faults."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mibvh

_ROOT = str(Path(__file__).resolve().parent.parent)
if _ROOT not in sys.path:
    sys.path.insert(0, _ROOT)

from mibvh.layouts import LAYOUTS  # noqa: E402
from tools.fuzz import layouts, pieces, soups  # noqa: E402


@pytest.fixture
def bench(monkeypatch):
    """Return a bench of one builder: others take long to compile."""
    monkeypatch.setattr(soups, "names", lambda: ["lbvh"])
    monkeypatch.setattr(soups, "STYLES", ("single",))
    return soups.Soups()


def test_soups_end_well(bench):
    found = {bench.run(seed) for seed in range(60)}
    assert found == {"soup", "points", "slivers", "sheet", "copies", "layers", "far"}


@pytest.mark.parametrize("part", ["trace", "mitsuba"])
def test_wrong_distances_are_found(bench, monkeypatch, part):
    if part == "mitsuba":
        true = soups.mitsuba_t
        monkeypatch.setattr(soups, "mitsuba_t", lambda *given: true(*given) * 1.01)
        said = "wrong Mitsuba's hits"
    else:
        trace = mibvh.trace

        def wrong(tree, *given, **options):
            hits = trace(tree, *given, **options)
            return (
                hits
                if tree.depth == 0
                else hits.__class__(
                    np.nextafter(hits.t, np.float32(0)), *list(vars(hits).values())[1:]
                )
            )

        monkeypatch.setattr(mibvh, "trace", wrong)
        said = "wrong hits of lbvh"
    with pytest.raises(AssertionError, match=said):
        list(map(bench.run, range(20)))


def test_pieces_end_well_and_a_file_outside_is_noticed(monkeypatch):
    bench = pieces.Pieces()
    found = {bench.run(seed) for seed in range(4)}
    assert found & {"hostile refused", "hostile reported"}
    assert "damaged made whole" in found

    def careless(folder):
        (Path(folder).parent / "elsewhere").touch()

    monkeypatch.setattr(pieces, "remake_report", careless)
    with pytest.raises(AssertionError, match="something outside the folder changed"):
        bench.run(0)


def test_damage_that_no_report_is_made_from_is_made_whole(monkeypatch):
    """Of such cases the study alone is run; wrong figures are found all the same."""
    bench = pieces.Pieces()
    reports = []
    monkeypatch.setattr(pieces, "remake_report", reports.append)
    monkeypatch.setattr(pieces, "_REPORTED", set())
    assert bench.run(1) == "damaged made whole"
    assert reports == []
    bench.truth += "7"
    with pytest.raises(AssertionError, match="wrong numbers from damaged pieces"):
        bench.run(1)


def run_fuzz(*words, **environment):
    return subprocess.run(
        [sys.executable, "-m", "tools.fuzz", *words],
        cwd=_ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )


CARELESS = """
import contextlib
import shutil
import mibvh.files
from tools.fuzz.kills import Kills


class Careless(Kills):
    def __init__(self):
        super().__init__()

        @contextlib.contextmanager
        def leaves(path):
            beside = path.with_name(f".{path.name}")
            yield beside
            shutil.copy(beside, path)

        mibvh.files.atomic_path = leaves
"""


def test_kills_end_well_and_half_files_are_found(tmp_path):
    (tmp_path / "careless.py").write_text(CARELESS)
    path = os.pathsep.join([str(tmp_path), _ROOT])
    whole, left = (
        run_fuzz(part, FUZZ_CASES="2", MIBVH_THREADS="1", PYTHONPATH=path)
        for part in ("kills", "careless:Careless")
    )
    assert (whole.returncode, whole.stderr) == (0, "")
    assert "kills: 2 cases" in whole.stdout
    assert whole.stdout.count("killed") >= 1
    assert left.returncode == 1
    assert "AssertionError: half a file is left" in left.stdout


def test_help_and_a_part_that_there_is_not():
    helped, wrong = run_fuzz("--help"), run_fuzz("mesh")
    assert (helped.returncode, helped.stderr) == (0, "")
    assert "files, imports, meshes" in helped.stdout
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "there is no part 'mesh'; there are: files, imports" in wrong.stderr


def test_trees_of_other_programs_damaged_and_whole(monkeypatch):
    """Wide layouts too, which are made of a collapsed tree."""
    bench = layouts.Imports()
    damaged = {bench.run(seed) for seed in range(40)}
    assert {how.split()[1] for how in damaged} <= {"refused", "accepted"}
    monkeypatch.setattr(layouts, "damaged", lambda data, _: data)
    whole = {bench.run(seed) for seed in range(100)}
    assert whole == {f"{layout} accepted" for layout in LAYOUTS}
