"""Variants: choosing one, and a GPU's without OptiX, acted out with LLVM."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from typer.testing import CliRunner

import mibvh
from mibvh import scene as scenes
from mibvh import variant
from mibvh.audit import run as audit_run
from mibvh.cli import app
from mibvh.studies.measure.stopwatch import Timings


@pytest.fixture
def no_optix(monkeypatch):
    """Mitsuba traces no ray: whoever asks it for a scene of the triangles fails."""

    def refuse(triangles):
        raise AssertionError("Mitsuba is asked to trace rays")

    for module in (scenes, audit_run):
        monkeypatch.setattr(module, "mitsuba_traces", lambda: False)
    monkeypatch.setattr(scenes, "mitsuba_geometry", refuse)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("cuda_ad", "no variant 'cuda_ad'"),
        ("cuda_ad_rgb", "an NVIDIA driver is needed"),
        ("scalar_rgb", "mibvh traces rays with Dr.Jit"),
    ],
)
def test_a_variant_that_cannot_be_used_leaves_the_one_that_is(monkeypatch, name, said):
    monkeypatch.setattr(dr, "has_backend", lambda backend: backend == dr.JitBackend.LLVM)
    variant._prepare.cache_clear()
    before = variant.mitsuba().variant()
    with pytest.raises(mibvh.MibvhError, match=said):
        variant.use_variant(name)
    assert mi.variant() == before


def test_study_refuses_a_variant_in_one_sentence(tmp_path):
    found = CliRunner().invoke(app, ["study", "cornell", "-o", str(tmp_path), "--variant", "gpu"])
    assert isinstance(found.exception, mibvh.MibvhError)
    assert "this Mitsuba has no variant 'gpu'; it has: " in str(found.exception)
    assert not any(tmp_path.iterdir())


def test_lanes_are_those_of_the_variant_in_use():
    assert variant._lane_width("cuda_ad_rgb") == 32
    assert variant.lane_width() in (4, 8, 16)


@pytest.mark.parametrize("name", ["cornell@2000", "livingroom@3000"])
def test_without_optix_a_scene_has_the_same_triangles_and_no_viewpoint(no_optix, name):
    found = mibvh.load(name)
    assert mi.variant().startswith("llvm")
    with pytest.MonkeyPatch.context() as undone:
        undone.setattr(scenes, "mitsuba_traces", lambda: True)
        whole = mibvh.load(name)
    assert found.triangles.digest == whole.triangles.digest
    assert found.sensors == []
    assert found.notes == [*whole.notes, scenes.NO_OPTIX]
    with pytest.raises(mibvh.MibvhError, match="no rays can be made"):
        mibvh.diffuse_rays(found)


def test_without_optix_given_rays_are_studied(request, tmp_path, cornell):
    rays = mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)
    request.getfixturevalue("no_optix")
    alone = mibvh.load(cornell.triangles)
    found = mibvh.study(
        [alone], tmp_path, rays=rays, builders=("bbvh", "sbvh"), scalar_rays=256, seconds=0.0
    )
    assert found.failures == []
    assert scenes.NO_OPTIX in found.scenes[0].notes
    for row in found.scenes[0].trees:
        names = {check.name for check in row.audit}
        assert {"hits", "lanes", "counts"} <= names
        assert "mitsuba" not in names


def test_where_no_processor_runs_the_kernel_its_own_clock_decides():
    seconds = np.random.default_rng(0).uniform(1, 2, (9, 3))
    timings = Timings({"kernel": seconds, "process": np.full((9, 3), np.nan)})
    assert timings.clock == "kernel"
    assert np.isfinite(timings.relative_error).all()
    assert np.isnan(timings.estimate_by("process")).all()
