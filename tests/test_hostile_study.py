"""A study's folder of somebody else's: its names are data, and nothing outside is touched."""

import csv
import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mibvh
from mibvh.errors import MibvhError
from mibvh.files import file_name, plain
from mibvh.studies.measure.store import Store
from mibvh.studies.record.scene import SceneRecord
from mibvh.studies.record.serialise import from_json
from mibvh.studies.record.sheet import Column, Sheet, write_csv
from mibvh.studies.run import read_study, remake_report, write_outputs

#: Names that mean something to a file system, a spreadsheet, LaTeX, Markdown, HTML or matplotlib.
NAMES = [
    "../../outside",
    "/outside/absolute",
    "=1+2",
    "@SUM(A1)",
    "<script>alert(1)</script>",
    "[a](javascript:b) | `c`",
    r"\input{x} %$#_{}~^&",
    "$\\frac{1}{0}$",
    "a|b\nc",
    '" onload="x',
    "_hidden",
    ".dot",
    "é" * 200,
    "nul\0 esc\x1b half\ud800",
]


@pytest.fixture
def folder(small_study, tmp_path):
    """Return a copy of a finished study, two folders deep, and what is around it."""
    copy = tmp_path / "around" / "study"
    shutil.copytree(small_study.folder, copy)
    return copy


def around(folder):
    return {path for path in folder.parent.parent.rglob("*") if folder not in path.parents}


def replace_scene(folder, **changes):
    """Change the first scene of a study as its author could, checksum included."""
    store = Store(folder / "cache")
    finished = store.read("study")
    first = finished["scenes"][0]
    record = store.read("scene-" + file_name(first))
    name = changes.get("scene", first)
    store.write("scene-" + file_name(name), {**record, **changes})
    store.write("study", {**finished, "scenes": [name, *finished["scenes"][1:]]})


def test_listed_files_outside_are_not_removed(folder):
    victims = [folder.parent / "precious.csv", folder / "mine.csv", folder / "tables" / "old.csv"]
    for path in victims:
        path.write_text("kept")
    listed = [
        "../precious.csv",
        "tables/../../precious.csv",
        str(victims[0]),
        "mine.csv",
        "tables/old.csv",
        "tables",
        "",
        "cache/study.json",
    ]
    Store(folder / "cache").write("study-files", {"files": listed})
    remake_report(folder)
    assert [path.exists() for path in victims] == [True, True, False]
    assert (folder / "cache" / "study.json").exists()


@pytest.mark.parametrize(
    "damage",
    [
        {"files": 3},
        {"files": [1, None]},
        {},
        {"files": {"a": 1}},
        {"other": []},
        {"files": [["x"]]},
    ],
)
def test_a_damaged_list_of_files_is_made_anew(folder, damage):
    Store(folder / "cache").write("study-files", damage)
    remake_report(folder)
    assert "tables/trees.csv" in Store(folder / "cache").read("study-files")["files"]


def test_names_of_scenes_and_builders_are_data(folder):
    """All names at once: each scene has one, and all of its trees."""
    before = around(folder)
    [record, *_] = read_study(folder).scenes
    records = [
        dataclasses.replace(
            record,
            scene=name,
            notes=[name],
            trees=[
                dataclasses.replace(tree, builder=f"{name}{i}" if i else name)
                for i, tree in enumerate(record.trees)
            ],
        )
        for name in NAMES
    ]
    write_outputs(folder, records)
    assert around(folder) == before
    page = (folder / "report.html").read_text()
    assert "<script>alert" not in page
    assert not re.search(r'<[^>]*" onload="x', page)
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt;") > 3
    text = (folder / "results.md").read_text()
    assert not re.search(r"(?<!\\)<script|(?<!\\)\]\(javascript", text)
    tables = re.findall(r"^\| .*(?:\n\| .*)+", text, re.MULTILINE)
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}) == 1
    for path in [*folder.glob("*.csv"), *folder.glob("tables/*.csv")]:
        with path.open(newline="") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert not [c for c in cells if re.match(r"[=@\t\r]|[+-][^\d]", c)], path.name
    latex = (folder / "tables" / "trees.tex").read_text()
    assert r"\textbackslash{}input\{x\} \%\$\#\_\{\}\textasciitilde{}\textasciicircum{}\&" in latex
    assert pd.read_parquet(folder / "results.parquet")["scene"].nunique() == len(NAMES)
    assert len(list((folder / "figures").glob("*.svg"))) >= 4 * len(NAMES)


def test_a_scene_is_kept_and_read_back_under_any_name(folder):
    before = around(folder)
    replace_scene(folder, scene="../../../outside")
    assert remake_report(folder).scenes[0].scene == "../../../outside"
    assert around(folder) == before


def test_linked_parts_are_not_written_through(folder):
    outside = folder.parent / "outside"
    outside.mkdir()
    shutil.rmtree(folder / "tables")
    (folder / "tables").symlink_to(outside)
    with pytest.raises(MibvhError, match="tables: is a link"):
        remake_report(folder)
    assert list(outside.iterdir()) == []
    (folder / "tables").unlink()
    (folder / "cache" / "lock").unlink()
    (folder / "cache" / "lock").symlink_to(folder.parent / "precious")
    with pytest.raises(MibvhError, match="lock: cannot be written"):
        remake_report(folder)
    assert not (folder.parent / "precious").exists()


