"""A hash of all that a rendered image of a scene depends on: lights and materials too."""

from __future__ import annotations

import hashlib

import numpy as np

from mibvh.errors import MibvhError
from mibvh.scene import Scene
from mibvh.variant import mitsuba


def scene_digest(scene: Scene) -> str:
    """Hash a scene's triangles and all parameters that Mitsuba renders it with.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    str
        SHA-256, hexadecimal. A scene that Mitsuba cannot render is hashed with the reason.
    """
    digest = hashlib.sha256(scene.triangles.digest.encode())
    try:
        whole = scene.renderable
    except MibvhError as error:  # the study goes on without a picture
        digest.update(str(error).encode())
        return digest.hexdigest()
    if whole is not None:
        parameters = mitsuba().traverse(whole)
        for name in sorted(parameters.keys()):
            digest.update(name.encode())
            array = np.array(parameters[name])
            # Transforms and the like become arrays of objects, but print their numbers.
            text = array.dtype == object
            digest.update(str(parameters[name]).encode() if text else array.tobytes())
    return digest.hexdigest()
