"""Mitsuba's scenes: the triangles are what Mitsuba itself traces, ray by ray."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
import pytest

import mibvh
from mibvh.scene import mesh_corners
from mibvh.variant import mitsuba

SHEAR = '<matrix value="1 .5 0 0  0 1 .3 0  0 0 1 0  0 0 0 1"/>'
UNEVEN = '<scale x="1" y="2" z="3"/>'
TURNED = '<rotate x=".6" z=".8" angle="50"/><scale value="1.7"/><translate x="1" y="2" z="-1"/>'
MIRRORED = '<scale x="-2" y="2" z="2"/><translate z="1"/>'


def write(tmp_path, body, name="a.xml"):
    path = tmp_path / name
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


def world(transform):
    return f'<transform name="to_world">{transform}</transform>'


def instance(group, transform):
    return f'<shape type="instance"><ref id="{group}"/>{world(transform)}</shape>'


def distances(path, count=20_000):
    """Distances along the same rays: Mitsuba's own scene, and ours."""
    mi = mitsuba()
    ours = mibvh.load(path)
    scene = mi.load_file(str(path))  # kept until the hits are there: they are found late
    box = scene.bbox()
    lower = np.minimum(ours.triangles.bounds[0], np.array(box.min)).astype(float)
    upper = np.maximum(ours.triangles.bounds[1], np.array(box.max)).astype(float)
    center, reach = (lower + upper) / 2, max(float(np.linalg.norm(upper - lower)), 1.0)
    rng = np.random.default_rng(0)
    o = rng.normal(size=(count, 3))
    o = center + 1.5 * reach * o / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(lower, upper, (count, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T))
    theirs = np.array(scene.ray_intersect_preliminary(ray).t)
    return theirs, np.array(ours.geometry.ray_intersect_preliminary(ray).t), reach


def same_as_mitsuba(path, within=1e-4, edges=0.002):
    """Hits and misses agree but at edges, and distances to a share of the scene's size."""
    theirs, ours, reach = distances(path)
    hit = np.isfinite(theirs)
    assert hit.mean() > 0.05
    assert (hit != np.isfinite(ours)).mean() <= edges
    both = hit & np.isfinite(ours)
    apart = np.abs(theirs[both] - ours[both]) > within * reach
    assert apart.mean() <= edges


# ------------------------------------------------------------------ shapes


@pytest.mark.parametrize("kind", ["sphere", "disk", "cylinder"])
@pytest.mark.parametrize("transform", [TURNED, UNEVEN, SHEAR, MIRRORED, UNEVEN + TURNED])
def test_analytic_shapes_are_where_mitsuba_has_them(tmp_path, kind, transform):
    """48 segments are within 1 - cos(pi / 48) = 0.2% of the radius; grazing rays differ."""
    path = write(tmp_path, f'<shape type="{kind}">{world(transform)}</shape>')
    same_as_mitsuba(path, within=0.01, edges=0.03)


@pytest.mark.parametrize("kind", ["cube", "rectangle"])
@pytest.mark.parametrize("transform", [TURNED, UNEVEN, SHEAR, MIRRORED])
def test_meshes_under_any_transform(tmp_path, kind, transform):
    same_as_mitsuba(write(tmp_path, f'<shape type="{kind}">{world(transform)}</shape>'))


def test_a_sphere_stays_one_under_an_uneven_scale(tmp_path):
    """The radius is the first of Mitsuba's scales: 1, not an ellipsoid of 2."""
    scene = mibvh.load(
        write(tmp_path, '<shape type="sphere">' + world('<scale y="2"/>') + "</shape>")
    )
    np.testing.assert_allclose(scene.triangles.bounds, [[-1, -1, -1], [1, 1, 1]], atol=0.003)
    assert "stays a sphere under its uneven transform" in scene.notes[0]


def test_axes_that_are_no_unit_vectors(tmp_path):
    """Mitsuba's matrix and its inverse then differ; disks are traced by both."""
    turn = world('<rotate x="1" y="2" z="3" angle="50"/>')
    same_as_mitsuba(write(tmp_path, f'<shape type="cube">{turn}</shape>'))
    group = '<shape type="shapegroup" id="g"><shape type="cube"/></shape>'
    placed = f'<shape type="instance"><ref id="g"/>{turn}</shape>'
    same_as_mitsuba(write(tmp_path, group + placed))
    for kind in ("disk", "cylinder"):
        with pytest.raises(mibvh.MibvhError, match=f"(?i){kind} 'a': its transform and Mitsuba's"):
            mibvh.load(write(tmp_path, f'<shape type="{kind}" id="a">{turn}</shape>'))


