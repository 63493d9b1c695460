"""Geometry and brute-force helpers that the tests share."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

import mibvh
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.scene import RayFacts, SceneRecord, TreeRow


@pytest.fixture(scope="session", autouse=True)
def _private_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Generated scenes go to a folder of the test run, not to the user's cache."""
    os.environ["MIBVH_CACHE"] = str(tmp_path_factory.mktemp("cache"))


#: Files of slow tests beside those of studies, and what else makes a test slow: whole studies, and
#: the mark ``slow`` on tests that take seconds among others that do not. All others are fast.
SLOW_FILES = {
    "test_cli",
    "test_cluster",
    "test_cluster_faults",
    "test_docs",
    "test_embree",
    "test_experiments",
    "test_faults",
    "test_fuzz_meshes",
    "test_fuzz",
    "test_hostile_study",
    "test_notebooks",
    "test_parallel",
    "test_plugins",
    "test_registries",
    "test_report_browser",
    "test_scenes_bundled",
    "test_traversal_styles",
    "test_traversal_warp",
    "test_traversal_wide_warp",
    "test_wide_audit",
}
SLOW_FIXTURES = {"small_study"}


@pytest.hookimpl(tryfirst=True)  # before those that are not asked for are left out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests as fast or slow; leave ``cuda`` out where there is no device to run them on."""
    for item in items:
        name = item.path.stem
        slow = name in SLOW_FILES or name.startswith("test_study")
        slow = slow or bool(SLOW_FIXTURES & set(getattr(item, "fixturenames", ())))
        if item.get_closest_marker("slow") is None:
            item.add_marker("slow" if slow else "fast")
    marked = [item for item in items if item.get_closest_marker("cuda")]
    if not marked:
        return
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.CUDA):
        config.hook.pytest_deselected(items=marked)
        items[:] = [item for item in items if item not in marked]


@pytest.fixture(scope="session", autouse=True)
def _short_launches() -> Iterator[None]:
    """The stopwatch takes launches of any length: no test asks how well times are known."""
    from mibvh.studies.measure import times

    saved, times.SHORTEST = times.SHORTEST, 1e-4
    yield
    times.SHORTEST = saved


@pytest.fixture(autouse=True)
def _builders_of_a_test() -> Iterator[None]:
    """Builders that a test registers are gone after it."""
    from mibvh.builders import registry

    saved = set(registry._registered)
    yield
    for name in set(registry._registered) - saved - set({**registry._BUNDLED, **registry._LATER}):
        del registry._registered[name]


def soup(count: int, seed: int = 0, size: float = 0.1) -> mibvh.Triangles:
    """Random triangles in a box: anisotropic, of mixed size, overlapping."""
    rng = np.random.default_rng(seed)
    scale = size * rng.lognormal(0, 0.7, (count, 1, 1))
    corners = rng.random((count, 1, 3)) * [3, 1, 2] + rng.normal(size=(count, 3, 3)) * scale
    return mibvh.Triangles(corners.astype(np.float32), f"soup{count}")


def closed_box(lower: float = 0.0, upper: float = 1.0, cells: int = 4) -> np.ndarray:
    """(N, 3, 3) float32: the closed surface of a cube, each face a grid of triangles."""
    s = np.linspace(lower, upper, cells + 1)
    u, v = (g.ravel() for g in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    quads = np.stack(
        [
            np.stack([s[u], s[v]], 1),
            np.stack([s[u + 1], s[v]], 1),
            np.stack([s[u + 1], s[v + 1]], 1),
            np.stack([s[u], s[v + 1]], 1),
        ],
        1,
    )
    flat = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    faces = []
    for axis in range(3):
        for level in (lower, upper):
            face = np.insert(flat, axis, level, axis=2)
            faces.append(face)
    return np.concatenate(faces).astype(np.float32)


def clipped(points, low, high):
    """Clip a polygon to a box in float64: keep what each half-space leaves."""
    for axis in range(3):
        for sign, bound in ((1.0, low[axis]), (-1.0, -high[axis])):
            out = []
            for p, q in zip(points, points[1:] + points[:1], strict=True):
                a, b = sign * p[axis] - bound, sign * q[axis] - bound
                if a >= 0:
                    out.append(p)
                if a * b < 0:
                    out.append(p + (q - p) * (a / (a - b)))
            points = out
    return np.array(points).reshape(-1, 3)


def tree_row(builder: str = "bbvh", **values: float) -> TreeRow:
    """Return a tree of a study of which only some quantities are known."""
    return TreeRow(
        builder=builder,
        options={"max_leaf": 8},
        values=values,
        sah_by_depth=[],
        epo_by_depth=[],
        cost_groups=[],
        costs_by_origin=[],
        leaf_distribution=[],
        build_report={},
    )


def scene_record(trees: list[TreeRow], name: str = "one", triangles: int = 100) -> SceneRecord:
    """Return a scene of a study of which only the trees are known."""
    return SceneRecord(
        scene=name,
        triangles=triangles,
        digest="",
        notes=[],
        rays=RayFacts(9, "", 1, 0, {}),
        timing={},
        trees=trees,
        options=StudyOptions(),
        environment={},
        picture="",
        seconds={},
        reused={},
        code="",
    )


@pytest.fixture(scope="session")
def small_soup() -> mibvh.Triangles:
    return soup(60)


@pytest.fixture(scope="session")
def cornell() -> mibvh.Scene:
    return mibvh.load("cornell@3000")


@pytest.fixture(scope="session")
def small_study(tmp_path_factory: pytest.TempPathFactory, cornell: mibvh.Scene) -> mibvh.Study:
    """Return a finished study of two scenes; tests only read it."""
    return mibvh.study(
        [cornell, "hairball@3000"],
        tmp_path_factory.mktemp("study"),
        builders=("bbvh", "lbvh", "hill", "treelet"),
        width=24,
        height=16,
        scalar_rays=256,
        seconds=0.0,
    )
