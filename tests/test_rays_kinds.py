"""Kinds of rays from the same paths, mixtures, and the cost of rays that any hit ends."""

import numpy as np
import pytest
from conftest import closed_box, soup

import mibvh
from mibvh.metrics.occlusion import (
    any_hit_ray_cost,
    estimate_alpha_any_hit,
    leaf_sizes,
    saved_by_any_hit,
)
from mibvh.rays.kinds import KINDS
from mibvh.studies.measure.counts import RayCounter
from mibvh.variant import mitsuba

FEW = {"width": 24, "height": 18, "samples": 2}
NAMES = ("o", "d", "tmax", "viewpoint", "source")

ROOM = """<scene version="3.0.0"><sensor type="perspective"><transform name="to_world">
<lookat origin="0,1,4" target="0,0,0" up="0,1,0"/></transform></sensor>{light}
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/>
</transform></shape><shape type="cube"><transform name="to_world"><scale value="0.3"/></transform>
</shape></scene>"""
LAMP = """<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/>
<scale value="0.5"/><translate y="2"/></transform><emitter type="area"/></shape>"""


def room(tmp_path, light):
    path = tmp_path / "room.xml"
    path.write_text(ROOM.format(light=light))
    return mibvh.load(path)


def test_bounces_are_those_of_diffuse_rays(cornell):
    both = mibvh.diffuse_rays(cornell, bounces=2, **FEW)
    for kind, vertex in [("diffuse", 1), ("bounce1", 1), ("bounce2", 2)]:
        rays = mibvh.make_rays(cornell, kind, **FEW)
        part = both.select(both.bounce == vertex)
        for name in NAMES:
            np.testing.assert_array_equal(getattr(rays, name), getattr(part, name))
        assert (rays.kind, rays.occlusion) == (kind, False)


def test_primary_rays_begin_at_the_cameras(cornell):
    rays = mibvh.make_rays(cornell, "primary", **FEW)
    assert len(rays) == 24 * 18 * 2 * len(cornell.sensors) == rays.meta["primary_rays"]
    assert set(rays.source) == {-1}
    assert set(rays.bounce) == {0}
    places = np.array(
        [np.array(s.world_transform().matrix)[:3, 3].ravel() for s in cornell.sensors]
    )[rays.viewpoint]
    assert np.linalg.norm(rays.o - places, axis=1).max() < 0.1 * cornell.triangles.diagonal


def test_shadow_rays_go_to_the_lamp_and_end_short_of_it(tmp_path):
    scene = room(tmp_path, LAMP)
    rays = mibvh.make_rays(scene, "shadow", **FEW)
    assert rays.occlusion
    target = rays.o + rays.d * rays.tmax[:, None]
    assert (np.abs(target[:, 1] - 2) < 3e-3).all()
    assert (target[:, 1] < 2).all()
    assert (np.abs(target[:, [0, 2]]) <= 0.503).all()
    # Spread evenly over the lamp: the mean of either coordinate is 0, with variance 1/12.
    error = np.sqrt(1 / 12 / len(rays))
    assert (np.abs(target[:, [0, 2]].mean(axis=0)) < 5 * error).all()
    hits = mibvh.trace(mibvh.build(scene, "bbvh"), scene, rays, repeats=1)
    lamp = np.flatnonzero(scene.triangles.corners[:, :, 1].min(axis=1) > 1.9)
    assert not np.isin(hits.triangle, lamp).any()
    assert 0 < (hits.triangle >= 0).mean() < 0.5
    # Mitsuba's own test of the same rays.
    mi = mitsuba()
    ray = mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T))
    ray.maxt = mi.Float(rays.tmax)
    np.testing.assert_array_equal(hits.triangle >= 0, np.array(scene.geometry.ray_test(ray)))


@pytest.mark.parametrize("light", ["", '<emitter type="constant"/>'])
def test_shadow_rays_to_the_sky_have_no_end(light, tmp_path):
    """The sky of a scene without lights is that of a constant one."""
    rays = mibvh.make_rays(room(tmp_path, light), "shadow", **FEW)
    assert np.isinf(rays.tmax).all()
    floor = rays.select(np.abs(rays.o[:, 1]) < 1e-4)
    assert floor.d[:, 1].min() > 0
    # Even over the hemisphere: the cosine has mean 1/2 and variance 1/12.
    assert abs(floor.d[:, 1].mean() - 0.5) < 5 * np.sqrt(1 / 12 / len(floor))


