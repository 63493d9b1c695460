"""glTF and GLB files, written here by the specification; right values by hand."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest

import mibvh

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
TWO = np.array([0, 1, 2, 0, 2, 3])
_TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class File:
    """A glTF document under way."""

    def __init__(self, **more):
        self.data = b""
        self.document = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], **more}

    def view(self, data):
        self.data += b"\0" * (-len(self.data) % 4)
        views = self.document["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(views) - 1

    def accessor(self, values, **more):
        values = np.asarray(values)
        values = values.astype(values.dtype.newbyteorder("<"))
        flat = values.transpose(0, 2, 1) if values.ndim == 3 else values
        entry = {
            "bufferView": self.view(flat.tobytes()),
            "count": len(values),
            "componentType": _TYPES[values.dtype.str[1:]],
            "type": _KINDS[values.shape[1:]],
            **more,
        }
        if values.shape[1:] == (3,):
            entry.setdefault("min", values.min(axis=0).tolist())
            entry.setdefault("max", values.max(axis=0).tolist())
        self.document["accessors"].append(entry)
        return len(self.document["accessors"]) - 1

    def square(self, index_type="u2", **more):
        """A mesh of the unit square."""
        primitive = {
            "attributes": {"POSITION": self.accessor(SQUARE)},
            "indices": self.accessor(TWO.astype(index_type)),
            **more,
        }
        self.document.setdefault("meshes", []).append({"primitives": [primitive]})
        return primitive

    def glb(self):
        self.document["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.document).encode()
        text += b" " * (-len(text) % 4)
        data = self.data + b"\0" * (-len(self.data) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text
        body += struct.pack("<II", len(data), 0x004E4942) + data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def one_scene(nodes, **more):
    return File(nodes=nodes, scenes=[{"nodes": [0]}], scene=0, **more)


@pytest.fixture
def load(tmp_path):
    def write_and_load(file):
        path = tmp_path / "a.glb"
        path.write_bytes(file if isinstance(file, bytes) else file.glb())
        return mibvh.load(path)

    return write_and_load


@pytest.fixture
def refusal(load):
    def fail(file):
        with pytest.raises(mibvh.MibvhError) as said:
            load(file)
        assert "a.glb: " in str(said.value)
        return str(said.value)

    return fail


def area(scene):
    return scene.triangles.areas.sum()


# ------------------------------------------------------------------ geometry


@pytest.mark.parametrize("index_type", ["u1", "u2", "u4"])
def test_indices_of_any_width(load, index_type):
    file = one_scene([{"mesh": 0}])
    file.square(index_type)
    scene = load(file)
    assert (len(scene.triangles), area(scene)) == (2, pytest.approx(1))


def test_without_indices_corners_follow_each_other(load):
    file = one_scene([{"mesh": 0}])
    file.square().pop("indices")
    file.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = file.accessor(
        SQUARE[TWO]
    )
    assert area(load(file)) == pytest.approx(1)


@pytest.mark.parametrize(
    ("mode", "indices", "triangles", "covered"),
    [
        (5, [0, 1, 3, 2], 2, 1.0),  # strip: (0 1 3) (1 3 2)
        (6, [0, 1, 2, 3], 2, 1.0),  # fan: (0 1 2) (0 2 3)
        (5, [0, 1, 3, 3, 1, 1, 2, 3], 2, 1.0),  # two strips tied by repeated corners
        (6, [0, 1, 2], 1, 0.5),
    ],
)
def test_strips_and_fans(load, mode, indices, triangles, covered):
    file = one_scene([{"mesh": 0}])
    file.square(mode=mode)["indices"] = file.accessor(np.array(indices, np.uint16))
    scene = load(file)
    assert (len(scene.triangles), area(scene)) == (triangles, pytest.approx(covered))


def test_lines_and_points_are_named(load):
    file = one_scene([{"mesh": 0}])
    first = file.square()
    file.document["meshes"][0]["primitives"] += [{**first, "mode": 1}, {**first, "mode": 0}]
    scene = load(file)
    assert area(scene) == pytest.approx(1)
    assert "1 primitives of lines" in scene.notes[0]
    assert "1 primitives of points" in scene.notes[1]


@pytest.mark.parametrize(
    ("kind", "largest", "normalized"), [("i2", 32767, True), ("u1", 255, True), ("i1", 100, False)]
)
def test_quantised_positions(load, kind, largest, normalized):
    """Normalised values are shares of the type's largest; the node scales them to 2."""
    scale = 2.0 if normalized else 2.0 / largest
    file = one_scene(
        [{"mesh": 0, "scale": [scale] * 3}], extensionsRequired=["KHR_mesh_quantization"]
    )
    primitive = file.square()
    values = np.pad((SQUARE * largest).astype(kind), ((0, 0), (0, 1)))  # rows of four: a stride
    view = file.view(values.tobytes())
    file.document["bufferViews"][view]["byteStride"] = 4 * values.itemsize
    file.document["accessors"].append(
        {
            "bufferView": view,
            "count": 4,
            "componentType": _TYPES[kind],
            "type": "VEC3",
            "normalized": normalized,
            "min": [0, 0, 0],
            "max": [largest, largest, 0],
        }
    )
    primitive["attributes"]["POSITION"] = len(file.document["accessors"]) - 1
    scene = load(file)
    np.testing.assert_allclose(scene.triangles.bounds, [[0, 0, 0], [2, 2, 0]], atol=1e-6)
    assert area(scene) == pytest.approx(4)


