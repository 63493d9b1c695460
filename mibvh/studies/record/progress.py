"""Where a study is: what the callback of :func:`mibvh.study` is given."""

from __future__ import annotations

import dataclasses
import os
import traceback
from collections.abc import Callable

from mibvh.errors import MibvhError
from mibvh.studies.record.scene import Missing

#: The last stage of a scene that cannot be studied.
LEFT_OUT = "left out"
#: The stage of a step that says what the study goes on without.
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
        Whose tree is in hand; None for what concerns all trees.
    done : float
        From 0 to 1 within the scene.
    memory : float or None
        Bytes that the process is expected to take, told once, before the first stage.
    missing : str or None
        What the study goes on without, and why, told once.
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
    found_missing : list of Missing
        What was reported to be missing, of all parts.
    """

    listener: Listener
    scene: str
    experiment: str = ""
    builder: str | None = None
    begin: float = 0.0
    share: float = 1.0
    found_missing: list[Missing] = dataclasses.field(default_factory=list)

    def __call__(self, stage: str, done: float) -> None:
        """Report that a stage of this part is reached, ``done`` from 0 to 1 within the part."""
        at = self.begin + self.share * done
        self.listener(Progress(self.scene, self.experiment, stage, self.builder, at))

    def expect(self, memory: float) -> None:
        """Report how many bytes the process is expected to take."""
        step = Progress(self.scene, self.experiment, "rays", self.builder, self.begin, memory)
        self.listener(step)

    def missing(self, what: str, why: MibvhError, tree: str = "") -> None:
        """Report that the study goes on without something; of the base experiment, maybe a tree."""
        where = f" in the experiment {self.experiment}" if self.experiment else ""
        found = Missing(what + where, str(why), "" if where else tree)
        self.found_missing.append(found)
        if os.environ.get("MIBVH_DEBUG"):
            traceback.print_exception(why)
        step = Progress(self.scene, self.experiment, MISSING, self.builder, self.begin)
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
