"""A sign of life where no terminal shows a bar: a line at least every ten seconds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from types import TracebackType

#: Seconds of silence after which a line is due, and between looks at the clock.
SILENCE, LOOK = 8.0, 1.0


class Heartbeat:
    """Calls ``say`` whenever nothing was said for a while.

    Parameters
    ----------
    say : callable
        Writes a line; called from a thread of its own. What keeps it from writing is ignored.
    silence : float
        Seconds.
    """

    def __init__(self, say: Callable[[], None], silence: float = SILENCE) -> None:
        self._say = say
        self._silence = silence
        self._spoke = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)

    def beat(self) -> None:
        """Note that something was said."""
        self._spoke = time.monotonic()

    def __enter__(self) -> Heartbeat:
        self.beat()
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _loop(self) -> None:
        while not self._ended.wait(min(LOOK, self._silence)):
            if time.monotonic() - self._spoke >= self._silence:
                with contextlib.suppress(OSError, ValueError):  # of a pipe that nobody reads
                    self._say()
                self.beat()