def test_flipped_normals_change_no_triangle(tmp_path):
    flip = '<boolean name="flip_normals" value="true"/>'
    same_as_mitsuba(write(tmp_path, f'<shape type="cube">{flip}</shape>'))
    same_as_mitsuba(write(tmp_path, f'<shape type="sphere">{flip}</shape>'), 0.01, 0.03)


def test_meshes_of_a_serialized_file_by_their_index(tmp_path):
    """Two meshes: a triangle of area 0.5, and one of area 2 at z = 3."""

    def mesh(scale, z):
        body = struct.pack("<I", 0x1000) + b"m\0" + struct.pack("<QQ", 3, 1)  # single precision
        body += np.array([[0, 0, z], [scale, 0, z], [0, scale, z]], "<f4").tobytes()
        return struct.pack("<HH", 0x041C, 4) + zlib.compress(body + struct.pack("<III", 0, 1, 2))

    first, second = mesh(1, 0), mesh(2, 3)
    data = first + second + struct.pack("<QQI", 0, len(first), 2)
    (tmp_path / "two.serialized").write_bytes(data)
    for index, area, z in ((0, 0.5, 0), (1, 2, 3)):
        scene = mibvh.load(
            write(
                tmp_path,
                '<shape type="serialized"><string name="filename" value="two.serialized"/>'
                f'<integer name="shape_index" value="{index}"/></shape>',
            )
        )
        assert scene.triangles.areas.tolist() == [area]
        assert scene.triangles.bounds[:, 2].tolist() == [z, z]


@pytest.mark.parametrize("version", [3, 4])
def test_indices_that_mitsuba_does_not_look_at(tmp_path, version):
    """It would write beside its arrays. A square whose second triangle names vertex 77 of 4."""
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    head = "ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    rows = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 77\n"
    (tmp_path / "text.ply").write_text(head.format("ascii") + rows)
    faces = struct.pack("<B3iB3i", 3, 0, 1, 2, 3, 0, 2, 77)
    data = head.format("binary_little_endian").encode() + np.array(corners, "<f4").tobytes() + faces
    (tmp_path / "binary.ply").write_bytes(data)
    name, kind = (b"m\0", "<QI") if version == 4 else (b"", "<II")
    for flags, real, beside in ((0x1000, "<f4", 0), (0x200B, "<f8", 8)):  # all values, in double
        body = struct.pack("<I", flags) + name + struct.pack("<QQ", 4, 2)
        body += np.array(corners, real).tobytes() + np.zeros((4, beside), real).tobytes()
        body += struct.pack("<6I", 0, 1, 2, 0, 2, 77)
        data = struct.pack("<HH", 0x041C, version) + zlib.compress(body) + struct.pack(kind, 0, 1)
        (tmp_path / f"{real[1:]}.serialized").write_bytes(data)
    for file in ("text.ply", "binary.ply", "f4.serialized", "f8.serialized"):
        kind = file.partition(".")[2]
        shape = f'<shape type="{kind}"><string name="filename" value="{file}"/></shape>'
        with pytest.raises(
            mibvh.MibvhError, match=f"{file}: a face names vertex 77, but there are 4"
        ):
            mibvh.load(write(tmp_path, shape))


def test_a_mesh_in_memory_whose_indices_are_wrong():
    mi = mitsuba()
    mesh = mi.Mesh("bent", vertex_count=3, face_count=1)
    params = mi.traverse(mesh)
    params["vertex_positions"] = [0, 0, 0, 1, 0, 0, 0, 1, 0]
    params["faces"] = [0, 1, 2]
    params.update()
    assert mesh_corners(mesh).shape == (1, 3, 3)
    params["faces"] = [0, 1, 9]
    with pytest.raises(mibvh.MibvhError, match="vertex 9, but there are 3"):
        mesh_corners(mesh)


