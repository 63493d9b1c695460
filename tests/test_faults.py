"""Full disks, folders that cannot be written, interrupts: a sentence, and nothing half-written."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from unittest import mock

import pytest
import typer.core

import mibvh
from mibvh import heartbeat
from mibvh.files import atomic_path, write_arrays, write_text
from mibvh.heartbeat import Heartbeat, Pulse
from mibvh.studies.lock import alone_in

COMMAND = [sys.executable, "-m", "mibvh"]
#: A process whose files are limited cannot write what it covered.
UNCOVERED = {name: v for name, v in os.environ.items() if not name.startswith("COVERAGE_")}


def mibvh_command(*arguments, most_bytes=None, **options):
    """Run the command line in a process of its own; files may have so many bytes."""

    def limit():
        if most_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))

    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        preexec_fn=limit,
        env={**(os.environ if most_bytes is None else UNCOVERED), **options},
        check=False,
        timeout=300,
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the files of a small scene: tree, rays."""
    folder = tmp_path_factory.mktemp("made")
    scene = mibvh.load("cornell@3000")
    mibvh.build(scene, "lbvh").save(folder / "t.npz")
    mibvh.diffuse_rays(scene, width=64, height=48).save(folder / "r.npz")
    return folder


@pytest.mark.parametrize(
    "arguments",
    [
        ("build", "cornell@3000", "--builder", "lbvh", "-o", "OUT.npz"),
        ("rays", "cornell@3000", "--width", 64, "--height", 48, "-o", "OUT.npz"),
        ("trace", "cornell@3000", "T", "R", "--repeats", 1, "-o", "OUT.npz"),
        ("export", "T", "-o", "OUT"),
        ("triangles", "cornell@3000", "-o", "OUT"),
        (
            "render",
            "cornell@3000",
            "--spp",
            1,
            "--size",
            "80x60",
            "--builder",
            "lbvh",
            "-o",
            "OUT.exr",
        ),
        ("scenes", "show", "cornell@3000", "-o", "OUT.png"),
        ("scenes", "make", "cornell", "--triangles", 3000, "-o", "OUT"),
    ],
    ids=lambda arguments: " ".join(arguments[: 1 + (arguments[0] == "scenes")]),
)
def test_a_full_disk(arguments, made, tmp_path):
    """A limit on the size of files acts as a full disk does, in the middle of writing."""
    names = {"T": made / "t.npz", "R": made / "r.npz"}
    arguments = [names.get(a, str(a).replace("OUT", str(tmp_path / "out"))) for a in arguments]
    ended = mibvh_command(*arguments, most_bytes=1024)
    assert ended.returncode == 2, ended.stderr
    assert "cannot be written (File too large)" in ended.stderr
    # Dr.Jit says in a line of its own that it cannot keep its kernels; a slow run has progress.
    said = [
        line
        for line in ended.stderr.splitlines()
        if not line.startswith("jit_kernel_write") and not line.endswith(("%)", "..."))
    ]
    assert len(said) == 1
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path for path in left if path.suffix not in (".xml", ".ply")] == []
    assert not any(".tmp" in path.name or path.name.startswith(".") for path in left)


def test_a_study_on_a_full_disk_goes_on_after(tmp_path):
    study = (
        "study",
        "cornell@1000",
        "-o",
        tmp_path / "s",
        "--builders",
        "lbvh,bbvh",
        "--seconds",
        0,
        "--experiments",
        "prediction",
    )
    ended = mibvh_command(*study, most_bytes=40_000)
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1].endswith("cannot be written (File too large)")
    assert "Traceback" not in ended.stderr
    assert not list((tmp_path / "s").rglob(".*"))
    ended = mibvh_command(*study)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "s" / "report.html").exists()


