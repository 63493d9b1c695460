import dataclasses

import numpy as np
import pytest
from conftest import closed_box

import mibvh
from mibvh.variant import mitsuba

FEW = {"width": 16, "height": 12, "samples": 1}


@pytest.fixture(scope="module")
def rays(cornell):
    return mibvh.diffuse_rays(cornell, width=32, height=24, samples=2, bounces=2)


def test_counts_and_order(rays, cornell):
    per_view = 32 * 24 * 2
    assert rays.meta["primary_rays"] == per_view * len(cornell.sensors)
    first = rays.bounce == 1
    assert first.sum() == rays.meta["primary_hits"]
    assert 0 < (rays.bounce == 2).sum() < first.sum()
    assert set(rays.viewpoint) == set(range(len(cornell.sensors)))
    assert (np.diff(rays.bounce) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(rays.d, axis=1), 1, atol=1e-5)
    assert np.isinf(rays.tmax).all()


def test_same_seed_same_rays(cornell, rays):
    again = mibvh.diffuse_rays(cornell, width=32, height=24, samples=2, bounces=2)
    other = mibvh.diffuse_rays(cornell, width=32, height=24, samples=2, bounces=2, seed=1)
    assert again.digest == rays.digest != other.digest


def test_rays_leave_surfaces_with_cosine_distribution():
    """Inside a closed box: every origin lies on a wall, and cos(theta) has mean 2/3."""
    scene = mibvh.load(closed_box(-1, 1))
    rays = mibvh.diffuse_rays(scene, width=64, height=48, samples=2)
    assert rays.meta["primary_hits"] == rays.meta["primary_rays"]  # from inside, nothing is missed
    wall = np.abs(rays.o).argmax(axis=1)
    at = np.take_along_axis(rays.o, wall[:, None], 1)[:, 0]
    np.testing.assert_allclose(np.abs(at), 1, atol=2e-4)
    cosine = -np.sign(at) * np.take_along_axis(rays.d, wall[:, None], 1)[:, 0]
    assert cosine.min() > 0
    # cos has mean 2/3 and variance 1/18 under the cosine distribution.
    error = np.sqrt(1 / 18 / len(cosine))
    assert abs(cosine.mean() - 2 / 3) < 5 * error
    assert abs((cosine**2).mean() - 1 / 2) < 5 * np.sqrt((1 / 3 - 1 / 4) / len(cosine))


def test_round_trip_and_damage(rays, tmp_path):
    path = tmp_path / "r.npz"
    rays.save(path)
    again = mibvh.RaySet.load(path)
    assert again.digest == rays.digest
    assert again.meta == rays.meta
    whole = path.read_bytes()
    at = whole.index(rays.d.tobytes())
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(mibvh.MibvhError, match="damaged"):
        mibvh.RaySet.load(path)


def test_cameras_whose_rays_are_no_numbers(cornell):
    """One that stands nowhere, and those of cubes below what Mitsuba takes."""
    mi = mitsuba()
    nowhere = mi.ScalarTransform4f(np.diag([np.nan, 1, 1, 1]))
    camera = mi.load_dict({"type": "perspective", "to_world": nowhere})
    cube = mibvh.load({"type": "scene", "cube": {"type": "cube"}}).triangles.corners
    for scene in (
        dataclasses.replace(cornell, sensors=[cornell.sensors[0], camera]),
        mibvh.load(cube * np.float32(1e-20)),
    ):
        with pytest.raises(
            mibvh.MibvhError, match=r"viewpoint [01] makes rays that are no numbers"
        ):
            mibvh.diffuse_rays(scene, **FEW)
    with pytest.raises(mibvh.MibvhError, match=r"no numbers|any geometry.*scale it up"):
        mibvh.diffuse_rays(mibvh.load(cube * np.float32(1e-16)), **FEW)
    assert len(mibvh.diffuse_rays(mibvh.load(cube * np.float32(1e-12)), **FEW)) > 0


def test_viewpoints_that_see_nothing_and_paths_that_end(cornell):
    """One camera looks away; a convex scene has no second bounce."""
    sensor = cornell.sensors[0]
    away = _looking_away(cornell)
    both = mibvh.diffuse_rays(dataclasses.replace(cornell, sensors=[away, sensor]), **FEW)
    assert set(both.viewpoint) == {1}
    with pytest.raises(mibvh.MibvhError, match="no viewpoint sees any geometry"):
        mibvh.diffuse_rays(dataclasses.replace(cornell, sensors=[away]), **FEW)
    far = {"type": "perspective", "to_world": _looking_at_origin(3e5)}
    large = {"type": "scene", "camera": far, "ball": {"type": "sphere", "radius": 1e5}}
    with pytest.raises(mibvh.MibvhError, match=r"far_clip: by default, from 0\.01 to 10,000"):
        mibvh.diffuse_rays(mibvh.load(large), **FEW)
    large["camera"] = {**far, "far_clip": 1e6}
    assert len(mibvh.diffuse_rays(mibvh.load(large), **FEW)) > 0
    import trimesh

    ball = trimesh.creation.icosphere(2)
    rays = mibvh.diffuse_rays(mibvh.Triangles(ball.triangles.astype(np.float32)), bounces=3, **FEW)
    assert set(rays.bounce) == {1}


def _looking_at_origin(distance):
    import mitsuba as mi

    return mi.ScalarTransform4f().look_at(origin=[0, 0, distance], target=[0, 0, 0], up=[0, 1, 0])


def _looking_away(scene):
    import mitsuba as mi

    lower, upper = (np.asarray(b, np.float64) for b in scene.triangles.bounds)
    origin = upper + (upper - lower)
    turned = mi.ScalarTransform4f().look_at(
        origin=origin.tolist(), target=(2 * origin - lower).tolist(), up=[0, 1, 0]
    )
    return mi.load_dict({"type": "perspective", "to_world": turned})


def test_impossible_requests(cornell):
    with pytest.raises(mibvh.MibvhError, match="viewpoints, fewer"):
        mibvh.diffuse_rays(cornell, viewpoints=99)
    with pytest.raises(mibvh.MibvhError, match="width must be"):
        mibvh.diffuse_rays(cornell, width=0)
    for views in (-1, 0):
        with pytest.raises(mibvh.MibvhError, match=f"viewpoints must be a .*, not {views}"):
            mibvh.diffuse_rays(cornell, viewpoints=views)
