"""The mutator of meshes finds what it is for: some hundred cases, and planted faults."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

_ROOT = str(Path(__file__).resolve().parent.parent)
if _ROOT not in sys.path:
    sys.path.insert(0, _ROOT)

from mibvh.loading import mesh, off  # noqa: E402
from tools.fuzz.meshes import Meshes  # noqa: E402

KINDS = ("glb", "obj", "off", "ply", "stl", "xml")


def run_cases(folder):
    bench = Meshes(folder)
    for seed in range(3000):
        bench.run(seed)


def test_cases_end_well_and_the_same_again(tmp_path):
    bench = Meshes(tmp_path)
    found = [bench.run(seed) for seed in range(300)]
    assert {f"{kind} {how}" for kind in KINDS for how in ("whole", "refused")} <= set(found)
    assert [bench.run(seed) for seed in range(20)] == found[:20]


def test_a_reader_that_takes_what_is_cut_short_is_found(monkeypatch, tmp_path):
    """As trimesh reads OFF: as many faces as there are."""

    def careless(data):
        rows = [row.split() for row in data.decode("latin-1").splitlines()[2:]]
        points = [tuple(map(float, row)) for row in rows if len(row) == 3]
        faces = [tuple(map(int, row[1:])) for row in rows if len(row) == 4 and row[0] == "3"]
        return mesh.Mesh(mesh.np.array([[points[i] for i in face] for face in faces]))

    monkeypatch.setattr(off, "read", careless)
    with pytest.raises(AssertionError, match="a off file that is cut short is read short"):
        run_cases(tmp_path)


def test_a_reader_that_moves_a_corner_is_found(monkeypatch, tmp_path):
    true = off.read
    monkeypatch.setattr(off, "read", lambda data: mesh.Mesh(true(data).corners * 1.001))
    with pytest.raises(AssertionError, match="off"):
        run_cases(tmp_path)
