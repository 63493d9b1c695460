"""A claim of the paper, what a study found, and whether it held."""

from __future__ import annotations

import dataclasses

#: Scenes on which a claim is judged, at least: the paper's own talk asks for ten and more.
FEWEST_SCENES = 10
#: What claims are about, in the order in which they are listed.
TOPICS = ("prediction", "rotation", "builders", "SIMD")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Claim:
    """One claim.

    Attributes
    ----------
    topic : str
        From :data:`TOPICS`, or another that comes after them.
    claim, paper, ours : str
        What is claimed, the paper's figures, and the study's.
    judged : str
        The conditions, in words.
    conditions : tuple of bool
        Empty where the study has nothing to judge it by.
    scenes : int or None
        On how many scenes; below :data:`FEWEST_SCENES` it is not judged. None for a claim that
        is not over scenes.
    """

    topic: str
    claim: str
    paper: str
    ours: str
    judged: str
    conditions: tuple[bool, ...]
    scenes: int | None = None

    @property
    def held(self) -> str:
        """``yes``, ``no``, ``partly``, or ``not judged``, with the number of scenes if too few."""
        if not self.conditions:
            return "not judged"
        if self.scenes is not None and self.scenes < FEWEST_SCENES:
            return f"not judged: {self.scenes} scene{'s' * (self.scenes != 1)}"
        if all(self.conditions):
            return "yes"
        return "partly" if any(self.conditions) else "no"

    @property
    def place(self) -> int:
        """Of its topic in the list."""
        return TOPICS.index(self.topic) if self.topic in TOPICS else len(TOPICS)
