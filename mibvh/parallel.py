"""Threads: how many, work handed out in blocks, and tasks that beget tasks."""

from __future__ import annotations

import heapq
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TypeVar

from mibvh.errors import MibvhError
from mibvh.ranges import RANGES

Task = TypeVar("Task")


def thread_count() -> int:
    """Return ``MIBVH_THREADS`` if set, otherwise the cores this process may use.

    Raises
    ------
    MibvhError
        If the variable is no whole number in its range.
    """
    asked = os.environ.get("MIBVH_THREADS")
    if asked is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else (os.cpu_count() or 1)
        )
    threads = int(asked) if asked.isascii() and asked.isdigit() else None
    if threads is None or not RANGES["threads"].holds(threads):
        raise MibvhError(f"MIBVH_THREADS must be {RANGES['threads']}, not {asked!r}")
    return threads


def run_blocks(
    work: Callable[[int, int, int], None],
    total: int,
    block: int,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Call ``work(worker, begin, end)`` over ``range(total)`` in blocks, on several threads.

    Parameters
    ----------
    work : callable
        Compiled code that drops the GIL does best. ``worker`` numbers the calling thread, so
        that each may have its own accumulator.
    total, block : int
        How much there is, and how much one call takes.
    threads : int, optional
        :func:`thread_count` by default.
    progress : callable, optional
        Called with the share done, from 0 to 1.
    """
    workers = min(threads or thread_count(), -(-total // block))
    begins = iter(range(0, total, block))
    lock = threading.Lock()
    stopped = threading.Event()

    def loop(worker: int) -> None:
        while not stopped.is_set():
            with lock:
                begin = next(begins, None)
            if begin is None:
                return
            work(worker, begin, min(begin + block, total))
            if progress:
                progress(min(begin + block, total) / total)

    if workers <= 1:
        loop(0)
        return
    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(loop, worker) for worker in range(workers)]
        try:
            for future in futures:
                future.result()
        finally:
            stopped.set()  # on Ctrl-C the others end after the block they are in


def run_tasks(
    work: Callable[[Task], Iterable[Task]],
    first: Task,
    size: Callable[[Task], int],
    threads: int,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Run a task and all that follow from it on several threads, the largest first.

    Threads take a task when they are free, so that one that is held up by other programs
    holds up nobody else.

    Parameters
    ----------
    work : callable
        Does a task and returns those that follow, of no greater size together. Compiled code
        that drops the GIL does best.
    first : Task
    size : callable
        How much work a task is.
    threads : int
    progress : callable, optional
        Called in the calling thread with the share done, from 0 to 1.
    """
    total, done, count = size(first), 0, 0
    waiting = [(-total, count, first)]
    running: dict[Future[Iterable[Task]], int] = {}
    with ThreadPoolExecutor(threads) as pool:
        while waiting or running:
            while waiting and len(running) < threads:
                weight, _, task = heapq.heappop(waiting)
                running[pool.submit(work, task)] = -weight
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                done += running.pop(future)
                for task in future.result():
                    count += 1
                    done -= size(task)
                    heapq.heappush(waiting, (-size(task), count, task))
            if progress and total:
                progress(done / total)
