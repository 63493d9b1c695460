import subprocess
import sys

import numpy as np
import pytest
import trimesh
from conftest import closed_box

import mibvh
from mibvh import scene as scenes
from mibvh.variant import mitsuba

CAMERA = """<sensor type="perspective"><transform name="to_world">
<lookat origin="0, 0, -9" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/></film>
</sensor>"""


def xml(tmp_path, body, camera=CAMERA):
    path = tmp_path / "a_scene.xml"
    path.write_text(f'<scene version="3.0.0">{camera}{body}</scene>')
    return path


def test_instances_are_flattened_and_transformed(tmp_path):
    scene = mibvh.load(
        xml(
            tmp_path,
            """
        <shape type="shapegroup" id="g"><shape type="cube"/><shape type="rectangle"/></shape>
        <shape type="instance"><ref id="g"/></shape>
        <shape type="instance"><ref id="g"/><transform name="to_world">
          <scale value="2"/><translate x="10"/></transform></shape>
        <shape type="cube"><transform name="to_world"><translate y="-5"/></transform></shape>
        """,
        )
    )
    assert scene.name == "a_scene"
    assert len(scene.triangles) == 12 + 2 * (12 + 2)
    np.testing.assert_allclose(scene.triangles.bounds, [[-1, -6, -2], [12, 2, 2]], atol=1e-6)
    # Cubes of side 2 (area 24) and 4 (96), and 2 (4) and 4 (16) wide squares.
    assert scene.triangles.areas.sum() == pytest.approx(24 + 24 + 96 + 4 + 16, rel=1e-5)
    assert len(scene.sensors) == 1


def test_of_a_large_scene_mitsubas_copies_come_and_go(tmp_path, monkeypatch):
    """Its cameras, lights and hits stay the same."""
    body = (
        '<shape type="cube"/><shape type="rectangle"/>'
        '<emitter type="point"><point name="position" x="1" y="4" z="-8"/></emitter>'
    )
    path = xml(tmp_path, body)
    kept = mibvh.load(path)
    monkeypatch.setattr(scenes, "LARGE", 13)
    scene = mibvh.load(path)
    assert kept.original is not None
    assert scene.original is None
    assert scene.triangles.digest == kept.triangles.digest
    rays = []
    for _ in range(2):
        assert len(scene.renderable.emitters()) == 1
        assert scene.geometry is scene.geometry
        rays.append([mibvh.make_rays(scene, k, width=9, height=6) for k in ("diffuse", "shadow")])
        scene.release()
        assert not {"geometry", "renderable"} & set(vars(scene))
    expected = [mibvh.make_rays(kept, kind, width=9, height=6) for kind in ("diffuse", "shadow")]
    assert len(expected[1]) > 0
    for made in rays:
        assert [found.digest for found in made] == [found.digest for found in expected]


def test_analytic_shapes_are_tessellated_and_others_named(tmp_path):
    scene = mibvh.load(
        xml(
            tmp_path,
            """
        <shape type="sphere" id="ball"><float name="radius" value="2"/></shape>
        <shape type="disk" id="plate"><transform name="to_world"><translate z="5"/></transform>
        </shape>
        <shape type="cylinder" id="can"/>""",
        )
    )
    said = " ".join(scene.notes)
    for name in ("ball", "plate", "can"):
        assert f"'{name}' was tessellated" in said
    exact = 4 * np.pi * 4 + np.pi + 2 * np.pi
    assert scene.triangles.areas.sum() == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("kind", ["ply", "obj", "glb", "stl"])
def test_mesh_files(tmp_path, kind):
    mesh = trimesh.creation.icosphere(subdivisions=2)
    path = tmp_path / f"ball.{kind}"
    mesh.export(path)
    scene = mibvh.load(path)
    assert scene.name == "ball"
    assert len(scene.triangles) == len(mesh.faces)
    assert scene.triangles.areas.sum() == pytest.approx(mesh.area, rel=1e-4)
    # An object seen from around it: every viewpoint is outside.
    for sensor in scene.sensors:
        origin = np.array(sensor.world_transform().matrix, dtype=float).reshape(4, 4)[:3, 3]
        assert np.linalg.norm(origin) > 1.5


def test_viewpoints_of_an_interior_are_inside():
    scene = mibvh.load(closed_box(-1, 1))
    assert len(scene.sensors) == 4
    for sensor in scene.sensors:
        origin = np.array(sensor.world_transform().matrix, dtype=float).reshape(4, 4)[:3, 3]
        assert np.abs(origin).max() < 1


def test_prim_index_is_the_triangle_id(small_soup):
    scene = mibvh.load(small_soup)
    mi = mitsuba()
    center = small_soup.corners[17].mean(axis=0)
    a, b, c = small_soup.corners[17].astype(float)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    ray = mi.Ray3f(mi.Point3f(center - 1e-3 * normal), mi.Vector3f(normal))
    hit = scene.geometry.ray_intersect_preliminary(ray)
    assert hit.prim_index[0] == 17


def test_bad_input_gets_one_sentence(tmp_path):
    with pytest.raises(mibvh.MibvhError, match="no such file, and no bundled scene"):
        mibvh.load("nowhere.xml")
    with pytest.raises(mibvh.MibvhError, match="Mitsuba cannot load it"):
        mibvh.load(
            xml(tmp_path, '<shape type="ply"><string name="filename" value="no.ply"/></shape>')
        )
    with pytest.raises(mibvh.MibvhError, match="no triangle in it"):
        mibvh.load(xml(tmp_path, ""))
    broken = tmp_path / "broken.ply"
    broken.write_text("ply\nnonsense")
    with pytest.raises(
        mibvh.MibvhError, match=r"broken\.ply: cannot be read as PLY: its header does not end"
    ):
        mibvh.load(broken)
    other = tmp_path / "notes.txt"
    other.write_text("hello")
    with pytest.raises(mibvh.MibvhError, match="neither Mitsuba XML nor"):
        mibvh.load(other)


def test_a_format_that_wants_another_package_names_it(tmp_path, monkeypatch):
    from mibvh import loading

    file = tmp_path / "arm.dae"
    file.write_text("<COLLADA/>")
    monkeypatch.setattr(loading, "mesh_formats", lambda: frozenset(["obj"]))
    with pytest.raises(mibvh.MibvhError, match=r"arm.dae: \.dae files .* are installed: pycollada"):
        mibvh.load(file)


def test_masks_are_not_ignored_without_a_word(tmp_path):
    mask = '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse"/></bsdf>'
    body = f'<shape type="cube">{mask}</shape><shape type="rectangle"><bsdf type="null"/></shape>'
    (note,) = mibvh.load(xml(tmp_path, body)).notes
    assert note.startswith("2 shapes have a mask or null material, which is ignored")
    assert mibvh.load(xml(tmp_path, '<shape type="cube"/>')).notes == []


def test_a_scene_file_may_name_our_integrators(tmp_path):
    """In a fresh process, that has not imported the plugins."""
    scene = tmp_path / "s.xml"
    scene.write_text(
        '<scene version="3.0.0"><integrator type="bvh_path"/><shape type="cube"/></scene>'
    )
    code = f"import mibvh; print(len(mibvh.load({str(scene)!r}).triangles))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "12\n"
