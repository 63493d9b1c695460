"""The registry of builders: the paper's, later ones, and the user's own."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
from collections.abc import Callable, Mapping
from typing import Any

from mibvh.builders.draft import Draft
from mibvh.builders.options import Options
from mibvh.builders.sharing import share
from mibvh.code import code_digest
from mibvh.errors import MibvhError, did_you_mean, guard
from mibvh.measures import Area, Measure
from mibvh.memory import require_memory, require_references
from mibvh.tree import Tree
from mibvh.triangles import Triangles
from mibvh.wide_tree import WideTree

_AREA = Area()


@dataclasses.dataclass(frozen=True)
class Context:
    """What a builder gets besides triangles and options.

    Attributes
    ----------
    progress : callable
        Called as ``progress(stage, done)`` with ``done`` from 0 to 1.
    measure : Measure
        The cost of a box.
    source : object
        The first argument of :func:`mibvh.build`. If it is a Scene, it can trace rays.
    """

    progress: Callable[[str, float], None] = lambda stage, done: None
    measure: Measure = _AREA
    source: Any = None

    def compiled_measure(self, scale: float) -> Any:
        """Return the measure in the form that kernels take; None stands for the area.

        Parameters
        ----------
        scale : float
            From scene to builder units (:attr:`References.scale`).
        """
        return self.measure.compiled(scale)

    def start(self, triangles: Any, name: str, options: Options) -> Draft:
        """Build the draft that an optimiser starts from, with the optimiser's cost constants."""
        entry = get(name)
        return entry.draft(triangles, entry.start_options(options), self)


BuildFunction = Callable[[Any, Any, Context], Any]
#: Bytes per triangle that a builder needs at most, unless it declares its own figure.
DEFAULT_MEMORY = 600.0
WideFunction = Callable[[Any, Any, int], WideTree]


