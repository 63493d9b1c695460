"""The Mitsuba plugins: the same images as Mitsuba's own, exact heat maps."""

import json
import shutil
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import trimesh
from conftest import closed_box
from cuts import CUTS

import mibvh
import mibvh.mitsuba
from mibvh.builders import registry
from mibvh.cli import main
from mibvh.mitsuba.accelerator import Accelerator
from mibvh.mitsuba.costs import QUANTITIES, CostProbe, leaf_depths
from mibvh.mitsuba.coverage import Coverage
from mibvh.scene import mitsuba_geometry
from mibvh.variant import mitsuba, spare_thread

mi = mitsuba()
At = mi.ScalarTransform4f


def film(size=32):
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}


def stage(**more):
    """A floor, a camera, and what is put on the floor."""
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "film": film(),
                "to_world": At().look_at([0, 2, 6], [0, 0.5, 0], [0, 1, 0]),
            },
            "floor": {
                "type": "rectangle",
                "to_world": At().rotate([1, 0, 0], -90).scale(4),
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {"type": "checkerboard", "to_uv": At().scale([7, 7, 1])},
                },
            },
            **more,
        }
    )


def box(bsdf, x, y=0.6, z=0.0):
    """A box above the floor: in faces that coincide either one may be hit."""
    at = At().translate([x, y, z]).rotate([0, 1, 0], 30).scale(0.5)
    return {"type": "cube", "to_world": at, "bsdf": bsdf}


def sky():
    pixels = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}


LAMP = {
    "type": "rectangle",
    "to_world": At().translate([0, 3, 1]).rotate([1, 0, 0], 90),
    "emitter": {"type": "area", "radiance": 4.0},
}


def cornell_box():
    scene = mi.cornell_box()
    scene["sensor"]["film"].update(width=32, height=32)
    return mi.load_dict(scene)


def render(scene, kind, **parameters):
    integrator = mi.load_dict({"type": kind, **parameters})
    return np.array(mi.render(scene, integrator=integrator, spp=8, seed=3))


def assert_same_image(scene, builder="sbvh", **parameters):
    """With Mitsuba's origins equal up to rounding, with nearer ones nearly so.

    A path in a thousand may fall on the other side of a decision.
    """
    wanted = render(scene, "path", **parameters)
    near = render(scene, "bvh_path", builder=builder, **parameters)
    with (
        mock.patch.object(Accelerator, "spawn_ray", lambda _, si, d: si.spawn_ray(d)),
        mock.patch.object(Accelerator, "spawn_ray_to", lambda _, si, p: si.spawn_ray_to(p)),
    ):
        found = render(scene, "bvh_path", builder=builder, **parameters)
    assert wanted.mean() > 0.01
    for image, tolerance, most, mean in [(found, 1e-3, 0.01, 2e-3), (near, 2e-2, 0.08, 1e-2)]:
        off = np.abs(image - wanted) > tolerance * (wanted + 0.01)
        assert off.any(axis=2).mean() < most
        assert image.mean() == pytest.approx(wanted.mean(), rel=mean)