@pytest.mark.parametrize("base", [True, False])
def test_sparse_accessors(load, base):
    """Corner 2 moves from (1, 1) to (3, 3), or from the origin that nothing is."""
    file = one_scene([{"mesh": 0}])
    primitive = file.square()
    rows = [2] if base else [1, 2, 3]
    new = np.array([[3, 3, 0]] if base else [[1, 0, 0], [3, 3, 0], [0, 1, 0]], np.float32)
    sparse = {
        "count": len(rows),
        "indices": {"bufferView": file.view(bytes(rows)), "componentType": 5121},
        "values": {"bufferView": file.view(new.tobytes())},
    }
    entry = file.document["accessors"][primitive["attributes"]["POSITION"]]
    entry |= {"sparse": sparse, "min": [0, 0, 0], "max": [3, 3, 0]}
    if not base:
        del entry["bufferView"]
    # (0 0) (1 0) (3 3) and (0 0) (3 3) (0 1): 1.5 each.
    assert area(load(file)) == pytest.approx(3)


def test_draco(load):
    import DracoPy

    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), -1).reshape(-1, 2)
    points = np.c_[grid, np.zeros(81)].astype(np.float32)
    at = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.c_[at, at + 1, at + 10], np.c_[at, at + 10, at + 9]])
    encoded = DracoPy.encode(points, faces.astype(np.uint32), quantization_bits=14)
    name = "KHR_draco_mesh_compression"
    file = one_scene([{"mesh": 0, "translation": [0, 0, 5]}], extensionsRequired=[name])
    file.document["accessors"] = [
        {"componentType": 5126, "count": 81, "type": "VEC3", "min": [0, 0, 0], "max": [8, 8, 0]},
        {"componentType": 5123, "count": faces.size, "type": "SCALAR"},
    ]
    extension = {"bufferView": file.view(encoded), "attributes": {"POSITION": 0}}
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "extensions": {name: extension}}
    file.document["meshes"] = [{"primitives": [primitive]}]
    scene = load(file)
    assert len(scene.triangles) == 128
    assert area(scene) == pytest.approx(64, rel=1e-3)
    np.testing.assert_allclose(scene.triangles.bounds, [[0, 0, 5], [8, 8, 5]], atol=1e-3)


# ------------------------------------------------------------------ nodes


def test_matrices_and_parts_of_nodes_agree(load):
    """Turned by 90 degrees about z, scaled by (2, 3, 1), moved: x in 10 - 3 .. 10, y in 0 .. 2."""
    half = np.sqrt(0.5)
    parts = {"translation": [10, 0, 0], "rotation": [0, 0, half, half], "scale": [2, 3, 1]}
    # Columns: the images of x and y, z, and the origin.
    matrix = {"matrix": [0, 2, 0, 0, -3, 0, 0, 0, 0, 0, 1, 0, 10, 0, 0, 1]}
    for transform in (parts, matrix):
        file = one_scene([{"mesh": 0, **transform}])
        file.square()
        scene = load(file)
        np.testing.assert_allclose(scene.triangles.bounds, [[7, 0, 0], [10, 2, 0]], atol=1e-6)
        assert area(scene) == pytest.approx(6)