@pytest.mark.parametrize("command", ["builders", "builders --json", "scenes list"])
def test_standard_output_may_be_full(command, tmp_path):
    """As a file that may not have a byte; `> /dev/full` is the same."""
    with (tmp_path / "out").open("w") as out:
        ended = subprocess.run(
            [*COMMAND, *command.split()],
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            env=UNCOVERED,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)),
        )
    assert ended.returncode == 2
    assert ended.stderr == "mibvh: standard output: cannot be written (File too large)\n"


def test_what_was_there_stays_when_writing_fails(tmp_path):
    path = tmp_path / "kept.txt"
    write_text(path, "before")

    def fails():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise OSError("no room")

    with pytest.raises(mibvh.MibvhError, match=r"kept\.txt: cannot be written \(no room\)"):
        fails()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_devices_pipes_and_folders_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in ("/dev/null", tmp_path / "pipe", tmp_path):
        with pytest.raises(mibvh.MibvhError, match="it exists, and is no file"):
            write_arrays(path, {}, {})
    assert os.path.exists("/dev/null")
    assert not os.path.isfile("/dev/null")


def test_one_study_at_a_time(tmp_path):
    (tmp_path / "cache").mkdir()
    choices = {"builders": ("lbvh",), "width": 8, "height": 8, "seconds": 0.0}
    with alone_in(tmp_path):
        said = rf"another study is at work in this folder \(process {os.getpid()}\)"
        with pytest.raises(mibvh.MibvhError, match=said):
            mibvh.study(["cornell@1000"], tmp_path, **choices)
    with alone_in(tmp_path):
        pass  # free again


