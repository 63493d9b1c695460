"""A cluster that loses its scheduler or its only worker, or that never was: one sentence, soon."""

import subprocess
import sys
import time

import pytest

import mibvh
from mibvh.studies import cluster as module

distributed = pytest.importorskip("distributed", reason="pip install 'mibvh[cluster]'")
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")

CHOICES = {
    "builders": ("bbvh", "lbvh"),
    "width": 24,
    "height": 16,
    "scalar_rays": 256,
    "seconds": 60.0,
    "standard_error": 0.0,
}


@pytest.fixture
def processes(tmp_path):
    """Return a scheduler and its only worker, each a process."""
    started = []

    def start(*arguments):
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=tmp_path,
        )
        started.append(process)
        return process

    file = tmp_path / "scheduler.json"
    scheduler = start(
        "scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
        "--scheduler-file",
        str(file),
    )
    worker = start(
        "worker",
        "--scheduler-file",
        str(file),
        "--no-nanny",
        "--nthreads",
        "1",
        "--resources",
        "mibvh=1",
        "--no-dashboard",
        "--host",
        "127.0.0.1",
    )
    deadline = time.monotonic() + 60
    while not file.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    with distributed.Client(scheduler_file=str(file), set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        yield client.scheduler.address, scheduler, worker
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.parametrize(
    ("victim", "said"),
    [
        (1, "but the scheduler is gone|in vain"),
        (2, r"no worker has offered the resource mibvh for 3 s; start one with: dask worker"),
    ],
    ids=["scheduler", "worker"],
)
def test_what_is_killed_is_named(processes, victim, said, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(module, "_SECONDS_WITHOUT_WORKER", 3)
    address, killed = processes[0], []

    def watch(step):
        if step.stage == "time scalar" and not killed:
            processes[victim].kill()
            killed.append(time.monotonic())

    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.study(["cornell@1000"], tmp_path / "s", scheduler=address, progress=watch, **CHOICES)
    assert killed
    assert "Traceback" not in capfd.readouterr().err


def test_a_mistake_on_a_worker_names_the_worker(processes, tmp_path):
    @mibvh.builder("only-here")
    def only_here(triangles, options, context):
        return list(range(len(triangles)))

    try:
        with pytest.raises(mibvh.MibvhError, match=r"on worker tcp://127.*no builder 'only-here'"):
            mibvh.study(
                ["cornell@1000"],
                tmp_path / "s",
                scheduler=processes[0],
                **{**CHOICES, "builders": ("only-here",)},
            )
    finally:
        from mibvh.builders import registry

        registry._registered.pop("only-here")


@pytest.mark.parametrize(
    "address",
    [
        "tcp://127.0.0.1:1",
        "127.0.0.1:1",
        "tcp://localhost:port",
        "tcp://:99999999",
        "tcp://",
        "",
        "tcp://a..b:1",
        "tcp://[::1",
        "nonsense://here",
    ],
)
def test_where_nothing_listens(address, tmp_path):
    with pytest.raises(mibvh.MibvhError, match="no Dask scheduler answers"):
        mibvh.study(["cornell@1000"], tmp_path, scheduler=address, **CHOICES)