@pytest.mark.parametrize(
    ("node", "said"),
    [
        ({"matrix": None}, "a node's matrix is not 16 numbers: None"),
        ({"matrix": [1] * 15}, "a node's matrix is not 16 numbers"),
        ({"scale": [1, 2]}, r"a node's scale is not 3 numbers: \[1, 2\]"),
        ({"scale": ["1", "2", "3"]}, "a node's scale is not 3 numbers"),
        ({"translation": [[1, 2, 3]]}, "a node's translation is not 3 numbers"),
        ({"rotation": {"x": 1}}, "a node's rotation is not 4 numbers"),
        (None, "number 0 of its nodes is no object"),
    ],
)
def test_transforms_that_are_none(load, node, said):
    for scenes in ({"scenes": [{"nodes": [0]}]}, {}):  # the default scene; all root nodes
        file = File(nodes=[node and {"mesh": 0, **node}], **scenes)
        file.square()
        with pytest.raises(mibvh.MibvhError, match=f"read as GLB: {said}"):
            load(file)


def test_hidden_nodes_are_left_out_with_those_below_them(load):
    """Squares at x = 0, 2, 4, 6; the second is hidden, and the third below it."""
    name = "KHR_node_visibility"
    extra = {True: {"extensions": {name: {"visible": True}}}}
    extra[False] = {"extensions": {name: {"visible": False}}}
    nodes = [
        {"children": [1, 2, 4]},
        {"mesh": 0, **extra[True]},
        {"mesh": 0, "translation": [2, 0, 0], "children": [3], **extra[False]},
        {"mesh": 0, "translation": [2, 0, 0], **extra[True]},
        {"mesh": 0, "translation": [6, 0, 0]},
    ]
    file = one_scene(nodes, extensionsRequired=[name])
    file.square()
    scene = load(file)
    assert area(scene) == pytest.approx(2)
    np.testing.assert_array_equal(np.unique(scene.triangles.lower[:, 0]), [0, 6])
    assert scene.notes == [f"2 meshes that {name} hides were left out"]


