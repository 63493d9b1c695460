import io
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import mibvh
from mibvh.files import checksum, read_arrays, write_arrays

ROOT = Path(__file__).parents[1]
NAMES = ("a", "b")


def arrays():
    return {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.arange(4, dtype=np.int32)}


def rewritten(path, members, compression=zipfile.ZIP_STORED):
    """Write an archive of arrays; values that are bytes as they are."""
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, value in members.items():
            buffer = io.BytesIO()
            if isinstance(value, bytes):
                buffer.write(value)
            else:
                np.save(buffer, value, allow_pickle=True)
            archive.writestr(f"{name}.npy", buffer.getvalue())


def members(path):
    with np.load(path) as data:
        return dict(data)


def test_kind_and_key(tmp_path):
    path = tmp_path / "x.npz"
    write_arrays(path, arrays(), {"m": 1}, kind="tree", key="bbvh of a")
    found, meta = read_arrays(path, "tree", NAMES, key="bbvh of a")
    assert meta == {"m": 1}
    assert all(np.array_equal(found[name], arrays()[name]) for name in NAMES)
    assert not any(array.flags.writeable for array in found.values())
    with pytest.raises(mibvh.MibvhError, match="is a tree file, not a hits file"):
        read_arrays(path, "hits", NAMES)
    with pytest.raises(mibvh.MibvhError, match="made from something else"):
        read_arrays(path, "tree", NAMES, key="sbvh of a")


def test_a_tree_under_another_name_is_not_believed(small_soup, tmp_path):
    mibvh.build(small_soup, "lbvh").save(tmp_path / "t.npz", key="lbvh")
    assert mibvh.Tree.load(tmp_path / "t.npz").meta["builder"] == "lbvh"
    with pytest.raises(mibvh.MibvhError, match="its key differs"):
        mibvh.Tree.load(tmp_path / "t.npz", key="bbvh")


def test_rays_have_a_kind_and_a_key(tmp_path):
    rays = mibvh.RaySet(np.zeros((3, 3)), np.ones((3, 3)))
    path = tmp_path / "r.npz"
    rays.save(path, key="four bounces")
    assert mibvh.RaySet.load(path, key="four bounces").digest == rays.digest
    with pytest.raises(mibvh.MibvhError, match="its key differs"):
        mibvh.RaySet.load(path, key="one bounce")
    names = ("o", "d", "tmax", "viewpoint", "bounce", "source")
    write_arrays(path, {name: getattr(rays, name) for name in names}, {}, kind="rays")
    with pytest.raises(mibvh.MibvhError, match="is a rays file, not a ray set file"):
        mibvh.RaySet.load(path)


@pytest.mark.parametrize(
    "change",
    [
        {"a": np.arange(6, dtype=np.float32)},
        {"a": np.arange(6, dtype=np.float32).reshape(3, 2)},
        {"a": arrays()["a"].view(np.int32)},
        {"a": arrays()["a"].astype(">f4")},
        {"a": arrays()["a"].byteswap().view(">f4")},
        {"a": arrays()["b"], "b": arrays()["a"]},
    ],
)
def test_the_checksum_covers_names_types_and_shapes(tmp_path, change):
    path = tmp_path / "x.npz"
    write_arrays(path, arrays(), {})
    rewritten(path, {**members(path), **change})
    with pytest.raises(mibvh.MibvhError, match="checksum does not match"):
        read_arrays(path, "tree", NAMES)


def test_format_1_is_read(tmp_path):
    """As mibvh 0.1.0 wrote it: the checksum is of the bytes and the metadata."""
    import hashlib

    digest = hashlib.sha256()
    for array in arrays().values():
        digest.update(array.tobytes())
    digest.update(json.dumps({"m": 1}).encode())
    header = {"format": 1, "checksum": digest.hexdigest(), "meta": {"m": 1}}
    np.savez(tmp_path / "x.npz", header=np.array(json.dumps(header)), **arrays())
    found, meta = read_arrays(tmp_path / "x.npz", "tree", NAMES)
    assert meta == {"m": 1}
    np.testing.assert_array_equal(found["a"], arrays()["a"])
    facts = {"format": 99, "kind": None, "key": None, "meta": {}}
    header = {**facts, "checksum": checksum(arrays(), facts)}
    np.savez(tmp_path / "x.npz", header=np.array(json.dumps(header)), **arrays())
    with pytest.raises(mibvh.MibvhError, match="format 99"):
        read_arrays(tmp_path / "x.npz", "tree", NAMES)


