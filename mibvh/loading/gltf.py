"""glTF 2.0: nodes, meshes and instances (Khronos, *glTF 2.0 Specification*).

Accessors are read in :mod:`mibvh.loading.accessors`. A file that requires an extension which is
not known to leave the surface as it is, is refused by the extension's name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mibvh.loading.accessors import Accessors, entry_of
from mibvh.loading.container import open_document
from mibvh.loading.mesh import I64, Mesh, Refused, check_memory, corners_of
from mibvh.triangles import F64

DRACO, INSTANCING = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing"
VISIBILITY = "KHR_node_visibility"
#: Extensions that are read, and kinds of them that say nothing of the surface.
_READ = {"KHR_mesh_quantization", DRACO, INSTANCING, VISIBILITY}
_NO_SURFACE = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "EXT_lights_",
    "KHR_xmp",
    "KHR_animation_",
    "KHR_audio",
    "MSFT_texture_",
)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def read(data: bytes, path: Path) -> Mesh:
    """Read the default scene of a glTF or GLB file, or all root nodes where it names none.

    Transforms, instances, morph weights and skins are applied as the file sets them at rest.

    Raises
    ------
    Refused
        If it needs what is not read, or holds other data than it declares.
    """
    document, buffers = open_document(data, path)
    for name in document.get("extensionsRequired", []):
        if name not in _READ and not name.startswith(_NO_SURFACE):
            raise Refused(f"it requires the extension {name}, which is not read")
    return _Reader(document, Accessors(document, buffers)).mesh()


@dataclasses.dataclass
class _Reader:
    """A document on the way to triangles."""

    document: dict[str, Any]
    accessors: Accessors
    notes: list[str] = dataclasses.field(default_factory=list)
    left_out: dict[str, int] = dataclasses.field(default_factory=dict)
    meshes: dict[int, list[F64]] = dataclasses.field(default_factory=dict)
    globals: dict[int, F64] = dataclasses.field(default_factory=dict)

    def mesh(self) -> Mesh:
        """All triangles of the scene."""
        placed: list[tuple[F64, list[F64]]] = []
        total = 0
        for index, matrices in self._placed_nodes():
            for corners in self._node_triangles(index):
                placed.append((corners, matrices))
                total += len(corners) * len(matrices)
            check_memory(total)
        parts = [_moved(corners, matrix) for corners, matrices in placed for matrix in matrices]
        for what, count in self.left_out.items():
            self.notes.append(f"{count:,} primitives of {what} were left out: they have no area")
        return Mesh(np.concatenate(parts) if parts else np.zeros((0, 3, 3)), self.notes)

    # -------------------------------------------------------------- nodes

    def _roots(self) -> list[int]:
        scenes = self.document.get("scenes", [])
        chosen = self.document.get("scene", 0 if len(scenes) == 1 else None)
        if chosen is not None:
            if len(scenes) > 1:
                self.notes.append(
                    f"it holds {len(scenes)} scenes; its default, number {chosen}, was read"
                )
            return list(entry_of(self.document, "scenes", chosen).get("nodes", []))
        count = len(self.document.get("nodes", []))
        nodes = [entry_of(self.document, "nodes", index) for index in range(count)]
        children = {child for node in nodes for child in node.get("children", [])}
        if len(scenes) > 1:
            self.notes.append(
                f"it holds {len(scenes)} scenes and no default; all its root nodes were read"
            )
        return [index for index in range(len(nodes)) if index not in children]

    def _placed_nodes(self) -> list[tuple[int, list[F64]]]:
        """Nodes of the scene with a mesh, and where each stands: once, or as instances.

        A node that is hidden hides those below it.
        """
        placed: list[tuple[int, list[F64]]] = []
        waiting = [(root, np.eye(4), False) for root in reversed(self._roots())]
        left_out = 0
        while waiting:
            index, above, hidden = waiting.pop()
            node = entry_of(self.document, "nodes", index)
            if index in self.globals:
                raise Refused(f"node {index} stands in its tree of nodes twice")
            matrix = above @ _local(node)
            self.globals[index] = matrix
            extension = node.get("extensions", {}).get(VISIBILITY, {})
            hidden = hidden or extension.get("visible", True) is False
            if "mesh" in node and hidden:
                left_out += 1
            elif "mesh" in node:
                placed.append((index, self._instances(node, matrix)))
            waiting.extend((child, matrix, hidden) for child in reversed(node.get("children", [])))
        if left_out:
            self.notes.append(f"{left_out:,} meshes that {VISIBILITY} hides were left out")
        return placed

    def _instances(self, node: dict[str, Any], matrix: F64) -> list[F64]:
        if "skin" in node:
            return [np.eye(4)]  # the joints place a skinned mesh, its node does not
        extension = node.get("extensions", {}).get(INSTANCING)
        if extension is None:
            return [matrix]
        found = {
            name.lower(): self.accessors.read(accessor)
            for name, accessor in extension.get("attributes", {}).items()
            if name in ("TRANSLATION", "ROTATION", "SCALE")
        }
        counts = {len(values) for values in found.values()}
        if len(counts) != 1:
            raise Refused(f"{INSTANCING}: its attributes differ in number, or there are none")
        return [
            matrix @ _local({name: values[i] for name, values in found.items()})
            for i in range(counts.pop())
        ]

    # -------------------------------------------------------------- meshes

    def _node_triangles(self, index: int) -> list[F64]:
        """(N, 3, 3) float64 of each primitive of a node's mesh, in the mesh's own space."""
        node = entry_of(self.document, "nodes", index)
        mesh = entry_of(self.document, "meshes", node["mesh"])
        if "skin" not in node and "weights" not in node:  # else the node makes it another surface
            if node["mesh"] not in self.meshes:
                self.meshes[node["mesh"]] = self._mesh_triangles(node, mesh)
            return self.meshes[node["mesh"]]
        return self._mesh_triangles(node, mesh)

    def _mesh_triangles(self, node: dict[str, Any], mesh: dict[str, Any]) -> list[F64]:
        weights = node.get("weights", mesh.get("weights", []))
        parts: list[F64] = []
        total = 0
        for k, primitive in enumerate(mesh.get("primitives", [])):
            mode = primitive.get("mode", _TRIANGLES)
            if mode not in (_TRIANGLES, _STRIP, _FAN):
                what = "points" if mode == 0 else "lines"
                self.left_out[what] = self.left_out.get(what, 0) + 1
                continue
            if "POSITION" not in primitive.get("attributes", {}):
                raise Refused(f"primitive {k} of mesh {node['mesh']} has no positions")
            positions, indices = self._geometry(primitive)
            positions = self._morphed(positions, primitive, weights)
            if "skin" in node:
                positions = self._skinned(positions, primitive, node["skin"])
            faces = _faces(indices, mode)
            total += len(faces)
            check_memory(total)  # primitives may share one long list of indices
            parts.append(corners_of(positions, faces))
        return parts

    def _geometry(self, primitive: dict[str, Any]) -> tuple[F64, I64]:
        """Positions of a primitive, and the order of its corners."""
        position = primitive["attributes"]["POSITION"]
        compressed = primitive.get("extensions", {}).get(DRACO)
        if compressed is not None and not self.accessors.has_data(position):
            return self._draco(primitive, compressed)
        positions = self.accessors.read(position, "VEC3")
        if "indices" not in primitive:
            return positions, np.arange(len(positions))
        return positions, self.accessors.read_indices(primitive["indices"])

    def _draco(self, primitive: dict[str, Any], compressed: dict[str, Any]) -> tuple[F64, I64]:
        try:
            import DracoPy
        except ImportError:
            raise Refused(f"{DRACO} needs DracoPy: pip install 'mibvh[draco]'") from None
        if {"JOINTS_0"} & set(primitive["attributes"]) or primitive.get("targets"):
            raise Refused(f"{DRACO} of a skinned or morphed mesh is not read")
        try:
            decoded = DracoPy.decode(self.accessors.view(compressed["bufferView"]))
        except (ValueError, RuntimeError, DracoPy.FileTypeException) as error:
            raise Refused(f"{DRACO}: {error}") from None
        positions = np.asarray(decoded.points, dtype=np.float64).reshape(-1, 3)
        faces = getattr(decoded, "faces", None)
        if faces is None:
            raise Refused(f"{DRACO}: it holds points, not triangles")
        indices = np.asarray(faces, dtype=np.int64).ravel()
        declared = entry_of(self.document, "accessors", primitive["attributes"]["POSITION"])
        self.accessors.check(declared, positions, slack=0.01)
        count = entry_of(self.document, "accessors", primitive["indices"]).get("count")
        if primitive.get("mode", _TRIANGLES) == _TRIANGLES and count != len(indices):
            raise Refused(f"{DRACO}: {count} indices are declared, {len(indices)} decoded")
        return positions, indices

    def _morphed(self, positions: F64, primitive: dict[str, Any], weights: list[float]) -> F64:
        targets = primitive.get("targets", [])
        if targets:
            self._note_once("morph targets were applied with the weights at rest")
        for target, weight in zip(targets, weights, strict=False):
            if weight and "POSITION" in target:
                offsets = self.accessors.read(target["POSITION"], "VEC3")
                if len(offsets) != len(positions):
                    raise Refused("a morph target has another number of vertices than its mesh")
                positions = positions + weight * offsets
        return positions

    def _skinned(self, positions: F64, primitive: dict[str, Any], skin_index: int) -> F64:
        """Positions in the scene, where the joints stand at rest."""
        self._note_once("skins were applied as their joints stand at rest")
        skin = entry_of(self.document, "skins", skin_index)
        joints = skin["joints"]
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        if "inverseBindMatrices" in skin:
            inverse = self.accessors.read(skin["inverseBindMatrices"], "MAT4")
            inverse = inverse.reshape(-1, 4, 4).transpose(0, 2, 1)[: len(joints)]
        missing = [joint for joint in joints if joint not in self.globals]
        if missing:
            raise Refused(f"joint {missing[0]} of a skin is not in the scene")
        matrices = np.stack([self.globals[j] for j in joints]) @ inverse
        attributes = primitive["attributes"]
        mixed = np.zeros((len(positions), 4, 4))
        k = 0
        while f"JOINTS_{k}" in attributes:
            which = self.accessors.read(attributes[f"JOINTS_{k}"], "VEC4").astype(np.int64)
            share = self.accessors.read(attributes[f"WEIGHTS_{k}"], "VEC4")
            if which.min(initial=0) < 0 or which.max(initial=0) >= len(joints):
                raise Refused("a vertex names a joint that its skin does not have")
            mixed += np.einsum("vj,vjab->vab", share, matrices[which])
            k += 1
        if k == 0:
            raise Refused("a mesh with a skin has no joints")
        moved = np.einsum("vab,vb->va", mixed[:, :3, :3], positions)
        return np.asarray(moved + mixed[:, :3, 3])

    def _note_once(self, note: str) -> None:
        if note not in self.notes:
            self.notes.append(note)


def _faces(indices: I64, mode: int) -> I64:
    """(N, 3) int64: triangles of a list, a strip or a fan."""
    if mode == _TRIANGLES:
        if len(indices) % 3:
            raise Refused(f"{len(indices):,} indices do not make triangles")
        return indices.reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    first = indices[:-2] if mode == _STRIP else np.full(len(indices) - 2, indices[0])
    found = np.stack([first, indices[1:-1], indices[2:]], axis=1)
    a, b, c = found.T
    return found[(a != b) & (b != c) & (a != c)]  # what ties strips together has no area


def _local(node: dict[str, Any]) -> F64:
    """(4, 4) float64: a node's transform, from its matrix or its parts."""
    if "matrix" in node:
        return _numbers(node, "matrix", np.eye(4).ravel()).reshape(4, 4).T
    x, y, z, w = _numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    if not norm > 0:
        raise Refused("a node's rotation is no rotation")
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3] = turn * _numbers(node, "scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = _numbers(node, "translation", (0.0, 0.0, 0.0))
    return matrix


def _numbers(node: dict[str, Any], name: str, default: Sequence[float] | F64) -> F64:
    """A property of a node, of as many numbers as its default."""
    found = node.get(name, default)
    try:
        values = np.array(found, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.shape != (len(default),) or any(isinstance(value, str) for value in found):
        raise Refused(f"a node's {name} is not {len(default)} numbers: {str(found)[:60]}")
    return values


def _moved(corners: F64, matrix: F64) -> F64:
    return np.asarray(corners @ matrix[:3, :3].T + matrix[:3, 3])
