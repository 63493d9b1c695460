"""The valid range of every number that a user can set."""

from __future__ import annotations

import dataclasses
import math
import numbers

from mibvh.errors import MibvhError


@dataclasses.dataclass(frozen=True)
class Range:
    """From ``low`` to ``high``, both included; whole numbers or not."""

    low: float
    high: float
    whole: bool = True

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        return f"{kind} from {self.low:g} to {self.high:,.15g}"

    def holds(self, value: object) -> bool:
        """Whether a value has the right type and is in the range; false for NaN."""
        kind = numbers.Integral if self.whole else numbers.Real
        if not isinstance(value, kind) or isinstance(value, bool):
            return False
        return math.isfinite(float(value)) and self.low <= float(value) <= self.high


_DAY = 86_400.0
_SEED = Range(0, 2**32 - 1)
#: By the name of an option or argument, wherever it stands.
RANGES = {
    "width": Range(1, 16_384),
    "height": Range(1, 16_384),
    "samples": Range(1, 65_536),
    "spp": Range(1, 1 << 20),
    "bounces": Range(1, 64),
    "viewpoints": Range(1, 10_000),
    "sensor": Range(0, 10_000),
    "seed": _SEED,
    "seconds": Range(0, _DAY, whole=False),
    "standard_error": Range(0, 1, whole=False),
    "scalar_rays": Range(1, 1 << 30),
    "repeats": Range(1, 10_000),
    "triangles": Range(1, 1 << 30),
    "threads": Range(1, 1_024),
}


def check(where: str = "", /, **values: object) -> None:
    """Raise if a value is outside its range.

    Parameters
    ----------
    where : str
        What the message begins with, such as a scene's name.
    **values
        By the names of :data:`RANGES`.

    Raises
    ------
    MibvhError
    """
    for name, value in values.items():
        if not RANGES[name].holds(value):
            before = f"{where}: " if where else ""
            raise MibvhError(f"{before}{name} must be {RANGES[name]}, not {value}")
