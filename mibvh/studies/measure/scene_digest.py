"""Hashes of all that a rendered image of a scene depends on, and of its lights alone."""

from __future__ import annotations

import hashlib
from typing import Any

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
        _add_parameters(digest, whole)
    return digest.hexdigest()


def lights_digest(scene: Scene) -> str:
    """Hash the parameters of a scene's lights, to which shadow rays go.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    str
        SHA-256, hexadecimal.
    """
    digest = hashlib.sha256()
    whole = scene.renderable
    for light in whole.emitters() if whole is not None else []:
        digest.update(light.class_name().encode())
        _add_parameters(digest, light)
    return digest.hexdigest()


def _add_parameters(digest: Any, of: Any) -> None:
    """Hash all parameters of an object of Mitsuba's, by name."""
    parameters = mitsuba().traverse(of)
    for name in sorted(parameters.keys()):
        digest.update(name.encode())
        array = np.array(parameters[name])
        # Transforms and the like become arrays of objects, but print their numbers.
        text = array.dtype == object
        digest.update(str(parameters[name]).encode() if text else array.tobytes())
