"""A study on a Dask cluster: scenes are the unit, and come back as the records of a local study.

A scene stays on one worker, so that its times are of one machine, and workers of one machine take
turns, so that nothing of ours disturbs the stopwatch. A worker that dies loses its scene only; the
scheduler gives it to another, which goes on from what is kept on its own machine.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
import os
import socket
import tempfile
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mibvh.bundled import cache_folder
from mibvh.errors import MibvhError
from mibvh.scene import load
from mibvh.studies.measure.given import Given
from mibvh.studies.measure.scene import study_scene
from mibvh.studies.measure.store import Store
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.progress import Listener, Progress
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.sources import Source

#: What a worker offers to be given scenes, and how one is started.
RESOURCE = "mibvh"
_HOW = f'dask worker ADDRESS --nthreads 1 --resources "{RESOURCE}=1"'
_SECONDS_TO_CONNECT, _SECONDS_TO_CLOSE, _SECONDS_BETWEEN_LOOKS = 5, 5, 1
#: A nanny restarts a worker that died within a few seconds.
_SECONDS_WITHOUT_WORKER = 30
#: Protocols of addresses that have a host and a port, and the port if none is said.
_PROTOCOLS, _DEFAULT_PORT = ("tcp", "tls", "ws", "wss"), 8786


class _SceneRefused(MibvhError):
    """A scene cannot be studied; the others may be."""


def study_on_cluster(
    sources: Sequence[Source], options: StudyOptions, address: str, listener: Listener
) -> Iterator[SceneRecord | MibvhError]:
    """Study scenes on the workers of a Dask scheduler.

    Parameters
    ----------
    sources : sequence of Source
        Of names of bundled scenes, or files that the workers see under the same path.
    options : StudyOptions
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    listener : callable
        Told of the progress, from another thread.

    Yields
    ------
    SceneRecord or MibvhError
        One of each scene, in the order of ``sources``; why a scene could not be studied.

    Raises
    ------
    MibvhError
        If Dask is not installed, no scheduler or fitting worker answers, at first or later on, or
        a scene is no file or name.
    """
    named = [_named(source.scene) for source in sources]
    distributed = _distributed()
    _check_address(address)
    with _quiet():
        try:
            client = distributed.Client(address, timeout=_SECONDS_TO_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise MibvhError(
                f"--scheduler {address}: no Dask scheduler answers ({error})"
            ) from None
        try:
            _check_workers(client, address)
            topic = f"mibvh-{uuid.uuid4().hex}"
            client.subscribe_topic(topic, lambda event: listener(Progress(*event[1])))
            # A key of its own each time: asking again must not bring back an old failure.
            futures = [
                client.submit(
                    _study_one,
                    name,
                    options,
                    topic,
                    source.given(),
                    key=f"{name}-{topic}",
                    resources={RESOURCE: 1},
                )
                for name, source in zip(named, sources, strict=True)
            ]
            for name, future in zip(named, futures, strict=True):
                try:
                    yield SceneRecord.from_json(_result(client, future, name, address))
                except _SceneRefused as error:
                    yield MibvhError(str(error))
        finally:
            client.close(timeout=_SECONDS_TO_CLOSE)


def _result(client: Any, future: Any, name: str, address: str) -> dict[str, Any]:
    """Wait for a scene's record; say what is missing if it cannot come."""
    from distributed import KilledWorker

    waits = f"--scheduler {address}: {name} waits"
    seen = time.monotonic()
    while True:
        try:
            return dict(future.result(timeout=_SECONDS_BETWEEN_LOOKS))
        except TimeoutError:
            pass
        except MibvhError:
            raise
        except KilledWorker as error:
            last = getattr(error.last_worker, "address", "")
            raise _SceneRefused(
                f"{name}: every worker that tried this scene died{last and f', at last {last}'}"
            ) from None
        # The scheduler is gone, and the future with it; or the worker has no mibvh, or another.
        except (Exception, CancelledError) as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            raise MibvhError(f"{waits} in vain ({reason})") from None
        now = time.monotonic()
        if client.status != "running":
            raise MibvhError(f"{waits}, but the scheduler is gone; the same command goes on")
        if _ours(client):
            seen = now
        elif now - seen > _SECONDS_WITHOUT_WORKER:
            raise MibvhError(
                f"{waits}, but no worker has offered the resource {RESOURCE} for "
                f"{_SECONDS_WITHOUT_WORKER} s; start one with: {_HOW}"
            )


def _check_address(address: str) -> None:
    """See at once that something listens where the scheduler should be: Dask tries for long."""
    from distributed.comm.addressing import parse_address, parse_host_port

    try:
        kind, place = parse_address(address)
        if kind not in _PROTOCOLS:
            return  # Dask says what it makes of these
        host, port = parse_host_port(place, _DEFAULT_PORT)
        socket.create_connection((host, port), timeout=_SECONDS_TO_CONNECT).close()
    except (OSError, ValueError, TypeError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MibvhError(f"--scheduler {address}: no Dask scheduler answers ({reason})") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask from telling in many lines what is said in a sentence here."""
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


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
    count = len(client.scheduler_info(n_workers=-1)["workers"])
    ours = _ours(client)
    if not ours:
        raise MibvhError(
            f"--scheduler {address}: none of its {count} workers offers the resource "
            f"{RESOURCE}; start them with: {_HOW}"
        )
    for name, worker in ours.items():
        if worker["nthreads"] != 1:
            raise MibvhError(
                f"--scheduler {address}: worker {name} has {worker['nthreads']} threads and could "
                f"do other work while it measures; start it with: {_HOW}"
            )


def _ours(client: Any) -> dict[str, Any]:
    """The workers that take scenes, by their addresses."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    return {name: w for name, w in workers.items() if RESOURCE in w["resources"]}


def _study_one(source: str, options: StudyOptions, topic: str, given: Given) -> dict[str, Any]:
    """Study one scene, and return its record as JSON-able values; runs on a worker."""
    from distributed import get_worker

    worker = get_worker()

    def listener(step: Progress) -> None:
        worker.log_event(topic, dataclasses.astuple(step))

    try:
        with _machine_to_ourselves():
            return study_scene(load(source), options, _store(), listener, given).to_json()
    except MibvhError as error:
        raise _SceneRefused(f"on worker {worker.address}: {error}") from None
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise MibvhError(f"on worker {worker.address}: {source}: {reason}") from error


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
