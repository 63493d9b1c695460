"""Parse builders with options: ``sbvh``, ``bittner(start=sbvh)``, and sweeps.

``sbvh(bins=8..128:8)`` is a sweep: one tree with each of 8, 16, ..., 128 bins.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

from mibvh.builders.options import Options
from mibvh.builders.registry import get
from mibvh.errors import MibvhError, did_you_mean

#: Largest number of trees in a sweep.
MOST = 64
#: Options whose value is the name of another builder.
_STARTS = ("start", "base")


@dataclasses.dataclass(frozen=True)
class Chosen:
    """A builder, and the options that differ from its defaults.

    Attributes
    ----------
    builder : str
    options : tuple of (str, value)
        In the order in which the builder declares them.
    swept : bool
        Whether it is one of the several cases of a sweep.
    """

    builder: str
    options: tuple[tuple[str, Any], ...] = ()
    swept: bool = dataclasses.field(default=False, compare=False)

    @property
    def name(self) -> str:
        """Name of the tree: the builder with these options, as :func:`parse` reads them."""
        if not self.options:
            return self.builder
        return f"{self.builder}({','.join(f'{k}={_text(v)}' for k, v in self.options)})"

    @property
    def asks_scene(self) -> bool:
        """Whether the tree may depend on more of a scene than the triangles."""
        made_by = (self.builder, *(name for name, _ in self.starts()))
        return any(get(name).asks_scene for name in made_by)

    def starts(self) -> frozenset[tuple[str, Options]]:
        """Return the chain of builders that this one starts from, with their options.

        Cost constants and leaf size are passed on; all other options are the defaults.
        """
        found: set[tuple[str, Options]] = set()
        options = get(self.builder).options(**dict(self.options))
        while "start" in (named := _builders_in(options)):
            name = named["start"]
            options = get(name).start_options(options)
            if (name, options) in found:
                break
            found.add((name, options))
        return frozenset(found)


def builder_of(name: str) -> str:
    """Return the builder in a tree's name.

    >>> builder_of("sbvh(bins=8)")
    'sbvh'
    """
    return name.partition("(")[0]


def split(text: str) -> tuple[str, ...]:
    """Split at the commas outside parentheses.

    >>> split("bbvh, sbvh(bins=8,budget=2)")
    ('bbvh', 'sbvh(bins=8,budget=2)')
    """
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return tuple(part.strip() for part in parts if part.strip())


def parse(text: str) -> list[Chosen]:
    """Parse a builder with its options.

    Parameters
    ----------
    text : str
        ``NAME`` or ``NAME(option=value,...)``. A numeric value ``LOW..HIGH:STEP`` is a sweep over
        these values; the step is 1 by default.

    Returns
    -------
    list of Chosen
        One, or one for each case of a sweep.

    Raises
    ------
    MibvhError
        If there is no such builder or option, a value is out of range, or a sweep has more than
        :data:`MOST` values.
    """
    name, opened, rest = (part.strip() for part in text.partition("("))
    entry = get(name)
    if opened and not rest.endswith(")"):
        raise MibvhError(f"builder {text!r}: options stand in parentheses, as in sbvh(budget=2)")
    defaults = {f.name: f.default for f in dataclasses.fields(entry.options)}
    given: dict[str, list[Any]] = {}
    for pair in split(rest[:-1]):
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals or not value:
            raise MibvhError(f"builder {text!r}: options are written name=value, not {pair!r}")
        if key not in defaults:
            raise MibvhError(
                f"builder {name} has no option {key!r}{did_you_mean(key, defaults)}; it has: "
                f"{', '.join(sorted(defaults))}"
            )
        if key in given:
            raise MibvhError(f"builder {text!r}: option {key} is given twice")
        given[key] = _values(text, value, defaults[key])
    cases = math.prod(len(values) for values in given.values())
    if cases > MOST:
        raise MibvhError(f"builder {text!r} stands for {cases} trees; at most {MOST} are swept")
    return [
        _checked(text, name, dict(zip(given, values, strict=True)), swept=cases > 1)
        for values in itertools.product(*given.values())
    ]


def parse_all(texts: Sequence[str]) -> list[Chosen]:
    """Parse several builders. A case of a sweep that is also named elsewhere is taken once.

    Raises
    ------
    MibvhError
        As for :func:`parse`, or if a builder is named twice.
    """
    found: list[Chosen] = []
    for chosen in (one for text in texts for one in parse(text)):
        if chosen not in found:
            found.append(chosen)
        elif not chosen.swept:
            raise MibvhError(f"a builder is named twice: {chosen.name} in {', '.join(texts)}")
    return found


def _values(text: str, value: str, default: Any) -> list[Any]:
    """Parse the value of an option, or the values of a sweep."""
    low, dots, rest = value.partition("..")
    if not dots or isinstance(default, bool | str):
        return [_value(value)]
    high, _, step = rest.partition(":")
    ends = [_value(part) for part in (low, high, step or "1")]
    if any(isinstance(end, str | bool) for end in ends) or not ends[2] > 0 or ends[0] > ends[1]:
        raise MibvhError(f"builder {text!r}: a sweep is written LOW..HIGH:STEP, not {value!r}")
    return list(_steps(text, *ends))


def _steps(text: str, low: float, high: float, step: float) -> Iterator[float]:
    count = (high - low) / step
    if not count < MOST:
        raise MibvhError(f"builder {text!r} stands for too many trees; at most {MOST} are swept")
    for i in range(math.floor(count + 1e-9) + 1):
        value = low + i * step
        yield value if isinstance(value, int) else float(f"{value:.12g}")


def _value(text: str) -> Any:
    """Parse a number or boolean as JSON; anything else is text."""
    try:
        value = json.loads(text)
    except ValueError:
        return text.strip()
    return value if isinstance(value, bool | int | float | str) else text


def _checked(text: str, name: str, given: dict[str, Any], swept: bool) -> Chosen:
    """Check the ranges of the options, and keep those that differ from the defaults."""
    kind = get(name).options
    try:
        chosen = kind(**given)
    except MibvhError as error:
        raise MibvhError(f"builder {text!r}: {error}") from None
    for start in _builders_in(chosen).values():
        get(start)
    values = ((f.name, getattr(chosen, f.name), f.default) for f in dataclasses.fields(kind))
    return Chosen(name, tuple((k, v) for k, v, default in values if v != default), swept)


def _builders_in(options: Options) -> dict[str, str]:
    """Return the options whose values name builders: those whose defaults do."""
    fields = {f.name: f.default for f in dataclasses.fields(options)}
    return {key: getattr(options, key) for key in _STARTS if known(fields.get(key))}


def known(name: object) -> bool:
    """Whether there is a builder of that name."""
    if not isinstance(name, str):
        return False
    try:
        get(name)
    except MibvhError:
        return False
    return True


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