SCENES = {
    "cornell box": cornell_box,
    "glass, gold and leaves in the sky": lambda: stage(
        sky=sky(),
        glass=box({"type": "dielectric"}, -1.2),
        gold=box({"type": "roughconductor", "material": "Au", "alpha": 0.2}, 0.3),
        leaves=box({"type": "mask", "opacity": 0.4, "b": {"type": "diffuse"}}, 1.5, z=1.0),
    ),
    "mirror and frosted glass under a lamp": lambda: stage(
        lamp=LAMP,
        point={"type": "point", "position": [2, 3, 1], "intensity": 4.0},
        mirror=box({"type": "conductor", "material": "Cu"}, -1.0),
        frosted=box({"type": "roughdielectric", "alpha": 0.3}, 0.8),
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_image_is_that_of_path(name):
    assert_same_image(SCENES[name]())


@pytest.mark.parametrize("name", SCENES)
def test_both_styles_render_the_same_image(name):
    scene = SCENES[name]()
    wide, single = (render(scene, "bvh_path", style=style) for style in ("wide", "single"))
    assert np.abs(wide - single).max() <= 1e-5 * single.max()


@pytest.mark.parametrize("builder", ["sbvh", "streelet", "lbvh"])
def test_both_styles_find_the_same_hits(builder):
    rng = np.random.default_rng(7)
    n = 999  # no multiple of any packet's width
    triangles = mibvh.Triangles(CUTS["pipes"]())
    scene = mitsuba_geometry(triangles)
    low, high = triangles.bounds
    o = low + (high - low) * rng.random((n, 3))
    d = rng.choice(triangles.corners.mean(axis=1), n) - o
    ray = mi.Ray3f(mi.Point3f(o.T), mi.Vector3f((d / np.linalg.norm(d, axis=1)[:, None]).T))
    ray.maxt = mi.Float(np.where(rng.random(n) < 0.5, 1e30, 0.05 * triangles.diagonal))
    active = mi.Bool(rng.random(n) < 0.8)
    found = [Accelerator(scene, builder, style=style) for style in ("wide", "single")]
    wide, single = (tree.intersect(ray, active) for tree in found)
    assert 0.2 < np.array(single.is_valid()).mean() < 0.79
    assert np.array_equal(np.array(wide.is_valid()), np.array(single.is_valid()))
    assert np.array_equal(np.array(wide.t), np.array(single.t))
    blocked = [np.array(tree.occluded(ray, active)) for tree in found]
    assert np.array_equal(*blocked)
    assert np.array_equal(blocked[0], np.array(single.is_valid()))


def test_an_unknown_style_is_refused():
    with pytest.raises(RuntimeError, match="style must be one of wide, single, not 'while-while'"):
        mi.load_dict({"type": "bvh_path", "style": "while-while"})
    with pytest.raises(mibvh.MibvhError, match="style must be one of"):
        Accelerator(cornell_box(), style="narrow")


def test_parameters_mean_what_they_do_in_path():
    scene = cornell_box()
    for parameters in ({"max_depth": 1}, {"max_depth": 4, "rr_depth": 1, "hide_emitters": True}):
        assert_same_image(scene, "lbvh", **parameters)
    assert not render(scene, "bvh_path", max_depth=0).any()


def test_a_bundled_scene_looks_as_in_path():
    scene = mi.load_file(str(mibvh.bundled.bundled_scene("livingroom@2000")))
    params = mi.traverse(scene.sensors()[0])
    params["film.size"] = [32, 24]
    params.update()
    assert_same_image(scene, "bbvh", max_depth=5)


def test_what_a_tree_cannot_hold_is_named_and_traced_beside_it():
    scene = stage(
        sky=sky(),
        ball={
            "type": "sphere",
            "radius": 0.5,
            "center": [-1, 0.5, 0],
            "bsdf": {"type": "dielectric"},
        },
        plate={"type": "disk", "to_world": At().translate([1, 1, -0.7])},
        box=box({"type": "diffuse"}, 0.0),
    )
    with pytest.warns(UserWarning, match="cannot hold Sphere 'ball', Disk 'plate'"):
        assert_same_image(scene)
    assert {shape.id() for shape in scene.shapes()} >= {"ball", "plate"}


def test_instances_are_traced_beside_the_tree():
    scene = stage(
        lamp=LAMP,
        group={"type": "shapegroup", "a": box({"type": "diffuse"}, 0), "b": {"type": "sphere"}},
        one={
            "type": "instance",
            "g": {"type": "ref", "id": "group"},
            "to_world": At().translate([-1.5, 0.3, 0]).scale(0.6),
        },
        box=box({"type": "diffuse"}, 1.0),
    )
    with pytest.warns(UserWarning, match="cannot hold Instance 'one'"):
        assert_same_image(scene)


@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_mono"])
def test_other_variants(variant):
    before = mi.variant()
    try:
        mi.set_variant(variant)
        scene = cornell_box()
        assert_same_image(scene)
        assert render(scene, "bvh_cost")[..., -1].mean() > 0.5
    finally:
        mi.set_variant(before)


def field(scale, move):
    """Boxes on a checkered floor under a white sky, scaled and moved with their camera."""
    at = At().translate([move] * 3).scale(scale)
    places = enumerate([[-1, 0.5, 0], [0, 0.4, 0.5], [1, 0.6, -0.5]])
    view = [[x * scale + move for x in p] for p in ([0, 2, 6], [0, 0.5, 0])]
    return mi.load_dict(
        {
            "type": "scene",
            "sky": {"type": "constant"},
            "sensor": {
                "type": "perspective",
                "near_clip": 0.01 * scale,
                "far_clip": 100 * scale,
                "film": film(),
                "to_world": At().look_at(*view, [0, 1, 0]),
            },
            "floor": {
                "type": "rectangle",
                "to_world": at @ At().rotate([1, 0, 0], -90).scale(4),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
            },
            **{
                f"box{i}": {
                    "type": "cube",
                    "bsdf": {"type": "diffuse"},
                    "to_world": at @ At().translate(p).rotate([0, 1, 0], 30 * i).scale(0.4),
                }
                for i, p in places
            },
        }
    )


@pytest.mark.parametrize(("scale", "move"), [(1e-6, 0), (1e6, 0), (1, 10000)])
def test_tiny_and_far_scenes_look_the_same(scale, move):
    """Mitsuba's own ``path`` moves the origins of its rays by up to 0.04 to 0.08 in this image."""
    wanted, found = (
        render(scene, "bvh_path", max_depth=4) for scene in (field(1, 0), field(scale, move))
    )
    assert np.sqrt(((wanted - found) ** 2).mean()) < 0.005
    assert found.mean() == pytest.approx(wanted.mean(), rel=1e-3)


GROUPS = """<scene version="3.0.0"><emitter type="constant"/><sensor type="perspective">
<transform name="to_world"><lookat origin="0,2,14" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film>
</sensor>
<shape type="shapegroup" id="two"><shape type="sphere"/><shape type="cube">
<transform name="to_world"><translate y="2"/></transform></shape></shape>
<shape type="shapegroup" id="one"><shape type="cube"/></shape>
<shape type="instance"><ref id="two"/><transform name="to_world"><translate x="3"/></transform>
</shape>
<shape type="instance"><ref id="two"/><transform name="to_world"><translate x="-3"/></transform>
</shape>
<shape type="instance" id="last"><ref id="one"/></shape>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="5"/>
<translate y="-1"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.9,0.1,0.1"/>
</bsdf></shape></scene>"""


def test_instances_are_the_same_triangles_in_files_and_in_memory(tmp_path):
    """What ``bvh_cost`` and ``bvh_rays`` are handed holds what ``build`` loads."""
    path = tmp_path / "groups.xml"
    # An instance keeps its transform in single precision, which a rotation shows.
    turned = '<translate x="-3"/></transform>\n</shape>\n<shape type="instance" id="last">'
    assert turned in GROUPS
    path.write_text(GROUPS.replace(turned, '<rotate y="1" angle="30"/>' + turned))
    loaded = mibvh.load(path)
    scene = mi.load_file(str(path), optimize=False)
    ids = [shape.id() for shape in scene.shapes()]
    live = mibvh.load(scene)
    assert len(loaded.triangles) == 2 * (2208 + 12) + 12 + 2
    assert live.triangles.digest == loaded.triangles.digest
    assert [shape.id() for shape in scene.shapes()] == ids
    integrator = mi.load_dict({"type": "bvh_cost"})
    with pytest.warns(UserWarning, match="tessellated"):
        image = mi.render(scene, integrator=integrator, spp=16)
    hit = mibvh.mitsuba.image_channels(image, integrator)["hit"]
    depth = mi.load_dict({"type": "aov", "aovs": "d:depth"})
    seen = np.array(mi.render(scene, integrator=depth, spp=16))[..., -1] > 0
    assert ((hit > 0) == seen).mean() > 0.97


def test_means_say_of_what_they_are():
    """Overlap is a matter of rays that hit: per hit and per ray are two quantities."""
    channels = {
        "a.cost": np.full((2, 2), 3.0, np.float32),
        "a.overlap": np.array([[8, 0], [0, 0]], np.float32),
        "hit": np.array([[1, 0], [1, 0]], np.float32),
    }
    means = mibvh.mitsuba.channel_means(channels)
    assert means == {"a.cost": 3, "a.overlap_per_hit": 4, "a.overlap_per_ray": 2, "hit": 0.5}
    full = {f"a.{name}": channels["a.overlap"] for name in QUANTITIES} | channels
    figure = mibvh.mitsuba.cost_figure(full, ["cost", "overlap"])
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles[0].endswith("mean 3 per ray")
    assert titles[1].endswith("mean 4 per hit")


def test_scalar_variants_and_bad_parameters_get_one_sentence():
    for parameters, said in [
        ({"builder": "oak"}, "there is no builder 'oak'"),
        ({"max_leaf": 0}, "option max_leaf must be from 1 to 255"),
        ({"colour": 0.5}, "bvh_path has no parameter 'colour'"),
        ({"max_depth": -2}, "max_depth must be at least 0"),
    ]:
        with pytest.raises(RuntimeError, match=said):
            mi.load_dict({"type": "bvh_path", **parameters})
    before = mi.variant()
    try:
        mi.set_variant("scalar_rgb")
        with pytest.raises(RuntimeError, match="which the variant scalar_rgb does not use"):
            mi.load_dict({"type": "bvh_path"})
    finally:
        mi.set_variant(before)


def test_costs_are_those_of_trace(cornell):
    """The heat map's counters are the study's; overlap and leaf depth agree with brute force."""
    rays = mibvh.diffuse_rays(cornell, width=12, height=9, samples=1)
    tree = mibvh.build(cornell, "sbvh")
    hits = mibvh.trace(tree, cornell, rays, repeats=1)
    probe = CostProbe(tree, cornell.triangles)
    told = probe(mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T)), mi.Bool(True))
    for name, column in [("inner", hits.inner), ("leaves", hits.leaves), ("triangles", hits.tests)]:
        np.testing.assert_array_equal(told[name], column)
    assert told["cost"].mean() == pytest.approx(hits.counted_cost())
    np.testing.assert_array_equal(told["hit"], hits.triangle >= 0)
    _, ends = mibvh.ray_ends(cornell.triangles, rays, hits)
    hit = np.flatnonzero(told["hit"])
    for i in range(0, len(hit), 7):
        point, triangle = ends.points[i], ends.triangle[i]
        inside = ((point >= tree.lower) & (point <= tree.upper)).all(axis=1)
        own = np.array(
            [
                triangle in tree.references[first : first + count]
                for first, count in zip(tree.first, tree.count, strict=True)
            ]
        )
        cost = np.where(tree.is_leaf, 1.0 * tree.count, 1.2)
        assert told["overlap"][hit[i]] == pytest.approx(cost[inside & ~own].sum(), abs=1e-6)
        depth = tree.depths[inside & own & tree.is_leaf].min()
        assert told["leaf_depth"][hit[i]] == depth