def test_transforms_of_parents_and_negative_scales(load):
    """The child is mirrored to x in -1 .. 0, the parent moves it by 10 and doubles it first."""
    nodes = [
        {"children": [1], "translation": [10, 0, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "scale": [-1, 1, 1]},
    ]
    file = one_scene(nodes)
    file.square()
    np.testing.assert_allclose(load(file).triangles.bounds, [[8, 0, 0], [10, 2, 0]], atol=1e-6)


def test_a_mesh_that_several_nodes_share(load):
    file = one_scene([{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}])
    file.square()
    scene = load(file)
    assert (len(scene.triangles), area(scene)) == (4, pytest.approx(2))
    assert scene.triangles.bounds[1, 0] == 6


def test_instances_on_the_gpu(load):
    """Three squares, scaled by 1, 2 and 3, of a node that doubles: areas 4, 16 and 36."""
    name = "EXT_mesh_gpu_instancing"
    file = one_scene([{"mesh": 0, "scale": [2, 2, 2]}], extensionsRequired=[name])
    file.square()
    moves = np.array([[0, 0, 0], [10, 0, 0], [20, 0, 0]], np.float32)
    scales = np.array([[1, 1, 1], [2, 2, 2], [3, 3, 3]], np.float32)
    attributes = {"TRANSLATION": file.accessor(moves), "SCALE": file.accessor(scales)}
    file.document["nodes"][0]["extensions"] = {name: {"attributes": attributes}}
    scene = load(file)
    assert area(scene) == pytest.approx(4 + 16 + 36)
    np.testing.assert_allclose(scene.triangles.bounds, [[0, 0, 0], [46, 6, 0]])


def test_which_scene(load):
    """Nodes 0 and 1 are roots, a square each; node 2 is a child of 1, scaled by 2: 4."""
    nodes = [{"mesh": 0}, {"mesh": 0, "children": [2]}, {"mesh": 0, "scale": [2, 2, 2]}]
    for more, covered, note in [
        ({}, 6, ""),
        ({"scenes": [{"nodes": [0]}]}, 1, ""),
        ({"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}, 5, "its default, number 1"),
        ({"scenes": [{"nodes": [0]}, {"nodes": [1]}]}, 6, "all its root nodes"),
    ]:
        file = File(nodes=nodes, **more)
        file.square()
        scene = load(file)
        assert area(scene) == pytest.approx(covered)
        assert note in " ".join(scene.notes)


def test_morph_targets_at_rest(load):
    """Corners 1 and 2 move by 2 in x at weight 1; a half of it makes the square 2 wide."""
    file = one_scene([{"mesh": 0}])
    primitive = file.square()
    shift = np.array([[0, 0, 0], [2, 0, 0], [2, 0, 0], [0, 0, 0]], np.float32)
    primitive["targets"] = [{"POSITION": file.accessor(shift)}]
    assert area(load(file)) == pytest.approx(1)  # no weights: none
    file.document["meshes"][0]["weights"] = [0.5]
    scene = load(file)
    assert area(scene) == pytest.approx(2)
    assert "morph targets were applied" in scene.notes[0]
    file.document["nodes"][0]["weights"] = [1.0]
    assert area(load(file)) == pytest.approx(3)


def test_skins_at_rest(load):
    """Left corners hang on joint 1 at x = 10, right ones on joint 2 at x = 20: 11 wide.

    The inverse bind matrices are none; the node's own transform does not count.
    """
    nodes = [
        {"children": [1, 2, 3]},
        {"translation": [10, 0, 0]},
        {"translation": [20, 0, 0]},
        {"mesh": 0, "skin": 0, "scale": [100, 100, 100]},
    ]
    file = one_scene(nodes, skins=[{"joints": [1, 2]}])
    primitive = file.square()
    which = np.array([[0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]], np.uint8)
    share = np.array([[1, 0, 0, 0]] * 4, np.float32)
    primitive["attributes"] |= {"JOINTS_0": file.accessor(which), "WEIGHTS_0": file.accessor(share)}
    scene = load(file)
    np.testing.assert_allclose(scene.triangles.bounds, [[10, 0, 0], [21, 1, 0]])
    assert "skins were applied" in scene.notes[0]
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[:, 0, 3] = -10  # moved back by 10 before the joints
    file.document["skins"][0]["inverseBindMatrices"] = file.accessor(bind)
    np.testing.assert_allclose(load(file).triangles.bounds, [[0, 0, 0], [11, 1, 0]])


# ------------------------------------------------------------------ buffers


def test_text_with_its_buffer_in_a_data_uri_or_a_file(tmp_path):
    file = one_scene([{"mesh": 0}])
    file.square()
    uri = "data:application/octet-stream;base64," + base64.b64encode(file.data).decode()
    (tmp_path / "the data.bin").write_bytes(file.data)
    for name in (uri, "the%20data.bin", "the data.bin"):
        file.document["buffers"] = [{"byteLength": len(file.data), "uri": name}]
        (tmp_path / "a.gltf").write_text(json.dumps(file.document))
        assert area(mibvh.load(tmp_path / "a.gltf")) == pytest.approx(1)
    for name, said in [
        ("no.bin", "its buffer 'no.bin' is missing"),
        ("https://example.org/a.bin", "a buffer is elsewhere"),
        ("data:;base64,####", "a data URI is damaged"),
        ("data:;base64,AAAA", "declares 60 bytes but has 3: cut short"),
    ]:
        file.document["buffers"] = [{"byteLength": len(file.data), "uri": name}]
        (tmp_path / "a.gltf").write_text(json.dumps(file.document))
        with pytest.raises(mibvh.MibvhError, match=r"a\.gltf: ") as found:
            mibvh.load(tmp_path / "a.gltf")
        assert said in str(found.value)


# ------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    "name", ["EXT_meshopt_compression", "KHR_meshopt_compression", "VENDOR_curves", "MSFT_lod"]
)
def test_extensions_that_are_required_and_not_read(refusal, name):
    file = one_scene([{"mesh": 0}], extensionsRequired=[name])
    file.square()
    assert f"requires the extension {name}, which is not read" in refusal(file)


def test_extensions_that_leave_the_surface_alone(load):
    names = ["KHR_materials_unlit", "KHR_texture_transform", "KHR_lights_punctual"]
    file = one_scene([{"mesh": 0}], extensionsRequired=names)
    file.square()
    assert area(load(file)) == pytest.approx(1)


def test_compressed_buffers_without_a_plain_form(refusal):
    """Used but not required, with a buffer that is only a place holder."""
    file = one_scene([{"mesh": 0}], extensionsUsed=["EXT_meshopt_compression"])
    file.square()
    content = json.loads(json.dumps(file.document))
    for view in content["bufferViews"]:
        view["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
        view["buffer"] = 1
    file.document = content
    original = file.glb

    def with_fallback():
        glb = original()
        content["buffers"].append({"byteLength": 60})
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        rest = glb[20 + struct.unpack_from("<I", glb, 12)[0] :]
        body = struct.pack("<II", len(text), 0x4E4F534A) + text + rest
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    assert "EXT_meshopt_compression is not read; unpack it first" in refusal(with_fallback())


def _broken(change):
    file = one_scene([{"mesh": 0}])
    file.square()
    change(file.document)
    return file


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["accessors"][0].update(max=[2, 1, 0]), "but it declares"),
        (lambda d: d["accessors"][0].update(min=[0, 0]), "bounds have another shape"),
        (lambda d: d["accessors"][0].update(count=5), "longer than its bufferView"),
        (lambda d: d["accessors"][0].update(count=1 << 40), "more than the file has bytes"),
        (lambda d: d["accessors"][0].update(count=-1), "more than the file has bytes"),
        (lambda d: d["accessors"][0].update(count=3), "names vertex 3, but there are 3"),
        (lambda d: d["accessors"][0].update(count=2), "but it declares"),
        (lambda d: d["accessors"][0].update(type="VEC2"), "is of VEC2, not VEC3"),
        (lambda d: d["accessors"][0].update(componentType=9), "type VEC3 of 9"),
        (lambda d: d["accessors"][0].pop("bufferView"), "has no values"),
        (lambda d: d["accessors"][1].update(count=5), "5 indices do not make triangles"),
        (lambda d: d["accessors"][1].update(componentType=5126), "holds no indices"),
        (lambda d: d["bufferViews"][0].update(byteLength=1000), "longer than its buffer"),
        (lambda d: d["bufferViews"][0].update(buffer=3), "buffer 3 is named, but there are 1"),
        (lambda d: d["bufferViews"][0].update(byteStride=1), "longer than its bufferView"),
        (lambda d: d["nodes"][0].update(mesh=7), "meshes 7 is named, but there are 1"),
        (lambda d: d["nodes"][0].update(children=[0]), "in its tree of nodes twice"),
        (lambda d: d["nodes"][0].update(rotation=[0, 0, 0, 0]), "is no rotation"),
        (lambda d: d["nodes"][0].pop("mesh"), "there is no triangle in it"),
        (lambda d: d.update(scene=4), "scenes 4 is named"),
        (lambda d: d["asset"].update(version="1.0"), "glTF 1.0 is not read"),
        (lambda d: d.update(nodes=3), "damaged"),
        (lambda d: d["meshes"][0]["primitives"][0]["attributes"].clear(), "has no positions"),
        (lambda d: d["nodes"][0].update(scale=[0, 0, 0]), "triangles all have no area"),
        (lambda d: d["nodes"][0].update(scale=[1e30, 1, 1]), "overlarge"),
    ],
)
def test_damaged_documents(refusal, change, said):
    assert said in refusal(_broken(change))


