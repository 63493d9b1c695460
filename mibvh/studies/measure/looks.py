"""What the picture of a scene depends on besides its triangles: lights, materials, textures."""

from __future__ import annotations

import hashlib

import numpy as np

from mibvh.scene import Scene
from mibvh.variant import mitsuba


def scene_digest(scene: Scene) -> str:
    """Hash all parameters of a scene as Mitsuba knows it, and its triangles."""
    digest = hashlib.sha256(scene.triangles.digest.encode())
    if scene.original is not None:
        parameters = mitsuba().traverse(scene.original)
        for name in sorted(parameters.keys()):
            digest.update(name.encode())
            array = np.array(parameters[name])
            # Transforms and the like are no arrays; they print their numbers.
            text = array.dtype == object
            digest.update(str(parameters[name]).encode() if text else array.tobytes())
    return digest.hexdigest()
