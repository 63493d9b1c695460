"""What an audit finds: checks of one number each."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Check:
    """One number, compared with what another path through the code gives.

    Attributes
    ----------
    name : str
        What is checked, such as ``epo``.
    passed : bool
    value : float
        The number as it is reported.
    expected : float
        What the other path gives.
    tolerance : float
        By how much the two may differ.
    detail : str
        What was compared, or the first fault, in one sentence.
    """

    name: str
    passed: bool
    value: float
    expected: float
    tolerance: float
    detail: str

    @classmethod
    def of(cls, name: str, value: float, expected: float, tolerance: float, detail: str) -> Check:
        """Compare two numbers; a NaN never passes."""
        passed = bool(abs(value - expected) <= tolerance)
        return cls(name, passed, float(value), float(expected), float(tolerance), detail)


@dataclasses.dataclass(frozen=True)
class Audit:
    """The checks of one tree.

    Attributes
    ----------
    builder : str
        Name of the tree.
    checks : tuple of Check
    """

    builder: str
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return not self.failures

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that did not pass."""
        return tuple(check for check in self.checks if not check.passed)
