"""The bundled scenes: every generator against its XML template, at small sizes."""

from __future__ import annotations

import functools
import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

_ROOT = Path(__file__).resolve().parent.parent
if str(_ROOT) not in sys.path:
    sys.path.insert(0, str(_ROOT))

import scenes  # noqa: E402
from mibvh.bundled import bundled_scene  # noqa: E402

_NAMES = list(scenes.CATALOGUE)


@functools.cache
def _small(name: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    return scenes.generate(name, 3000)


@pytest.mark.parametrize("name", _NAMES)
def test_small_version_is_sane_and_repeatable(name: str) -> None:
    parts = _small(name)
    again = scenes.generate(name, 3000)
    assert list(parts) == list(again)
    total = 0
    for part, (v, f) in parts.items():
        assert v.dtype == np.float32
        assert f.dtype == np.int32
        assert v.shape[1] == f.shape[1] == 3
        assert np.isfinite(v).all()
        assert len(f) > 0, part
        assert f.min() >= 0
        assert f.max() < len(v)
        assert v.tobytes() == again[part][0].tobytes()
        assert f.tobytes() == again[part][1].tobytes()
        total += len(f)
        a = v[f[:, 0]].astype(float)
        n = np.cross(v[f[:, 1]] - a, v[f[:, 2]] - a)
        assert (n != 0).any(axis=1).all(), "zero-area triangles"
    # Some scenes need more than 3000 triangles to be what they claim to be.
    assert 1000 < total < 9000


@pytest.mark.parametrize("name", _NAMES)
def test_template_names_exactly_the_parts(name: str) -> None:
    root = ET.parse(Path(scenes.__file__).parent / f"{name}.xml").getroot()
    files = [
        s.get("value", "")
        for shape in root.iter("shape")
        for s in shape.iter("string")
        if s.get("name") == "filename"
    ]
    assert sorted(files) == sorted(f"meshes/{p}.ply" for p in _small(name))
    assert len(list(root.iter("sensor"))) >= 4
    assert scenes.CATALOGUE[name].name == name


@pytest.mark.parametrize("name", _NAMES)
def test_size_knob_keeps_the_world(name: str) -> None:
    """A finer version fills the same box: cameras stay valid."""
    boxes = []
    for parts in (_small(name), scenes.generate(name, 40_000)):
        v = np.concatenate([v[np.unique(f)] for v, f in parts.values()])
        boxes.append(np.array([v.min(axis=0), v.max(axis=0)]))
    assert 0.7 * 40_000 < sum(len(f) for _, f in parts.values()) < 1.3 * 40_000
    diagonal = np.linalg.norm(boxes[1][1] - boxes[1][0])
    # A tenth: eleven strands of hair do not fill the ball as a hundred do.
    assert np.abs(boxes[0] - boxes[1]).max() < 0.1 * diagonal


@pytest.mark.parametrize("name", _NAMES)
def test_seed_changes_the_layout_or_nothing_breaks(name: str) -> None:
    other = scenes.generate(name, 3000, seed=1)
    assert list(other) == list(_small(name))
    assert all(np.isfinite(v).all() and len(f) for v, f in other.values())


def test_unknown_name_lists_the_choices() -> None:
    with pytest.raises(ValueError, match="cornell"):
        scenes.generate("no such scene")
    with pytest.raises(ValueError, match="hairball"):
        scenes.write("no such scene", Path("never made"))


def test_written_folder_is_complete(tmp_path: Path) -> None:
    xml = scenes.write("cornell", tmp_path / "c", 2500, seed=3)
    assert xml == tmp_path / "c" / "scene.xml"
    record = json.loads((tmp_path / "c" / "scene.json").read_text())
    parts = scenes.generate("cornell", 2500, seed=3)
    assert record["name"] == "cornell"
    assert record["seed"] == 3
    assert record["triangles"] == sum(len(f) for _, f in parts.values())
    assert not list(tmp_path.rglob("*.tmp"))
    import trimesh

    for part, (v, f) in parts.items():
        mesh = trimesh.load(tmp_path / "c" / "meshes" / f"{part}.ply", process=False)
        np.testing.assert_array_equal(np.asarray(mesh.vertices, dtype=np.float32), v)
        np.testing.assert_array_equal(mesh.faces, f)


@pytest.mark.parametrize("stale", ["generator", "template", "record"])
def test_a_cached_scene_of_another_version_is_generated_anew(tmp_path, monkeypatch, stale):
    monkeypatch.setenv("MIBVH_CACHE", str(tmp_path))
    xml = bundled_scene("cornell@1000")
    mesh, record = next((xml.parent / "meshes").iterdir()), xml.parent / "scene.json"
    fresh, template = mesh.read_bytes(), xml.read_bytes()
    mesh.write_bytes(b"kept")
    bundled_scene("cornell@1000")
    assert mesh.read_bytes() == b"kept"
    if stale == "generator":
        older = json.loads(record.read_text()) | {"generator_version": 0}
        record.write_text(json.dumps(older))
    elif stale == "template":
        xml.write_bytes(template + b"<!-- older -->")
    else:
        record.write_text("[]")
    bundled_scene("cornell@1000")
    assert mesh.read_bytes() == fresh
    assert xml.read_bytes() == template
