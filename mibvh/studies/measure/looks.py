"""What the picture of a scene depends on besides its triangles: lights, materials, textures."""

from __future__ import annotations

import hashlib

import numpy as np

from mibvh.errors import MibvhError
from mibvh.scene import Scene
from mibvh.variant import mitsuba


def scene_digest(scene: Scene) -> str:
    """Hash all parameters of a scene as Mitsuba renders it, and its triangles."""
    digest = hashlib.sha256(scene.triangles.digest.encode())
    try:
        whole = scene.renderable
    except MibvhError as error:  # it has no picture, then
        digest.update(str(error).encode())
        return digest.hexdigest()
    if whole is not None:
        parameters = mitsuba().traverse(whole)
        for name in sorted(parameters.keys()):
            digest.update(name.encode())
            array = np.array(parameters[name])
            # Transforms and the like are no arrays; they print their numbers.
            text = array.dtype == object
            digest.update(str(parameters[name]).encode() if text else array.tobytes())
    return digest.hexdigest()