def test_distant_lights_are_all_in_one_direction(tmp_path):
    light = '<emitter type="directional"><vector name="direction" value="0,-3,-4"/></emitter>'
    rays = mibvh.make_rays(room(tmp_path, light), "shadow", **FEW)
    np.testing.assert_allclose(rays.d, np.tile([0, 0.6, 0.8], (len(rays), 1)), atol=1e-5)
    assert np.isinf(rays.tmax).all()


def test_ambient_occlusion_has_a_radius(cornell):
    diagonal = cornell.triangles.diagonal
    for how, radius in [
        ({}, 0.1 * diagonal),
        ({"radius_share": 0.3}, 0.3 * diagonal),
        ({"radius": 0.05}, 0.05),
    ]:
        rays = mibvh.make_rays(cornell, "ao", **how, **FEW)
        np.testing.assert_allclose(rays.tmax, radius, rtol=1e-6)
        assert rays.meta["radius"] == pytest.approx(radius)
    diffuse = mibvh.make_rays(cornell, "diffuse", **FEW)
    np.testing.assert_array_equal(rays.d, diffuse.d)


def test_kinds_survive_files_and_are_traced_as_what_they_are(cornell, tmp_path):
    rays = mibvh.make_rays(cornell, "ao", **FEW)
    rays.save(tmp_path / "ao.npz")
    again = mibvh.read_rays(tmp_path / "ao.npz")
    assert (again.kind, again.occlusion, again.digest) == ("ao", True, rays.digest)
    tree = mibvh.build(cornell, "sbvh")
    told, any_hit, closest = (
        mibvh.trace(tree, cornell, again, any_hit=how, repeats=1) for how in (None, True, False)
    )
    np.testing.assert_array_equal(told.inner, any_hit.inner)
    assert told.inner.sum() < closest.inner.sum()


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("glossy", "no kind of rays 'glossy'; there are: primary, diffuse, shadow, ao"),
        ("primary2", "no kind of rays 'primary2'"),
        ("bounce0", "no kind of rays 'bounce0'"),
        ("", "no kind of rays ''"),
    ],
)
def test_unknown_kinds(kind, said, cornell):
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.make_rays(cornell, kind, **FEW)


def test_impossible_radii_and_vertices_that_no_path_reaches(cornell):
    with pytest.raises(mibvh.MibvhError, match="radius_share must be above 0 and finite"):
        mibvh.make_rays(cornell, "ao", radius_share=0, **FEW)
    floor = mibvh.Triangles([[[-1, 0, -1], [1, 0, -1], [0, 0, 1]]])
    with pytest.raises(mibvh.MibvhError, match="there are no diffuse rays that leave vertex 2"):
        mibvh.make_rays(floor, "bounce2", **FEW)


def test_every_kind_leaves_its_surface(cornell):
    """No kind's rays hit what they leave, by Mitsuba and by mibvh."""
    tree = mibvh.build(cornell, "bbvh")
    for name in KINDS:
        rays = mibvh.make_rays(cornell, name, **FEW)
        assert rays.meta["self_hits"] == 0
        hits = mibvh.trace(tree, cornell, rays, any_hit=False, repeats=1)
        assert not ((hits.triangle == rays.source) & (rays.source >= 0)).any()


def test_mixtures_weigh_the_kinds(cornell):
    parts = [mibvh.make_rays(cornell, kind, **FEW) for kind in ("diffuse", "shadow")]
    mixture = mibvh.Mixture(parts)
    count = sum(map(len, parts))
    assert mixture.mean(len) == pytest.approx(sum(len(p) ** 2 for p in parts) / count)
    assert mibvh.Mixture(parts, (1, 3)).mean(lambda rays: rays.occlusion) == 0.75
    assert mibvh.Mixture(parts, (0, 2)).mean(lambda rays: rays.occlusion) == 1
    for weights, said in [
        ((1,), "2 ray sets and 1 weights"),
        ((1, -1), "weights must be finite"),
        ((0, 0), "not all 0"),
    ]:
        with pytest.raises(mibvh.MibvhError, match=said):
            mibvh.Mixture(parts, weights)
    with pytest.raises(mibvh.MibvhError, match="weights must be"):
        mibvh.Mixture([])