DAMAGE = {
    "no trees": {"trees": []},
    "trees of another type": {"trees": {"a": 1}},
    "a tree too few values": {"trees": [{"builder": "x"}]},
    "text for a number": {"triangles": "many"},
    "a truth for a number": {"triangles": True},
    "a number for text": {"scene": 3},
    "a huge number": {"triangles": 10**40},
    "no picture": {"picture": "AAAA"},
    "an environment of nothing": {"environment": {}},
    "timing of nothing": {"timing": {}},
    "an unknown experiment": {"results": {"alchemy": {}}},
    "results of another type": {"results": [1]},
    "one field more": {"extra": 1},
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_records_that_make_no_sense_are_one_sentence(folder, damage):
    try:
        replace_scene(folder, **DAMAGE[damage])
    except TypeError:  # a scene whose name is no text
        Store(folder / "cache").write("study", {"scenes": [3], "format": 7})
    with pytest.raises(MibvhError) as said:
        remake_report(folder)
    assert "\n" not in str(said.value)
    assert str(folder) in str(said.value)


@pytest.mark.parametrize(
    "finished",
    [
        {"scenes": "cornell", "format": 7},
        {"scenes": [], "format": 7},
        {"format": 7},
        {"scenes": [["a"]], "format": 7},
        {"scenes": ["absent"], "format": 7},
        {"scenes": [], "format": "7"},
        {"scenes": [], "format": 6},
    ],
)
def test_a_damaged_list_of_scenes_is_one_sentence(folder, finished):
    Store(folder / "cache").write("study", finished)
    with pytest.raises(MibvhError, match=str(folder)):
        read_study(folder)


@dataclasses.dataclass(frozen=True)
class Piece:
    number: int
    values: dict[str, float]


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"\xff\xfe",
        b"[" * 100_000,
        b"1" * 10_000,
        b"NaN",
        b'{"checksum": 1}',
        b"[]",
        b"null",
        b'{"checksum": "x", "seconds": {}, "value": {}}',
        b'{"checksum": "x", "seconds": 1e999}',
    ],
    ids=range(10),
)
def test_a_damaged_piece_is_made_anew(tmp_path, damage):
    store = Store(tmp_path)
    (tmp_path / "piece.json").write_bytes(damage)
    assert store.record("piece", Piece, lambda: Piece(3, {"a": 0.5})) == Piece(3, {"a": 0.5})
    assert store.read("piece") == {"number": 3, "values": {"a": 0.5}}


@pytest.mark.parametrize(
    "value",
    [
        {},
        {"number": 1},
        {"number": "1", "values": {}},
        {"number": 1, "values": []},
        {"number": 1, "values": {"a": "b"}},
        {"number": 10**30, "values": {}},
    ],
)
def test_a_piece_of_another_shape_is_made_anew(tmp_path, value):
    store = Store(tmp_path)
    store.write("piece", value)
    assert store.record("piece", Piece, lambda: Piece(3, {})) == Piece(3, {})
    assert store.read("piece") == {"number": 3, "values": {}}


def test_records_nested_too_deeply():
    deep: dict = {}
    for _ in range(100_000):
        deep = {"a": deep}
    with pytest.raises(MibvhError, match="nested too deeply"):
        from_json(dict[str, object], {"a": deep})


def test_file_names():
    assert file_name("city_italian@10000-trees") == "city_italian@10000-trees"
    made = [file_name(name) for name in [*NAMES, "", ".", "..", "a/b", "a_b", "a b"]]
    assert len(set(made)) == len(made)
    for name in made:
        assert name == Path(name).name
        assert not name.startswith(".")
        assert len(name.encode()) < 128


def test_plain_text():
    assert plain("a\0b\x1bc\ud800d\te\nf é α") == "a?b?c?d\te\nf é α"


def test_spreadsheets_get_no_formulas(tmp_path):
    frame = pd.DataFrame({"=name": ["=1", "+a", "-2.5%", "@x", "ok"], "n": [-1.0, 2, 3, 4, np.nan]})
    write_csv(frame, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text().splitlines() == [
        "'=name,n",
        "'=1,-1.0",
        "'+a,2.0",
        "-2.5%,3.0",
        "'@x,4.0",
        "ok,",
    ]
    assert frame["=name"][0] == "=1"


def test_tables_keep_their_shape():
    sheet = Sheet(
        name="a_b/c\\d",
        section="s",
        title="<b> of a|b",
        frame=pd.DataFrame({"x": ["[2]", "*|\n"]}),
        columns=[Column("x")],
    )
    assert sheet.markdown().splitlines() == [
        r"### \<b\> of a\|b",
        "",
        "| x |",
        "| --- |",
        r"| \[2\] |",
        r"| \*\| |",
    ]
    latex = sheet.latex()
    assert r"\label{tab:a-b-c-d}" in latex
    assert "{[}2] \\\\\n{*}| \\\\\n" in latex


def test_a_sound_record_passes(small_study):
    for record in small_study.scenes:
        assert SceneRecord.from_json(json.loads(json.dumps(record.to_json()))).trees == record.trees


def test_a_picture_that_cannot_be_rendered_ends_no_study(monkeypatch, cornell):
    from mibvh import picture
    from mibvh.studies.measure import scene

    real = picture.picture

    def fails(scene, samples=32, **options):
        if samples:
            raise RuntimeError("no\nlight")
        return real(scene, samples=samples, **options)

    monkeypatch.setattr(picture, "picture", fails)
    made = scene._picture(cornell)
    assert made.png
    assert made.note.endswith("lit from the camera: Mitsuba cannot render this scene (no light)")
    monkeypatch.setattr(picture, "picture", lambda *_, **__: 1 / 0)
    made = scene._picture(cornell)
    assert made.png == ""
    assert "the picture is missing" in made.note


def test_lights_that_are_no_numbers(tmp_path):
    from mibvh.studies.measure import scene

    (tmp_path / "s.xml").write_text(
        '<scene version="3.0.0"><emitter type="constant"><rgb name="radiance" '
        'value="nan,nan,nan"/></emitter><shape type="rectangle"/></scene>'
    )
    assert scene._picture(mibvh.load(tmp_path / "s.xml")).png