def test_an_index_beyond_the_vertices(refusal):
    file = one_scene([{"mesh": 0}])
    file.square()["indices"] = file.accessor(np.array([0, 1, 65535], np.uint16))
    assert "names vertex 65535, but there are 4 vertices" in refusal(file)


def test_files_that_are_cut_short(refusal):
    file = one_scene([{"mesh": 0}])
    file.square()
    whole = file.glb()
    for length in (10, 19, 40, len(whole) - 40, len(whole) - 1):
        assert "cut short" in refusal(whole[:length])
    assert "GLB of version 1" in refusal(whole[:4] + b"\1\0\0\0" + whole[8:])
    assert "its JSON is damaged" in refusal(whole.replace(b'"asset"', b'\xff"asse"', 1))


def test_primitives_that_would_fill_the_memory(refusal, monkeypatch):
    """Two triangles that fifty primitives share, where memory is for 99 of a hundred."""
    file = one_scene([{"mesh": 0}])
    file.document["meshes"] = [{"primitives": [file.square()] * 50}]
    monkeypatch.setattr("mibvh.memory.available_memory", lambda: 99 * 180)
    assert "100 triangles need about" in refusal(file)


def test_instances_that_would_fill_the_memory(refusal, monkeypatch):
    """Two triangles that five hundred nodes share, where memory is for 999 of a thousand."""
    file = File(nodes=[{"mesh": 0}] * 500, scenes=[{"nodes": list(range(500))}], scene=0)
    file.square()
    monkeypatch.setattr("mibvh.memory.available_memory", lambda: 999 * 180)
    assert "1,000 triangles need about 0.0 GB of memory" in refusal(file)
