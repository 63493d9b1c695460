"""A study on a Dask cluster: scenes are the unit, and come back as the records of a local study.

A scene stays on one worker, so that its times are of one machine, and workers of one machine take
turns, so that nothing of ours disturbs the stopwatch. A worker that dies loses its scene only; the
scheduler gives it to another, which goes on from what is kept on its own machine.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mibvh.bundled import cache_folder
from mibvh.errors import MibvhError
from mibvh.scene import load
from mibvh.studies.measure.scene import study_scene
from mibvh.studies.measure.store import Store
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import Listener, Progress
from mibvh.studies.record.scene import SceneRecord

#: What a worker offers to be given scenes, and how one is started.
RESOURCE = "mibvh"
_HOW = f'dask worker ADDRESS --nthreads 1 --resources "{RESOURCE}=1"'
_SECONDS_TO_CONNECT = 10


def study_on_cluster(
    sources: Sequence[Any], options: StudyOptions, address: str, listener: Listener
) -> Iterator[SceneRecord]:
    """Study scenes on the workers of a Dask scheduler.

    Parameters
    ----------
    sources : sequence of str or path
        Names of bundled scenes, or files that the workers see under the same path.
    options : StudyOptions
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    listener : callable
        Told of the progress, from another thread.

    Yields
    ------
    SceneRecord
        One of each scene, in the order of ``sources``.

    Raises
    ------
    MibvhError
        If Dask is not installed, no scheduler or fitting worker answers, a scene is no file or
        name, a scene cannot be studied, or every worker that tried it died.
    """
    named = [_named(source) for source in sources]
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_SECONDS_TO_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise MibvhError(f"--scheduler {address}: no Dask scheduler answers ({error})") from None
    with client:
        _check_workers(client, address)
        topic = f"mibvh-{uuid.uuid4().hex}"
        client.subscribe_topic(topic, lambda event: listener(Progress(*event[1])))
        # A key of its own each time: asking again must not bring back an old failure.
        futures = [
            client.submit(_study_one, name, options, topic, key=f"{name}-{topic}",
                          resources={RESOURCE: 1})
            for name in named
        ]  # fmt: skip
        for name, future in zip(named, futures, strict=True):
            try:
                yield SceneRecord.from_json(future.result())
            except distributed.KilledWorker:
                raise MibvhError(f"{name}: every worker that tried this scene died") from None


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise MibvhError(
            "--scheduler needs Dask, which is not installed: pip install 'mibvh[cluster]'"
        ) from None
    return distributed


def _named(source: Any) -> str:
    """A scene by what workers can find it by."""
    if not isinstance(source, str | os.PathLike):
        raise MibvhError("with a scheduler, scenes are given by name or file, not as objects")
    return str(Path(source).resolve()) if Path(source).exists() else str(source)


def _check_workers(client: Any, address: str) -> None:
    """See that there is a worker, and that those that take scenes do nothing else meanwhile."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    ours = {name: w for name, w in workers.items() if RESOURCE in w["resources"]}
    if not ours:
        raise MibvhError(
            f"--scheduler {address}: none of its {len(workers)} workers offers the resource "
            f"{RESOURCE}; start them with: {_HOW}"
        )
    for name, worker in ours.items():
        if worker["nthreads"] != 1:
            raise MibvhError(
                f"--scheduler {address}: worker {name} has {worker['nthreads']} threads and could "
                f"do other work while it measures; start it with: {_HOW}"
            )


def _study_one(source: str, options: StudyOptions, topic: str) -> dict[str, Any]:
    """Study one scene, and return its record as JSON-able values; runs on a worker."""
    from distributed import get_worker

    worker = get_worker()

    def listener(step: Progress) -> None:
        worker.log_event(topic, dataclasses.astuple(step))

    with _machine_to_ourselves():
        return study_scene(load(source), options, _store(), listener).to_json()


@functools.cache
def _store() -> Store:
    """Where this machine's workers keep trees, rays and measurements."""
    return Store(cache_folder() / "cluster")


@contextmanager
def _machine_to_ourselves() -> Iterator[None]:
    """Wait until no other worker of this machine studies a scene.

    The lock is the system's, so that one whose holder was killed is free at once.
    """
    import fcntl

    with (Path(tempfile.gettempdir()) / "mibvh-worker.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
