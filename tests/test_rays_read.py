"""Ray sets of the user's own: from arrays, and from files of several kinds."""

import io

import numpy as np
import pytest

import mibvh
from mibvh.files import write_arrays
from mibvh.rays import RaySet

O = np.array([[0, 0, 0], [1, 2, 3]], np.float32)  # noqa: E741 - as the attribute
D = np.array([[0, 0, 1], [0.6, 0, 0.8]], np.float32)


def test_origins_and_directions_are_enough():
    rays = RaySet(O.tolist(), D)
    assert rays.tmax.tolist() == [np.inf] * 2
    assert rays.viewpoint.tolist() == [0, 0]
    assert rays.bounce.tolist() == [1, 1]
    assert rays.source.tolist() == [-1, -1]
    assert {a.dtype for a in (rays.o, rays.d, rays.tmax)} == {np.dtype(np.float32)}
    triangles = mibvh.Triangles([[[-1, -1, 5], [3, -1, 5], [-1, 3, 5]]])
    hits = mibvh.trace(mibvh.build(triangles, "bbvh"), triangles, rays, repeats=1)
    assert hits.t[0] == 5
    assert repr(rays) == "RaySet(2 rays)"


FAULTS = [
    ({"o": O[:, :2]}, r"o must have the shape \(2, 3\), not \(2, 2\)"),
    ({"d": D[:1]}, r"d must have the shape \(2, 3\), not \(1, 3\)"),
    ({"d": D * [[1], [np.nan]]}, r"1 of 2 rays have a direction that is not finite \(first: ray 1"),
    ({"d": D * [[0], [1]]}, "1 of 2 rays have a direction of no length .first: ray 0"),
    ({"d": D.astype(float) * 1e300}, "2 of 2 rays have a direction that is not finite"),
    ({"o": O + [np.inf, 0, 0]}, "2 of 2 rays have an origin that is not finite"),
    ({"tmax": np.array([1, np.nan])}, "a tmax that is negative or no number"),
    ({"tmax": np.array([1, -1.0])}, "a tmax that is negative or no number"),
    ({"tmax": np.ones(3)}, r"tmax must have the shape \(2,\), not \(3,\)"),
    ({"source": np.array([0, 2**40])}, "source has numbers that do not fit into 32 bits"),
    ({"source": np.array([0, -2])}, "a source triangle below -1"),
    ({"viewpoint": np.array([-1, 0])}, "a viewpoint below 0"),
    ({"bounce": np.array([0.5, 1])}, "bounce has numbers that are not whole"),
    ({"bounce": np.array(["a", "b"])}, "bounce is no array of numbers"),
    ({"o": O + 1j}, "o is no array of numbers"),
]


@pytest.mark.parametrize(("wrong", "said"), FAULTS)
def test_arrays_that_are_no_rays_are_refused(wrong, said, tmp_path):
    arrays = {"o": O, "d": D, **wrong}
    with pytest.raises(mibvh.MibvhError, match=said):
        RaySet(**arrays)
    sound = RaySet(O, D)
    names = ("o", "d", "tmax", "viewpoint", "bounce", "source")
    whole = {name: getattr(sound, name) for name in names} | wrong
    file = tmp_path / "r.npz"
    write_arrays(file, whole, {})  # with a right checksum
    for read in (RaySet.load, mibvh.read_rays):
        # Shapes and types are those of the format before they are those of rays.
        with pytest.raises(mibvh.MibvhError, match=f"{said}|not a ray set file of mibvh") as error:
            read(file)
        assert str(error.value).startswith(str(file))


def test_rays_that_leave_triangles_that_are_not_there():
    triangles = mibvh.Triangles([[[-1, -1, 5], [3, -1, 5], [-1, 3, 5]]])
    rays = RaySet(O, D, source=np.array([0, 1]))
    with pytest.raises(mibvh.MibvhError, match="ray 1 leaves triangle 1, but triangles has 1"):
        mibvh.trace(mibvh.build(triangles, "bbvh"), triangles, rays, repeats=1)


