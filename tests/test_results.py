"""``make results``: stages, what it writes into the docs, and the numbers that the prose quotes."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import scene_record, tree_row

import mibvh
from mibvh.errors import MibvhError
from mibvh.studies.record.options import StudyOptions
from mibvh.studies.record.sheet import Column, Sheet
from tools.results import all_builders, blocks, quoted
from tools.results.__main__ import main
from tools.results.later import later_sheets
from tools.results.pages import OLD, PAGES, marked_as_old, on_page
from tools.results.study import scenes_of, stages

ROOT = Path(__file__).parents[1]
QUOTED = ROOT / "docs/results/quoted.json"
QUICK = (
    "--profile quick --samples 1 --seconds 0.02 --builders bbvh,sbvh,lbvh,hill,treelet "
    "--experiments prediction,depth --readme-scene livingroom@800"
)


@pytest.mark.parametrize("page", ["README.md", "docs/results.md"])
def test_the_prose_quotes_what_was_measured(page):
    text = (ROOT / page).read_text()
    assert len(quoted.MARKED.findall(text)) >= 5
    assert quoted.fill(text, quoted.read(QUOTED)["values"], page) == text


def test_every_r_in_the_readme_is_quoted():
    """A number such as 0.925 without a key behind it would not follow the study."""
    text = (ROOT / "README.md").read_text()
    section = text[text.index("## Which predictor?") : text.index("```python")]
    assert re.findall(r"\b0\.\d{3}\b(?!<!--)", section) == []


def test_fill():
    text = "r is 0.9<!--r.a--> (0.1<!--r.b-->), 5%<!--c-->."
    assert quoted.fill(text, {"r.a": "0.95", "r.b": "0.2", "c": "6%"}) == (
        "r is 0.95<!--r.a--> (0.2<!--r.b-->), 6%<!--c-->."
    )
    with pytest.raises(MibvhError, match=r"page.md: no number is known for r.b"):
        quoted.fill(text, {"r.a": "0.95", "c": "6%"}, "page.md")


def test_blocks():
    text = "a\n<!-- begin x -->\nold\n<!-- end x -->\nb\n"
    assert blocks.put(text, "x", "new") == "a\n<!-- begin x -->\nnew\n<!-- end x -->\nb\n"
    assert blocks.put(text, "x", "") == "a\n<!-- begin x -->\n<!-- end x -->\nb\n"
    with pytest.raises(MibvhError, match="there is no block 'y'"):
        blocks.put(text, "y", "new")


def test_old_pages_are_marked_once():
    once = marked_as_old("# Title\n\nText.\n")
    assert once == f"# Title\n\n{OLD}\n\nText.\n"
    assert marked_as_old(once) == once


def test_stages_end_with_whole_tables():
    chosen = StudyOptions(experiments=("prediction", "sensitivity", "depth", "rotation"))
    assert [one.experiments for one in stages(chosen)] == [
        ("prediction", "depth"),
        ("prediction", "depth", "sensitivity"),
        ("prediction", "depth", "sensitivity", "rotation"),
    ]


def test_sheets_of_a_page():
    import pandas as pd

    frame = pd.DataFrame({"a": [1]})
    sheets = [
        Sheet(name=name, section="s", title=name, frame=frame, columns=[Column("a")])
        for name in ("pooled-b", "r-others", "trees", "overview", "pooled-a", "r")
    ]
    page = next(page for page in PAGES if page.file == "correlations")
    assert [s.name for s in on_page(page, sheets)] == [
        "overview",
        "pooled-b",
        "pooled-a",
        "r",
        "r-others",
    ]


def write_scene(folder: Path, name: str, triangles: int, seed: int) -> None:
    """Write a folder with a Mitsuba scene of random triangles."""
    rng = np.random.default_rng(seed)
    corners = rng.random((triangles, 1, 3)) * [3, 1, 2] + rng.normal(size=(triangles, 3, 3)) * 0.05
    (folder / name).mkdir(parents=True)
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in corners.reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(triangles)]
    (folder / name / "mesh.obj").write_text("\n".join(lines) + "\n")
    (folder / name / "scene.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"><transform name="to_world">'
        '<lookat origin="1.5, 0.5, -3" target="1.5, 0.5, 1" up="0, 1, 0"/></transform></sensor>'
        '<shape type="obj"><string name="filename" value="mesh.obj"/></shape></scene>'
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a checkout whose docs were written from a tiny study of two scenes, and the study."""
    folder = tmp_path_factory.mktemp("results")
    write_scene(folder / "scenes", "small", 300, 1)
    write_scene(folder / "scenes", "large", 700, 2)
    write_scene(folder / "scenes", "other", 200, 3)
    checkout = folder / "checkout"
    shutil.copytree(ROOT / "docs", checkout / "docs")
    shutil.copy(ROOT / "README.md", checkout)
    given = [str(folder / "scenes"), "-o", str(folder / "out"), "--docs", str(checkout)]
    arguments = [*given, "--without", "other", *QUICK.split()]
    assert main(arguments) == 0
    return folder, checkout, arguments


