"""Finished trees and rays that the user brings to the study of a scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

from mibvh.errors import MibvhError
from mibvh.rays import RaySet
from mibvh.tree import MAX_DEPTH, Tree
from mibvh.triangles import Triangles


@dataclasses.dataclass(frozen=True, eq=False)
class Given:
    """Finished trees and rays of one scene.

    Attributes
    ----------
    trees : mapping of str to Tree
        By their names in tables. Each access may read a file.
    rays : RaySet or None
        Traced instead of diffuse rays from the scene's cameras.
    """

    trees: Mapping[str, Tree] = dataclasses.field(default_factory=dict)
    rays: RaySet | None = None

    def check(self, triangles: Triangles) -> dict[str, MibvhError]:
        """Check that trees and rays belong to these triangles, and can be traced.

        Returns
        -------
        dict of str to MibvhError
            The trees that do not, and why.

        Raises
        ------
        MibvhError
            If a tree cannot be read, or the rays fail the check.
        """
        unfit: dict[str, MibvhError] = {}
        for name in self.trees:
            tree = self.trees[name]
            try:
                check_given(name, tree, triangles)
            except MibvhError as error:
                unfit[name] = error
        if self.rays is not None:
            if len(self.rays) == 0:
                raise MibvhError(f"there are no rays in those given for {triangles.name}")
            if self.rays.occlusion:
                raise MibvhError(
                    f"the rays given for {triangles.name} are {self.rays.kind} rays, which end at "
                    "any hit; a study asks for the closest, so trace them with mibvh trace"
                )
            self.rays.check_matches(triangles)
        return unfit

    def notes(self, studied: Collection[str]) -> list[str]:
        """Return notes for the report on the given rays, and on the given trees under study."""
        said = [
            f"The tree {name} was given as it is: it has no options and no build time."
            for name in self.trees
            if name in studied and "build_seconds" not in self.trees[name].meta
        ]
        if self.rays is not None:
            of = self.rays.meta.get("file") or self.rays.meta.get("kind") or "an array"
            said.append(f"The rays were given ({of}); options that make rays had no part in it.")
        return said


def check_given(name: str, tree: Tree, triangles: Triangles) -> None:
    """Check that a given tree belongs to these triangles, and can be traced.

    Raises
    ------
    MibvhError
        If it does not; the message names the first fault.
    """
    try:
        tree.check_matches(triangles)
    except MibvhError as error:
        raise MibvhError(f"tree {name} of {triangles.name}: {error}") from None
    if tree.depth > MAX_DEPTH:
        raise MibvhError(
            f"tree {name} of {triangles.name}: it is {tree.depth} levels deep; the "
            f"traversal stack has {MAX_DEPTH}"
        )