def ply(kind, directions=("dx", "dy", "dz")):
    names = ["x", "y", "z", *directions, "source"]
    head = f"ply\nformat {kind} 1.0\ncomment rays\nelement vertex 2\n"
    head += "".join(f"property float {name}\n" for name in names[:6])
    head += "property int source\nelement face 0\nproperty list uchar int i\nend_header\n"
    source = np.array([[4], [7]])
    if kind == "ascii":
        rows = np.concatenate([O, D], axis=1)
        body = "".join(
            " ".join(map(str, [*row.tolist(), s])) + "\n"
            for row, s in zip(rows, source[:, 0], strict=True)
        )
        return (head + body).encode()
    order = "<" if "little" in kind else ">"
    table = np.zeros(2, [("r", order + "f4", 6), ("s", order + "i4")])
    table["r"], table["s"] = np.concatenate([O, D], axis=1), source[:, 0]
    return head.encode() + table.tobytes()


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("directions", [("dx", "dy", "dz"), ("nx", "ny", "nz")])
def test_ply_points_with_directions(kind, directions, tmp_path):
    path = tmp_path / "rays.ply"
    path.write_bytes(ply(kind, directions))
    rays = mibvh.read_rays(path)
    np.testing.assert_array_equal(rays.o, O)
    np.testing.assert_array_equal(rays.d, D)
    assert rays.source.tolist() == [4, 7]


def test_plain_arrays_and_mibvhs_own(tmp_path):
    np.save(tmp_path / "a.npy", np.concatenate([O, D], axis=1).astype(np.float64))
    np.savez(tmp_path / "b.npz", o=O, d=D, tmax=np.float32([1, 2]))
    RaySet(O, D, meta={"scene": "x"}).save(tmp_path / "c.npz")
    a, b, c = (mibvh.read_rays(tmp_path / name) for name in ("a.npy", "b.npz", "c.npz"))
    for rays in (a, b, c):
        np.testing.assert_array_equal(rays.o, O)
        np.testing.assert_array_equal(rays.d, D)
    assert b.tmax.tolist() == [1, 2]
    assert c.meta == {"scene": "x"}


def test_files_tell_their_kind_and_key(tmp_path):
    file, tree = tmp_path / "r.npz", tmp_path / "t.npz"
    RaySet(O, D).save(file, key="a")
    assert len(RaySet.load(file, key="a")) == 2
    with pytest.raises(mibvh.MibvhError):
        RaySet.load(file, key="b")
    with pytest.raises(mibvh.MibvhError):
        mibvh.Tree.load(file)
    triangles = mibvh.Triangles([[[-1, -1, 5], [3, -1, 5], [-1, 3, 5]]])
    mibvh.build(triangles, "bbvh").save(tree)
    with pytest.raises(mibvh.MibvhError):
        mibvh.read_rays(tree)


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def zip_of_another_version():
    """What zipfile knows no version of: a NotImplementedError of Python's."""
    file = io.BytesIO()
    np.savez(file, o=O, d=D)
    whole = file.getvalue()
    at = whole.index(b"PK\x01\x02")
    return whole[: at + 6] + b"\xb8" + whole[at + 7 :]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.npz", zip_of_another_version(), "zip file version"),
        ("a.npy", npy(np.zeros((3, 5))), r"need an array of shape \(R, 6\), not \(3, 5\)"),
        ("a.npy", b"nonsense", "a.npy: "),
        ("a.npz", b"nonsense", "a.npz: "),
        ("a.txt", b"0 0 0 0 0 1", "rays are read from .npz, .npy, .ply files"),
        ("a.ply", b"solid", "does not begin with 'ply'"),
        ("a.ply", ply("ascii", ("a", "b", "c")), "neither dx, dy, dz nor nx, ny, nz"),
        ("a.ply", ply("ascii")[:-20], "a vertex that is not numbers"),
        ("a.ply", ply("binary_little_endian")[:-1], "has fewer: cut short"),
    ],
)
def test_files_that_hold_no_rays_are_refused(name, content, said, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(mibvh.MibvhError, match=said) as error:
        mibvh.read_rays(path)
    assert "\n" not in str(error.value)
    with pytest.raises(mibvh.MibvhError, match="there is no such ray file"):
        mibvh.read_rays(tmp_path / "gone.npz")
