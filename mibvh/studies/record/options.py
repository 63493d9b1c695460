"""The options of a study, and the two profiles."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

from mibvh.builders.chosen import split
from mibvh.errors import MibvhError, did_you_mean
from mibvh.ranges import check
from mibvh.rays.kinds import kind_named

#: Children per node of the trees that a study collapses.
WIDTHS = (2, 4, 8)
#: Kinds of rays that the experiment ``kinds`` takes, if none are named.
KINDS = ("diffuse", "shadow", "ao", "primary", "bounce2")
#: The registered experiments, and what each adds; see :mod:`mibvh.studies.record.experiment`.
EXPERIMENTS: dict[str, str] = {}


@dataclasses.dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of a study.

    Attributes
    ----------
    builders : tuple of str or None
        Names, with options in parentheses, such as ``sbvh(budget=2)`` (see
        :mod:`mibvh.builders.chosen`); or a string of them, separated by commas. None stands for
        the paper's builders and the user's own. An empty tuple studies given trees only.
    experiments : tuple of str
        Names from :data:`EXPERIMENTS`, or a string of them; ``("all",)`` for all of them.
    width, height, samples, bounces, viewpoints, seed
        As for :func:`mibvh.diffuse_rays`: ``width`` and ``height`` are pixels per viewpoint.
        ``viewpoints`` 0 means all viewpoints of a scene.
    scalar_rays : int
        Largest number of rays timed with one lane per packet: every k-th ray of the set.
    seconds : float
        Time budget of the stopwatch, per scene and lane mode.
    standard_error : float
        Relative standard error of a tree's time at which timing stops.
    cull : bool
        Re-test popped nodes against the current hit; off, as in the paper.
    warp_width : int
        Number of lanes of the simulated warps.
    warp_style : str
        Rules of the simulated warps, from :data:`mibvh.traversal.warp.STYLES`; by default those
        of the paper's kernel.
    styles : tuple of str
        Kernels that the experiment ``styles`` times and simulates, from
        :data:`mibvh.traversal.styles.STYLES`, or a string of them. Any other than ``single``
        turns that experiment on. Everything else uses ``single``.
    widths : tuple of int
        Children per node (2, 4 or 8) to which the experiment ``width`` collapses the trees. Any
        turns that experiment on; if there is none, it takes all three.
    kinds : tuple of str
        Kinds of rays (:data:`mibvh.rays.kinds.KINDS`) for the experiment ``kinds``. All or none
        have a weight in the mixture after a colon, such as ``shadow2:0.5``. Any turns that
        experiment on; if there is none, it takes :data:`KINDS`.
    """

    builders: tuple[str, ...] | None = None
    experiments: tuple[str, ...] = ("prediction", "depth")
    width: int = 160
    height: int = 120
    samples: int = 1
    bounces: int = 1
    viewpoints: int = 0
    seed: int = 0
    scalar_rays: int = 32768
    seconds: float = 2.0
    standard_error: float = 0.005
    cull: bool = False
    warp_width: int = 32
    warp_style: str = "persistent"
    styles: tuple[str, ...] = ("single",)
    widths: tuple[int, ...] = ()
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        numbers = (
            "width",
            "height",
            "samples",
            "bounces",
            "scalar_rays",
            "seed",
            "seconds",
            "standard_error",
        )
        check(**{name: getattr(self, name) for name in numbers})
        if self.viewpoints != 0:  # all of a scene
            check(viewpoints=self.viewpoints)
        self._check_warps()
        for name in ("builders", "experiments", "styles", "kinds"):
            given = getattr(self, name)
            if given is None and name == "builders":
                continue
            names = split(given) if isinstance(given, str) else _names(name, given)
            object.__setattr__(self, name, names)
        object.__setattr__(self, "widths", widths_of(self.widths))
        weights(self.kinds)  # raises if one is invalid
        self._ask_for("width", bool(self.widths))
        self._ask_for("kinds", bool(self.kinds))
        if self.experiments == ("all",):
            object.__setattr__(self, "experiments", tuple(EXPERIMENTS))
        self._check_styles()
        self._ask_for("styles", self.styles != ("single",))
        if unknown := sorted(set(self.experiments) - set(EXPERIMENTS)):
            raise MibvhError(
                f"there is no experiment {unknown[0]!r}{did_you_mean(unknown[0], EXPERIMENTS)}; "
                f"there are: {', '.join(EXPERIMENTS)}"
            )

    def _ask_for(self, experiment: str, asked: bool) -> None:
        """Add an experiment that another option turns on."""
        if asked and not {experiment, "all"} & set(self.experiments):
            object.__setattr__(self, "experiments", (*self.experiments, experiment))

    def _check_warps(self) -> None:
        from mibvh.traversal.warp import check_rules  # late: importing compiled code is slow

        check_rules(self.warp_width, self.warp_style)

    def _check_styles(self) -> None:
        from mibvh.traversal.styles import find_style

        if not self.styles:
            raise MibvhError("styles names no style of traversal; single is the default")
        for style in map(find_style, self.styles):
            if self.cull and not style.culls:
                raise MibvhError(
                    f"the {style.name} style does not re-test popped nodes: leave cull off"
                )
        if len(set(self.styles)) < len(self.styles):
            raise MibvhError(f"styles names one twice: {', '.join(self.styles)}")

    def rays(self) -> dict[str, Any]:
        """Arguments for :func:`mibvh.diffuse_rays`."""
        names = ("width", "height", "samples", "bounces", "seed")
        return {"viewpoints": self.viewpoints or None, **{n: getattr(self, n) for n in names}}

    def warps(self) -> dict[str, Any]:
        """Arguments for :class:`mibvh.studies.measure.warps.WarpRules`."""
        return {"width": self.warp_width, "style": self.warp_style}

    def stopwatch(self, lanes: str) -> dict[str, Any]:
        """Options that times depend on, besides the trees, the rays and the machine."""
        names = ("seconds", "standard_error", "cull")
        chosen = (*names, *(("scalar_rays",) if lanes == "scalar" else ()))
        return {"by": "portions", **{n: getattr(self, n) for n in chosen}}