def test_depth_of_the_leaf_of_a_split_triangle():
    """Two references of one triangle, at depths 1 and 2: the point decides."""
    triangles = mibvh.Triangles([[[0, 0, 0], [4, 0, 0], [0, 1, 0]]] * 2)
    tree = mibvh.Tree(
        lower=np.array([[0, 0, 0], [0, 0, 0], [2, 0, 0], [2, 0, 0], [2, 0, 0]], np.float32),
        upper=np.array([[4, 1, 0], [2, 1, 0], [4, 1, 0], [4, 1, 0], [4, 1, 0]], np.float32),
        left=np.array([1, -1, 3, -1, -1], np.int32),
        first=np.array([0, 0, 1, 1, 2], np.int32),
        count=np.array([3, 1, 2, 1, 1], np.int32),
        references=np.array([0, 0, 1], np.int32),
    )
    points = np.array([[1, 0.1, 0], [3, 0.1, 0], [2, 0.1, 0], [3, 0.1, 0]])
    found = leaf_depths(tree, triangles, points, np.array([0, 0, 0, 1]))
    np.testing.assert_array_equal(found, [1, 2, 1, 2])


def test_heat_maps_of_two_trees_and_their_figure(tmp_path):
    scene = cornell_box()
    integrator = mi.load_dict(
        {
            "type": "bvh_cost",
            "builder": "sbvh",
            "max_leaf": 2,
            "compare": "lbvh",
            "compare_max_leaf": 8,
        }
    )
    assert integrator.layers == ["sbvh", "lbvh", "difference"]
    image = mi.render(scene, integrator=integrator, spp=2)
    channels = mibvh.mitsuba.image_channels(image, integrator)
    assert list(channels) == integrator.aov_names()
    assert {name.split(".")[1] for name in channels if "." in name} == set(QUANTITIES)
    for name in QUANTITIES:
        np.testing.assert_allclose(
            channels[f"difference.{name}"],
            channels[f"lbvh.{name}"] - channels[f"sbvh.{name}"],
            atol=1e-4,
        )
    np.testing.assert_allclose(
        channels["sbvh.cost"], 1.2 * channels["sbvh.inner"] + channels["sbvh.triangles"], rtol=1e-5
    )
    np.testing.assert_allclose(np.array(image)[..., 0], channels["sbvh.cost"], rtol=1e-5)
    figure = mibvh.mitsuba.cost_figure(channels)
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == 6
    assert titles[2].startswith("lbvh less sbvh")
    with pytest.raises(mibvh.MibvhError, match="no quantity 'speed'"):
        mibvh.mitsuba.cost_figure(channels, ["speed"])