@dataclasses.dataclass(frozen=True)
class Builder:
    """A registered builder.

    Attributes
    ----------
    name, summary, source : str
        Its name, one line on what it does, and the paper that it comes from.
    options : type
        A subclass of :class:`Options`.
    function : callable
        ``function(triangles, options, context)`` returning a :class:`Draft`, nested pairs of
        triangle ids (see :meth:`Draft.from_nested`), or a finished :class:`~mibvh.Tree`.
    version : str or None
        Version of a user's builder. A study keeps its trees as long as this stays the same; without
        a version it builds them in every run.
    wide : callable or None
        ``wide(triangles, options, width)`` returning a :class:`~mibvh.WideTree`, if the builder
        makes wide trees itself.
    traces : bool
        Whether it asks the scene for rays, so that its trees depend on the cameras.
    memory : float
        Bytes per triangle that a build needs at most, with the default options.
    """

    name: str
    summary: str
    source: str
    options: type[Options]
    function: BuildFunction
    version: str | None = None
    wide: WideFunction | None = None
    traces: bool = False
    memory: float = DEFAULT_MEMORY

    @property
    def asks_scene(self) -> bool:
        """Whether its trees may depend on more of a scene than its triangles."""
        return self.traces or not self.bundled

    @property
    def bundled(self) -> bool:
        """Whether it belongs to this package; a user's builder may have the same name."""
        module = {**_BUNDLED, **_LATER}.get(self.name)
        return module is not None and getattr(self.function, "__module__", None) == module

    def options_of(self, given: Mapping[str, Any]) -> Options:
        """Return its options from keyword arguments.

        Raises
        ------
        MibvhError
            If the builder has no option of a given name, or a value is impossible.
        """
        known = {f.name for f in dataclasses.fields(self.options)}
        if unknown := sorted(set(given) - known):
            raise MibvhError(
                f"builder {self.name} has no option {unknown[0]!r}"
                f"{did_you_mean(unknown[0], known)}; it has: {', '.join(sorted(known))}"
            )
        return self.options(**given)

    def references(self, triangles: int, options: Options) -> int:
        """Return the largest number of references of a tree over so many triangles."""
        budget = getattr(options, "budget", 0.0) + getattr(options, "beta", 0.0)
        return int(triangles * (1.0 + budget) * (1.0 + options.presplit))

    def memory_of(self, triangles: int, options: Options) -> float:
        """Return the largest number of bytes that building a tree needs, its start included."""
        default = self.references(triangles, self.options())
        own = self.memory * triangles * self.references(triangles, options) / max(default, 1)
        starts = (getattr(options, name, None) for name in ("start", "base"))
        others = [get(name) for name in starts if name in all_names() and name != self.name]
        return max(own, *(o.memory_of(triangles, o.start_options(options)) for o in others), 0.0)

    def check_room(self, triangles: Triangles, options: Options) -> None:
        """Refuse a build that needs too much memory, or more nodes than int32 can number.

        Raises
        ------
        MibvhError
        """
        what = f"{len(triangles):,} triangles of {triangles.name}, for builder {self.name},"
        require_references(self.references(len(triangles), options), what)
        require_memory(self.memory_of(len(triangles), options), what)

    def start_options(self, of: Options) -> Options:
        """Return this builder's options for the start tree of a builder with the options ``of``."""
        common = {f.name: getattr(of, f.name) for f in dataclasses.fields(Options)}
        common["presplit"] = 0.0  # the optimiser's triangles are split already
        return self.options(**common)

    def draft(self, triangles: Any, options: Options, context: Context) -> Draft:
        """Run the builder without the shared finishing.

        Raises
        ------
        MibvhError
            If it returns a finished tree, which has no draft.
        """
        made = self.run(triangles, options, context)
        if isinstance(made, Tree):
            raise MibvhError(f"builder {self.name} makes finished trees; nothing starts from those")
        return made

    def run(self, triangles: Any, options: Options, context: Context) -> Draft | Tree:
        """Run the builder and return its draft, or its tree if it returns a finished one."""
        return share(
            self.name, triangles, options, context, lambda: self._made(triangles, options, context)
        )

    def _made(self, triangles: Any, options: Options, context: Context) -> Draft | Tree:
        with self.guard(self.function):
            result = self.function(triangles, options, context)
        if isinstance(result, Tree):
            return result
        try:
            if not isinstance(result, Draft):
                return Draft.from_nested(result, triangles)
            if not self.bundled:
                result.check(triangles)
            return result
        except MibvhError as error:
            raise MibvhError(f"builder {self.name}: {error}") from error

    def guard(self, function: Callable[..., Any]) -> contextlib.AbstractContextManager[None]:
        """Turn whatever a user's builder raises in the block into one sentence."""
        return guard(f"builder {self.name}", function)

    def code(self) -> str | None:
        """Return the hash or version of the builder's code for cache keys; None if there is none.

        The code of a bundled builder is followed through its imports. That is impossible for a
        user's builder, so its author declares a version that changes with its trees.
        """
        if self.bundled:
            return code_digest("mibvh.builders.building")
        return self.version

    def describe(self) -> dict[str, Any]:
        """Return a JSON-able description with the options' defaults and ranges."""
        return {
            "name": self.name,
            "summary": self.summary,
            "source": self.source,
            "options": {
                f.name: {"default": f.default, **f.metadata}
                for f in dataclasses.fields(self.options)
            },
        }


#: The paper's builders in the paper's order, and the module each one lives in.
_BUNDLED: dict[str, str] = {
    "bbvh": "mibvh.builders.sweep",
    "sbvh": "mibvh.builders.spatial",
    "agglo": "mibvh.builders.agglomerative",
    "lbvh": "mibvh.builders.morton",
    "hill": "mibvh.builders.rotations",
    "anneal": "mibvh.builders.rotations",
    "bittner": "mibvh.builders.insertion",
    "treelet": "mibvh.builders.treelet",
    "streelet": "mibvh.builders.treelet",
}
#: Builders that are not in the paper's comparison. Studies include them only by name.
_LATER: dict[str, str] = {
    "binned": "mibvh.builders.binned",
    "ploc": "mibvh.builders.ploc",
    "reinsertion": "mibvh.builders.reinsertion",
    "bittner_sbvh": "mibvh.builders.combined",
    "bittner_streelet": "mibvh.builders.combined",
    "treelet_sbvh": "mibvh.builders.combined",
    "finite": "mibvh.builders.finite",
    "embree": "mibvh.builders.embree",
}
_registered: dict[str, Builder] = {}