@pytest.mark.slow
def test_scenes_of_a_folder(made):
    folder, _, _ = made
    found = scenes_of(folder / "scenes", ["other"])
    assert [path.parent.name for path in found] == ["small", "large"]
    with pytest.raises(MibvhError, match="no scene 'none' to leave out"):
        scenes_of(folder / "scenes", ["none"])
    with pytest.raises(MibvhError, match=r"no folder with a scene.xml"):
        scenes_of(folder / "scenes" / "small")


def test_pages_hold_the_study(made):
    folder, checkout, _ = made
    study = mibvh.studies.read_study(folder / "out")
    page = (checkout / "docs/results/trees.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith(("| small", "| large"))]
    assert len(rows) == len(study.table) == 10
    first = study.table.iloc[0]
    cells = [cell.strip() for cell in rows[0].split("|")]
    assert cells[1:4] == [first["scene"], str(first["triangles"]), first["builder"]]
    assert cells[4] == f"{first['sah']:.2f}"
    assert "version 0.1" not in page
    for kept in ("rotation", "sensitivity"):
        old = (ROOT / f"docs/results/{kept}.md").read_text()
        new = (checkout / f"docs/results/{kept}.md").read_text()
        assert OLD in new
        assert new.replace(f"{OLD}\n\n", "") == old.replace(f"{OLD}\n\n", "")


def test_numbers_of_the_prose_are_the_study_s(made):
    folder, checkout, _ = made
    study = mibvh.studies.read_study(folder / "out")
    r = study.correlations
    sah = r[(r["measurement"] == "counted_cost") & (r["predictor"] == "SAH")]["pearson"]
    held = json.loads((checkout / "docs/results/quoted.json").read_text())
    assert held["values"]["r.counted.SAH.mean"] == f"{sah.mean():.3f}"
    assert held["values"]["r.counted.SAH.min"] == f"{sah.min():.3f}"
    assert held["values"]["scenes"] == "2"
    assert "rotation.sah" in held["kept"]
    for page in ("README.md", "docs/results.md"):
        text = (checkout / page).read_text()
        assert quoted.fill(text, held["values"]) == text
    text = (checkout / "docs/results.md").read_text()
    before = quoted.read(ROOT / "docs/results/quoted-0.1.json")["values"]
    old = f"{before['r.counted.SAH.mean']} ({before['r.counted.SAH.min']})"
    assert f"| {old} | {sah.mean():.3f} ({sah.min():.3f}) |" in text
    assert text.count(OLD.replace("these tables were", "this was")) == 2
    drawn = (checkout / "docs/images/livingroom.png").read_bytes()
    assert drawn == (folder / "out/readme/figures/livingroom@800-counted.png").read_bytes()


def test_it_goes_on_and_stops_when_the_time_is_out(made, capsys):
    _, checkout, arguments = made
    before = (checkout / "docs/results/trees.md").read_text()
    assert main([*arguments, "--pages-only"]) == 0
    assert (checkout / "docs/results/trees.md").read_text() == before
    later = [*arguments[:-3], "prediction,depth,rotation", *arguments[-2:]]
    assert main([*later, "--minutes", "0"]) == 0
    said = capsys.readouterr()
    assert "out of time" in said.err
    assert "2 of 2 scenes" in said.out
    assert "rotation.md" in said.out


def test_a_folder_of_nothing_is_a_sentence(tmp_path, capsys):
    assert main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith(f"results: {tmp_path}: there is no folder")


@pytest.mark.slow
def test_the_page_of_bundled_scenes_holds_the_study(tmp_path):
    few = ["--scenes", "cornell", "--triangles", "400", "--seconds", "0"]
    where = ["-o", str(tmp_path / "out"), "--docs", str(tmp_path)]
    assert all_builders.main([*where, *few]) == 0
    page = (tmp_path / "docs/results/bundled.md").read_text()
    study = mibvh.studies.read_study(tmp_path / "out")
    assert len(study.table) == 16
    assert "| finite |" in page
    assert "by kind of rays" in page
    assert "8 children" in page
    assert "none failed" in page


@pytest.mark.slow
def test_the_page_of_real_scenes_holds_the_study(tmp_path):
    for seed, (name, size) in enumerate((("small", 300), ("smaller", 200), ("other", 400))):
        write_scene(tmp_path / "scenes", name, size, seed)
    where = ["-o", str(tmp_path / "out"), "--docs", str(tmp_path), "--seconds", "0"]
    fewer = ["--without", "other", "--without-builders", "embree,agglo"]
    assert all_builders.main([str(tmp_path / "scenes"), *where, *fewer]) == 0
    page = (tmp_path / "docs/results/all-builders.md").read_text()
    assert "2 scenes of 200 to 300 triangles, 15 trees each" in page
    assert "-o DIR SCENES --without other --profile quick --seconds 0 --" in page
    assert "| agglo |" not in page
    table = mibvh.studies.read_study(tmp_path / "out").table
    costs = table.pivot(index="scene", columns="builder", values="counted_cost")
    nine = [name for name in mibvh.builders.names() if name in costs]
    over = np.exp(np.log(costs["finite"] / costs[nine].min(axis=1)).mean())
    rows = [line for line in page.splitlines() if line.startswith("| finite |")]
    assert any(line.startswith(f"| finite | {over:.3f} |") for line in rows)
    scene = (costs["ploc"] / costs[nine].min(axis=1))["small"]
    assert any(f" {scene:.3f} |" in line for line in page.splitlines() if "| small |" in line)


def test_later_builders_stand_beside_the_nine_without_times():
    nan = float("nan")
    trees = [
        tree_row(name, counted_cost=cost, sah=cost, scalar_ns=nan, simd_ns=nan, warp_cost=cost)
        for name, cost in (("bbvh", 4.0), ("sbvh", 2.0), ("ploc", 5.0), ("finite", 1.0))
    ]
    records = [scene_record(trees, name) for name in ("one", "two")]
    sheets = {sheet.name: sheet.frame for sheet in later_sheets(records)}
    assert sheets["later-scenes"]["ploc"].tolist() == [2.5, 2.5, pytest.approx(2.5)]
    means = sheets["later-means"].set_index("builder")
    assert means.loc["finite", "counted_cost"] == pytest.approx(0.5)
    assert means["scalar_ns"].isna().all()
    assert "finite" in next(s.title for s in later_sheets(records) if s.name == "later-cheapest")
    assert later_sheets([scene_record(trees[:2], "one")]) == []


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--scenes", "cornel"], "cornel"),
        (["--without-builders", "agglom"], "agglom"),
        (["missing"], "no folder with a scene.xml"),
    ],
)
def test_a_page_of_all_builders_that_cannot_be_is_a_sentence(tmp_path, capsys, wrong, said):
    assert all_builders.main(["-o", str(tmp_path / "o"), "--docs", str(tmp_path), *wrong]) == 2
    assert said in capsys.readouterr().err
