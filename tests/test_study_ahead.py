"""What a study compiles before its first build, and by whom."""

from __future__ import annotations

import subprocess
import sys

import pytest

from mibvh.studies import ahead

#: Compiled functions of the package and how many signatures each has, before and after real work.
_CODE = """
import gc
import mibvh
from mibvh.builders import names
from mibvh.studies.ahead import METRICS, SPLIT_CHECKS, compile_part
from numba.core.dispatcher import Dispatcher

def compiled():
    found = [f for f in gc.get_objects() if isinstance(f, Dispatcher)]
    return {(f.py_func.__module__, f.py_func.__name__, s) for f in found for s in f.signatures}

for part in (*names(), METRICS, SPLIT_CHECKS):
    compile_part(part)
before = compiled()
triangles = mibvh.load("livingroom@1500").triangles
for name in names():
    tree = mibvh.build(triangles, name)
    tree.validate(triangles)
    mibvh.epo(tree, triangles)
print(len(before), sorted(f"{m}.{f}" for m, f, _ in compiled() - before))
"""


class Helper:
    """A process that never ends by itself."""

    def __init__(self, parts):
        self.parts, self.ended = parts, False

    def poll(self):
        return -9 if self.ended else None

    def kill(self):
        self.ended = True

    def wait(self):
        assert self.ended


@pytest.fixture
def watched(monkeypatch, tmp_path):
    """Helpers that were started, and parts that were compiled here."""
    helpers, here = [], []
    monkeypatch.setattr(ahead, "_start", lambda parts: helpers.append(Helper(parts)) or helpers[-1])
    monkeypatch.setattr(ahead, "compile_part", here.append)
    monkeypatch.setattr(ahead, "_note", lambda parts: tmp_path / "-".join(parts))
    monkeypatch.setattr(ahead, "thread_count", lambda: 2)
    return helpers, here


def test_two_processes_begin_at_both_ends_and_only_once(watched):
    helpers, here = watched
    said = []
    for _ in range(2):
        with ahead.compiled_ahead(["bbvh", "mine", "lbvh", "bbvh"], said.append) as finish:
            finish()
            assert helpers[0].ended  # before anything is built
            finish()
    assert [helper.parts for helper in helpers] == [["metrics", "lbvh", "bbvh"]]
    assert here == said == ["bbvh", "lbvh", "metrics"]
    with ahead.compiled_ahead(["lbvh", "sbvh"], said.append) as finish:
        finish()
    assert here[3:] == ["lbvh", "sbvh", "metrics", "checks of split triangles"]


def test_a_study_that_fails_early_leaves_no_process(watched):
    helpers, here = watched
    with pytest.raises(KeyError), ahead.compiled_ahead(["bbvh", "lbvh"], print):
        raise KeyError
    assert helpers[0].ended
    assert here == []


def test_one_core_has_no_helper(watched, monkeypatch):
    monkeypatch.setattr(ahead, "thread_count", lambda: 1)
    with ahead.compiled_ahead(["bbvh", "lbvh"], print) as finish:
        finish()
    assert watched == ([], [])


def test_real_trees_need_nothing_that_is_not_compiled_ahead():
    ran = subprocess.run([sys.executable, "-c", _CODE], capture_output=True, text=True, check=True)
    count, missing = ran.stdout.split(maxsplit=1)
    assert int(count) > 40
    assert missing.strip() == "[]"