def test_what_is_made_of_no_triangles_is_named(tmp_path):
    (tmp_path / "hair.txt").write_text("0 0 0 .1\n1 0 0 .1\n2 1 0 .1\n3 1 0 .1\n")
    file = '<string name="filename" value="hair.txt"/>'
    for kind, name in (("linearcurve", "LinearCurve"), ("bsplinecurve", "BSpline")):
        body = f'<shape type="cube"/><shape type="{kind}" id="hair">{file}</shape>'
        scene = mibvh.load(write(tmp_path, body))
        assert len(scene.triangles) == 12
        assert scene.notes == [f"{name} 'hair' is not made of triangles and was left out"]
        with pytest.raises(mibvh.MibvhError, match=f"no triangle in it \\({name} 'hair'"):
            mibvh.load(write(tmp_path, body.removeprefix('<shape type="cube"/>')))
    mi = mitsuba()
    grid = mi.TensorXf(np.linspace(-1, 1, 8), (2, 2, 2, 1))
    scene = mibvh.load(
        {"type": "scene", "c": {"type": "cube"}, "s": {"type": "sdfgrid", "grid": grid}}
    )
    assert "SDFgrid 's' is not made of triangles" in scene.notes[0]
    parts = {"centers": np.zeros((1, 3)), "scales": np.ones((1, 3)), "quaternions": [[0, 0, 0, 1]]}
    parts = {name: mi.TensorXf(np.array(values)) for name, values in parts.items()}
    balls = {"type": "ellipsoids", **parts}
    scene = mibvh.load({"type": "scene", "c": {"type": "cube"}, "balls": balls})
    assert "Ellipsoids 'balls' is not made of triangles" in scene.notes[0]


@pytest.mark.parametrize("kind", ["heightfield", "hair", "nurbs"])
def test_shapes_that_mitsuba_does_not_have(tmp_path, kind):
    with pytest.raises(mibvh.MibvhError, match=f'a.xml: Mitsuba cannot load it .*"{kind}"'):
        mibvh.load(write(tmp_path, f'<shape type="{kind}"/>'))


def test_a_scene_without_area_is_refused(tmp_path):
    flat = '<shape type="rectangle">' + world('<scale x="0" y="1"/>') + "</shape>"
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: "):
        mibvh.load(write(tmp_path, flat))
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    line = '<shape type="obj"><string name="filename" value="line.obj"/></shape>'
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: its 1 triangles all have no area"):
        mibvh.load(write(tmp_path, line))


# ------------------------------------------------------------------ instances

GROUP = '<shape type="shapegroup" id="g">{}</shape>'
CUBE = '<shape type="cube"/>'
RADUIS = '<float name="raduis" value="3"/>'


@pytest.mark.parametrize(
    "body",
    [
        # members with transforms of their own
        GROUP.format(f'<shape type="cube">{world(TURNED)}</shape><shape type="rectangle"/>')
        + instance("g", SHEAR + '<translate x="9"/>')
        + instance("g", MIRRORED),
        # the group's transform, which Mitsuba does not take
        GROUP.format(world('<translate x="50"/>') + '<shape type="cube"/>')
        + instance("g", '<translate x="4"/>'),
        # shapes that are merged in the group
        GROUP.format(
            '<shape type="merge"><shape type="cube"/><shape type="rectangle">'
            + world('<translate z="3"/>')
            + "</shape></shape>"
        )
        + instance("g", '<translate x="5"/>')
        + instance("g", UNEVEN),
        # one instance twice, a group that nobody names, and the same cube outside
        GROUP.format('<shape type="cube"/>')
        + '<shape type="cube"/>'
        + instance("g", '<translate y="8"/>') * 2
        + '<shape type="shapegroup" id="unused"><shape type="cube"/></shape>',
        # two groups of equal members
        GROUP.format('<shape type="cube"/>')
        + '<shape type="shapegroup" id="h"><shape type="cube"/></shape>'
        + instance("g", '<translate y="8"/>')
        + instance("h", '<translate y="-8"/>'),
        # an instance without a transform
        GROUP.format('<shape type="cube"/>') + '<shape type="instance"><ref id="g"/></shape>',
    ],
)
def test_instances_are_where_mitsuba_has_them(tmp_path, body):
    same_as_mitsuba(write(tmp_path, body))