def leaves_of(tree, triangle):
    """Leaves that refer to a triangle, as often as they do."""
    return [
        n
        for n in np.flatnonzero(tree.is_leaf)
        for reference in tree.references[tree.first[n] :][: tree.count[n]]
        if reference == triangle
    ]


def brute_saved(tree, triangles, rays, hits):
    """Half of the foreign nodes that hold a hit ray's ends, and of its leaf's other triangles."""
    saved = 0.0
    cost = np.where(tree.is_leaf, 1.0 * tree.count, 1.2)
    for o, d, t, start, end in zip(rays.o, rays.d, hits.t, rays.source, hits.triangle, strict=True):
        if end < 0:
            continue
        at = o.astype(np.float64) + d.astype(np.float64) * t
        for point, triangle in ((o, start), (at, end)):
            near = mibvh.metrics.points.on_surface(
                triangles, np.array([point]), np.array([triangle])
            )[0]
            for n in range(len(tree.left)):
                own = triangle in tree.references[tree.first[n] :][: tree.count[n]]
                inside = (near >= tree.lower[n]).all() and (near <= tree.upper[n]).all()
                saved += 0.5 * cost[n] * (inside and not own)
        leaves = leaves_of(tree, end)
        saved += 0.5 * (np.mean(tree.count[leaves]) - 1)
    return saved / len(rays)


@pytest.mark.parametrize("builder", ["bbvh", "sbvh", "streelet"])
def test_what_is_saved_against_brute_force(builder):
    triangles = soup(150, 3, 0.3)
    rays = mibvh.make_rays(triangles, "ao", width=6, height=4, samples=1, radius_share=0.5)
    tree = mibvh.build(triangles, builder)
    hits = mibvh.trace(tree, triangles, rays, any_hit=False, repeats=1)
    found = saved_by_any_hit(tree, triangles, rays, hits)
    assert found == pytest.approx(brute_saved(tree, triangles, rays, hits), rel=1e-9)
    assert found > 0.5
    sizes = [tree.count[leaves_of(tree, t)].mean() for t in range(len(triangles))]
    np.testing.assert_allclose(leaf_sizes(tree, triangles), sizes)


def test_occluded_rays_do_not_pay_for_overlap():
    """In a closed room with thick layers of overlapping boxes, most of it is predicted.

    What closest hits touch costs two thirds more; of that, less than a fourth remains.
    """
    walls = closed_box(-2, 2, 6)
    inside = np.clip(soup(600, 1, 0.25).corners - [1.5, 0.5, 1.0], -1.9, 1.9)
    triangles = mibvh.Triangles(np.concatenate([walls, inside]).astype(np.float32))
    rays = mibvh.make_rays(triangles, "shadow", width=48, height=36, samples=1)
    tree = mibvh.build(triangles, "bbvh")
    closest = mibvh.trace(tree, triangles, rays, any_hit=False, repeats=1)
    assert (closest.triangle >= 0).mean() > 0.99
    ended = mibvh.trace(tree, triangles, rays, repeats=1)
    lines = mibvh.ray_lines(triangles, rays, closest)
    touched = mibvh.metrics.lines.line_costs(tree, lines, whole=False).mean()
    saved = saved_by_any_hit(tree, triangles, rays, closest)
    assert touched > 1.6 * ended.counted_cost()
    assert touched - saved == pytest.approx(ended.counted_cost(), rel=0.15)


def test_estimates():
    assert estimate_alpha_any_hit(0.5, 1.0) == 0
    assert estimate_alpha_any_hit(0.5, 0.0) == pytest.approx(1 / 1.5)
    np.testing.assert_allclose(any_hit_ray_cost([10, 20], [5, 6], 0.5, [1, 2]), [9, 14])


@pytest.mark.parametrize("kind", ["shadow", "ao"])
def test_leaves_are_counted_in_the_tree_at_hand(cornell, kind):
    """Ends and lines of occlusion rays are those of the closest hits in the first tree."""
    rays = mibvh.make_rays(cornell, kind, width=32, height=24, samples=1)
    counter = RayCounter(cornell, rays, cull=False)
    for builder in ("lbvh", "sbvh"):
        counts = counter(mibvh.build(cornell, builder))
        leaves = np.arange(len(counts.leaf_distribution)) @ counts.leaf_distribution
        assert leaves / len(rays) == pytest.approx(counts.values["leaves_per_ray"])
