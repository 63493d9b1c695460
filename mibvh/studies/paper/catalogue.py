"""The paper's scenes: where to get them, and the figures published for each.

A user who has the files names them as the catalogue does and puts them into one folder; a study of
the folder finds them, checks their triangle counts and shows the paper's figures beside its own.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pandas as pd

from mibvh.errors import MibvhError
from mibvh.studies.paper.published import PaperScene, published
from mibvh.studies.record.scene import Records


def find_paper_scene(name: str) -> PaperScene | None:
    """Find a scene of the paper by the name of a file or folder.

    >>> find_paper_scene("san-miguel").name
    'San Miguel'
    """
    asked = _plain(name)
    for scene in published().known_scenes:
        if asked in {_plain(known) for known in (scene.name, *scene.files)}:
            return scene
    return None


def _plain(name: str) -> str:
    return "".join(c for c in name.lower() if c.isalnum())


def triangle_count_notes(name: str, triangles: int) -> list[str]:
    """Return a sentence if a scene has the name of one of the paper's but not its triangles."""
    known = find_paper_scene(name)
    if known is None or known.triangles in (None, triangles):
        return []
    return [
        f"{name} has {triangles:,} triangles, but the {known.name} that is available at "
        f"{known.where} has {known.triangles:,}: another version, so figures will differ"
    ]


def scenes_in(source: Any) -> list[Any]:
    """Return the scenes of a source: those in it if it is a folder, otherwise the source itself.

    In a folder, every mesh and Mitsuba XML file is a scene, and every folder with a ``scene.xml``.

    Raises
    ------
    MibvhError
        If there is no scene in the folder.
    """
    if not isinstance(source, str | os.PathLike) or not Path(source).is_dir():
        return [source]
    found = [path for path in sorted(Path(source).iterdir()) if _is_scene(path)]
    if not found:
        raise MibvhError(f"{source}: there is no scene in this folder")
    return [path / "scene.xml" if path.is_dir() else path for path in found]


def _is_scene(path: Path) -> bool:
    if path.is_dir():
        return (path / "scene.xml").is_file()
    from mibvh.loading import mesh_formats

    return path.suffix.lower().lstrip(".") in {"xml", *mesh_formats()}


def paper_comparison(records: Records, correlations: pd.DataFrame) -> pd.DataFrame:
    """Published figures beside measured ones, for the studied scenes that are the paper's.

    Parameters
    ----------
    records : sequence of SceneRecord
    correlations : DataFrame
        From :func:`mibvh.studies.analyse.correlations.correlations`.

    Returns
    -------
    DataFrame
        Columns ``scene, triangles, expected, r_sah, paper_r_sah, r_sah_epo, paper_r_sah_epo,
        alpha, paper_alpha``; r is with scalar ns/ray.
    """
    scalar = correlations[correlations["measurement"] == "scalar_ns"].set_index(
        ["scene", "predictor"]
    )
    rows = []
    for record in records:
        known = find_paper_scene(record.scene)
        if known is None:
            continue
        alone, both = (scalar.loc[(record.scene, name)] for name in ("SAH", "fitted"))
        rows.append(
            {
                "scene": record.scene,
                "triangles": record.triangles,
                "expected": known.triangles,
                "r_sah": alone["pearson"],
                "paper_r_sah": known.r_sah,
                "r_sah_epo": both["pearson"],
                "paper_r_sah_epo": known.r_sah_epo,
                "alpha": both["alpha"],
                "paper_alpha": known.alpha,
            }
        )
    names = [
        "scene",
        "triangles",
        "expected",
        "r_sah",
        "paper_r_sah",
        "r_sah_epo",
        "paper_r_sah_epo",
        "alpha",
        "paper_alpha",
    ]
    return pd.DataFrame(rows, columns=names)