def test_xml_with_parameters():
    scene = mi.load_string(
        """<scene version="3.0.0"><default name="who" value="bbvh"/>
        <integrator type="bvh_path"><string name="builder" value="$who"/>
        <integer name="max_leaf" value="2"/></integrator>
        <sensor type="perspective"><transform name="to_world">
        <lookat origin="0, 0, -5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/>
        <integer name="height" value="8"/></film></sensor><emitter type="constant"/>
        <shape type="cube"/></scene>""",
        who="lbvh",
    )
    assert "tree = lbvh(max_leaf=2)" in str(scene.integrator())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array(mi.render(scene, spp=1)).max() > 0


def test_plugins_are_found_in_an_installed_package(tmp_path):
    """Laid out as the wheel is, in a fresh process that sets its variant last, and twice."""
    root = Path(mibvh.__file__).parents[1]
    shutil.copytree(root / "mibvh", tmp_path / "mibvh", ignore=shutil.ignore_patterns("__py*"))
    build = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    for source, target in build["targets"]["wheel"]["force-include"].items():
        shutil.copytree(root / source, tmp_path / target)
    code = """
import mibvh.mitsuba
import mitsuba as mi
assert mi.variant() is None
for variant in ("llvm_ad_mono", "llvm_ad_rgb", "llvm_ad_mono"):
    mi.set_variant(variant)
    print([type(mi.load_dict({"type": name})).__module__ for name in mibvh.mitsuba.PLUGINS])
print(mibvh.mitsuba.register.__code__.co_filename)
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    *names, file = ran.stdout.splitlines()
    assert Path(file).is_relative_to(tmp_path)
    assert names[0] == names[2] != names[1]
    assert names[0].count("llvm_ad_mono") == len(mibvh.mitsuba.PLUGINS)


def test_passes_share_the_records_and_not_with_another_geometry():
    scene = stage(box=box({"type": "diffuse"}, 0.0))
    integrator = mi.load_dict({"type": "bvh_cost", "builder": "bbvh"})
    first, again = integrator.prepare(scene)[0], integrator.prepare(scene)[0]
    assert first._records is again._records
    params = mi.traverse(scene)
    params["box.vertex_positions"] = params["box.vertex_positions"] * 0.5
    params.update()
    moved = integrator.prepare(scene)[0]
    assert moved._records is not first._records
    assert moved.triangles.digest != first.triangles.digest


def test_a_builder_registered_anew_builds_anew(monkeypatch):
    monkeypatch.setattr(registry, "_registered", registry._registered.copy())
    scene, built = stage(box=box({"type": "diffuse"}, 0.0)), []

    for version in ("first", "second"):

        @mibvh.builder("mine", summary="counts its builds")
        def mine(triangles, options, context, version=version):
            built.append(version)
            return np.arange(len(triangles))

        for _ in range(2):
            Accelerator(scene, "mine")
    assert built == ["first", "second"]


@pytest.mark.parametrize("builder", ["finite", "bittner"])
def test_a_builder_that_asks_for_rays_gets_those_of_the_cameras(builder):
    """A render's tree is the one that `mibvh build` makes; a camera elsewhere makes another."""
    scene = mi.load_file(str(mibvh.bundled.bundled_scene("cornell@3000")), optimize=False)
    options = {"start": "finite"} if builder == "bittner" else {}
    first = Accelerator(scene, builder, **options)
    assert first.tree.digest == mibvh.build(mibvh.load(scene), builder, **options).digest
    assert Accelerator(scene, builder, **options).tree is first.tree
    if builder == "finite":
        assert first.tree.meta["report"]["rays"].startswith("diffuse rays of ")
    plain = Accelerator(scene, "lbvh").tree
    params = mi.traverse(scene.sensors()[0])
    params["to_world"] = params["to_world"] @ mi.ScalarTransform4f().translate([0.1, 0, 0.3])
    params.update()
    assert Accelerator(scene, builder, **options).tree.digest != first.tree.digest
    assert Accelerator(scene, "lbvh").tree is plain


