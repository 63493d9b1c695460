"""One case: a study that is killed up to six times, and begun again each time.

Half of the kills come at a random moment, the others before a random change to the study's folder:
a file that is opened, moved into place or removed. A case passes if the last run has the figures of
one that nobody killed, and leaves no half a file.

Each run is forked off a process that has all of mibvh loaded and compiled. Dr.Jit, whose threads do
not survive a fork, is started in the run itself.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np

import mibvh
from mibvh.bundled import bundled_scene
from mibvh.code import code_digest
from mibvh.studies.ahead import METRICS, compile_part
from mibvh.studies.report.html import template
from tools.fuzz.pieces import CHOICES, SCENE, known

#: Seconds that a run may take that nobody kills.
PATIENCE = 600.0
#: Kills of a case, at most.
MOST_KILLS = 6


class Kills:
    """Studies in processes of their own."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="mibvh-fuzz-"))
        for part in (*CHOICES["builders"], METRICS):
            compile_part(part)
        code_digest("mibvh.studies.measure.scene")
        template()
        bundled_scene(SCENE)
        self.truth, _, _ = self._finish(self.folder / "first")  # compiles what is left
        truth, self.seconds, self.changes = self._finish(self.folder / "whole")
        if truth != self.truth:
            raise AssertionError("two studies that nobody killed differ")

    def _finish(self, folder: Path) -> tuple[str, float, int]:
        """Study to the end: the figures, the seconds, and how many changes were made to files."""
        started, said = time.monotonic(), self.folder / "said"
        code = _wait(_fork(lambda: _study(folder, said, sys.maxsize)), PATIENCE)
        text, _, changes = said.read_text().rpartition("\n")
        if code != 0:
            raise AssertionError(f"a study that is begun again fails: {text.splitlines()[-1]}")
        return text, time.monotonic() - started, int(changes)

    def _kill(self, folder: Path, rng: np.random.Generator) -> str:
        """Study, and kill that; return how."""
        said = self.folder / "said"
        if rng.random() < 0.5:
            code = _wait(
                _fork(lambda: _study(folder, said, sys.maxsize)),
                float(rng.uniform(0.1, 1.0) * self.seconds),
            )
            how = "in time"
        else:
            most = int(rng.integers(self.changes))
            code = _wait(_fork(lambda: _study(folder, said, most)), PATIENCE)
            how = "at a file"
        if code not in (0, -signal.SIGKILL):
            raise AssertionError(f"a study fails: {said.read_text().splitlines()[-2]}")
        return how if code else ""

    def run(self, seed: int) -> str:
        """Run a case; return what became of it."""
        rng = np.random.default_rng(seed)
        case = self.folder / "case"
        shutil.rmtree(case, ignore_errors=True)
        kills = [self._kill(case, rng) for _ in range(int(rng.integers(1, MOST_KILLS + 1)))]
        found, _, _ = self._finish(case)
        if found != self.truth:
            raise AssertionError(f"wrong numbers after kills {kills}")
        left = [path.name for path in case.rglob(".*")]
        if left:
            raise AssertionError(f"half a file is left: {left[0]}")
        return f"killed {sum(map(bool, kills))} times"


def _study(folder: Path, said: Path, changes: int) -> None:
    """Study, with so many changes to files in the folder at most; say the figures and the count."""
    count = _count_changes(folder, changes)
    try:
        # The picture is a piece like any other, and takes as long as all others to render.
        with mock.patch("mibvh.picture.picture", return_value=np.zeros((2, 3, 3))):
            text = known(mibvh.study([SCENE], folder, **CHOICES))
    except BaseException:
        said.write_text(f"{traceback.format_exc()}\n{count()}")
        raise
    said.write_text(f"{text}\n{count()}")


def _count_changes(folder: Path, most: int) -> Callable[[], int]:
    """Count what changes files in a folder, for the rest of this process; die before one too many.

    Returns
    -------
    callable
        Gives the number so far.
    """
    made = 0

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal made
        changes = event in ("os.rename", "os.remove", "os.mkdir", "os.chmod") or (
            event == "open" and int(arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR)  # type: ignore[call-overload]
        )
        if changes and str(arguments[0]).startswith(str(folder)):
            if made == most:
                os.kill(os.getpid(), signal.SIGKILL)
            made += 1

    sys.addaudithook(hook)
    return lambda: made


def _fork(run: Callable[[], None]) -> int:
    """Run something in a child of this process; return the child's number."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        run()
        code = 0
    finally:
        os._exit(code)  # nothing of the parent's is to be tidied up


def _wait(child: int, seconds: float) -> int:
    """Wait for a child for so long, then kill it; return its exit code."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
