import importlib
import inspect
import json
import os
import subprocess
import sys

import numpy as np
import pytest

import mibvh
from mibvh.audit import audit
from mibvh.cli import main
from mibvh.cli.app import COMMANDS
from mibvh.cli.progress import progress_bar, show_stages
from mibvh.layouts import LAYOUTS


def run(capsys, monkeypatch, *arguments):
    """Run the command line in this process; returns (exit code, stdout, stderr)."""
    monkeypatch.setattr(sys, "argv", ["mibvh", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    captured = capsys.readouterr()
    return ended.value.code or 0, captured.out, captured.err


@pytest.fixture
def cli(capsys, monkeypatch):
    return lambda *arguments: run(capsys, monkeypatch, *arguments)


def defaults(function):
    """Defaults of a function's parameters by name; None is filled in elsewhere."""
    found = {name: p.default for name, p in inspect.signature(function).parameters.items()}
    return {k: v for k, v in found.items() if v is not None and v is not inspect.Parameter.empty}


@pytest.mark.parametrize(
    ("command", "function", "same"),
    [
        ("build", mibvh.build, {"builder"}),
        ("collapse", mibvh.collapse, {"width", "method"}),
        ("rays", mibvh.diffuse_rays, {"width", "height", "samples", "bounces", "seed"}),
        ("trace", mibvh.trace, {"lanes", "cull", "repeats"}),
        ("audit", audit, {"seed"}),
        ("study", mibvh.StudyOptions, {"seed", "warp_width", "warp_style"}),
    ],
)
def test_the_defaults_of_a_command_are_those_of_its_function(command, function, same):
    """They stand in both, so that help on the command line needs no slow import."""
    told, meant = defaults(COMMANDS[command]), defaults(function)
    assert {name: told[name] for name in same} == {name: meant[name] for name in same}


@pytest.mark.parametrize("option", ["--widths", "--width"])
def test_a_study_takes_widths_by_either_name(cli, tmp_path, monkeypatch, option):
    taken = []

    def study(sources, output, *, options, **_):
        taken.append(options)
        raise mibvh.MibvhError("enough is known")

    monkeypatch.setattr(mibvh, "study", study)
    assert cli("study", "cornell@300", "-o", tmp_path, option, "2,8")[0] == 2
    assert [options.widths for options in taken] == [(2, 8)]


@pytest.mark.parametrize("command", ["import", "export"])
def test_the_help_names_every_layout(cli, command):
    code, out, _ = cli(command, "--help")
    assert code == 0
    words = set(out.replace(",", " ").replace(";", " ").split())
    assert set(LAYOUTS) <= words


def test_the_whole_path(cli, tmp_path):
    scene = "cornell@3000"
    tree, rays, hits = (tmp_path / name for name in ("t.npz", "r.npz", "h.npz"))
    code, out, _ = cli("build", scene, "--builder", "lbvh", "-o", tree, "--json")
    built = json.loads(out)
    assert code == 0
    assert built["builder"] == "lbvh"
    assert built["sah"] == mibvh.sah(mibvh.Tree.load(tree))
    assert {"triangles", "references", "nodes", "leaves", "depth", "build_seconds"} <= set(built)
    code, out, _ = cli("metrics", scene, tree, "--json")
    metrics = json.loads(out)
    assert metrics["sah"] == built["sah"]
    assert metrics["epo"] > 0
    assert {"nodes", "leaves", "depth", "mean_leaf_size"} <= set(metrics)
    code, out, _ = cli(
        "rays", scene, "-o", rays, "--width", 32, "--height", 24, "--bounces", 2, "--json"
    )
    made = json.loads(out)
    assert made["rays"] == len(mibvh.RaySet.load(rays))
    assert made["rays_per_bounce"]["1"] + made["rays_per_bounce"]["2"] == made["rays"]
    for lanes in ("simd", "scalar"):
        code, out, _ = cli("trace", scene, tree, rays, "--lanes", lanes, "-o", hits, "--json")
        traced = json.loads(out)
        assert traced["rays"] == made["rays"]
        assert traced["ns_per_ray"] > 0
        with np.load(hits) as kept:
            assert kept["t"].dtype == np.float32
            assert kept["triangle"].dtype == np.int32
            assert int((kept["triangle"] >= 0).sum()) == traced["hits"]
            assert kept["leaves"].astype(float).std() == pytest.approx(traced["lcv"])
            assert np.isinf(kept["t"][kept["triangle"] < 0]).all()
    _, out, _ = cli("trace", scene, tree, rays, "--style", "wide", "--repeats", 1, "--json")
    wide = json.loads(out)
    assert wide["hits"] == traced["hits"]
    assert not {"counted_cost", "lcv", "inner_per_ray", "leaves_per_ray"} & set(wide)
    assert wide["wide_counted_cost"] != traced["counted_cost"]


def test_other_kinds_of_rays_and_rays_of_ones_own(cli, tmp_path):
    """Shadow rays end at any hit; plain arrays are traced like ray sets."""
    scene, small = "cornell@3000", ("--width", 16, "--height", 12, "--json")
    tree, rays, plain = (tmp_path / name for name in ("t.npz", "r.npz", "r.npy"))
    cli("build", scene, "-o", tree)
    code, out, _ = cli("rays", scene, "-o", rays, "--kind", "shadow", *small)
    made = json.loads(out)
    assert code == 0
    assert (made["kind"], made["occlusion"]) == ("shadow", True)
    shadow = mibvh.read_rays(rays)
    np.save(plain, np.concatenate([shadow.o, shadow.d], axis=1))
    costs = []
    for file in (rays, plain):
        code, out, _ = cli("trace", scene, tree, file, "--repeats", 1, "--json")
        costs.append(json.loads(out)["inner_per_ray"])
    assert costs[0] < costs[1]
    hits = mibvh.trace(mibvh.Tree.load(tree), mibvh.load(scene), shadow, any_hit=True, repeats=1)
    assert costs[0] == pytest.approx(hits.inner.mean())
    code, out, err = cli("rays", scene, "-o", rays, "--kind", "glossy", *small)
    assert (code, out) == (2, "")
    assert "there is no kind of rays 'glossy'" in err
    code, out, err = cli("rays", scene, "-o", rays, "--kind", "ao", "--bounces", 2, *small)
    assert code == 2
    assert "--bounces is for diffuse rays" in err


def test_a_study_for_machines(cli, tmp_path):
    """JSON lines, the result last; twice the samples are twice the camera rays."""
    code, out, err = cli(
        "study",
        "cornell@1000",
        "-o",
        tmp_path,
        "--builders",
        "lbvh",
        "--experiments",
        "prediction",
        "--seconds",
        0,
        "--samples",
        2,
        "--json",
    )
    # Where something takes long, a sign of life says so.
    said = [line for line in err.splitlines() if not line.endswith((" ...", "%)"))]
    assert (code, said) == (0, [])
    *progress, result = map(json.loads, out.splitlines())
    assert {line["event"] for line in progress} == {"progress"}
    assert ("count", "lbvh") in {(line["stage"], line["builder"]) for line in progress}
    # Where writing the report takes long, a sign of life says so.
    *_, last = (line for line in progress if line["stage"] != "report")
    assert (last["stage"], last["done"]) == ("done", 1.0)
    assert result["event"] == "result"
    assert [row["builder"] for row in result["trees"]] == ["lbvh"]
    rays = json.loads((tmp_path / "cache" / "scene-cornell@1000.json").read_text())["value"]["rays"]
    assert rays["meta"]["samples"] == 2
    assert rays["count"] > 1.5 * 160 * 120 * rays["viewpoints"]


def test_options_reach_the_builder(cli, tmp_path):
    cli("build", "cornell@3000", "-o", tmp_path / "t.npz", "--option", "max_leaf=1", "--json")
    assert mibvh.Tree.load(tmp_path / "t.npz").count.min() == 1
    assert mibvh.Tree.load(tmp_path / "t.npz").stats()["max_leaf_size"] == 1


def test_what_is_no_triangle_is_named(cli, tmp_path):
    (tmp_path / "s.xml").write_text(
        '<scene version="3.0.0"><shape type="sphere" id="ball"/><shape type="cube"/></scene>'
    )
    code, out, err = cli("build", tmp_path / "s.xml", "-o", tmp_path / "t.npz", "--json")
    assert code == 0
    assert json.loads(out)["triangles"] > 12
    assert "mibvh: s: Sphere 'ball' was tessellated" in err


def test_a_plugin_registers_a_builder(cli, tmp_path):
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        "import mibvh, numpy as np\n"
        "@mibvh.builder('mine', summary='halves')\n"
        "def mine(triangles, options, context):\n"
        "    return np.arange(len(triangles))\n"
    )
    code, out, _ = cli("--plugin", plugin, "builders", "--json")
    assert code == 0
    names = [b["name"] for b in json.loads(out)["builders"]]
    assert names[0] == "bbvh"
    assert "mine" in names


def test_a_plugin_may_import_its_neighbours(cli, tmp_path):
    (tmp_path / "the_neighbour.py").write_text("NAME = 'from_next_door'\n")
    (tmp_path / "house.py").write_text(
        "import mibvh, numpy as np, the_neighbour\n"
        "@mibvh.builder(the_neighbour.NAME)\n"
        "def build(triangles, options, context):\n"
        "    return np.arange(len(triangles))\n"
    )
    code, out, _ = cli("--plugin", tmp_path / "house.py", "builders", "--json")
    assert code == 0
    assert "from_next_door" in [b["name"] for b in json.loads(out)["builders"]]


@pytest.mark.parametrize("name", ["random", "numpy", "graphlib"])
def test_a_plugin_may_be_called_as_a_module_of_others(cli, tmp_path, name):
    """Whoever imports that gets the module meant, imported before or not."""
    before = sys.modules.get(name)
    (tmp_path / f"{name}.py").write_text(
        "from __future__ import annotations\n"
        "import dataclasses, mibvh, numpy as np\n"
        "@dataclasses.dataclass(frozen=True, kw_only=True)\n"
        "class Own(mibvh.Options):\n"
        "    pairs: int = mibvh.option(2, 'of them')\n"
        f"@mibvh.builder('by {name}', options=Own)\n"
        "def build(triangles, options, context):\n"
        "    return np.arange(len(triangles))\n"
    )
    code, out, _ = cli("--plugin", tmp_path / f"{name}.py", "builders", "--json")
    assert code == 0
    assert f"by {name}" in [b["name"] for b in json.loads(out)["builders"]]
    assert sys.modules.get(name) is before
    assert importlib.import_module(name).__file__ != str(tmp_path / f"{name}.py")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\n\nraise KeyError('oak')\n", "line 3: KeyError: 'oak'"),
        ("x = 1\ndef (:\n", "line 2: SyntaxError: "),
        ("import mibvh\nmibvh.load('nowhere.ply')\n", "line 2: MibvhError: nowhere.ply"),
        ("import not_a_module_of_anyone\n", "line 1: ModuleNotFoundError: No module named"),
    ],
)
def test_a_plugin_that_fails_is_one_sentence(cli, tmp_path, text, said):
    (tmp_path / "failing.py").write_text(text)
    code, out, err = cli("--plugin", tmp_path / "failing.py", "builders")
    assert (code, out) == (2, "")
    assert f"--plugin {tmp_path / 'failing.py'}, {said}" in err
    assert len(err.splitlines()) == 1
    assert "failing" not in sys.modules


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise ValueError('kaboom\\nand more')", "line 4: ValueError: kaboom and more"),
        ("raise SystemExit(0)", "line 4: SystemExit: 0"),
        ("triangles.corners[0] = 5", "line 4: ValueError: "),
        ("return None", "builder boom: a leaf must be the ids of triangles, not None"),
    ],
)
def test_a_builder_that_fails_is_one_sentence(cli, tmp_path, body, said):
    head = "import mibvh\n@mibvh.builder('boom')\ndef boom(triangles, options, context):\n"
    (tmp_path / "boom.py").write_text(f"{head}    {body}\n")
    command = ("build", "cornell@100", "--builder", "boom", "-o", tmp_path / "tree.npz")
    code, out, err = cli("--plugin", tmp_path / "boom.py", *command)
    assert (code, out) == (2, "")
    assert said in err.splitlines()[-1]  # a slow machine has lines of progress before it
    assert not (tmp_path / "tree.npz").exists()