def test_rays_are_those_of_diffuse_rays_and_shown_where_they_end(tmp_path):
    path = mibvh.bundled.bundled_scene("cornell@3000")
    scene = mi.load_file(str(path), optimize=False)
    params = mi.traverse(scene.sensors()[0])
    params["film.size"] = [16, 12]
    params.update()
    how = {"width": 24, "height": 16, "samples": 2, "bounces": 2, "seed": 5}
    file = tmp_path / "rays.npz"
    integrator = mi.load_dict({"type": "bvh_rays", "filename": str(file), **how})
    channels = mibvh.mitsuba.image_channels(
        mi.render(scene, integrator=integrator, spp=1), integrator
    )
    assert set(channels) == {
        "all.density",
        "bounce1.density",
        "bounce2.density",
        "shade",
        "hit",
    }
    wanted = mibvh.diffuse_rays(scene, **how)
    assert integrator.rays.digest == wanted.digest == mibvh.RaySet.load(file).digest
    assert integrator.rays.meta["digest"] == wanted.meta["digest"]
    assert set(wanted.bounce) == {1, 2}
    assert channels["bounce2.density"].max() > 0
    assert mibvh.mitsuba.coverage_figure(channels, wanted).axes[0].get_title() == (
        f"all bounces: {len(wanted):,} rays"
    )


