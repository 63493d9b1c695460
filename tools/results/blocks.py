"""The parts of ``docs/results.md`` that are made: the command, what changed, what is old."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from mibvh.errors import MibvhError
from tools.results.pages import OLD

#: What changed since version 0.1, as it is read: a label, and the keys of its numbers.
HEADLINES = (
    ("SAH, r with scalar time: mean (worst)", "r.scalar.SAH"),
    ("SAH + EPO, α fitted", "r.scalar.fitted"),
    ("SAH + EPO, α = 0.79", "r.scalar.fixed-0.79"),
    ("finite rays", "r.scalar.finite-rays"),
    ("SAH, r with counted cost: mean (worst)", "r.counted.SAH"),
    ("SAH + EPO, α fitted", "r.counted.fitted"),
    ("finite rays", "r.counted.finite-rays"),
    ("finite by lines", "r.counted.finite-by-lines"),
    ("α fitted to counted cost: from", "alpha.min"),
    ("to", "alpha.max"),
    ("best for all scenes", "alpha.best"),
    ("EPO of `sbvh` (`lbvh` = 100%)", "relative.sbvh.epo"),
    ("EPO of `streelet`", "relative.streelet.epo"),
    ("EPO of `bbvh`", "relative.bbvh.epo"),
    ("level of finite rays: lowest", "level.finite.low"),
    ("highest", "level.finite.high"),
    ("worst error of a tree when the scene's mean is out", "level.finite.spread.max"),
    ("rotation: scalar time grows by", "rotation.scalar_ns"),
    ("counted cost", "rotation.counted_cost"),
    ("SAH", "rotation.sah"),
    ("EPO", "rotation.epo"),
    ("SAH + EPO, average α", "rotation.fitted"),
    ("times of a scene's trees known to: scalar", "times.scalar.error.max"),
    ("SIMD", "times.SIMD.error.max"),
)


def changed(old: Mapping[str, str], new: Mapping[str, str], scenes: Sequence[str]) -> str:
    """Return the table of headline figures, version 0.1 beside now.

    Parameters
    ----------
    old, new : mapping of str to str
        Numbers by key; see :mod:`tools.results.quoted`.
    scenes : sequence of str
        Those that are studied now and were not in version 0.1, or the other way round, as said.
    """
    lines = ["| figure | version 0.1 | now |", "| --- | ---: | ---: |"]
    for label, key in HEADLINES:
        before, now = (_number(values, key) for values in (old, new))
        lines.append(f"| {label} | {before} | {now} |")
    said = f"\n\n{' '.join(scenes)}" if scenes else ""
    return "\n".join(lines) + said


def _number(values: Mapping[str, str], key: str) -> str:
    if f"{key}.mean" in values and f"{key}.min" in values:
        return f"{values[f'{key}.mean']} ({values[f'{key}.min']})"
    return values.get(key, "–")


def status(new: bool) -> str:
    """Return what is said above the findings of an experiment."""
    return "" if new else OLD.replace("these tables were", "this was")


def put(text: str, name: str, body: str, page: str = "") -> str:
    """Replace what stands between the comments that begin and end a block.

    Raises
    ------
    MibvhError
        If the page has no such block.
    """
    block = re.compile(rf"(<!-- begin {name} -->\n).*?(<!-- end {name} -->)", re.S)
    if not block.search(text):
        raise MibvhError(f"{page}: there is no block {name!r}")
    return block.sub(lambda found: found[1] + (f"{body}\n" if body else "") + found[2], text)
