"""Trees of other leaf sizes: derived from drafts that are built once, and equal to built ones."""

from __future__ import annotations

import numpy as np
import pytest
from cuts import CUTS

import mibvh
from mibvh.builders import Context, all_names, get, sharing
from mibvh.builders.building import draft_or_tree, leaf_measure
from mibvh.builders.chosen import parse
from mibvh.builders.draft import Draft
from mibvh.builders.finish import finish
from mibvh.builders.registry import Builder
from mibvh.builders.sharing import shared_drafts
from mibvh.collapsing import nodes_in_finer
from mibvh.metrics.epo import overlap
from mibvh.nodes import PAPER_COSTS
from mibvh.studies.measure import sensitivity
from mibvh.studies.measure.sensitivity import LEAF_SIZES, SensitivityResult
from mibvh.studies.measure.trees import TreeSource, bundled_drafts

#: Every builder that has drafts, and options on which drafts and collapse depend.
BUILDERS = (
    *(name for name in all_names() if name != "embree"),
    "bbvh(presplit=0.5)",
    "sbvh(alpha=0.0,max_leaf=2)",
    "streelet(beta=1.0)",
    "hill(start=streelet)",
    "lbvh(c_inner=3.0)",
)
CHOICES = {"width": 16, "height": 12, "scalar_rays": 64, "seconds": 0.0}


@pytest.fixture(scope="module")
def scenes():
    """Pieces of the geometry of real scenes, whose long triangles splitting builders split."""
    return {name: mibvh.load(make()) for name, make in CUTS.items()}


@pytest.fixture(scope="module")
def scene(scenes):
    return scenes["needles"]


@pytest.fixture(scope="module")
def rays(scene):
    return mibvh.diffuse_rays(scene, width=16, height=12, samples=1)


def draft(name, scene):
    (chosen,) = parse(name)
    entry = get(chosen.builder)
    options, context = entry.options(**dict(chosen.options)), Context(source=scene)
    made = draft_or_tree(entry, scene.triangles, options, context)
    return options, made, leaf_measure(made, context)


def trees_of(name, scene):
    """One tree for each leaf size, each finished from the draft."""
    options, made, measure = draft(name, scene)
    costs = {"c_inner": options.c_inner, "c_tri": options.c_tri}
    meta = {"triangles": len(scene.triangles), "digest": scene.triangles.digest, **costs}
    return [finish(made, **costs, max_leaf=size, meta=meta, measure=measure) for size in LEAF_SIZES]


@pytest.mark.parametrize("name", BUILDERS)
def test_overlap_of_nodes_does_not_depend_on_their_leaves(name, scenes):
    """To the last bit, so that EPO is: the finest tree's nodes are those of all others."""
    for scene in scenes.values():
        finest, *others = trees_of(name, scene)
        fraction = overlap(finest, scene.triangles).fraction
        for tree in others:
            nodes = nodes_in_finer(tree, finest)
            assert np.array_equal(fraction[nodes], overlap(tree, scene.triangles).fraction)
        assert len({len(tree) for tree in (finest, *others)}) > 2


@pytest.mark.parametrize("name", BUILDERS)
def test_own_leaf_size_gives_the_built_tree(name, scene, rays):
    """The tree of a builder's own leaf size is its tree in the study, with the same figures."""
    options, _, _ = draft(name, scene)
    chosen = parse(name)[0]
    built = mibvh.build(scene, chosen.builder, **dict(chosen.options))
    built = built.replace(meta={**built.meta, **PAPER_COSTS})
    found = sensitivity._leaf_sizes(TreeSource.of(chosen), scene, rays, cull=False)
    (own,) = (one for one in found.sizes if one.max_leaf == options.max_leaf)
    hits = mibvh.trace(built, scene.triangles, rays, repeats=1)
    assert list(own.values) == ["sah", "epo", "counted_cost", "mean_leaf_size"]
    assert own.values["sah"] == mibvh.sah(built)
    assert own.values["epo"] == mibvh.epo(built, scene.triangles)
    assert own.values["counted_cost"] == float(hits.costs(**PAPER_COSTS).mean())
    assert own.values["mean_leaf_size"] == built.stats()["mean_leaf_size"]


