"""Options and names: each has its range, each mistake gets one sentence and exit code 2."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

import mibvh
from mibvh.cli import main
from mibvh.loading.sandbox import try_to_load
from mibvh.ranges import RANGES, check


@pytest.fixture
def cli(capsys, monkeypatch):
    """Run the command line in this process: (exit code, stdout, stderr)."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["mibvh", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return ended.value.code or 0, captured.out, captured.err

    # What --debug and --sandbox set is taken back after the test.
    for name in ("MIBVH_DEBUG", "MIBVH_SANDBOX"):
        monkeypatch.setenv(name, "")
    return run


SIZED = """<scene version="3.0.0"><default name="n" value="1"/><shape type="cube"><transform
name="to_world"><scale value="$n"/></transform></shape></scene>"""


# ------------------------------------------------------------------ ranges


@pytest.mark.parametrize("name", RANGES)
def test_both_ends_of_every_range(name):
    found = RANGES[name]
    kind = int if found.whole else float
    for value in (kind(found.low), kind(found.high)):
        check(**{name: value})
    for value in (found.low - 1, found.high + 1, float("nan"), float("inf"), "3", None, True):
        with pytest.raises(mibvh.MibvhError, match=f"^a scene: {name} must be a .*number from "):
            check("a scene", **{name: value})
    if found.whole:
        with pytest.raises(mibvh.MibvhError, match="must be a whole number"):
            check(**{name: found.low + 0.5})


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("study", "cornell@1000", "-o", "out", "--seconds", "nan"), "seconds must be a number"),
        (("study", "cornell@1000", "-o", "out", "--seconds", "-1"), "seconds must be a number"),
        (("study", "cornell@1000", "-o", "out", "--seed", "-1"), "seed must be a whole number"),
        (("study", "cornell@900", "-o", "o", "--warp-width", "3"), "warp width must be one of"),
        (
            ("study", "cornell@900", "-o", "o", "--warp-style", "oak"),
            "warp style must be one of",
        ),
        (("study", "cornell@1000", "-o", "out", "--samples", "0"), "samples must be a whole"),
        (("study", "cornell@1000", "-o", "out", "--samples", 10**9), "samples must be a whole"),
        (("rays", "cornell@1000", "-o", "r.npz", "--width", "100000"), "width must be a whole"),
        (("rays", "cornell@1000", "-o", "r.npz", "--height", "0"), "height must be a whole"),
        (("rays", "cornell@1000", "-o", "r.npz", "--seed", "-1"), "seed must be a whole"),
        (("rays", "cornell@1000", "-o", "r.npz", "--viewpoints", "-1"), "viewpoints must be"),
        (("rays", "cornell@1000", "-o", "r.npz", "--viewpoints", "0"), "viewpoints must be"),
        (("rays", "cornell@1000", "-o", "r.npz", "--bounces", "99"), "bounces must be a whole"),
        (("render", "cornell@1000", "-o", "p.png", "--size", "0x9"), "width must be a whole"),
        (("render", "cornell@1000", "-o", "p.png", "--size", "9x99999"), "height must be a whole"),
        (("render", "cornell@1000", "-o", "p.png", "--size", "9x\u00b2"), "takes WIDTHxHEIGHT"),
        (("render", "cornell@1000", "-o", "p.png", "--seed", "-1"), "seed must be a whole"),
        (("render", "cornell@1000", "-o", "p.png", "--sensor", "-1"), "sensor must be a whole"),
        (("scenes", "make", "cornell", "--triangles", "0"), "cornell: triangles must be a whole"),
        (("scenes", "make", "cornell", "--seed", "-1"), "cornell: seed must be a whole"),
        (("build", "cornell@\u00b2", "-o", "t.npz"), "after the @, write the number of triangles"),
        (("build", "cornell@0", "-o", "t.npz"), "cornell: triangles must be a whole"),
        (("build", "cornell@99999999999", "-o", "t.npz"), "cornell: triangles must be a whole"),
        (("build", "a\0b", "-o", "t.npz"), "no such file, and no bundled scene"),
        (("build", "x" * 5000, "-o", "t.npz"), "no such file, and no bundled scene"),
    ],
)
def test_numbers_out_of_range(cli, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = cli(*arguments)
    assert code == 2
    assert said in err
    assert err.startswith("mibvh: ")
    assert out == ""


@pytest.mark.parametrize("threads", ["100000", "0", "-1", "two", "\u00b2", ""])
def test_threads_out_of_range(monkeypatch, threads):
    monkeypatch.setenv("MIBVH_THREADS", threads)
    with pytest.raises(mibvh.MibvhError, match="MIBVH_THREADS must be a whole number from 1 to"):
        mibvh.parallel.thread_count()


# ------------------------------------------------------------------ names


def test_misspelt_names_are_guessed(cli, tmp_path):
    assert "(did you mean 'cornell'?)" in cli("build", "corneil@2000", "-o", tmp_path / "t")[2]
    assert "(did you mean 'hairball'?)" in cli("build", "Hairbal", "-o", tmp_path / "t")[2]
    code, _, err = cli("build", "cornell@1000", "-o", tmp_path / "t", "--builder", "bbvhh")
    assert code == 2
    assert "no builder 'bbvhh' (did you mean 'bbvh'?)" in err
    assert "did you mean" not in cli("build", "qqqqq", "-o", tmp_path / "t")[2]


def test_a_scenes_name_is_taken_where_triangles_are():
    tree = mibvh.build("cornell@2000", "lbvh")
    assert tree.meta["digest"] == mibvh.load("cornell@2000").triangles.digest
    assert mibvh.epo(tree, "cornell@2000") == mibvh.epo(tree, mibvh.load("cornell@2000"))
    with pytest.raises(mibvh.MibvhError, match="no such file"):
        mibvh.build("nowhere.obj")


def test_a_trimesh_is_a_scene():
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    assert mibvh.load(ball).triangles.areas.sum() == pytest.approx(ball.area, rel=1e-5)


# ------------------------------------------------------------------ parameters of XML


def notes(err):
    """What was said beside the progress, of which a slow run has lines."""
    return [line for line in err.splitlines() if not line.endswith("%)")]


def test_parameters_in_every_command(cli, tmp_path):
    path = tmp_path / "s.xml"
    path.write_text(SIZED)
    tree, rays, picture = (tmp_path / name for name in ("t.npz", "r.npz", "p.png"))
    given = ("-D", "n=3", "--json")
    code, out, err = cli("build", path, "-o", tree, *given)
    assert (code, notes(err)) == (0, [])
    box = np.array([mibvh.Tree.load(tree).lower[0], mibvh.Tree.load(tree).upper[0]])
    np.testing.assert_array_equal(box, [[-3] * 3, [3] * 3])
    assert cli("metrics", path, tree, *given)[0] == 0
    assert cli("rays", path, "-o", rays, "--width", 9, "--height", 9, *given)[0] == 0
    assert mibvh.RaySet.load(rays).meta["scene"] == "s[n=3]"
    code, out, err = cli("trace", path, tree, rays, "--repeats", 1, *given)
    assert (code, notes(err)) == (0, [])
    # Without the parameter it is another geometry.
    assert "another geometry" in cli("trace", path, tree, rays)[2]
    code, out, _ = cli("scenes", "show", path, "-o", picture, *given)
    assert json.loads(out)["scene"] == "s[n=3]"
    # The file has no camera: they are chosen.
    code, out, err = cli("render", path, "-o", picture, "--size", "16x12", "--spp", 1, *given)
    (note,) = notes(err)
    assert code == 0
    assert note.endswith("it has no camera that can be used; the viewpoint was chosen for it")
    assert json.loads(out)["width"] == 16
    for command, output in (("build", tree), ("render", picture)):
        code, _, err = cli(command, "cornell@1000", "-o", output, "-D", "no=3")
        assert code == 2
        assert "Mitsuba cannot load it" in err


@pytest.mark.slow
def test_parameters_in_a_study(cli, tmp_path):
    """Two scenes of one file in one folder: neither takes the other's results."""
    path = tmp_path / "s.xml"
    path.write_text(SIZED.replace("</scene>", '<emitter type="constant"/></scene>'))
    common = (
        "study",
        "-o",
        tmp_path / "out",
        "--builders",
        "lbvh",
        "--experiments",
        "prediction",
        "--seconds",
        0,
        "--json",
    )
    code, out, _ = cli(*common, f"{path}[n=2]", path)
    assert code == 0
    assert [row["scene"] for row in json.loads(out.splitlines()[-1])["trees"]] == ["s[n=2]", "s"]
    code, out, _ = cli(*common, path, "-D", "n=2")
    assert [row["scene"] for row in json.loads(out.splitlines()[-1])["trees"]] == ["s[n=2]"]


# ------------------------------------------------------------------ exceptions


def test_debug_shows_what_is_behind_a_sentence(cli, tmp_path):
    path = tmp_path / "a.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "nodes": 3}')
    code, _, err = cli("build", path, "-o", tmp_path / "t.npz")
    assert (code, err.count("\n")) == (2, 1)
    assert f"mibvh: {path}: cannot be read as GLTF: damaged (TypeError: " in err
    code, _, err = cli("--debug", "build", path, "-o", tmp_path / "t.npz")
    assert code == 2
    assert "Traceback" in err
    assert "gltf.py" in err
    assert f"mibvh: {path}: " in err.splitlines()[-1]


def test_a_picture_without_an_integrator(cli, tmp_path):
    path = tmp_path / "s.xml"
    path.write_text(SIZED.replace("</scene>", '<emitter type="constant"/></scene>'))
    assert cli("scenes", "show", path, "-o", tmp_path / "p.png")[0] == 0
    assert mibvh.load(path).original.integrator() is None


# ------------------------------------------------------------------ on trial


def test_a_scene_on_trial(cli, tmp_path):
    path = tmp_path / "s.xml"
    path.write_text(SIZED)
    code, out, _ = cli("--sandbox", "build", path, "-D", "n=2", "-o", tmp_path / "t.npz", "--json")
    assert code == 0
    assert json.loads(out)["triangles"] == 12
    path.write_text("<scene")
    code, _, err = cli("--sandbox", "build", path, "-o", tmp_path / "t.npz")
    assert (code, err.count("\n")) == (2, 1)
    assert f"mibvh: {path}: Mitsuba cannot load it" in err


_RUN = subprocess.run


def _pretend(monkeypatch, code):
    """Let the process on trial run some Python instead."""

    def run(command, **more):
        return _RUN([sys.executable, "-c", code], **more)

    monkeypatch.setattr(subprocess, "run", run)


def test_crashes_and_endless_work_on_trial(monkeypatch):
    _pretend(monkeypatch, f"import os; os.kill(os.getpid(), {int(signal.SIGSEGV)})")
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: the process .* was ended by SIGSEGV"):
        try_to_load("a.xml")
    _pretend(monkeypatch, "import time; time.sleep(60)")
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: was not loaded within 0\.5 seconds"):
        try_to_load("a.xml", 0.5)
    _pretend(monkeypatch, "raise KeyError('x')")
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: could not be loaded on trial \(KeyError"):
        try_to_load("a.xml")


# ------------------------------------------------------------------ memory


def test_what_memory_there_is(monkeypatch, tmp_path):
    from mibvh import memory

    left = memory.available_memory()
    assert left is None or 0 < left < 1 << 50
    (tmp_path / "meminfo").write_text("MemTotal: 9 kB\nMemAvailable:    2000 kB\n")
    (tmp_path / "max").write_text("900000\n")
    (tmp_path / "used").write_text("100000\n")
    monkeypatch.setattr(memory, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "_limit", lambda: None)
    monkeypatch.setattr(memory, "_GROUPS", ((tmp_path / "no", tmp_path / "no"),))
    assert memory.available_memory() == 2_048_000
    monkeypatch.setattr(memory, "_GROUPS", ((tmp_path / "max", tmp_path / "used"),))
    assert memory.available_memory() == 800_000
    memory.require_memory(800_000, "it")
    with pytest.raises(mibvh.MibvhError, match=r"^it need about 0\.0 GB of memory"):
        memory.require_memory(800_001, "it")


def test_ulimit_counts():
    code = (
        "import resource; from mibvh.memory import available_memory as left;"
        "resource.setrlimit(resource.RLIMIT_AS, (1 << 31, 1 << 31)); print(left())"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0 < int(ran.stdout) < 1 << 31
