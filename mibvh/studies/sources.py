"""The scenes of a study before they are loaded, each with its given trees and rays."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from mibvh.builders.chosen import known
from mibvh.errors import MibvhError, did_you_mean
from mibvh.layouts import read_binary
from mibvh.rays import read_rays
from mibvh.scene import Scene, load, scene_name
from mibvh.studies.measure.given import Given
from mibvh.studies.paper.catalogue import scenes_in
from mibvh.tree import Tree
from mibvh.triangles import Triangles

T = TypeVar("T")

#: Names that a given tree may have: they appear in tables, figures and pages.
_NAME = re.compile(r"[\w.+-][\w.+ -]*")


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """A scene to be studied, with its given trees and rays.

    Attributes
    ----------
    scene
        Anything that :func:`mibvh.load` takes.
    name : str
        The name that it will have once it is loaded.
    trees : mapping of str to Tree or path
    rays : RaySet, path or None
    """

    scene: Any
    name: str
    trees: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    rays: Any = None

    def given(self) -> Given:
        """Return the given trees and rays; trees are read from their files on access."""
        return Given(
            _Trees(self.trees),
            read_rays(self.rays) if isinstance(self.rays, str | os.PathLike) else self.rays,
        )


def study_sources(
    scenes: Any, trees: Mapping[str, Any], rays: Any
) -> tuple[list[Source], dict[str, str]]:
    """Find the scenes of a study.

    Parameters
    ----------
    scenes : sequence, or one scene
        As for :func:`mibvh.study`.
    trees : mapping of str to trees
        As for :func:`mibvh.study`.
    rays
        As for :func:`mibvh.study`.

    Returns
    -------
    sources : list of Source
    left_out : dict of str to str
        Names of the scenes that cannot be found, and why.

    Raises
    ------
    MibvhError
        If there are no scenes, two scenes have the same name, a tree has the name of a builder,
        or it is unclear to which scene a tree or the rays belong.
    """
    found, names, left_out = _named(scenes)
    for name in trees:
        _check_name(name)
    of_scenes = {name: _by_scene(f"tree {name}", given, names) for name, given in trees.items()}
    rays_of = {} if rays is None else _by_scene("the rays", rays, names)
    sources = [
        Source(
            scene,
            name,
            {tree: given[name] for tree, given in of_scenes.items() if name in given},
            rays_of.get(name),
        )
        for scene, name in zip(found, names, strict=True)
        if name not in left_out
    ]
    return sources, left_out


def checked(sources: list[Source], keep: bool) -> tuple[list[Source], dict[str, str]]:
    """Check that given trees and rays belong to their scenes.

    Only scenes with given trees or rays are loaded.

    Parameters
    ----------
    sources : list of Source
    keep : bool
        Whether to keep the loaded scene if it is the only one; several might not fit in memory.

    Returns
    -------
    sources : list of Source
        Without the scenes that failed to load.
    left_out : dict of str to str
        Names of the scenes that failed to load, and why.

    Raises
    ------
    MibvhError
        If a tree or ray file cannot be read, rays do not belong to their scene, or a tree belongs
        to none of its scenes. A tree that belongs to some is reported as missing in the others
        when they are studied.
    """
    sound, left_out = [], {}
    faults: dict[str, list[MibvhError | None]] = {}
    for source in sources:
        if source.trees or source.rays is not None:
            given = source.given()
            try:
                scene = load(source.scene)
            except MibvhError as error:
                left_out[source.name] = str(error)
                continue
            unfit = given.check(scene.triangles)
            for name in source.trees:
                faults.setdefault(name, []).append(unfit.get(name))
            if keep and len(sources) == 1:
                source = dataclasses.replace(source, scene=scene)
        sound.append(source)
    for of_scenes in faults.values():
        if of_scenes[0] is not None and all(of_scenes):
            raise of_scenes[0]
    return sound, left_out


def _named(scenes: Any) -> tuple[list[Any], list[str], dict[str, str]]:
    """Return the scenes with folders expanded, their names, and those that cannot be found."""
    found: list[Any] = []
    names: list[str] = []
    left_out: dict[str, str] = {}
    for scene in (part for given in _several(scenes) for part in scenes_in(given)):
        try:
            if not isinstance(scene, str | os.PathLike):
                scene = load(scene)
            name = scene_name(scene)
        except MibvhError as error:
            name = str(scene) if isinstance(scene, str | os.PathLike) else f"scene {len(found) + 1}"
            left_out[name] = str(error)
        if name in names:
            raise MibvhError(f"two scenes are called {name}; rename a file or folder")
        found.append(scene)
        names.append(name)
    if not found:
        raise MibvhError("a study needs at least one scene")
    return found, names, left_out


def _several(scenes: Any) -> Sequence[Any]:
    """Return a sequence of scenes; a single scene becomes a sequence of one."""
    single = isinstance(scenes, str | os.PathLike | Scene | Triangles | np.ndarray | dict)
    if single or not isinstance(scenes, Sequence):
        try:
            return [scenes] if single else list(scenes)
        except TypeError:
            return [scenes]
    return scenes


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise MibvhError(
            f"a tree cannot be called {name!r}: letters, digits, spaces and any of _.+- make a name"
        )
    if known(name):
        raise MibvhError(f"a tree cannot have the name of a builder, {name}")


def _by_scene(what: str, given: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return what is given for each scene, by the scene's name."""
    if isinstance(given, Mapping):
        for name in given:
            if name not in names:
                raise MibvhError(
                    f"{what} is of {name!r}, which is no scene of the study"
                    f"{did_you_mean(str(name), names)}; there are: {', '.join(names)}"
                )
        return dict(given)
    several = given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    if len(several) != len(names):
        raise MibvhError(
            f"{what}: {len(several)} given for {len(names)} scenes; give one for each scene, in "
            "their order (nothing where there is none)"
        )
    pairs = zip(names, several, strict=True)
    return {name: one for name, one in pairs if one is not None and one != ""}


class _Trees(Mapping[str, Tree]):
    """Given trees by name, each read from its file on access."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self._given = given

    def __getitem__(self, name: str) -> Tree:
        return _tree(name, self._given[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._given)

    def __len__(self) -> int:
        return len(self._given)


def _tree(name: str, given: Any) -> Tree:
    if isinstance(given, Tree):
        return given
    if isinstance(given, str | os.PathLike):
        return read_binary(given, name)
    raise MibvhError(f"tree {name} is a Tree or a file, not a {type(given).__name__}")
