"""Threads: how many, and work handed out in blocks."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from mibvh.errors import MibvhError


def thread_count() -> int:
    """Return ``MIBVH_THREADS`` if set, otherwise the cores this process may use.

    Raises
    ------
    MibvhError
        If the variable is no positive whole number.
    """
    asked = os.environ.get("MIBVH_THREADS")
    if asked is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else (os.cpu_count() or 1)
        )
    if not asked.isdigit() or int(asked) < 1:
        raise MibvhError(f"MIBVH_THREADS must be a positive whole number, not {asked!r}")
    return int(asked)


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
