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


#: Every way in which images are read and written, with one thread for everything.
IMAGES = """
import faulthandler, sys
faulthandler.dump_traceback_later(500, exit=True)
import drjit, numpy
from mibvh.cli import main
from mibvh.variant import mitsuba
mi = mitsuba()
assert drjit.thread_count() == 1
mi.Bitmap(numpy.full((4, 8, 3), 128, numpy.uint8)).write("grey.png")
open("s.xml", "w").write('''<scene version="3.0.0"><sensor type="perspective">
<transform name="to_world"><lookat origin="0, 1, -5" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film>
</sensor><emitter type="envmap"><string name="filename" value="$sky"/></emitter>
<shape type="cube"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
<string name="filename" value="$sky"/></texture></bsdf></shape></scene>''')
few = ("--spp", "2", "--builder", "lbvh")
for words in (
    ("render", "s.xml", "-o", "sky.exr", "-D", "sky=grey.png", *few),
    ("render", "s.xml", "-o", "out.exr", "-D", "sky=sky.exr", *few),
    ("render", "s.xml", "-o", "out.png", "-D", "sky=sky.exr", *few),
    ("render", "s.xml", "-o", "c.exr", "-D", "sky=sky.exr", "--integrator", "bvh_cost", *few),
    ("render", "s.xml", "-o", "c.png", "-D", "sky=sky.exr", "--integrator", "bvh_cost", *few),
    ("scenes", "show", "s.xml", "-D", "sky=sky.exr", "-o", "show.png"),
    ("study", "s.xml", "-D", "sky=sky.exr", "-o", "out", "--builders", "lbvh", "--seconds", "0"),
    ("report", "out", "--figures", "png"),
):
    sys.argv = ["mibvh", *words]
    try:
        main()
    except SystemExit as ended:
        assert not ended.code, (words, ended.code)
    assert drjit.thread_count() == 1
"""


def test_images_are_read_and_written_with_one_thread(tmp_path):
    """Mitsuba's tasks of OpenEXR files wait for ever where there is no thread to do them."""
    ended = subprocess.run(
        [sys.executable, "-c", IMAGES],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "MIBVH_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert ended.returncode == 0, ended.stderr[-3000:]
    for name in ("sky.exr", "out.exr", "out.png", "c.exr", "c.png", "show.png", "out/report.html"):
        assert (tmp_path / name).stat().st_size > 100


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
