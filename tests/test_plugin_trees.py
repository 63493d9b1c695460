"""Tree files in the place of a builder: the same images, and one sentence where they do not fit."""

import json
import sys
from unittest import mock

import numpy as np
import pytest
import trimesh

import mibvh
import mibvh.mitsuba
from mibvh.cli import main
from mibvh.mitsuba import Accelerator, image_channels
from mibvh.mitsuba.trees import TreeFile
from mibvh.variant import mitsuba

mi = mitsuba()
SIZE = "cornell@500"


def command(capsys, *arguments, code=0):
    """What a command prints; to stderr if it fails."""
    with (
        mock.patch.object(sys, "argv", ["mibvh", *map(str, arguments)]),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    captured = capsys.readouterr()
    assert (ended.value.code or 0) == code, captured.err
    return captured.err if code else captured.out


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Tree files of a scene: by `lbvh`, by `sbvh` in nodes of four, of another scene."""
    folder = tmp_path_factory.mktemp("trees")
    scene = mibvh.load(SIZE)
    mibvh.build(scene, "lbvh").save(folder / "morton.npz")
    mibvh.collapse(mibvh.build(scene, "sbvh"), 4).save(folder / "wide.npz")
    mibvh.build(mibvh.load("cornell@300"), "lbvh").save(folder / "other.npz")
    return folder


@pytest.fixture(scope="module")
def scene():
    """The scene as Mitsuba loads it, small."""
    loaded = mi.load_file(str(mibvh.bundled.bundled_scene(SIZE)), optimize=False)
    params = mi.traverse(loaded.sensors()[0])
    params["film.size"] = [24, 18]
    params.update()
    return loaded


@pytest.mark.parametrize("style", ["wide", "single"])
def test_the_image_is_that_of_the_tree_s_builder(scene, files, style):
    given = {"tree": str(files / "morton.npz")}, {"builder": "lbvh"}
    plugins = [mi.load_dict({"type": "bvh_path", "style": style, **tree}) for tree in given]
    found, wanted = (np.array(mi.render(scene, integrator=plugin, spp=4)) for plugin in plugins)
    assert wanted.mean() > 0.01
    assert np.abs(found - wanted).max() <= 1e-5 * wanted.max()  # films add in any order


def test_heat_maps_compare_a_tree_file_with_another(scene, files):
    integrator = mi.load_dict(
        {"type": "bvh_cost", "builder": "lbvh", "compare_tree": str(files / "morton.npz")}
    )
    assert integrator.layers == ["lbvh", "morton", "difference"]
    channels = image_channels(mi.render(scene, integrator=integrator, spp=1), integrator)
    assert channels["morton.cost"].mean() > 1
    assert np.array_equal(channels["morton.cost"], channels["lbvh.cost"])


def test_a_tree_of_a_scene_with_its_instances_is_refused_by_name(tmp_path):
    """Mitsuba traces the instances, beside the tree of the rest."""
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><shape type="shapegroup" id="g"><shape type="cube"/></shape>'
        '<shape type="instance"><ref id="g"/></shape><shape type="rectangle"/></scene>'
    )
    mibvh.build(path, "lbvh").save(tmp_path / "all.npz")
    given = TreeFile(str(tmp_path / "all.npz"))
    said = r"another geometry than the scene without its instances \(2 triangles\)"
    with pytest.raises(mibvh.MibvhError, match=said):
        Accelerator(mi.load_file(str(path)), given)


def test_a_file_written_anew_is_read_anew(scene, tmp_path):
    loaded = mibvh.load(SIZE)
    integrator = mi.load_dict({"type": "bvh_cost", "tree": str(tmp_path / "tree.npz")})
    costs = []
    for builder in ("lbvh", "sbvh"):
        mibvh.build(loaded, builder).save(tmp_path / "tree.npz")
        costs.append(np.array(mi.render(scene, integrator=integrator, spp=1))[..., 0].mean())
    assert costs[1] < costs[0]


def test_rays_written_anew_build_anew(scene, tmp_path):
    """The file that an option names counts, as in a study."""
    loaded, digests = mibvh.load(SIZE), []
    for seed in (1, 2):
        rays = mibvh.diffuse_rays(loaded, width=24, height=18, seed=seed)
        rays.save(tmp_path / "rays.npz")
        digests.append(Accelerator(scene, "finite", rays=str(tmp_path / "rays.npz")).tree.digest)
    assert digests[0] != digests[1]


def test_lights_that_move_build_anew():
    """Shadow rays go to them."""
    lamp = {"type": "point", "position": [0.5, 9.0, 0.5]}
    body = {"type": "scene", "lamp": lamp, "box": {"type": "cube"}}
    lit, kept = mi.load_dict(body), []
    for height in (9.0, 9.0, -9.0):
        params = mi.traverse(lit)
        params["lamp.position"] = [0.5, height, 0.5]
        params.update()
        kept.append(Accelerator(lit, "finite", kind="shadow").tree)
    assert kept[0] is kept[1]
    assert kept[0] is not kept[2]


SCENE = """<scene version="3.0.0">
    <integrator type="bvh_cost"><string name="tree" value="beside.npz"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
    </sensor>
    <shape type="ply"><string name="filename" value="ball.ply"/></shape>
</scene>"""


def test_a_scene_finds_the_tree_beside_it(capsys, tmp_path):
    """As it finds its meshes and textures, from wherever it is loaded."""
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.ply")
    (tmp_path / "scene.xml").write_text(SCENE)
    mibvh.build(mibvh.load(tmp_path / "scene.xml"), "bbvh").save(tmp_path / "beside.npz")
    facts = command(capsys, "render", tmp_path / "scene.xml", "-o", tmp_path / "cost.exr", "--json")
    assert json.loads(facts)["means"]["beside.cost"] > 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--tree", "other.npz"], "other.npz: the tree (lbvh, "),
        (["--tree", "wide.npz"], "wide.npz: a tree with nodes of 4 children; name a binary one"),
        (["--tree", "none.npz"], "none.npz: there is no such tree file"),
        (
            ["--tree", "morton.npz", "--builder", "sbvh"],
            "tree is a finished tree: leave builder out",
        ),
        (
            ["--integrator", "bvh_cost", "--compare-tree", "morton.npz", "--compare", "sbvh"],
            "compare_tree is a finished tree: leave compare out",
        ),
    ],
)
def test_what_does_not_fit_is_one_sentence(capsys, files, tmp_path, monkeypatch, given, said):
    monkeypatch.chdir(files)
    picture = tmp_path / "picture.png"
    arguments = ["render", SIZE, "-o", picture, "--size", "16x12", "--spp", 1, *given]
    assert said in command(capsys, *arguments, code=2).splitlines()[-1]
    assert not picture.exists()