def test_trees_that_are_not_of_one_draft_have_no_common_nodes(scene):
    one, other = (trees_of(name, scene) for name in ("bbvh", "agglo"))
    assert nodes_in_finer(one[3], other[0]) is None
    # The finer of the two, and one whose boxes alone differ.
    assert nodes_in_finer(one[0], one[3]) is None
    wider = one[0].replace(upper=one[0].upper + np.float32(1))
    assert nodes_in_finer(one[3], wider) is None


def test_trees_whose_depth_was_repaired_are_measured_themselves(scene, monkeypatch):
    """Their nodes need not be those of the finest tree."""
    asked = []
    triangles = scene.triangles
    at_size = dict(zip(LEAF_SIZES, trees_of("sbvh", scene), strict=True)).__getitem__
    derived = sensitivity._metrics_of_sizes(at_size, triangles)
    monkeypatch.setattr(sensitivity, "nodes_in_finer", lambda *trees: asked.append(trees))
    assert sensitivity._metrics_of_sizes(at_size, triangles) == derived
    assert len(asked) == len(LEAF_SIZES)


def test_each_draft_is_built_once(tmp_path, scene, monkeypatch):
    """In the scene as it stands; and a study that finds its trees builds drafts again."""
    built = []
    made = Builder._made

    def counted(self, triangles, options, context):
        built.append((self.name, triangles.digest == scene.triangles.digest))
        return made(self, triangles, options, context)

    names = ("bbvh", "sbvh", "lbvh", "hill", "treelet", "streelet")
    options = {"builders": names, **CHOICES}
    for name in names:
        mibvh.build(scene, name)  # compiles
    monkeypatch.setattr(Builder, "_made", counted)
    at_once = mibvh.study([scene], tmp_path / "a", experiments=("sensitivity",), **options)
    of_scene = sorted(name for name, here in built if here)
    assert of_scene == sorted(names)
    built.clear()
    mibvh.study([scene], tmp_path / "b", **options)
    later = mibvh.study([scene], tmp_path / "b", experiments=("sensitivity",), **options)
    assert sorted(set(of_scene)) == sorted({name for name, here in built if here})
    sizes, again = (s.scenes[0].result(SensitivityResult).leaf_sizes for s in (at_once, later))
    assert sizes == again


def test_drafts_for_later_are_in_files_until_the_end(tmp_path, scene):
    """They outlast a block of the same triangles, and builders get copies of them."""
    triangles = scene.triangles
    with shared_drafts(triangles.digest, tmp_path) as drafts:
        drafts.later = bundled_drafts(("lbvh", "sbvh"))
        with shared_drafts(triangles.digest, tmp_path) as inner:
            assert inner is drafts
            inner.want(frozenset())
            first = mibvh.build(scene, "lbvh")
        assert drafts.spared <= 0.0  # keeping it is no part of building
        files = [again for again, _ in drafts._kept.values()]
        assert [type(file) for file in files] == [sharing._InFile]
        ((key, (file, seconds)),) = drafts._kept.items()
        assert seconds > 0
        drafts._kept[key] = file, 100.0
        again = mibvh.build(scene, "lbvh")
        assert again.digest == first.digest
        assert again.meta["build_seconds"] > 99  # the second is said to have taken as long
        with shared_drafts("another scene"):
            mibvh.build(scene, "sbvh")
        assert len(drafts._kept) == 1
    assert drafts._kept == {}
    assert all(file._file.closed for file in files)


def test_a_full_disk_costs_a_second_build_and_no_more(tmp_path, scene, monkeypatch):
    def full(*_, **options):
        raise OSError("no space left on device")

    with shared_drafts(scene.triangles.digest, tmp_path) as drafts:
        drafts.later = bundled_drafts(("lbvh",))
        monkeypatch.setattr(sharing.pickle, "dump", full)
        kept = mibvh.build(scene, "lbvh")
        assert drafts._kept == {}
        monkeypatch.undo()
        monkeypatch.setattr(sharing, "_SPARE", 0.0)
        assert mibvh.build(scene, "lbvh").digest == kept.digest
        assert drafts._kept == {}


def test_drafts_of_users_builders_are_not_kept():
    """Nothing tells whether such a builder makes the same draft twice, or fails."""
    mibvh.builder("own", summary="a test's")(lambda t, o, c: np.arange(len(t)))
    names = [name for name, _ in bundled_drafts(("own", "lbvh", "sbvh(budget=0.5)"))]
    assert sorted(names) == ["lbvh", "sbvh"]
    assert isinstance(draft("own", mibvh.load(CUTS["tiles"]()))[1], Draft)
