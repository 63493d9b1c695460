"""The progress of a study, which the callback of :func:`mibvh.study` receives."""

from __future__ import annotations

import dataclasses
import os
import traceback
from collections.abc import Callable

from mibvh.errors import MibvhError
from mibvh.studies.record.scene import Missing

#: The stage of a scene that cannot be studied.
LEFT_OUT = "left out"
#: The stage of a step that reports a missing result.
MISSING = "missing"


@dataclasses.dataclass(frozen=True)
class Progress:
    """A step of a study.

    Attributes
    ----------
    scene, experiment, stage : str
        The stage is ``rays``, ``compiling``, ``build``, ``metrics``, ``count``, ``time scalar``
        and so on; ``done`` when the scene is finished, ``left out`` when it cannot be studied.
    builder : str or None
        Name of the current tree; None for steps that concern all trees.
    done : float
        From 0 to 1 within the scene.
    memory : float or None
        Predicted peak memory of the process in bytes, reported once, before the first stage.
    missing : str or None
        A result that the study continues without, and why; reported once.
    """

    scene: str
    experiment: str
    stage: str
    builder: str | None
    done: float
    memory: float | None = None
    missing: str | None = None

    def __str__(self) -> str:
        words = [self.stage, self.builder, f"({self.experiment})" if self.experiment else None]
        return " ".join(word for word in words if word)


#: A callback for the steps of a study. Any thread may call it.
Listener = Callable[[Progress], None]


@dataclasses.dataclass(frozen=True)
class Reporter:
    """Reports the progress of one part of a scene's study as progress of the whole.

    Attributes
    ----------
    listener : callable
    scene, experiment : str
    builder : str or None
    begin, share : float
        Where the part begins within the scene's progress, and its share of it.
    found_missing : list of Missing
        Everything that was reported missing, shared by the reporters of all parts.
    """

    listener: Listener
    scene: str
    experiment: str = ""
    builder: str | None = None
    begin: float = 0.0
    share: float = 1.0
    found_missing: list[Missing] = dataclasses.field(default_factory=list)

    def __call__(self, stage: str, done: float) -> None:
        """Report that this part has reached a stage; ``done`` is from 0 to 1 within the part."""
        self.listener(
            Progress(self.scene, self.experiment, stage, self.builder, self._within(done))
        )

    def _within(self, done: float) -> float:
        """Progress of the whole; rounded, as a part may end one rounding after the next begins."""
        return round(self.begin + self.share * done, 12)

    def expect(self, memory: float) -> None:
        """Report the predicted peak memory of the process, in bytes."""
        step = Progress(
            self.scene, self.experiment, "rays", self.builder, self._within(0.0), memory
        )
        self.listener(step)

    def missing(self, what: str, why: MibvhError, tree: str = "") -> None:
        """Report a missing result; ``tree`` names a whole tree that the base study lacks."""
        where = f" in the experiment {self.experiment}" if self.experiment else ""
        found = Missing(what + where, str(why), "" if where else tree)
        self.found_missing.append(found)
        if os.environ.get("MIBVH_DEBUG"):
            traceback.print_exception(why)
        step = Progress(self.scene, self.experiment, MISSING, self.builder, self._within(0.0))
        self.listener(dataclasses.replace(step, missing=str(found)))

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
