"""Rays do not hit the triangle that they leave, and begin no farther from it than they must."""

from fractions import Fraction

import numpy as np
import pytest
from conftest import soup

import mibvh
from mibvh.rays import origins, paths
from mibvh.rays.origins import clear_origins
from mibvh.variant import mitsuba

FEW = {"width": 48, "height": 36, "samples": 2}


def boxes(offset, scale=1.0):
    """40 unit boxes in a cube of 20, as float64 before they are moved."""
    rng = np.random.default_rng(1)
    place = np.round(rng.uniform(-10, 10, (40, 1, 1, 3)), 4)
    corner = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.float64)
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    faces = [[q[0], *pair] for q in quads for pair in (q[1:3], q[2:4])]
    corners = (place + corner[faces]).reshape(-1, 3, 3) * scale + offset
    return mibvh.Triangles(corners.astype(np.float32), "boxes")


def self_hits(triangles, rays):
    """Shares of rays that hit what they leave: by mibvh's kernel, Mitsuba's, and in float64."""
    mi = mitsuba()
    ours = mibvh.trace(mibvh.build(triangles, "sbvh"), triangles, rays, repeats=1)
    hit = mibvh.load(triangles).geometry.ray_intersect_preliminary(
        mi.Ray3f(mi.Point3f(rays.o.T), mi.Vector3f(rays.d.T)), coherent=False
    )
    theirs = np.array(hit.is_valid()) & (np.array(hit.prim_index) == rays.source)
    a, b, c = np.moveaxis(triangles.corners[rays.source].astype(np.float64), 1, 0)
    normal = np.cross(b - a, c - a)
    above = np.einsum("ij,ij->i", normal, rays.o - a)
    away = np.einsum("ij,ij->i", normal, rays.d.astype(np.float64))
    return [(ours.triangle == rays.source).mean(), theirs.mean(), (above * away <= 0).mean()]


@pytest.mark.parametrize("offset", [0, 1000, 3500, 10000, 100000])
def test_no_self_hits_and_the_same_cost_at_any_offset(offset):
    triangles = boxes(offset)
    rays = mibvh.diffuse_rays(triangles, bounces=2, **FEW)
    assert rays.meta["self_hits"] == 0
    assert self_hits(triangles, rays) == [0, 0, 0]
    first = rays.select(rays.bounce == 1)
    hits = mibvh.trace(mibvh.build(triangles, "bbvh"), triangles, first, repeats=1)
    assert hits.counted_cost() == pytest.approx(7.2, rel=0.02)


def test_scenes_that_float32_cannot_hold_are_refused():
    with pytest.raises(mibvh.MibvhError, match=r"steps of 0.0625 .* move it towards the origin"):
        mibvh.diffuse_rays(boxes(1e6), **FEW)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_tiny_and_huge_scenes(scale):
    triangles = boxes(0, scale)
    assert self_hits(triangles, mibvh.diffuse_rays(triangles, **FEW)) == [0, 0, 0]


def test_a_camera_ten_thousand_diagonals_away():
    mi = mitsuba()
    triangles = boxes(0)
    scene = mibvh.load(triangles)
    at = mi.ScalarTransform4f().look_at([2e5, 1e5, 2e5], [0, 0, 0], [0, 1, 0])
    scene.sensors = [
        mi.load_dict({"type": "perspective", "fov": 0.005, "far_clip": 1e6, "to_world": at})
    ]
    rays = mibvh.diffuse_rays(scene, **FEW)
    assert len(rays) > 300
    assert self_hits(triangles, rays) == [0, 0, 0]


def test_slivers_and_mixed_sizes_turned():
    """Needles a thousand times longer than wide, in a soup of sizes, turned and moved."""
    rng = np.random.default_rng(5)
    needles = soup(400, 3).corners.astype(np.float64)
    needles[:, 2] = needles[:, 1] + 1e-3 * rng.normal(size=(400, 3)) * 0.1
    corners = np.concatenate([needles, soup(400, 4).corners]) + [20, -10, 40]
    triangles = mibvh.Triangles(corners.astype(np.float32), "needles")
    rays = mibvh.diffuse_rays(triangles, bounces=2, **FEW)
    assert rays.meta["self_hits"] == 0
    assert self_hits(triangles, rays) == [0, 0, 0]


