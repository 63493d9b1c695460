"""One case: a damaged file of another program's tree, through import, metrics and traversal."""

from __future__ import annotations

import numpy as np

import mibvh
from mibvh.layouts import LAYOUTS, get
from tools.fuzz.files import Bench, same
from tools.fuzz.mutate import damaged


class Imports(Bench):
    """The trees of the bench, in the layouts of other programs; wide ones where it takes such."""

    def __init__(self) -> None:
        super().__init__()
        self.path = self.folder / "tree"
        self.foreign = []
        for tree in self.trees.values():
            for layout in LAYOUTS:
                width = getattr(get(layout), "width", 2)
                fitting = tree if width == 2 else mibvh.collapse(tree, width)
                mibvh.write_tree(fitting, self.path, layout)
                self.foreign.append((layout, self.path.read_bytes()))

    def run(self, seed: int) -> str:
        """Run a case; return what became of it."""
        rng = np.random.default_rng(seed)
        layout, data = self.foreign[int(rng.choice(len(self.foreign)))]
        self.path.write_bytes(damaged(data, rng))
        try:
            tree = mibvh.read_tree(self.path, layout)
            mibvh.epo(tree, self.triangles)
            style = "wide" if isinstance(tree, mibvh.WideTree) else "single"
            hits = self.trace(tree, self.rays, style)
        except mibvh.MibvhError:
            return f"{layout} refused"
        same("hits", hits.t, self.truth.t)
        return f"{layout} accepted"
