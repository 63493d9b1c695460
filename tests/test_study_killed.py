"""A study that is killed goes on where it stopped."""

import json
import os
import signal
import subprocess
import sys

import mibvh

SCENES = ["cornell@3000", "hairball@3000"]
CHOICES = {
    "builders": ["bbvh", "lbvh", "hill"],
    "width": 24,
    "height": 16,
    "scalar_rays": 256,
    "seconds": 0.0,
}
PROGRAM = """
import json, sys, mibvh
scenes, folder, choices = json.loads(sys.argv[1])
choices["builders"] = tuple(choices["builders"])
mibvh.study(scenes, folder, progress=lambda step: print(step.scene, step, flush=True), **choices)
"""


def test_kill_minus_nine(tmp_path):
    killed = tmp_path / "killed"
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, json.dumps([SCENES, str(killed), CHOICES])],
        stdout=subprocess.PIPE,
        text=True,
        env=dict(os.environ),
    )
    with process:
        for line in process.stdout:
            if line.startswith("hairball@3000 count lbvh"):  # in the middle of the second scene
                process.send_signal(signal.SIGKILL)
                break
        process.stdout.read()
    assert process.returncode == -signal.SIGKILL
    assert not (killed / "report.html").exists()
    kept = {
        p: (p.stat().st_mtime_ns, p.read_bytes())
        for p in (killed / "cache").iterdir()
        if not p.name.startswith(".")
    }
    # Of each tree a file, its metrics and its depths, and its counts: five trees, one in flight.
    assert sum(p.name.startswith("tree-") for p in kept) >= 5

    choices = {**CHOICES, "builders": tuple(CHOICES["builders"])}
    again = mibvh.study(SCENES, killed, **choices)
    for path, (time, content) in kept.items():
        # Records are put together anew, and the lock names the process that holds it.
        if not path.name.startswith(("scene-", "study", "lock")):
            assert path.stat().st_mtime_ns == time, path.name
            assert path.read_bytes() == content

    whole = mibvh.study(SCENES, tmp_path / "whole", **choices)
    assert again.report.exists()
    measured = [
        "build_seconds",
        *(
            f"{lanes}_{of}"
            for lanes in ("scalar", "simd")
            for of in ("ns", "error", "ns_kernel", "ns_process")
        ),
    ]
    assert again.table.drop(columns=measured).equals(whole.table.drop(columns=measured))