def test_a_killed_study_holds_no_lock_and_leaves_no_half_file(tmp_path):
    (tmp_path / "cache").mkdir()
    program = (
        "import sys, time, pathlib\n"
        "from mibvh.files import atomic_path\nfrom mibvh.studies.lock import alone_in\n"
        "folder = pathlib.Path(sys.argv[1])\n"
        "with alone_in(folder), atomic_path(folder / 'cache' / 'tree-1.npz') as path:\n"
        "    path.write_text('half'); print('there', flush=True); time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        process.stdout.readline()
        assert len(list((tmp_path / "cache").iterdir())) == 2
        with pytest.raises(mibvh.MibvhError, match="another study"), alone_in(tmp_path):
            pass
        process.kill()
        process.wait()
    with alone_in(tmp_path):
        assert [path.name for path in (tmp_path / "cache").iterdir()] == ["lock"]


def test_an_interrupted_study_says_that_it_goes_on(tmp_path):
    command = [
        *COMMAND,
        "study",
        "cornell@1000",
        "-o",
        str(tmp_path),
        "--builders",
        "lbvh,bbvh",
        "--seconds",
        "30",
        "--json",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        for line in process.stdout:
            if '"time scalar"' in line:
                process.send_signal(signal.SIGINT)
                break
        _, err = process.communicate(timeout=60)
    assert err == "mibvh: interrupted; the same command goes on\n"
    assert process.returncode == 130
    assert not list((tmp_path / "cache").glob(".*"))


def test_compiling_is_told_apart_from_building(monkeypatch):
    from mibvh.builders import building

    monkeypatch.setattr(building, "_warm", set())
    seen = []
    for _ in range(2):
        mibvh.build(
            mibvh.load("cornell@1000"), "lbvh", progress=lambda stage, done: seen.append(stage)
        )
    assert seen[:2] == ["compiling", "building"]
    assert seen.count("compiling") == 1


class Told:
    """Heartbeats by a clock of the test's own, and what they say."""

    def __init__(self):
        self.now, self.lines = 0.0, []
        self.pulse = Pulse(lambda: self.now)

    def phase(self, name, has_one=True):
        def say():
            if has_one:
                self.lines.append((self.now, name))
            return has_one

        return Heartbeat(say, self.pulse)

    def silence(self, seconds):
        """Let time go by, with a look every half second."""
        for _ in range(int(2 * seconds)):
            self.now += 0.5
            self.pulse.look()


@pytest.fixture
def told(monkeypatch):
    """The looks are the test's: the thread has none."""
    monkeypatch.setattr(Pulse, "_loop", lambda self, ended: None)
    return Told()


def test_a_sign_of_life_in_silence_only(told):
    with told.phase("one") as heart:
        for _ in range(9):
            told.silence(3)
            heart.beat()
        assert told.lines == []
        told.silence(20)
    assert told.lines == [(33.0, "one"), (39.0, "one"), (45.0, "one")]


def test_phases_that_follow_on_each_other_are_one_silence(told):
    """Each by a clock of its own, three phases of five seconds would be silent for fifteen."""
    with told.phase("at work"):
        for name in ("load", "build", "save"):
            with told.phase(name):
                told.silence(5)
        told.silence(5)
        with told.phase("nothing yet", has_one=False):
            told.silence(5)
    assert told.lines == [(6.0, "build"), (12.0, "save"), (18.0, "at work"), (24.0, "at work")]


def test_a_pipe_that_nobody_reads_ends_nothing(told):
    def say():
        raise BrokenPipeError

    with Heartbeat(say, told.pulse), told.phase("inner", has_one=False):
        told.silence(20)


def test_the_clock_is_looked_at_while_there_is_a_phase(monkeypatch):
    monkeypatch.setattr(heartbeat, "LOOK", 0.001)
    monkeypatch.setattr(heartbeat, "SILENCE", 0.0)
    said, pulse = threading.Event(), Pulse()
    with Heartbeat(lambda: said.set() or True, pulse), Heartbeat(lambda: False, pulse):
        assert said.wait(60)
    assert pulse._thread is None


def test_a_command_shows_signs_of_life_in_all_it_does(monkeypatch, capsys):
    """From its start to its end, between its phases too."""
    monkeypatch.setattr(heartbeat, "LOOK", 0.001)
    monkeypatch.setattr(heartbeat, "SILENCE", 0.0)
    from mibvh.cli.app import _Commands

    def invoke(self, ctx):
        deadline = time.monotonic() + 60
        while "at work" not in capsys.readouterr().err and time.monotonic() < deadline:
            time.sleep(0.001)
        return deadline > time.monotonic()

    monkeypatch.setattr(typer.core.TyperGroup, "invoke", invoke)
    assert _Commands().invoke(mock.Mock(args=[]))


def test_compiled_code_is_kept_elsewhere_where_package_and_home_are_read_only(tmp_path):
    """Numba's own answer is "cannot cache function: no locator available for file"."""
    program = (
        "import numba.core.caching as c, numba, sys\n"
        "def refuse(self): raise OSError(30, 'Read-only file system')\n"
        "for name in ('InTreeCacheLocator', 'UserWideCacheLocator'):\n"
        "    kind = getattr(c, name, None) or getattr(c, '_' + name)  # until Numba 0.61\n"
        "    kind.ensure_cache_path = refuse\n"
        "from mibvh.builders.radix import float_keys\n"
        "import numpy as np\n"
        "float_keys(np.zeros(3, np.float32))\n"
        "print(numba.config.CACHE_DIR)\n"
    )
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    for private in (True, False):
        ended = subprocess.run(
            [sys.executable, "-c", program],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )
        assert ended.returncode == 0, ended.stderr
        folder = tmp_path / f"mibvh-compiled-{os.getuid()}"
        assert (ended.stdout.strip() == str(folder)) == private
        assert list(folder.rglob("*.nbc"))
        folder.chmod(0o777)  # somebody else could put code there: another is taken, and removed
    assert list(tmp_path.iterdir()) == [folder]


def test_a_full_disk_does_not_keep_from_compiling(tmp_path):
    program = (
        "import resource, numpy as np\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))\n"
        "from mibvh.builders.radix import float_keys\n"
        "print(float_keys(np.zeros(3, np.float32)).shape)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    assert (ended.returncode, ended.stdout) == (0, "(3,)\n"), ended.stderr