def test_rays_follow_a_camera_that_moves():
    scene = mi.load_file(str(mibvh.bundled.bundled_scene("cornell@1000")), optimize=False)
    how = {"width": 8, "height": 6, "samples": 1}
    integrator = mi.load_dict({"type": "bvh_rays", **how})
    first = integrator.prepare(scene)
    assert integrator.prepare(scene) is first
    params = mi.traverse(scene.sensors()[0])
    move = mi.ScalarTransform4f().translate([0.1, 0, 0])
    params["to_world"] = mi.Transform4f(move) @ params["to_world"]
    params.update()
    assert integrator.prepare(scene) is not first
    assert integrator.rays.digest == mibvh.diffuse_rays(scene, **how).digest


def test_density_of_ray_ends_is_relative_to_an_even_spread():
    """Rays straight down onto the left half of a square: twice as dense there, none elsewhere."""
    square = np.array([[[0, 0, 0], [2, 0, 0], [2, 1, 0]], [[0, 0, 0], [2, 1, 0], [0, 1, 0]]])
    rng = np.random.default_rng(1)
    n = 40000
    o = np.column_stack([rng.random((n, 2)), np.ones(n)]).astype(np.float32)
    d = np.tile(np.float32([0, 0, -1]), (n, 1))
    zero = np.zeros(n, np.int32)
    rays = mibvh.RaySet(o, d, np.full(n, np.inf, np.float32), zero, zero + 1, zero)
    coverage = Coverage(mibvh.load(square.astype(np.float32)), rays)
    inside = np.column_stack([0.1 + 0.8 * rng.random((500, 2)), np.zeros(500)])
    assert coverage.density(inside, "bounce1").mean() == pytest.approx(2, rel=0.1)
    assert coverage.density(inside + [1, 0, 0], "all").mean() < 0.02
    assert not coverage.density(inside, "bounce2").any()