def test_what_is_read_is_not_written_to(cli, tmp_path):
    mesh = tmp_path / "one.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    before = mesh.read_bytes()
    (tmp_path / "other.obj").symlink_to(mesh)
    for output in (mesh, tmp_path / "other.obj"):
        code, _, err = cli("build", mesh, "-o", output)
        assert (code, mesh.read_bytes()) == (2, before)
        assert f"{output} is what is read" in err


def test_the_version(cli):
    code, out, _ = cli("--version")
    assert (code, out) == (0, f"mibvh {mibvh.__version__}\n")


def test_the_shell_completes():
    words = {"COMP_WORDS": "mibvh comp", "COMP_CWORD": "1", "_MIBVH_COMPLETE": "complete_bash"}
    program = "import sys; sys.argv = ['mibvh']; from mibvh.cli import main; main()"
    shown = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env={**os.environ, **words}
    )
    assert "compare" in shown.stdout.split()


def test_a_study_with_trees_and_a_scene_that_is_not_there(cli, tmp_path):
    """What can be studied is, and the exit code says that something was left out."""
    scene = mibvh.load("cornell@1000")
    tree = mibvh.build(scene, "sbvh", max_leaf=2)
    mibvh.write_tree(tree, tmp_path / "tree.bin")
    mibvh.diffuse_rays(scene, width=16, height=12, samples=1).save(tmp_path / "rays.npz")
    code, out, err = cli(
        "study",
        "cornell@1000",
        "absent.ply",
        "-o",
        tmp_path / "out",
        "--builders",
        "lbvh,hill(start=lbvh,sweeps=2)",
        "--tree",
        f"given={tmp_path / 'tree.bin'},",
        "--rays",
        f"{tmp_path / 'rays.npz'},",
        "--seconds",
        0,
        "--experiments",
        "prediction",
        "--json",
    )
    result = json.loads(out.splitlines()[-1])
    assert code == 2
    assert "mibvh: absent.ply was left out: absent.ply: there is no such file" in err
    assert list(result["left_out"]) == ["absent.ply"]
    assert [row["builder"] for row in result["trees"]] == [
        "lbvh",
        "hill(start=lbvh,sweeps=2)",
        "given",
    ]
    assert result["trees"][2]["sah"] == pytest.approx(mibvh.sah(tree))
    assert result["trees"][2]["build_seconds"] is None
    assert result["audit_failures"] == []
    code, out, _ = cli("report", tmp_path / "out")
    assert code == 0
    assert "absent.ply" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["build", "nowhere.ply", "-o", "t.npz"], "nowhere.ply: there is no such file"),
        (["build", "cornell@3000", "-o", "t.npz", "--builder", "oak"], "no builder 'oak'"),
        (["build", "cornell@3000", "-o", "t.npz", "--option", "leaf=3"], "no option 'leaf'"),
        (["build", "cornell@3000", "-o", "t.npz", "--option", "max_leaf=0"], "from 1 to 255"),
        (["build", "cornell@3000", "-o", "t.npz", "--option", "max_leaf=two"], "of type int"),
        (["build", "cornell@3000", "-o", "t.npz", "--option", "x"], "NAME=VALUE"),
        (["build", "cornell@3000", "-o", "absent/t.npz"], "absent/t.npz: cannot be written"),
        (["metrics", "cornell@3000", "absent.npz"], "absent.npz: there is no such tree file"),
        (["study", "cornell@3000", "-o", "out", "--profile", "slow"], "--profile is one of"),
        (["study", "cornell@3000", "-o", "out", "--tree", "t.npz"], "--tree takes NAME=VALUE"),
        (["study", "cornell@3000", "-o", "out", "--tree", "t=absent.npz"], "absent.npz"),
        (["study", "cornell@3000", "-o", "out", "--rays", "a.npz,b.npz"], "2 given for 1 scenes"),
        (["report", "absent"], "no finished scene"),
        (["--plugin", "absent.py", "builders"], "no such Python file"),
    ],
)
def test_mistakes_get_one_sentence(cli, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = cli(*arguments)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_usage_errors_exit_with_2(cli):
    code, _, err = cli("build")
    assert code == 2
    assert "SCENE" in err


@pytest.mark.parametrize(
    "command",
    [
        "build",
        "metrics",
        "rays",
        "trace",
        "study",
        "report",
        "builders",
        "doctor",
        "scenes",
        "experiments",
        "predictors",
    ],
)
def test_help(cli, command):
    code, out, _ = cli(command, "--help")
    assert code == 0
    assert "Usage" in out


def test_doctor(cli):
    code, out, _ = cli("doctor", "--json")
    found = json.loads(out)
    assert code == 0
    assert [found[name] for name in ("ready", "llvm")] == [True, True]
    assert all(type(found[name]) is bool for name in ("ready", "llvm", "cuda"))
    assert found["environment"]["lane_width"] >= 4


def test_import_is_quick_and_touches_no_variant():
    program = (
        "import sys, time; t = time.perf_counter(); import mibvh;"
        "assert 'mitsuba' not in sys.modules and 'numba' not in sys.modules;"
        "print(time.perf_counter() - t)"
    )
    times = [
        float(
            subprocess.run(
                [sys.executable, "-c", program],
                capture_output=True,
                text=True,
                check=True,
                env=dict(os.environ),
            ).stdout
        )
        for _ in range(3)
    ]
    assert min(times) < 1.0


def test_scenes_make_and_show(cli, tmp_path):
    code, out, _ = cli("scenes", "make", "cornell", "--triangles", 3000, "-o", tmp_path)
    assert code == 0
    assert (tmp_path / "cornell" / "scene.xml").exists()
    code, out, _ = cli(
        "scenes", "show", tmp_path / "cornell" / "scene.xml", "-o", tmp_path / "p.png", "--json"
    )
    assert code == 0
    assert json.loads(out)["triangles"] > 1000
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def test_a_new_stage_has_time_left():
    with progress_bar() as bar:
        task = bar.add_task("build", total=1.0)
        show = show_stages(bar, task)
        show("sort", 1.0)
        assert bar.tasks[task].finished
        show("split", 0.25)
        assert not bar.tasks[task].finished
        assert (bar.tasks[task].description, bar.tasks[task].completed) == ("split", 0.25)


def test_json_is_alone_on_standard_output(tmp_path):
    """Mitsuba warns of a sphere under an uneven transform, by itself on standard output."""
    (tmp_path / "oval.xml").write_text(
        '<scene version="3.0.0"><shape type="sphere"><transform name="to_world">'
        '<scale x="1" y="2" z="1"/></transform></shape></scene>'
    )
    run = [sys.executable, "-m", "mibvh", "build", "oval.xml", "-o", "tree.npz", "--json"]
    found = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(found.stdout)["builder"] == "bbvh"
    assert "non-uniform scaling" in found.stderr
