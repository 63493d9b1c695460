"""A sign of life where no terminal shows a bar: a line at least every ten seconds.

All heartbeats of a process go by one clock, which begins with the command: phases that follow on
each other in silence are one silence.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from types import TracebackType

#: Seconds of silence after which a line is due, and between looks at the clock. What is left of ten
#: is for threads that do not let go of Python, and for machines with much other work.
SILENCE, LOOK = 6.0, 0.5


class Pulse:
    """When the last line was written, and who is asked for the next one.

    Parameters
    ----------
    clock : callable
        Returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._spoke = clock()
        self._sayers: list[Callable[[], bool]] = []
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def beat(self) -> None:
        """Note that a line was written."""
        self._spoke = self._clock()

    def look(self) -> None:
        """Look at the clock: where silence has lasted, ask the latest sayer that has something."""
        if self._clock() - self._spoke < SILENCE:
            return
        for say in self._sayers[::-1]:
            with contextlib.suppress(OSError, ValueError):  # of a pipe that nobody reads
                if say():
                    break
        self.beat()

    def begin(self, say: Callable[[], bool]) -> None:
        """Ask from here on; the first one starts a thread that looks at the clock."""
        self._sayers.append(say)
        if self._thread is None:
            self.beat()
            self._ended = threading.Event()
            self._thread = threading.Thread(target=self._loop, args=(self._ended,), daemon=True)
            self._thread.start()

    def end(self, say: Callable[[], bool]) -> None:
        """Ask no more; the last one ends the thread."""
        self._sayers.remove(say)
        if not self._sayers and self._thread is not None:
            self._ended.set()
            self._thread.join()
            self._thread = None

    def _loop(self, ended: threading.Event) -> None:
        while not ended.wait(LOOK):
            self.look()


#: Of this process.
PULSE = Pulse()


class Heartbeat:
    """Calls ``say`` whenever nothing was said for a while.

    Parameters
    ----------
    say : callable
        Writes a line, and returns whether it had one to write; called from a thread of its own.
        Within several heartbeats, the innermost one is asked first. What keeps it from writing is
        ignored.
    pulse : Pulse
    """

    def __init__(self, say: Callable[[], bool], pulse: Pulse = PULSE) -> None:
        self._say = say
        self._pulse = pulse

    def beat(self) -> None:
        """Note that something was said."""
        self._pulse.beat()

    def __enter__(self) -> Heartbeat:
        self._pulse.begin(self._say)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pulse.end(self._say)
