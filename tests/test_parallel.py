"""Tasks that beget tasks."""

from __future__ import annotations

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