def builder(
    name: str,
    *,
    summary: str = "",
    source: str = "",
    options: type[Options] = Options,
    version: str | None = None,
    wide: WideFunction | None = None,
    traces: bool = False,
    memory: float = DEFAULT_MEMORY,
) -> Callable[[BuildFunction], BuildFunction]:
    """Register a builder for studies and the command line.

    Parameters
    ----------
    name : str
        Its name. A builder that already has this name is replaced.
    summary, source : str
        One line on what it does, and the paper that it comes from.
    options : type
        A frozen, keyword-only dataclass that inherits from :class:`Options`, each field from
        :func:`option`.
    version : str, optional
        Change it whenever the builder's trees change. A study keeps the trees of a builder with a
        version; without one it builds them in every run.
    wide : callable, optional
        ``wide(triangles, options, width)``, which returns a :class:`~mibvh.WideTree`.
        :func:`mibvh.build_wide` calls it instead of collapsing the builder's binary tree.
    traces : bool
        Whether it asks the scene for rays (:attr:`Context.source`).
    memory : float
        Bytes per triangle that a build needs at most, with the default options. A build that
        needs more than is available is refused before it begins.

    Returns
    -------
    callable
        Decorator for ``function(triangles, options, context)``. The function returns nested pairs
        of triangle ids (:meth:`Draft.from_nested`); or a :class:`Draft`, if it splits triangles
        (:class:`References`) or improves another builder's tree (:meth:`Context.start`); or a
        finished :class:`~mibvh.Tree`, of which no box, leaf or reference is changed.

    Examples
    --------
    >>> import numpy as np
    >>> import mibvh
    >>> @mibvh.builder("halves", summary="halve the list of triangles")
    ... def halves(triangles, options, context):
    ...     return np.arange(len(triangles))
    >>> corners = np.random.default_rng(0).random((9, 3, 3))
    >>> mibvh.build(corners, "halves").validate()
    []
    """

    def register(function: BuildFunction) -> BuildFunction:
        new = Builder(name, summary, source, options, function, version, wide, traces, memory)
        # Bundled builders are imported on first use, and must not replace a user's of that name.
        if name not in _registered or not new.bundled:
            _registered[name] = new
        return function

    return register


def names() -> list[str]:
    """Return the names that a study takes by default: the paper's, then the user's builders."""
    known = [*_BUNDLED, *_LATER]
    return [*_BUNDLED, *(name for name in _registered if name not in known)]


def later_names() -> list[str]:
    """Return the names of the bundled builders that came after the paper."""
    return list(_LATER)


def all_names() -> list[str]:
    """Return all names: the paper's, the later ones, the user's."""
    paper = list(_BUNDLED)
    return [*paper, *_LATER, *(name for name in names() if name not in paper)]


def get(name: str) -> Builder:
    """Look up a builder by name.

    Raises
    ------
    MibvhError
        If there is no builder of that name.
    """
    bundled = {**_BUNDLED, **_LATER}
    if name not in _registered and name in bundled:
        importlib.import_module(bundled[name])
    if name not in _registered:
        raise MibvhError(
            f"there is no builder {name!r}{did_you_mean(name, all_names())}; there are: "
            f"{', '.join(all_names())}"
        )
    return _registered[name]


def of_paper(entry: Builder) -> bool:
    """Whether a builder is one of the paper's; a user's builder may have the same name."""
    return entry.bundled and entry.name in _BUNDLED