def test_render_command(tmp_path, capsys, monkeypatch):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["mibvh", "render", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code or 0, *capsys.readouterr()

    xml = tmp_path / "s.xml"
    xml.write_text(
        '<scene version="3.0.0"><default name="grey" value="0.1"/><sensor type="perspective">'
        '<transform name="to_world"><lookat origin="0, 0, -5" target="0, 0, 0" up="0, 1, 0"/>'
        '</transform></sensor><emitter type="constant"/><shape type="sphere" id="ball">'
        '<point name="center" value="0, 3, 0"/></shape>'
        '<shape type="cube"><bsdf type="diffuse"><rgb name="reflectance" value="$grey"/></bsdf>'
        "</shape></scene>"
    )
    image = tmp_path / "a.exr"
    small = ("--size", "12x8", "--spp", 2)
    code, out, err = run(xml, "-o", image, *small, "-D", "grey=0.9", "--builder", "lbvh", "--json")
    assert code == 0
    assert json.loads(out)["width"] == 12
    assert "cannot hold Sphere 'ball'" in err
    with spare_thread():
        pixels = np.array(mi.Bitmap(str(image)))
    assert pixels[4, 6, 0] > 0.5  # 0.1 at most without -D
    code, out, _ = run(
        "cornell@3000",
        "-o",
        image,
        *small,
        "--integrator",
        "bvh_cost",
        "--compare",
        "lbvh",
        "--json",
    )
    assert json.loads(out)["means"]["difference.cost"] > 0
    with spare_thread():
        names = [field.name for field in mi.Bitmap(str(image)).struct_()]
    assert {"R", "sbvh.overlap", "lbvh.leaf_depth", "difference.cost", "hit"} <= set(names)
    corners = closed_box(-1, 1)
    trimesh.Trimesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)).export(
        tmp_path / "box.ply"
    )
    for integrator in ("bvh_path", "bvh_rays", "bvh_cost"):
        picture = tmp_path / f"{integrator}.png"
        code, _, _ = run(tmp_path / "box.ply", "-o", picture, *small, "--integrator", integrator)
        assert code == 0
        assert np.array(mi.Bitmap(str(picture))).std() > 0
    own = tmp_path / "own.xml"
    own.write_text(
        xml.read_text().replace(
            "<emitter",
            '<default name="who" value="lbvh"/><integrator type="bvh_cost">'
            '<string name="builder" value="$who"/></integrator><emitter',
        )
    )
    _, out, _ = run(own, "-o", image, *small, "--json")
    assert "lbvh.cost" in json.loads(out)["means"]
    _, out, _ = run(own, "-o", image, *small, "--json", "--builder", "sbvh")
    assert json.loads(out)["integrator"] == "bvh_path"
    code, _, err = run(own, "-o", image, *small, "-D", "who=oak")
    assert code == 2
    assert "(At " in err
    assert "there is no builder 'oak'" in err
    assert "Traceback" not in err
    own.write_text('<scene version="3.0.0"><shape type="cube"/></scene>')
    code, out, _ = run(own, "-o", tmp_path / "own.png", *small, "--json")
    assert (code, json.loads(out)["width"]) == (0, 12)  # with a camera that is chosen
    for arguments, said in [
        (("-o", tmp_path / "b.jpg"), "an image is an .exr or a .png file"),
        (("-o", tmp_path / "gone" / "b.png"), "there is no folder"),
        (("-o", image, "--quantity", "speed"), "there is no quantity 'speed'"),
        (("-o", image, "--size", "12"), "--size takes WIDTHxHEIGHT"),
        (("-o", image, "--spp", 0), "spp must be a whole number from 1"),
        (("-o", image, "--sensor", 9), "there is no 9"),
        (("-o", image, "-D", "grey"), "-D takes NAME=VALUE"),
        (("-o", image, "--builder", "oak"), "integrator bvh_path: there is no builder 'oak'"),
    ]:
        code, out, err = run("cornell@3000", *arguments)
        assert (code, out) == (2, "")
        assert said in err
        assert err.count("\n") == 1