RECTANGLE = '<shape type="rectangle" id="r"/>'
REF = '<ref id="r"/>'
MERGED = '<shape type="merge">{}</shape>'
GLASS = '<shape type="cube"><bsdf type="dielectric"/></shape>'  # what no merge joins
OTHER = '<shape type="shapegroup" id="h">{}</shape>'
AT_7, AT_MINUS_7 = instance("g", '<translate x="7"/>'), instance("h", '<translate x="-7"/>')


@pytest.mark.parametrize(
    ("body", "count"),
    [
        (RECTANGLE + GROUP.format(REF) + AT_7, 2 + 2),
        (GROUP.format(RECTANGLE) + REF + AT_7, 2 + 2),
        (GROUP.format(RECTANGLE) + OTHER.format(REF + CUBE) + AT_7 + AT_MINUS_7, 2 + 2 + 12),
        (
            GROUP.format(MERGED.format(RECTANGLE)) + OTHER.format(MERGED.format(REF))
            + AT_7 + AT_MINUS_7,
            2 + 2,
        ),
        (GROUP.format(RECTANGLE) + MERGED.format(REF + GLASS) + AT_7, 2 + 12 + 2),
        (GROUP.format(RECTANGLE + REF) + AT_7, 4),
        (GROUP.format(RECTANGLE) + MERGED.format(CUBE + AT_7), 12 + 2),
        (GROUP.format(RECTANGLE) + MERGED.format(AT_7), 2),
    ],
)  # fmt: skip
def test_a_shape_that_stands_in_several_places(tmp_path, body, count):
    """In the scene, groups and merges: each is a place of its own, in memory as in a file."""
    path = write(tmp_path, body)
    triangles = mibvh.load(path).triangles
    assert len(triangles) == count
    theirs = mitsuba().load_file(str(path))
    box = theirs.bbox()
    np.testing.assert_array_equal(triangles.bounds, [np.array(box.min), np.array(box.max)])
    same_as_mitsuba(path)
    np.testing.assert_array_equal(mibvh.load(theirs).triangles.corners, triangles.corners)


def test_groups_that_are_objects_already():
    """Loaded alone they take the names that their instances have for them."""
    mi = mitsuba()
    cube, flat = (
        mi.load_dict({"type": "shapegroup", "shape": {"type": kind}})
        for kind in ("cube", "rectangle")
    )
    place = mi.ScalarTransform4f().translate([9, 0, 0])
    scene = {
        "type": "scene",
        "cube": cube,
        "flat": flat,
        "one": {"type": "instance", "a": cube},
        "two": {"type": "instance", "b": flat, "to_world": place},
    }
    triangles = mibvh.load(scene).triangles
    assert triangles.areas.sum() == pytest.approx(24 + 4)
    np.testing.assert_array_equal(triangles.bounds, [[-1, -1, -1], [10, 1, 1]])
    scene["two"] = {"type": "instance", "a": flat, "to_world": place}
    for source in (scene, mi.load_dict(scene)):
        with pytest.raises(mibvh.MibvhError, match="cannot be told: 2 groups have its name"):
            mibvh.load(source)