def widths_of(given: Any) -> tuple[int, ...]:
    """Return widths in ascending order, from a sequence or a string such as ``2,4,8``.

    Raises
    ------
    MibvhError
        If one is not 2, 4 or 8.
    """
    parts = split(given) if isinstance(given, str) else given
    try:
        found = sorted({int(str(part)) for part in parts})
    except (TypeError, ValueError):
        found = [0]
    if not set(found) <= set(WIDTHS):
        raise MibvhError(f"widths are of 2, 4, 8, separated by commas, not {given!r}")
    return tuple(found)


def weights(kinds: Iterable[str]) -> dict[str, float | None]:
    """Parse kinds of rays with their weights in the mixture.

    Parameters
    ----------
    kinds : iterable of str
        Such as ``shadow`` or ``shadow:2``.

    Returns
    -------
    dict of str to float or None
        The weight of each kind; None if rays count by their numbers.

    Raises
    ------
    MibvhError
        If a kind is unknown or named twice, a weight is negative or all are 0, or only some kinds
        have a weight.
    """
    found: dict[str, float | None] = {}
    for kind in kinds:
        name, colon, text = kind.partition(":")
        kind_named(name)
        try:
            weight = float(text) if colon else None
        except ValueError:
            weight = -1.0
        if weight is not None and not 0 <= weight < float("inf"):
            raise MibvhError(f"a weight is a number that is not negative, not {text!r} of {kind}")
        if name in found:
            raise MibvhError(f"the kind of rays {name} is named twice")
        found[name] = weight
    if len({weight is None for weight in found.values()}) > 1:
        raise MibvhError("all kinds of rays have a weight, or none has")
    if found and not any(weight is None or weight > 0 for weight in found.values()):
        raise MibvhError("the weights of the kinds of rays are all 0")
    return found


def kinds_or_files(text: str) -> tuple[tuple[str, ...], list[str]]:
    """Tell whether a list names kinds of rays or ray files.

    Parameters
    ----------
    text : str
        Kinds or files, separated by commas; may be empty.

    Returns
    -------
    kinds : tuple of str
    files : list of str
        At least one of the two is empty.

    Raises
    ------
    MibvhError
        If the list mixes kinds and files.
    """
    parts = text.split(",") if text else []
    kinds = [part.strip() for part in parts if _is_kind(part.strip())]
    if kinds and len(kinds) < len(parts):
        other = next(part for part in parts if part.strip() not in kinds)
        raise MibvhError(
            f"rays are kinds or files, not both: {kinds[0]} is a kind, and {other!r} is none"
        )
    return tuple(kinds), [] if kinds else parts


def _is_kind(text: str) -> bool:
    try:
        kind_named(text.partition(":")[0])
    except MibvhError:
        return False
    return True


def _names(option: str, given: Any) -> tuple[str, ...]:
    """Return a tuple of names, from any iterable of strings."""
    if not isinstance(given, Iterable) or not all(isinstance(name, str) for name in given):
        raise MibvhError(f"{option} takes names, not {given!r}")
    return tuple(given)


#: ``quick`` for a first look and for tests, ``paper`` for figures to be cited.
PROFILES: dict[str, dict[str, Any]] = {
    "quick": {},
    "paper": {
        "width": 320,
        "height": 240,
        "samples": 4,
        "scalar_rays": 131072,
        "seconds": 25.0,
        "experiments": ("prediction", "depth", "rotation", "sensitivity"),
    },
}
