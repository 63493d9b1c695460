"""The traversal styles: which records a kernel reads, how it is launched, what it counts.

A new style is a function that makes a :class:`~mibvh.traversal.launches.Launch`, and an entry in
:data:`STYLES`.
"""

from __future__ import annotations

import dataclasses
import functools
import warnings
from collections.abc import Callable

from mibvh.errors import MibvhError
from mibvh.traversal.kernel_rays import KernelRays
from mibvh.traversal.launches import InRounds, LanesFetch, Launch, OneRayPerLane
from mibvh.traversal.records import Layout

#: Takes the rays, and whether to trace one per packet, to re-test popped nodes, and to end at any
#: hit.
Prepare = Callable[[KernelRays, bool, bool, bool], Launch]


@dataclasses.dataclass(frozen=True)
class TraversalStyle:
    """One way to trace rays.

    Attributes
    ----------
    name : str
    summary : str
        What a packet does, in a line.
    layout : "binary" or "wide"
        Of the records that the kernel reads.
    prepare : callable
        Makes the launch; see :data:`Prepare`.
    culls : bool
        Whether the kernel can re-test popped nodes against the current hit.
    prefix : str
        What the names of counters begin with where these count another tree than the one given:
        they are not the paper's.
    """

    name: str
    summary: str
    layout: Layout
    prepare: Prepare
    culls: bool = True
    prefix: str = ""


def _single(rays: KernelRays, scalar: bool, cull: bool, any_hit: bool) -> Launch:
    from mibvh.traversal.kernel import walk

    return OneRayPerLane(rays, scalar, functools.partial(walk, cull=cull, any_hit=any_hit))


def _rounds(rays: KernelRays, scalar: bool, cull: bool, any_hit: bool, postpone: bool) -> Launch:
    from mibvh.traversal.rounds import walk_in_rounds

    walk = functools.partial(walk_in_rounds, postpone=postpone, cull=cull, any_hit=any_hit)
    return InRounds(rays, scalar, walk)


def _wide(rays: KernelRays, scalar: bool, cull: bool, any_hit: bool) -> Launch:
    return LanesFetch(rays, scalar, any_hit)


STYLES = {
    style.name: style
    for style in (
        TraversalStyle(
            "single",
            "one loop: each step does for every lane what it needs next",
            "binary",
            _single,
        ),
        TraversalStyle(
            "while-while",
            "rounds: all lanes descend to a leaf, then all test triangles",
            "binary",
            functools.partial(_rounds, postpone=False),
        ),
        TraversalStyle(
            "speculative",
            "the same, but a lane puts its first leaf aside and descends to the second",
            "binary",
            functools.partial(_rounds, postpone=True),
        ),
        TraversalStyle(
            "wide",
            "the fastest: nodes of eight children, lanes that fetch their next ray",
            "wide",
            _wide,
            culls=False,
            prefix="wide_",
        ),
    )
}

#: Former names.
_RENAMED = {"postponed": "speculative"}


def find_style(name: str) -> TraversalStyle:
    """Return the style of that name.

    Raises
    ------
    MibvhError
        If there is none.
    """
    if name in _RENAMED:
        warnings.warn(
            f"the style {name!r} is now called {_RENAMED[name]!r}",
            DeprecationWarning,
            stacklevel=3,
        )
        name = _RENAMED[name]
    if name not in STYLES:
        raise MibvhError(f"style must be one of {', '.join(STYLES)}, not {name!r}")
    return STYLES[name]