def test_turned_rays_are_put_clear_again():
    triangles = mibvh.Triangles(soup(300, 8, 0.3).corners + np.float32([200, -30, 90]))
    rays = mibvh.diffuse_rays(triangles, **FEW)
    turn = mibvh.rotation_about((1, 1, 1), 45)
    turned = triangles.rotated(turn)
    assert max(self_hits(turned, rays.rotated(turn))) > 0.01
    again = rays.rotated(turn, turned)
    assert self_hits(turned, again) == [0, 0, 0]
    assert again.meta["digest"] == turned.digest
    moved = np.linalg.norm(again.o - rays.o.astype(np.float64) @ turn.T, axis=1)
    assert moved.max() < 8 * np.spacing(np.float32(400))


def exact_distance(triangle, origin):
    """Squared distance from the plane, exact; its sign is that of the side."""
    a, b, c, o = ([Fraction(float(x)) for x in p] for p in (*triangle, origin))
    e, f, g = ([p[k] - a[k] for k in range(3)] for p in (b, c, o))
    n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]]
    along = sum(x * y for x, y in zip(n, g, strict=True))
    return float(along * abs(along) / sum(x * x for x in n))


def test_origins_are_on_the_side_left_to_and_near():
    """In exact arithmetic; near: a few steps of float32 of the triangle and of the place."""
    triangles = mibvh.Triangles(soup(300, 8, 0.3).corners + np.float32([3, -7, 11]))
    rng = np.random.default_rng(0)
    ids = np.repeat(np.arange(300, dtype=np.int32), 2)
    d = rng.normal(size=(600, 3)).astype(np.float32)
    points = mibvh.metrics.points.points_on(triangles, ids)
    o = clear_origins(triangles, ids, points, d)
    for i in range(600):
        a, b, c = triangles.corners[ids[i]].astype(np.float64)
        side = np.sign(np.cross(b - a, c - a) @ d[i].astype(np.float64))
        squared = exact_distance(triangles.corners[ids[i]], o[i]) * side
        edges = np.abs([b - a, c - b, a - c])
        sliver = edges.max() ** 3 / np.linalg.norm(np.cross(b - a, c - a))
        most = 2.0**-24 * (2 * np.abs(o[i]).sum() + 40 * edges.max() + 24 * sliver)
        assert (2.0**-25 * edges.max()) ** 2 < squared < most**2


def test_thin_double_sheets_are_not_jumped_through():
    """A sheet lies 1e-4 above another, turned; rays that leave the lower one upwards hit it."""
    turn = mibvh.rotation_about((3, 1, 2), 40)
    sheet = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    pair = np.concatenate([sheet, sheet + [0, 0, 1e-4]]) @ turn.T + [30, 40, 50]
    triangles = mibvh.Triangles(pair.astype(np.float32))
    rng = np.random.default_rng(2)
    inside = rng.uniform(0.1, 0.8, (2000, 2)) * [1, 0.5]
    points = np.column_stack([inside[:, 0] + 0.1, inside[:, 1], np.zeros(2000)]) @ turn.T
    up = np.tile((turn @ [0, 0, 1]).astype(np.float32), (2000, 1))
    ids = np.zeros(2000, np.int32)
    o = clear_origins(triangles, ids, points + [30, 40, 50], up)
    hits = mibvh.trace(mibvh.build(triangles, "bbvh"), triangles, mibvh.RaySet(o, up), repeats=1)
    assert (hits.triangle >= 2).all()


def test_self_hits_are_counted_and_refused(monkeypatch):
    """With origins put on the wrong side, all rays hit what they leave."""
    triangles = boxes(0)

    def wrong(a, b, c, point, towards):
        origin, normal = origins.clear_origin(a, b, c, point, -towards)
        return origin, -normal

    monkeypatch.setattr(paths, "clear_origin", wrong)
    with pytest.raises(mibvh.MibvhError, match="diffuse rays hit the triangle that they leave"):
        mibvh.diffuse_rays(triangles, **FEW)


def test_an_irradiance_meter_is_a_viewpoint(tmp_path):
    path = tmp_path / "irrad.xml"
    path.write_text(
        '<scene version="3.0.0"><shape type="cube"><transform name="to_world">'
        '<translate y="4"/></transform></shape><shape type="rectangle"><transform name="to_world">'
        '<rotate x="1" angle="-90"/></transform><sensor type="irradiancemeter">'
        '<film type="hdrfilm">'
        '<integer name="width" value="1"/><integer name="height" value="1"/>'
        '<rfilter type="box"/></film></sensor></shape></scene>'
    )
    rays = mibvh.diffuse_rays(path, **FEW)
    assert set(rays.source) <= set(range(14))
    assert rays.o[:, 1].min() > 2.9  # on the cube above the meter
