"""Where a study is: what the callback of :func:`mibvh.study` is given."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

#: The last stage of a scene that cannot be studied.
LEFT_OUT = "left out"


@dataclasses.dataclass(frozen=True)
class Progress:
    """A step of a study.

    Attributes
    ----------
    scene, experiment, stage : str
        The stage is ``rays``, ``compiling``, ``build``, ``metrics``, ``count``, ``time scalar``
        and so on; ``done`` when the scene is finished, ``left out`` when it cannot be studied.
    builder : str or None
        Whose tree is in hand; None for what concerns all trees.
    done : float
        From 0 to 1 within the scene.
    memory : float or None
        Bytes that the process is expected to take, told once, before the first stage.
    """

    scene: str
    experiment: str
    stage: str
    builder: str | None
    done: float
    memory: float | None = None

    def __str__(self) -> str:
        words = [self.stage, self.builder, f"({self.experiment})" if self.experiment else None]
        return " ".join(word for word in words if word)


#: Takes the steps of a study, from any thread.
Listener = Callable[[Progress], None]


@dataclasses.dataclass(frozen=True)
class Reporter:
    """Reports the steps of one part of a scene's study as those of the whole.

    Attributes
    ----------
    listener : callable
    scene, experiment : str
    builder : str or None
    begin, share : float
        Where in the scene's progress the part begins, and how much of it the part is.
    """

    listener: Listener
    scene: str
    experiment: str = ""
    builder: str | None = None
    begin: float = 0.0
    share: float = 1.0

    def __call__(self, stage: str, done: float) -> None:
        """Report that a stage of this part is reached, ``done`` from 0 to 1 within the part."""
        at = self.begin + self.share * done
        self.listener(Progress(self.scene, self.experiment, stage, self.builder, at))

    def expect(self, memory: float) -> None:
        """Report how many bytes the process is expected to take."""
        step = Progress(self.scene, self.experiment, "rays", self.builder, self.begin, memory)
        self.listener(step)

    def part(self, begin: float, share: float, builder: str | None = None) -> Reporter:
        """Return a reporter of a part of this part."""
        return dataclasses.replace(
            self,
            builder=builder or self.builder,
            begin=self.begin + self.share * begin,
            share=self.share * share,
        )

    def of(self, experiment: str, begin: float, share: float) -> Reporter:
        """Return a reporter of one experiment."""
        return dataclasses.replace(self.part(begin, share), experiment=experiment)
