"""A claim of the paper, what a study found, and whether it held."""

from __future__ import annotations

import dataclasses

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
    """

    topic: str
    claim: str
    paper: str
    ours: str
    judged: str
    conditions: tuple[bool, ...]

    @property
    def held(self) -> str:
        """``yes``, ``no``, ``partly``, or ``not judged``."""
        if not self.conditions:
            return "not judged"
        if all(self.conditions):
            return "yes"
        return "partly" if any(self.conditions) else "no"

    @property
    def place(self) -> int:
        """Of its topic in the list."""
        return TOPICS.index(self.topic) if self.topic in TOPICS else len(TOPICS)
