"""What the user brings to the study of a scene: finished trees, and rays."""

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
        By the name that they have in tables; asked for one at a time.
    rays : RaySet or None
        Traced instead of diffuse rays from the scene's cameras.
    """

    trees: Mapping[str, Tree] = dataclasses.field(default_factory=dict)
    rays: RaySet | None = None

    def check(self, triangles: Triangles) -> dict[str, MibvhError]:
        """See that trees and rays are of these triangles, and can be traced.

        Returns
        -------
        dict of str to MibvhError
            What is wrong with each tree that is not.

        Raises
        ------
        MibvhError
            If a tree cannot be read, or with the first fault of the rays.
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
        """What a reader has to know of them, in sentences; of trees, of those that are studied."""
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
    """See that a given tree is of these triangles, and can be traced.

    Raises
    ------
    MibvhError
        With the first fault.
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
