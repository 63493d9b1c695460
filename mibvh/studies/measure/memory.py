"""Memory of the study of a scene: predicted beforehand, and measured."""

from __future__ import annotations

import contextlib
import dataclasses
import mmap
from collections.abc import Iterator, Mapping, Sequence

from mibvh.builders import get
from mibvh.memory import BYTES, peak_memory, require_memory, require_references, reset_peak
from mibvh.rays.make import ray_memory
from mibvh.scene import LARGE, Scene
from mibvh.studies.measure import shelf, times
from mibvh.studies.measure.given import Given
from mibvh.studies.measure.trees import TreeSource
from mibvh.studies.record.options import StudyOptions
from mibvh.variant import release_memory

#: Of large records, the share of the pages that rays read, with one ray for each page; with other
#: numbers of rays it goes by this power of theirs, up to the most. Measured with 0.02 to 40 rays a
#: page: San Miguel has 0.3 to 0.8 times this, Sahyadri Jungle and San Francisco 0.75 to 1.05 times,
#: Dragon, of which rays see all, 1 to 1.5 times.
_READ, _POWER, _MOST = 0.55, 0.28, 0.9


@dataclasses.dataclass(frozen=True)
class _TreeNeeds:
    """Bytes needed to build a tree, and the expected number of its references."""

    build: float
    references: float


def predicted_memory(
    scene: Scene, options: StudyOptions, sources: Mapping[str, TreeSource], given: Given
) -> dict[str, float]:
    """Predict the bytes that each stage needs at most, beyond what is in memory before.

    Parameters
    ----------
    scene : Scene
    options : StudyOptions
    sources : mapping of str to TreeSource
    given : Given

    Raises
    ------
    MibvhError
        If a tree may have more references than can be numbered.
    """
    trees = [_of_tree(source, scene) for source in sources.values()]
    views = options.viewpoints or len(scene.sensors)
    primary = views * options.width * options.height * options.samples
    count = primary * options.bounces if given.rays is None else len(given.rays)
    references = [tree.references for tree in trees]
    largest = max(references, default=0.0)
    # Beside the tree at hand, as many as there is room for.
    held = BYTES["tree"] * largest + min(BYTES["tree"] * sum(references), shelf.ROOM)
    whole = BYTES["records"] * largest
    traced = BYTES["trace"] * count
    work = max(
        max((tree.build for tree in trees), default=0.0),
        BYTES["epo"] * largest,
        whole + traced,
    )
    needs = {
        "rays": 0.0 if given.rays is not None else ray_memory(primary, options.bounces - 1),
        "trees": held + work,
        "stopwatch": held
        + whole
        + _records([*references, references[0], references[-1]], count)
        + traced,
    }
    if "rotation" in options.experiments:
        turned = BYTES["turned"] * len(scene.triangles)
        slow = min(count, options.scalar_rays)
        timed = whole + _records([*references, *references], slow) + 2 * traced
        needs["rotation"] = 2 * held + turned + max(work, timed)
    return needs


def _records(references: Sequence[float], rays: int) -> float:
    """Bytes of the records of trees that are timed in turn, which are all in memory at once."""
    needed = BYTES["records"] * sum(references)
    if needed <= times.LARGE:
        return needed
    pages = needed / len(references) / mmap.PAGESIZE
    return needed * min(_MOST, _READ * (rays / pages) ** _POWER)


def _of_tree(source: TreeSource, scene: Scene) -> _TreeNeeds:
    triangles = len(scene.triangles)
    if source.given is not None:
        return _TreeNeeds(0.0, len(source.given().references))
    assert source.chosen is not None
    entry = get(source.chosen.builder)
    options = entry.options(**dict(source.chosen.options))
    most = entry.references(triangles, options)
    require_references(most, f"{triangles:,} triangles of {scene.name}, for {source.name},")
    # A budget for splits is seldom spent whole.
    return _TreeNeeds(entry.memory_of(triangles, options), (triangles + most) / 2)


def check_memory(scene: Scene, stages: Mapping[str, float]) -> float:
    """Refuse a scene whose study needs too much memory; return the bytes of the largest stage.

    Raises
    ------
    MibvhError
    """
    stage = max(stages, key=lambda name: stages[name])
    require_memory(
        stages[stage],
        f"{len(scene.triangles):,} triangles of {scene.name}, in the study's stage {stage},",
    )
    return stages[stage]


def make_room(scene: Scene) -> None:
    """Release to the system what is cached of a scene, before something else needs the memory.

    Of a small scene, Mitsuba's copies stay: to make them again would take longer than they are
    worth.
    """
    if len(scene.triangles) > LARGE:
        scene.release()
    release_memory()


class Peaks:
    """Records the peak memory of each stage of a study.

    Attributes
    ----------
    found : dict of str to float
        Bytes of the whole process, by stage; empty where the system does not tell.
    """

    def __init__(self) -> None:
        self.found: dict[str, float] = {}

    @contextlib.contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Record the peak memory of the block as that of a stage."""
        reset_peak()
        yield
        if (peak := peak_memory()) is not None:
            self.found[stage] = float(peak)
