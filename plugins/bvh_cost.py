"""The integrator ``bvh_cost``."""

from __future__ import annotations

import warnings

import mitsuba as mi
import numpy as np

from mibvh.mitsuba.costs import QUANTITIES, CostProbe
from mibvh.mitsuba.parameters import plain_variant, read_tree_source, refuse_unknown
from mibvh.scene import load
from mibvh.variant import mitsuba


class BvhCost(mi.SamplingIntegrator):
    r"""Heat maps of what camera rays cost in one tree, or in two.

    .. pluginparameters::

     * - builder
       - |string|
       - Builder of the tree: a name from ``mibvh builders``. (Default: ``sbvh``)
     * - compare
       - |string|
       - Builder of a second tree to compare with. (Default: none)
     * - tree, compare_tree
       - |string|
       - File of a tree of this scene, in the place of ``builder`` and of ``compare``.
     * - cull
       - |bool|
       - Re-test popped nodes against the current hit. The paper does not. (Default: false)
     * - max_leaf, c_inner, ...
       - |int| or |float|
       - Any option of the builder; with the prefix ``compare_``, of the second builder.

    The film's channels are means over a pixel's samples. The colour is the total cost.
    ``NAME.inner``, ``NAME.leaves`` and ``NAME.triangles`` are inner nodes visited, leaves visited
    and triangles tested; ``NAME.cost`` is their total by the cost constants. ``NAME.leaf_depth`` is
    the depth of the leaf that is hit, ``NAME.overlap`` the cost of the nodes that contain the hit
    point but not the triangle that is hit (end-point overlap); both are 0 for rays that miss.
    ``hit`` is the share of rays that hit anything. NAME is the builder's, or the tree file's. With
    a second tree its channels follow, and those of ``difference``: second minus first.

    Shapes other than meshes are tessellated or left out, and named in warnings.

    .. tabs::
        .. code-tab:: xml

            <integrator type="bvh_cost">
                <string name="builder" value="sbvh"/>
                <string name="compare" value="lbvh"/>
            </integrator>

        .. code-tab:: python

            'type': 'bvh_cost',
            'builder': 'sbvh',
            'compare': 'lbvh'
    """

    def __init__(self, props: mi.Properties) -> None:
        mitsuba()
        plain_variant("bvh_cost", mi.variant())
        super().__init__(props)
        self.sources = [read_tree_source(props, "builder", "sbvh")]
        if "compare_tree" in props.keys() or props.get("compare", ""):  # noqa: SIM118 - keys only
            self.sources.append(read_tree_source(props, "compare", "", "compare_"))
        self.cull = bool(props.get("cull", False))
        refuse_unknown(props, "bvh_cost")

    @property
    def layers(self) -> list[str]:
        """Prefixes of the channels: the builders' names, and ``difference`` if there are two."""
        names = [source.name for source in self.sources]
        if len(names) == 1:
            return names
        return [names[0], names[1] + ("_compare" if names[0] == names[1] else ""), "difference"]

    def aov_names(self) -> list[str]:
        """Names of the film's channels beside the colour."""
        return [f"{layer}.{key}" for layer in self.layers for key in QUANTITIES] + ["hit"]

    def prepare(self, scene, sensor=None, progress=None) -> list[CostProbe]:
        """Build the scene's trees, unless they are cached."""
        loaded = load(scene)
        for note in loaded.notes:
            warnings.warn(note, stacklevel=2)
        built = [source.tree(loaded, progress) for source in self.sources]
        return [CostProbe(tree, loaded.triangles, self.cull, records) for tree, records in built]

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Cost of each ray; see ``mitsuba.SamplingIntegrator.sample``."""
        told = [probe(mi.Ray3f(ray), mi.Bool(active)) for probe in self.prepare(scene)]
        layers = [np.array([one[key] for key in QUANTITIES], np.float32) for one in told]
        if len(layers) == 2:
            layers.append(layers[1] - layers[0])
        channels = [mi.Float(channel) for layer in layers for channel in layer]
        hit = mi.Float(told[0]["hit"].astype(np.float32))
        return mi.Spectrum(mi.Float(told[0]["cost"].astype(np.float32))), hit > 0, [*channels, hit]

    def to_string(self) -> str:
        """Describe the integrator, as Mitsuba's own do."""
        return f"BvhCost[trees = {[source.name for source in self.sources]}]"