def test_spheres_in_groups(tmp_path):
    body = GROUP.format('<shape type="sphere"/>') + instance(
        "g", '<translate x="4"/><scale value="2"/>'
    )
    same_as_mitsuba(write(tmp_path, body), 0.01, 0.03)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (
            GROUP.format('<shape type="cube"/>')
            + '<shape type="shapegroup" id="h"><shape type="instance"><ref id="g"/></shape></shape>'
            + instance("h", ""),
            "Nested instancing is not permitted",
        ),
        ('<shape type="cube"><animation name="to_world"/></shape>', "<animation>"),
        ('<shape type="instance"><ref id="nobody"/></shape>', "nobody"),
        ('<shape type="instance"/><shape type="cube"/>', "A reference to a 'shapegroup' must be"),
        (
            '<shape type="cube" id="c"/>' + instance("c", ""),
            "Only a shapegroup can be specified in an instance",
        ),
        (
            '<shape type="instance"><shape type="shapegroup"><shape type="cube"/></shape></shape>',
            "find key",  # a group has to stand in the scene
        ),
        (f'<shape type="sphere">{RADUIS}</shape>', 'float "raduis": 3'),
        (GROUP.format(f'<shape type="sphere">{RADUIS}</shape>') + instance("g", ""), "raduis"),
        (
            GROUP.format('<shape type="cube"/>')
            + f'<shape type="instance"><ref id="g"/>{RADUIS}</shape>',
            "raduis",
        ),
        (
            '<shape type="cube"><string name="filename" value="a.xml"/></shape>',
            'string "filename": "a.xml"',
        ),
        ('<string name="a" value="b"/><shape type="cube"/>', 'string "a": "b"'),
        ('<include filename="no.xml"/>', "no.xml"),
        ('<shape type="cube">', "a.xml"),
    ],
)
def test_what_mitsuba_refuses_is_one_sentence(tmp_path, body, said):
    with pytest.raises(mibvh.MibvhError) as found:
        mibvh.load(write(tmp_path, body))
    text = str(found.value)
    assert text.startswith(f"{tmp_path / 'a.xml'}: Mitsuba cannot load it (")
    assert said in text
    assert "\n" not in text


def test_a_chain_of_includes_is_said_once(tmp_path):
    path = write(tmp_path, '<include filename="a.xml"/>')
    with pytest.raises(mibvh.MibvhError) as found:
        mibvh.load(path)
    assert "Exceeded maximum include recursion depth" in str(found.value)
    assert "while processing" not in str(found.value)
    write(tmp_path, '<include filename="no.xml"/>', "b.xml")
    with pytest.raises(mibvh.MibvhError, match=r'a\.xml: .*b\.xml \(line .*"no\.xml" not found'):
        mibvh.load(write(tmp_path, '<include filename="b.xml"/>'))


def test_files_of_a_scene_are_those_beside_it(tmp_path, monkeypatch):
    """The working folder may hold others of the same names, whose geometry would be studied."""
    (tmp_path / "scene").mkdir()
    corners = np.eye(3, dtype=np.float32)[None]
    for folder, height in ((tmp_path / "scene", 0.0), (tmp_path, 7.0)):
        faces = (f"v {x} {y} {z + height}\n" for x, y, z in corners[0])
        (folder / "mesh.obj").write_text("".join(faces) + "f 1 2 3\n")
    path = write(
        tmp_path / "scene",
        '<shape type="obj"><string name="filename" value="mesh.obj"/></shape>',
    )
    monkeypatch.chdir(tmp_path)
    for name in (path, path.relative_to(tmp_path)):
        assert np.array_equal(mibvh.load(name).triangles.corners, corners)


def test_a_shape_of_no_numbers_is_named(tmp_path):
    ends = '<point name="p0" value="1, 2, 3"/><point name="p1" value="1, 2, 3"/>'
    body = CUBE + f'<shape type="cylinder" id="pin">{ends}</shape>'
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: Cylinder 'pin': 96 of 96 triangles have"):
        mibvh.load(write(tmp_path, body))


def test_instances_are_counted_before_they_are_made(tmp_path, monkeypatch):
    monkeypatch.setattr("mibvh.memory.available_memory", lambda: 35 * 72)
    body = GROUP.format('<shape type="cube"/>') + instance("g", "") * 3
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: its 36 triangles need about"):
        mibvh.load(write(tmp_path, body))


# ------------------------------------------------------------------ beside the geometry


@pytest.mark.parametrize("kind", ["stokes", "no_such_integrator"])
def test_an_integrator_that_does_not_fit_is_left_out(tmp_path, kind):
    body = f'<integrator type="{kind}"/><shape type="cube"/><sensor type="perspective"/>'
    scene = mibvh.load(write(tmp_path, body))
    assert len(scene.triangles) == 12
    assert len(scene.sensors) == 1
    assert scene.notes == [
        f"its integrator '{kind}' does not fit the variant {mitsuba().variant()} and was left out"
    ]


METER = """<shape type="rectangle"><transform name="to_world"><translate z="5"/></transform>
<sensor type="irradiancemeter"><film type="hdrfilm"/></sensor></shape>
<shape type="cube"><transform name="to_world"><translate z="9"/></transform></shape>"""