def test_damage_of_other_kinds(tmp_path):
    path = tmp_path / "x.npz"
    write_arrays(path, arrays(), {})
    good = members(path)
    npy = b"\x93NUMPY\x01\x00"
    huge = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000,), }\n"
    cases = [
        {**good, "a": np.array([{}], dtype=object)},
        {**good, "a": npy + len(huge).to_bytes(2, "little") + huge},
        {**good, "a": b"\x93NUMPY\x09\x00"},
        {**good, "a": b""},
        {**good, "header": np.array("[" * 100000)},
        {**good, "header": np.array("[]")},
        {**good, "header": np.array("{}")},
        {**good, "header": np.zeros(3)},
        {"header": good["header"]},
        {},
    ]
    for case in cases:
        rewritten(path, case)
        with pytest.raises(mibvh.MibvhError, match="not a tree file of mibvh, or damaged"):
            read_arrays(path, "tree", NAMES)
    rewritten(path, {**good, "a": np.zeros(10**6, np.float32)}, zipfile.ZIP_DEFLATED)
    with pytest.raises(mibvh.MibvhError, match="is compressed"):
        read_arrays(path, "tree", NAMES)


def test_what_is_no_file(tmp_path):
    with pytest.raises(mibvh.MibvhError, match="no such tree file"):
        read_arrays(tmp_path / "absent", "tree", NAMES)
    with pytest.raises(mibvh.MibvhError, match="is no file"):
        read_arrays(tmp_path, "tree", NAMES)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(mibvh.MibvhError, match="is no file"):
        read_arrays(tmp_path / "pipe", "tree", NAMES)


def test_hits_round_trip_and_are_checked(tmp_path, cornell):
    tree = mibvh.build(cornell, "bbvh")
    rays = mibvh.diffuse_rays(cornell, width=12, height=8, samples=1)
    hits = mibvh.trace(tree, cornell, rays, repeats=1)
    path = tmp_path / "h.npz"
    hits.save(path)
    again = mibvh.Hits.load(path)
    assert again.summary() == hits.summary()
    np.testing.assert_array_equal(again.t, hits.t)
    with pytest.raises(mibvh.MibvhError, match="not a tree file"):
        mibvh.Tree.load(path)
    columns = ("t", "triangle", "inner", "leaves", "tests", "steps", "boxes", "seconds")
    good = {name: getattr(hits, name) for name in columns}
    meta = {"lanes": "simd", "lane_width": 8, "issued": 8, "style": "single"}
    for change, said in [
        ({"t": np.where(np.arange(len(rays)) == 3, np.nan, hits.t)}, "no distance"),
        ({"t": -hits.t}, "no distance"),
        ({"triangle": np.full(len(rays), -1, np.int32)}, "no triangle"),
        ({"triangle": hits.triangle[:-1]}, r"triangle is int32 \("),
        ({"inner": hits.inner.astype(np.int64)}, "inner is int64"),
        ({"seconds": -hits.seconds}, "negative"),
    ]:
        write_arrays(path, {**good, **change}, meta, kind="hits")
        with pytest.raises(mibvh.MibvhError, match=said):
            mibvh.Hits.load(path)
    write_arrays(path, good, {**meta, "issued": "8"}, kind="hits")
    with pytest.raises(mibvh.MibvhError, match="issued is '8'"):
        mibvh.Hits.load(path)
    elsewhere = np.where(hits.triangle >= 0, 10**6, -1).astype(np.int32)
    write_arrays(path, {**good, "triangle": elsewhere}, meta, kind="hits")
    with pytest.raises(mibvh.MibvhError, match="of another geometry"):
        mibvh.ray_ends(cornell, rays, mibvh.Hits.load(path))


def run_fuzz(code, **environment):
    """Run the fuzzer with other parts; return its exit code and what it says."""
    ran = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        check=False,
    )
    return ran.returncode, ran.stdout


def test_mutated_files_are_refused_or_right():
    code, said = run_fuzz(
        "import sys; from tools.fuzz import __main__ as f; sys.argv = ['fuzz', 'files'];"
        "raise SystemExit(f.main())",
        FUZZ_CASES="300",
        FUZZ_SEED="7",
    )
    assert code == 0, said
    assert "files: 300 cases from 7" in said
    for outcome in ("tree refused", "tree accepted", "hits refused"):
        assert outcome in said


BAD = """
import os, time
class Bench:
    def run(self, seed):
        if seed == 1: os.abort()
        if seed == 3: time.sleep(99)
        if seed == 5: raise IndexError("off")
        return "fine"
"""


def test_the_watchdog_sees_crashes_hangs_and_exceptions(tmp_path):
    (tmp_path / "bad_part.py").write_text(BAD)
    code, said = run_fuzz(
        "import sys; from tools.fuzz import __main__ as f; f.FIRST_PATIENCE = f.PATIENCE = 6;"
        "counts, faults = f.fuzz('bad_part:Bench', 0, 600, 7); print(counts, faults)",
        PYTHONPATH=f"{ROOT}{os.pathsep}{tmp_path}",
    )
    assert code == 0
    assert "{'fine': 4}" in said
    assert "seed 1: exit code -6" in said
    assert "seed 3: takes longer" in said
    assert "IndexError: off" in said
