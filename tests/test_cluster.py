"""Studies on a Dask cluster of several worker processes."""

import os
import signal
import sys
import threading
import time

import pytest

import mibvh
from mibvh.studies.record.options import StudyOptions

pytest.importorskip("distributed", reason="Dask is not installed: pip install 'mibvh[cluster]'")
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")

SCENES = ["cornell@3000", "hairball@3000"]
CHOICES = {
    "builders": ("bbvh", "lbvh"),
    "width": 24,
    "height": 16,
    "scalar_rays": 256,
    "seconds": 0.0,
}


@pytest.fixture(scope="module")
def cluster():
    import dask
    from distributed import LocalCluster

    quiet = {"distributed.admin.log-format": "%(message)s", "logging.distributed": "critical"}
    with (
        dask.config.set(quiet),
        LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            resources={"mibvh": 1},
            dashboard_address=None,
            silence_logs=50,
        ) as found,
    ):
        yield found


def test_a_killed_worker_loses_its_scene_only(cluster, tmp_path):
    from distributed import Client

    seen, killed = [], []
    finished = threading.Event()

    def watch(step):
        seen.append((step.scene, step.stage, step.done))

    def kill_one():
        """Kill the worker of the first scene that is being built."""
        with Client(cluster.scheduler_address, set_as_default=False) as client:
            while not finished.is_set():
                under_way = [s for s, stage, done in list(seen) if 0.02 < done < 0.5]
                for address, keys in client.processing().items() if under_way else ():
                    if any(str(key).startswith(under_way[0]) for key in keys):
                        nanny = next(
                            w for w in cluster.workers.values() if w.worker_address == address
                        )
                        os.kill(nanny.pid, signal.SIGKILL)
                        killed.append(under_way[0])
                        return
                time.sleep(0.01)

    killer = threading.Thread(target=kill_one)
    killer.start()
    try:
        there = mibvh.study(
            SCENES,
            tmp_path / "there",
            scheduler=cluster.scheduler_address,
            progress=watch,
            **CHOICES,
        )
    finally:
        finished.set()
        killer.join()
    assert len(killed) == 1
    begun = {
        name: sum(s == name and d == 0.0 and t == "rays" for s, t, d in seen) for name in SCENES
    }
    assert begun == {name: 2 if name == killed[0] else 1 for name in SCENES}

    here = mibvh.study(SCENES, tmp_path / "here", **CHOICES)
    assert there.report.exists()
    for name in ("scene", "builder", "sah", "epo", "lcv", "counted_cost", "point_query"):
        assert there.table[name].tolist() == here.table[name].tolist()


def test_a_tree_that_fails_on_a_worker_is_missing(cluster, tmp_path):
    tree = mibvh.build(SCENES[0], "lbvh")
    found = mibvh.study(
        SCENES,
        tmp_path,
        trees={"mine": [tree, tree]},
        scheduler=cluster.scheduler_address,
        **CHOICES,
    )
    assert [len(record.trees) for record in found.scenes] == [3, 2]
    ((scene, one),) = found.missing
    assert (scene, one.tree) == (SCENES[1], "mine")
    assert "built for another geometry" in one.why


def test_mistakes_on_a_cluster(cluster, tmp_path):
    address = cluster.scheduler_address
    with pytest.raises(mibvh.MibvhError, match=r"nowhere\.ply: there is no such file"):
        mibvh.study(["nowhere.ply"], tmp_path, scheduler=address, **CHOICES)
    with pytest.raises(mibvh.MibvhError, match="not as objects"):
        mibvh.study([mibvh.load("cornell@3000")], tmp_path, scheduler=address, **CHOICES)
    with pytest.raises(mibvh.MibvhError, match="no Dask scheduler answers"):
        mibvh.study(SCENES, tmp_path, scheduler="nonsense://here", **CHOICES)


@pytest.mark.parametrize(
    ("worker", "said"),
    [
        ({"nthreads": 1, "resources": {}}, "none of its 1 workers offers the resource mibvh"),
        ({"nthreads": 4, "resources": {"mibvh": 1.0}}, "worker w has 4 threads"),
    ],
)
def test_workers_must_be_fit_to_measure(worker, said):
    from mibvh.studies.cluster import _check_workers

    class Client:
        def scheduler_info(self, n_workers):
            return {"workers": {"w": worker}}

    with pytest.raises(mibvh.MibvhError, match=said):
        _check_workers(Client(), "tcp://there")


def test_without_dask(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(mibvh.MibvhError, match=r"pip install 'mibvh\[cluster\]'"):
        mibvh.study(SCENES, tmp_path, options=StudyOptions(), scheduler="tcp://there:1")