def test_sensors_that_make_no_rays_are_left_out(tmp_path, monkeypatch):
    """An irradiance meter makes rays, if others than a camera's."""
    scene = mibvh.load(write(tmp_path, METER))
    assert (len(scene.sensors), scene.notes) == (1, [])
    assert len(mibvh.diffuse_rays(scene, width=8, height=8, samples=1)) > 0

    def none(*_):
        raise mibvh.MibvhError("no rays")

    monkeypatch.setattr("mibvh.scene.camera_rays", none)
    scene = mibvh.load(write(tmp_path, METER))
    assert "IrradianceMeter makes no rays from the points of an image" in scene.notes[0]
    assert len(scene.sensors) == 4  # chosen


def test_pipes_and_lying_headers_in_a_scene(tmp_path):
    os.mkfifo(tmp_path / "pipe.obj")
    shape = '<shape type="{}"><string name="filename" value="{}"/></shape>'
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: .*pipe\.obj: is no regular file"):
        mibvh.load(write(tmp_path, shape.format("obj", "pipe.obj")))
    (tmp_path / "lies.ply").write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
        "property float y\nproperty float z\nend_header\n"
    )
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: .*lies\.ply: it declares 4,000,000,000"):
        mibvh.load(write(tmp_path, shape.format("ply", "lies.ply")))


def test_bytes_that_are_not_utf8(tmp_path):
    (tmp_path / "a.xml").write_bytes(b'<scene version="3.0.0"><shape type="caf\xe9"/></scene>')
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: Mitsuba cannot load it \(.+\)"):
        mibvh.load(tmp_path / "a.xml")
    (tmp_path / "a.xml").write_bytes(
        b'<scene version="3.0.0"><shape type="cube" id="caf\xe9"/></scene>'
    )
    with pytest.raises(mibvh.MibvhError, match=r"a\.xml: the id of a shape, .+ is not UTF-8"):
        mibvh.load(tmp_path / "a.xml")
    path = os.fsdecode(os.fsencode(tmp_path) + b"/\xe9.xml")
    with open(path, "w") as file:
        file.write('<scene version="3.0.0"><shape type="cube"/></scene>')
    with pytest.raises(mibvh.MibvhError, match=r"\\xe9\.xml: Mitsuba opens no file whose name"):
        mibvh.load(path)


# ------------------------------------------------------------------ names

SIZED = (
    '<default name="n" value="2"/><shape type="cube">' + world('<scale value="$n"/>') + "</shape>"
)


def test_parameters_are_part_of_the_name(tmp_path):
    path = write(tmp_path, SIZED)
    for scene, name, half in [
        (mibvh.load(path), "a", 2),
        (mibvh.load(path, {"n": 3}), "a[n=3]", 3),
        (mibvh.load(f"{path}[n=5]"), "a[n=5]", 5),
    ]:
        assert scene.name == scene.triangles.name == name
        assert scene.triangles.bounds[1].tolist() == [half] * 3


@pytest.mark.parametrize(
    ("source", "defines", "said"),
    [
        ("{}[m=3]", None, "Mitsuba cannot load it"),
        ("{}[n]", None, "in the brackets, write name=value"),
        ("{}", {"n": "much"}, "Mitsuba cannot load it"),
        ("{}[n=2].obj", None, "no such file"),
    ],
)
def test_parameters_that_are_wrong(tmp_path, source, defines, said):
    path = write(tmp_path, SIZED)
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.load(source.format(path), defines)


def test_parameters_are_for_xml(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(mibvh.MibvhError, match=r"a\.obj: -D sets parameters of Mitsuba XML"):
        mibvh.load(tmp_path / "a.obj", {"n": 3})
    with pytest.raises(mibvh.MibvhError, match="for Mitsuba XML files"):
        mibvh.load(np.zeros((1, 3, 3)), {"n": 3})


def test_a_file_that_is_named_like_parameters_is_itself(tmp_path):
    assert mibvh.load(write(tmp_path, SIZED, "b.xml[n=7].xml")).triangles.bounds[1, 0] == 2


@pytest.mark.parametrize("source", [3, None, [1, 2], object()])
def test_what_is_no_scene(source):
    with pytest.raises(mibvh.MibvhError, match="a scene is a file"):
        mibvh.load(source)
