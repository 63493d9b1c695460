"""Tasks that beget tasks."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from mibvh.parallel import run_tasks


@pytest.mark.parametrize("threads", [1, 3])
def test_every_task_runs_once_and_progress_ends_at_one(threads):
    done, shares = [], []
    lock = threading.Lock()

    def halve(task):
        begin, end = task
        if end - begin == 1:
            with lock:
                done.append(begin)
            return []
        middle = (begin + end) // 2
        return [(begin, middle), (middle, end)]

    run_tasks(halve, (0, 100), lambda task: task[1] - task[0], threads, shares.append)
    assert sorted(done) == list(range(100))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_the_largest_goes_first():
    seen = []

    def work(task):
        seen.append(task)
        return [3, 5, 1] if task == 9 else []

    run_tasks(work, 9, lambda task: task, 1)
    assert seen == [9, 5, 3, 1]


def test_an_error_comes_through():
    def work(task):
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        run_tasks(work, 1, lambda task: task, 2)


FORKED = """
import os, sys
import numpy as np
import mibvh
corners = np.random.default_rng(0).random((4000, 3, 3)).astype(np.float32)
builders = ("bbvh", "streelet")
before = [mibvh.build(corners, name) for name in builders]
child = os.fork()
if child == 0:
    after = [mibvh.build(corners, name) for name in builders]
    os._exit(0 if all(np.array_equal(a.lower, b.lower) for a, b in zip(before, after)) else 3)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""

THREADS = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
import mibvh
corners = np.random.default_rng(0).random((3000, 3, 3)).astype(np.float32)
builders = ("bbvh", "streelet")
alone = [mibvh.build(corners, name) for name in builders]
with ThreadPoolExecutor(8) as pool:
    found = list(pool.map(lambda name: mibvh.build(corners, name), builders * 8))
assert all(np.array_equal(a.lower, b.lower) for a, b in zip(alone * 8, found))
"""


@pytest.mark.parametrize("program", [FORKED, THREADS], ids=["forked", "threads"])
def test_builders_run_in_a_forked_process_and_in_several_threads(program):
    """Thread pools of the parent do not survive a fork; none may be kept."""
    ended = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
        env={**os.environ, "MIBVH_THREADS": "2"},
    )
    assert ended.returncode == 0, ended.stderr
