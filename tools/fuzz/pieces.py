"""One case: a study's folder with damaged or hostile pieces, through ``report`` and ``study``.

A case passes if the folder is refused in a sentence or a report comes of it, and nothing outside
the folder has changed. Pieces whose bytes are damaged must come out as if they were whole.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import mibvh
from mibvh.studies.measure.store import Store
from mibvh.studies.outputs import remake_report
from tools.fuzz.mutate import VALUES, Random, damaged

CHOICES: Any = {
    "builders": ("lbvh", "bbvh"),
    "width": 12,
    "height": 8,
    "scalar_rays": 64,
    "seconds": 0.0,
    "seed": 3,
}
SCENE = "cornell@300"
#: First words of the names of pieces that tables and report are made from.
_REPORTED = {"scene", "study"}
#: Names that would lead out of the folder, or mean something to whoever reads a table.
NAMES = ["../../gone", "/tmp/mibvh-fuzz-gone", "..", "", "=1+1", "<b>", "$x$", "a|b\n", "é" * 300]


class Pieces:
    """A finished study of one small scene, copied and damaged for each case."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="mibvh-fuzz-"))
        self.whole = self.folder / "whole"
        self.scene = mibvh.load(SCENE)
        self.truth = known(mibvh.study([self.scene], self.whole, **CHOICES))
        self.case = self.folder / "around" / "case"

    def run(self, seed: int) -> str:
        """Run a case; return what became of it. An exception other than MibvhError is a fault."""
        rng = np.random.default_rng(seed)
        shutil.rmtree(self.case.parent, ignore_errors=True)
        shutil.copytree(self.whole / "cache", self.case / "cache")
        (self.case.parent / "precious").write_text("kept")
        hostile = seed % 3 == 0
        names = sorted(path for path in (self.case / "cache").iterdir() if path.suffix != "")
        touched = set()
        for _ in range(int(rng.integers(1, 4))):
            path = names[int(rng.choice(len(names)))]
            if hostile:
                path = names[
                    int(rng.choice([i for i, p in enumerate(names) if p.suffix == ".json"]))
                ]
                replace(path, rng)
            else:
                path.write_bytes(damaged(path.read_bytes(), rng))
            touched.add(path.name.partition("-")[0].partition(".")[0])
        try:
            if hostile or touched & _REPORTED:
                said = self._report()
            if not hostile:
                found = known(self._study(bool(touched & _REPORTED)))
                if found != self.truth:
                    raise AssertionError("wrong numbers from damaged pieces")
                said = "made whole"
        finally:
            around = sorted(path.name for path in self.case.parent.iterdir())
        if around != ["case", "precious"]:
            raise AssertionError(f"something outside the folder changed: {around}")
        return f"{'hostile' if hostile else 'damaged'} {said}"

    def _study(self, outputs: bool) -> mibvh.Study:
        """Study the folder; tables and report are made of records alone, mostly those of before."""
        keep = (
            contextlib.nullcontext() if outputs else mock.patch("mibvh.studies.run.write_outputs")
        )
        with keep:
            return mibvh.study([self.scene], self.case, **CHOICES)

    def _report(self) -> str:
        try:
            remake_report(self.case)
        except mibvh.MibvhError as error:
            if "\n" in str(error) or not 0 < len(str(error)) < 700:
                raise AssertionError(f"no sentence: {str(error)!r}") from None
            return "refused"
        return "reported"


def known(study: Any) -> str:
    """What of a study's figures is the same in every run: all that are no times."""
    table = study.table
    return str(
        table[
            [
                c
                for c in table
                if "ns" not in str(c) and "error" not in str(c) and "seconds" not in str(c)
            ]
        ].to_csv()
    )


def replace(path: Path, rng: Random) -> None:
    """Change values of a JSON piece, and make its checksum fit, as whoever made it could."""
    store, name = Store(path.parent), path.stem
    value = store.read(name)
    for _ in range(int(rng.integers(1, 3))):
        holder: Any = value
        key: Any = None
        while isinstance(holder, dict | list) and holder:
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            key = keys[int(rng.integers(len(keys)))]
            if not isinstance(holder[key], dict | list) or not holder[key] or rng.random() < 0.2:
                break
            holder = holder[key]
        if key is None or not holder:
            continue
        choice = rng.random()
        if choice < 0.15:
            del holder[key]
        elif choice < 0.4:
            holder[key] = NAMES[int(rng.integers(len(NAMES)))]
        else:
            holder[key] = json.loads(json.dumps(VALUES[int(rng.integers(len(VALUES)))]))
    store.write(name, value or {})
