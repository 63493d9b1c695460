"""Shows the progress of a study: bars on a terminal, JSON lines, or few lines of text."""

from __future__ import annotations

import dataclasses
import json
import sys
import threading
import time
from typing import Any, NamedTuple

from mibvh.heartbeat import Heartbeat
from mibvh.studies.record.progress import MISSING, Progress

#: Seconds between two lines of the same stage.
_EVERY = 1.0


class Board:
    """Shows the progress of a study and the time left.

    Called as the ``progress`` of :func:`mibvh.study`, from any thread; several scenes may be
    under way at a time.

    Parameters
    ----------
    scenes : int
        How many there are.
    lines : bool
        Whether to write a JSON object per line to standard output, for machines.
    """

    def __init__(self, scenes: int, lines: bool) -> None:
        self._scenes = scenes
        self._lines = lines
        self._started = time.monotonic()
        self._begun: dict[str, float] = {}
        self._done: dict[str, float] = {}
        self._step: Progress | None = None
        self._last: Progress | None = None
        self._written = 0.0
        self._lock = threading.Lock()
        self._bars = None if lines or not sys.stderr.isatty() else _bars(scenes)
        self._tasks: dict[str, Any] = {}
        self._heartbeat = Heartbeat(self._sign_of_life)

    def __enter__(self) -> Board:
        if self._bars:
            self._bars.start()
        else:
            self._heartbeat.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars:
            self._bars.stop()
        else:
            self._heartbeat.__exit__(None, None, None)

    def _sign_of_life(self) -> bool:
        """Print the current step again, if it has lasted long."""
        with self._lock:
            step, now = self._step, time.monotonic()
            if step is None or step.done == 1.0:
                stage = "report" if self._finished == self._scenes else "load"
                step, left = Progress("", "", stage, None, 0.0), _Left(None, None)
            else:
                left = self._time_left(step.scene, now)
            if self._lines:
                self._write(step, left, now)
            else:
                more = f", {_clock(left.scene)}" if left.scene else ""
                sys.stderr.write(f"{step.scene or 'study'}: {step} ({step.done:.0%}{more})\n")
        return True

    def __call__(self, step: Progress) -> None:
        """Show that a step was reached."""
        scene, done = step.scene, step.done
        with self._lock:
            now = time.monotonic()
            if step.missing is not None:
                self._tell(step, now)
                if step.stage == MISSING:
                    return
            if scene not in self._begun or (done == 0.0 and self._done[scene] > 0.0):
                self._begun[scene] = now  # a scene whose worker died begins again
            self._done[scene], self._step = done, step
            left = self._time_left(scene, now)
            if self._lines:
                self._write(step, left, now)
            elif self._bars:
                self._draw(step, left)
            elif step.memory is not None:
                sys.stderr.write(f"{scene}: {_room(step.memory)}\n")
                self._heartbeat.beat()
            elif done == 1.0:
                sys.stderr.write(f"{scene}: {step.stage} ({self._finished} of {self._scenes})\n")
                self._heartbeat.beat()

    def _tell(self, step: Progress, now: float) -> None:
        """Print a missing result."""
        line = f"{step.scene}: {step.missing}"
        if self._lines:
            if step.stage == MISSING:  # the end of a scene has a line anyway
                self._write(step, _Left(None, None), now)
        elif self._bars:
            self._bars.console.print(line, highlight=False, markup=False)
        else:
            sys.stderr.write(f"mibvh: {line}\n")
            self._heartbeat.beat()

    def _time_left(self, scene: str, now: float) -> _Left:
        return _Left(
            scene=_left(now - self._begun[scene], self._done[scene], 1.0),
            all=_left(now - self._started, sum(self._done.values()), self._scenes),
        )

    @property
    def _finished(self) -> int:
        return sum(done == 1.0 for done in self._done.values())

    def _write(self, step: Progress, left: _Left, now: float) -> None:
        """Write a line, unless the last one of the same stage was written a moment ago."""
        same = self._last is not None and dataclasses.replace(step, done=self._last.done)
        if (
            step.done < 1.0
            and step.missing is None
            and same == self._last
            and now - self._written < _EVERY
        ):
            return
        self._last, self._written = step, now
        line = {
            "event": "progress",
            **dataclasses.asdict(step),
            "done": round(step.done, 4),
            "seconds_left": left.scene,
            "scenes_done": self._finished,
            "scenes": self._scenes,
            "all_seconds_left": left.all,
        }
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
        self._heartbeat.beat()

    def _draw(self, step: Progress, left: _Left) -> None:
        bars = self._bars
        if bars is None:
            return
        if step.memory is not None:
            bars.console.print(f"{step.scene}: {_room(step.memory)}", highlight=False)
        if step.scene not in self._tasks:
            self._tasks[step.scene] = bars.add_task(step.scene, total=1.0, left="")
        bars.update(
            self._tasks[step.scene],
            description=f"{step.scene}: {step}",
            completed=step.done,
            left=_clock(left.scene),
            visible=step.done < 1.0,
        )
        bars.update(
            bars.task_ids[0],
            description=f"study: {self._finished} of {self._scenes} scenes",
            completed=sum(self._done.values()),
            left=_clock(left.all),
        )


def _room(memory: float) -> str:
    return f"expected to take about {memory / 1e9:,.1f} GB of memory"


class _Left(NamedTuple):
    """Seconds left for the scene and for the study; None if there is no estimate yet."""

    scene: float | None
    all: float | None


def _left(spent: float, done: float, total: float) -> float | None:
    """Return the seconds left at the pace so far; None if there is no estimate yet."""
    return round(spent * (total - done) / done, 1) if done > 0 else None


def _clock(seconds: float | None) -> str:
    if seconds is None:
        return ""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}") + " left"


def _bars(scenes: int) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    bars = Progress(
        TextColumn("{task.description:<36}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TextColumn("{task.fields[left]}"),
        console=Console(stderr=True),
        transient=True,
    )
    bars.add_task(f"study: 0 of {scenes} scenes", total=float(scenes), left="")
    return bars
