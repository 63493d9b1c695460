"""The report's tables, in every form, and its figures as files."""

import csv
import dataclasses
import io
import re
import shutil
from html import unescape
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from conftest import scene_record, tree_row
from PIL import Image

from mibvh.errors import MibvhError
from mibvh.metrics.predictors import predictor, predictors
from mibvh.metrics.registry import DIGITS
from mibvh.plot.marks import builder_colour, builder_dash, builder_shape, label_places
from mibvh.studies.analyse.advice import Advice, advice
from mibvh.studies.analyse.choice import cost_of_choice
from mibvh.studies.analyse.correlations import SCALAR
from mibvh.studies.analyse.winners import (
    InTime,
    Winner,
    cost_over_best,
    winner,
    winner_in_time,
    wins,
    wins_in_time,
)
from mibvh.studies.outputs import remake_report
from mibvh.studies.record.scene import samples
from mibvh.studies.record.sheet import Column, Sheet, within
from mibvh.studies.report import tidy
from mibvh.studies.report.agreement import limits_beside, multiples, scatter, together
from mibvh.studies.report.answer import answer
from mibvh.studies.report.axes import Axis, Panel
from mibvh.studies.report.drawing import Dot, Drawing, Part, Stroke, Words
from mibvh.studies.report.overall import overall
from mibvh.studies.report.plots import by_depth
from mibvh.studies.report.tables import answers
from mibvh.studies.report.tables.prediction import NAMED, by_traversal, times_known
from mibvh.studies.report.winners import winners

SHEET = Sheet(
    name="costs",
    section="Costs",
    title="Costs of 100% & more",
    note="With α = 0.5.",
    frame=pd.DataFrame(
        {
            "builder": ["a_b", "c"],
            "cost": [2.5, 1.25],
            "error": [0.011, np.nan],
            "held": [True, False],
            "none": [np.nan, np.inf],
        }
    ),
    columns=[
        Column("builder"),
        Column("cost", format=".2f", error="error", smaller_is_better=True),
        Column("held"),
        Column("none", "nothing"),
    ],
)


def test_cells():
    assert SHEET.values.columns.tolist() == ["builder", "cost", "held", "nothing", "cost error"]
    assert [[c.text for c in row] for row in SHEET.rows()] == [
        ["a_b", "2.50", "yes", "–"],
        ["c", "1.25", "no", "∞"],
    ]
    first, second = (row[1] for row in SHEET.rows())
    assert (first.sort, first.error, first.best) == (2.5, "±1.1%", False)
    assert (second.error, second.best) == ("", True)


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.20132, "0.201"), (2.0, "2.00"), (48.349, "48.3"), (512.6, "513"), (12345.6, "12346")],
)
def test_times_have_three_digits_on_any_machine(value, said):
    sheet = dataclasses.replace(
        SHEET, frame=pd.DataFrame({"ns": [value, -value, 0.0]}), columns=[Column("ns", "", DIGITS)]
    )
    assert [row[0].text for row in sheet.rows()] == [said, f"-{said}", "0.00"]


@pytest.mark.parametrize(("error", "said"), [(0.0112, "±1.1%"), (3e-4, "±0.03%"), (0, "±0.01%")])
def test_a_small_error_is_not_told_as_none(error, said):
    assert within(error) == said


def test_markdown():
    assert SHEET.markdown().splitlines() == [
        "### Costs of 100% & more",
        "",
        "With α = 0.5.",
        "",
        "| builder | cost | held | nothing |",
        "| --- | ---: | ---: | ---: |",
        "| a_b | 2.50 | yes | – |",
        "| c | 1.25 | no | ∞ |",
    ]


def test_latex():
    assert SHEET.latex().splitlines() == [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        r"\caption{Costs of 100\% \& more. With $\alpha$ = 0.5.}",
        r"\label{tab:costs}",
        r"\begin{tabular}{lrrr}",
        r"\toprule",
        r"builder & cost & held & nothing \\",
        r"\midrule",
        r"a\_b & 2.50 & yes & -- \\",
        r"c & \textbf{1.25} & no & $\infty$ \\",
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]


@pytest.mark.parametrize("name", ["overview", "r", "pooled-counted_cost", "trees", "stopwatch"])
def test_table_files(small_study, name):
    rows = list(
        csv.DictReader(io.StringIO((small_study.folder / f"tables/{name}.csv").read_text()))
    )
    latex = (small_study.folder / f"tables/{name}.tex").read_text()
    body = latex[latex.index("\\midrule") : latex.index("\\bottomrule")]
    assert body.count(r"\\") == len(rows)
    assert latex.isascii()
    columns = re.search(r"\\begin{tabular}{(\w+)}", latex).group(1)
    assert {line.count(" & ") for line in body.splitlines()[1:]} == {len(columns) - 1}


def test_figure_files(small_study):
    scene = small_study.scenes[0].scene
    for name in ("counted", "scalar", "simd", "depth"):
        drawn = (small_study.folder / f"figures/{scene}-{name}.svg").read_text()
        assert "currentColor" not in drawn
        panels = 2 if name == "depth" else 3
        assert drawn.count('data-builder="lbvh"') == panels
        ElementTree.fromstring(drawn)


def test_other_forms_of_figures_are_drawn_on_demand(small_study, tmp_path):
    assert not list((small_study.folder / "figures").glob("*.p*"))
    copy = shutil.copytree(small_study.folder, tmp_path / "copy")
    remake_report(copy, ("pdf", "png"))
    drawn = {path.stem for path in (copy / "figures").glob("*.svg")}
    assert {path.stem for path in (copy / "figures").glob("*.pdf")} == drawn
    for path in (copy / "figures").glob("*.png"):
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"))
        assert pixels.std() > 5, path  # something is drawn
        assert path.stem in drawn
    remake_report(copy)
    assert not list((copy / "figures").glob("*.p*"))  # those of the run before are gone
    with pytest.raises(MibvhError, match="drawn as pdf or png beside SVG, not 'gif'"):
        remake_report(copy, ("gif",))


def test_builders_are_named_below_the_curves_of_a_file_and_once_on_the_page(small_study):
    record = small_study.scenes[0]
    figure = by_depth(record)
    assert re.findall(r">(\w*bvh)</text>", figure.file()) == ["bbvh", "lbvh"]
    assert len(figure.parts) == 2
    for part in figure.parts:
        assert ElementTree.fromstring(figure.svg(part)).tag.endswith("svg")
        assert "lbvh</text>" not in figure.svg(part)


def test_points_stand_where_their_values_are():
    sheet = Drawing(200, 100)
    panel = Panel(sheet, Part(0, 0, 200, 100), (0, 10), (1, 100), log=(False, True))
    left, right, low, top = 46, 190, 66, 22
    assert panel.x([0, 5, 10]) == pytest.approx([left, (left + right) / 2, right])
    assert panel.y([1, 10, 100]) == pytest.approx([low, (low + top) / 2, top])
    assert panel.x([-3, 40]) == pytest.approx([left, right])  # at the edge
    turned = Axis(3.5, -0.5, 0.0, 80.0)
    assert turned([3.5, 0.5, -0.5]) == pytest.approx([0.0, 60.0, 80.0])
    assert turned.ticks(4).tolist() == [0, 1, 2, 3]


def test_points_tell_what_they_are_and_text_is_text(small_study):
    sheet = Drawing(20, 20)
    sheet.add(Dot(x=1, y=2, owner='a"<b', tip="1 < 2 & 3"), Words(x=1, y=1, text="<i>$x$"))
    root = ElementTree.fromstring(sheet.svg())
    point = next(g for g in root if g.get("class") == "point")
    assert (point.get("data-builder"), point.get("data-tip")) == ('a"<b', "1 < 2 & 3")
    assert root[-1].text == "<i>$x$"


def test_many_trees_beyond_the_line_stay_in_their_scene():
    trees = [
        tree_row(str(i), counted_cost=cost, scalar_ns=100.0, scalar_error=0.1)
        for i, cost in enumerate([10.0, *[40.0] * 12])
    ]
    sheet = winners([scene_record(trees, f"scene {i}") for i in range(2)])
    second = sheet.parts[1].x
    first = [mark.x for mark in sheet.marks if isinstance(mark, Dot) and "scene 0" in mark.tip]
    assert len(first) == 13
    assert max(first) + 5 < second


def test_builders_are_ranked_by_their_mean_over_the_scenes_best():
    """The bar ends at the mean, the points are the scenes, and who lacks a scene has no row."""
    costs = [{"a": 10.0, "b": 11.0, "c": 40.0}, {"a": 12.0, "b": 10.0, "c": 30.0, "d": 9.0}]
    records = [
        scene_record([tree_row(name, counted_cost=cost) for name, cost in of.items()], f"scene {i}")
        for i, of in enumerate(costs)
    ]
    sheet = overall(records)
    rows = {mark.text: mark.y for mark in sheet.marks if isinstance(mark, Words) and mark.x == 18}
    assert sorted(rows, key=rows.get) == ["b", "a", "c"]
    over = {"a": [0, 12 / 9 - 1], "b": [0.1, 10 / 9 - 1], "c": [3, 30 / 9 - 1]}
    for name, shares in over.items():
        (bar,) = [m for m in sheet.marks if isinstance(m, Stroke) and m.owner == name]
        scenes = [m for m in sheet.marks if isinstance(m, Dot) and m.owner == name]
        assert [m.tip for m in scenes] == [
            f"scene {i}: {name}, +{share:.1%}" for i, share in enumerate(shares)
        ]
        assert f"+{np.mean(shares):.1%} on average" in bar.tip
        ends = sorted(mark.x for mark in scenes)
        assert ends[0] - 1e-6 <= bar.points[1, 0] <= ends[1] + 1e-6
        assert {mark.y for mark in scenes} == {rows[name]} == {bar.points[1, 1]}
    assert overall([scene_record([tree_row(n, counted_cost=1.0)]) for n in "ab"]) is None


def times(scalar, simd):
    return {"scalar_ns": scalar, "scalar_error": 0.1, "simd_ns": simd, "simd_error": 0.1}


def test_time_is_told_over_all_scenes(small_study):
    """Of the second builder, relative to the best for all."""
    ratios = (0.8, 0.9, 1.0, 0.9)
    records = [
        scene_record(
            [
                tree_row("a", counted_cost=1.0 + i / 10, **times(time, np.sqrt(time))),
                tree_row("b", counted_cost=1.2, **times(1.0, 1.0)),
            ],
            f"scene {i}",
        )
        for i, time in enumerate(ratios)
    ]
    logs = np.log(ratios)
    more = 1 / np.exp(logs.mean())
    error = more * logs.std(ddof=1) / 2
    told = next(o for o in answer(records, small_study.correlations) if o.startswith("One for all"))
    assert f"time of b over that of a: scalar {more - 1:+.1%} ± {error:.1%}, SIMD" in told
    assert f"SIMD {np.sqrt(more) - 1:+.1%} ±" in told


def test_a_winner_that_saw_rays_is_told(small_study):
    for name, told in (("finite", True), ("finite(kind=ao)", True), ("bbvh", False), ("my", False)):
        trees = [
            dataclasses.replace(
                tree_row(builder, counted_cost=cost, **times(cost, cost)),
                cost_groups=[cost, 1.1 * cost, 0.9 * cost],
            )
            for builder, cost in ((name, 1.0), ("lbvh", 2.0))
        ]
        records = [scene_record(trees, f"scene {i}") for i in range(4)]
        first = answer(records, small_study.correlations)[0]
        assert first.startswith(f"Best tree of 4 scenes: {name} in all 4")
        saw = f". {name} was built for different rays from the same cameras; the best that knows"
        assert (f"{saw} no cameras is lbvh" in first) is told
        assert ("built for" in first) is told


def test_the_winner_and_its_lead():
    costs = {"a": [10.0, 12.0, 8.0], "b": [11.0, 13.0, 9.0], "c": [20.0, 20.0, 20.0]}
    trees = [
        dataclasses.replace(
            tree_row(name, counted_cost=float(np.mean(of)), scalar_ns=t, scalar_error=0.02),
            cost_groups=of,
        )
        for (name, of), t in zip(costs.items(), (100.0, 99.0, 200.0), strict=True)
    ]
    record = scene_record(trees)
    best = winner(record)
    ratios = [11 / 10, 13 / 12, 9 / 8]
    assert (best.builder, best.second) == ("a", "b")
    assert best.lead == pytest.approx(0.1)
    assert best.error == pytest.approx(np.std(ratios, ddof=1) / np.sqrt(3))
    assert best.sure
    assert str(best) == "a, 10.0% ± 1.2% ahead of b"
    timed = winner_in_time(record, SCALAR)
    assert (timed.builder, timed.second, timed.sure) == ("b", "a", False)
    assert str(timed).startswith("b or a (1.0% ± 2.9% apart)")
    assert wins([record, record]) == {"a": 2}
    over = {name: shares.tolist() for name, shares in cost_over_best([record, record]).items()}
    assert over == {"a": [1, 1], "b": pytest.approx([1.1, 1.1]), "c": [2, 2]}
    assert wins_in_time([record], SCALAR) == InTime(same=0, another=0, open=1)
    sure = [dataclasses.replace(t, values={**t.values, "scalar_error": 1e-4}) for t in trees]
    assert wins_in_time([record, scene_record(sure)], SCALAR) == InTime(0, 1, 1)
    agrees = [sure[0].with_values(scalar_ns=90.0), *sure[1:]]
    assert wins_in_time([scene_record(agrees)], SCALAR) == InTime(1, 0, 0)
    alone = scene_record([dataclasses.replace(trees[0], cost_groups=[])])
    assert str(winner(alone)) == "a"


def _correlations(r: dict[str, list[float]], trees: int = 9) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "scene": f"scene {i}",
                "measurement": "counted_cost",
                "predictor": name,
                "pearson": value,
                "trees": trees,
            }
            for name, values in r.items()
            for i, value in enumerate(values)
        ]
    )


def test_a_difference_within_the_noise_gives_no_advice():
    many = {"SAH": [0.94] * 16, "finite rays": [0.990] * 16, "finite by lines": [0.992] * 16}
    found = advice(_correlations(many))
    assert found == Advice("finite rays", "finite by lines", ("finite by lines",))
    # arctanh(.98) - arctanh(.94) is .56; twice the error is 2 sqrt(2 / 6 / 16) = .29, and of
    # one scene 1.15.
    worse = {"SAH": [0.98] * 16, "finite rays": [0.94] * 16}
    assert advice(_correlations(worse)) == Advice("SAH", "SAH", ())
    one = {name: of[:1] for name, of in worse.items()}
    assert advice(_correlations(one)) == Advice("finite rays", "SAH", ("SAH",))
    # Three trees tell nothing: Fisher's z has no error there.
    assert advice(_correlations(worse, trees=3)).name == "finite rays"
    assert advice(_correlations({"SAH": [np.nan]})) is None
    # What is fitted, or traced, is no advice however well it does.
    better = {**many, "fitted": [0.9999] * 16, "touched": [0.9999] * 16}
    assert advice(_correlations(better)).name == "finite rays"


def test_what_needs_a_traversal_is_no_prediction():
    assert {"touched", "spread", "with LCV"} <= set(by_traversal())
    assert not set(NAMED) & set(by_traversal())


def test_times_are_told_with_the_lanes_they_are_of(small_study):
    records = small_study.scenes
    told = times_known(records)
    for title, key in (("scalar", "scalar_error"), ("SIMD", "simd_error")):
        error = max(record.column(key).max() for record in records)
        assert f"±{error:.1%} ({title})" in told
    for name in ("claims", "overview"):
        latex = (small_study.folder / f"tables/{name}.tex").read_text()
        assert told.split("±")[1].split("%")[0] in latex


def test_how_it_was_measured_says_what_the_records_hold(small_study):
    page = unescape(small_study.report.read_text())
    told = page[page.index('id="how-it-was-measured"') :]
    viewpoints = {record.rays.viewpoints for record in small_study.scenes}
    assert f"<dt>viewpoints</dt><dd>{' or '.join(map(str, sorted(viewpoints)))}</dd>" in told
    assert "<dd></dd>" not in told
    for name in {name for record in small_study.scenes for name in record.results}:
        assert name in told.split("<dt>experiments</dt>")[1].split("</dd>")[0]


def test_claims_that_none_can_judge_are_folded(small_study):
    page = unescape(small_study.report.read_text())
    claims = page[page.index('id="claims"') : page.index('id="scenes"')]
    assert re.search(r"None of the \d+ claims is judged: .* 2 scenes are too few", claims)
    assert claims.index("<details") < claims.index("<table")


def test_no_two_of_many_builders_look_alike():
    points = {(builder_colour(i), builder_shape(i)) for i in range(40)}
    assert len(points) == 40
    assert len({(builder_colour(i), builder_dash(i)) for i in range(27)}) == 27
    # The first ones are those of the paper's figures, as before.
    assert [builder_shape(i) for i in range(9)] == list("oDs^vPXpd")


def _crowd(count: int) -> tuple[np.ndarray, list[str], np.ndarray]:
    points = np.random.default_rng(count).normal((60, 50), 18, (count, 2)).clip(0, (200, 120))
    return points, [f"builder_{i}" for i in range(count)], np.array([200.0, 120.0])


@pytest.mark.parametrize("count", [3, 9, 17, 40])
def test_labels_cover_nothing(count):
    points, names, size = _crowd(count)
    found = label_places(points, names, size, only_clear=True)
    boxes = [
        (p.centre - [2.5 * len(names[p.of]), 5], p.centre + [2.5 * len(names[p.of]), 5])
        for p in found
    ]
    for i, (low, high) in enumerate(boxes):
        assert (low >= 0).all()
        assert (high <= size).all()
        for other_low, other_high in boxes[:i]:
            assert not ((low < other_high) & (other_low < high)).all()
        for place, point in enumerate(points):
            if place != found[i].of:
                assert not ((low < point + 4) & (point - 4 < high)).all()
    assert 2 <= len(found) <= count
    assert len(label_places(points, names, size)) == count  # all, where nothing else names them
    unnamed = label_places(points, ["", *names[1:]], size, only_clear=True)
    assert 0 not in [p.of for p in unnamed]


def test_the_dearest_of_a_crowd_stands_at_the_edge():
    assert together(np.array([10.0, 12.0, 11.0, 40.0])).tolist() == [True, True, True, False]
    assert together(np.array([10.0, 22.0, 11.0, 30.0])).all()
    assert together(np.array([10.0, 11.0, 40.0])).all()  # three are no crowd
    assert together(np.array([10.0, 11.0, np.nan, 40.0])).all()
    costs = {"a": 10.0, "b": 12.0, "c": 11.0, "lbvh": 40.0}
    trees = [tree_row(name, counted_cost=cost, sah=cost + 1) for name, cost in costs.items()]
    sheet = multiples([scene_record(trees)], "SAH")
    top = {mark.owner: mark.y for mark in sheet.marks if isinstance(mark, Dot) and mark.tip}
    assert top["lbvh"] == pytest.approx(44.0)  # the upper margin
    assert min(y for name, y in top.items() if name != "lbvh") < 76  # the others fill the panel
    assert "lbvh: 40 ↗" in [mark.text for mark in sheet.marks if isinstance(mark, Words)]


def test_trees_beyond_the_line_stand_apart():
    trees = [
        tree_row(name, counted_cost=cost, scalar_ns=100.0, scalar_error=0.1)
        for name, cost in (("a", 10.0), ("b", 15.0), ("c", 30.0), ("d", 20.0))
    ]
    marks = winners([scene_record(trees)]).marks
    at = {mark.owner: mark.x for mark in marks if isinstance(mark, Dot)}
    end = max(mark.points[:, 0].max() for mark in marks if isinstance(mark, Stroke))
    assert at["a"] < at["b"] < end < at["d"] < at["c"]
    assert at["c"] - at["d"] >= 7  # as wide as a point
    assert "2 beyond" in [mark.text for mark in marks if isinstance(mark, Words)]


def test_a_lead_and_its_error_are_told_to_the_same_digit():
    for lead, error, told in (
        (0.042, 0.012, "4.2% ± 1.2%"),
        (0.04167, 0.0003, "4.17% ± 0.03%"),
        (0.04167, 0.0, "4.17% ± 0.01%"),
        (0.04167, np.nan, "4.2%"),
    ):
        assert Winner("s", "a", "b", lead, error).margin == told


def test_what_a_choice_costs():
    """By hand: of three trees, and of two of which SAH names the dearer."""
    scenes = [
        scene_record([tree_row(sah=s, counted_cost=c) for s, c in trees], f"scene {i}")
        for i, trees in enumerate([[(3, 30.0), (1, 10.0), (2, 8.0)], [(5, 7.0), (6, 9.0)]])
    ]
    assert cost_of_choice(scenes, "SAH") == pytest.approx([10 / 8, 1.0])
    assert np.isnan(cost_of_choice(scenes, "finite rays")).all()


def test_the_answer_says_what_the_advice_is_worth(small_study):
    records, advised = small_study.scenes, advice(small_study.correlations)
    line = next(o for o in answer(records, small_study.correlations) if o.startswith("Its choice"))
    for name in {advised.name, "SAH"}:
        over = cost_of_choice(records, name)
        best = int((over == 1).sum()) or "none"
        assert f"{name} puts first is the best in {best} of {len(records)} scenes" in line
        most = over.max() - 1
        assert f"(worst {most:.{2 if 0 < most < 5e-4 else 1}%})" in line


def test_the_answer_says_what_is_left_of_r_without_one_tree(small_study):
    records, advised = small_study.scenes, advice(small_study.correlations)
    line = next(o for o in answer(records, small_study.correlations) if o.startswith("Others"))
    for name in {advised.name, "SAH"}:
        left = []
        for one in samples(records, "counted_cost"):
            values = predictor(name)([one])[1]
            whole = np.corrcoef(values, one.measured)[0, 1]
            rest = [
                np.corrcoef(np.delete(values, i), np.delete(one.measured, i))[0, 1]
                for i in range(len(values))
            ]
            left.append(max(rest, key=lambda r: abs(r - whole)))
        assert f"{name} {np.mean(left):.3f}" in line.partition("in each scene, r is ")[2]


def test_the_answer_takes_ten_lines(small_study):
    lines = answer(small_study.scenes, small_study.correlations)
    assert 3 <= len(lines) <= 10
    assert all(": " in line for line in lines)  # what it is about, and what was found
    assert lines[0].startswith(small_study.scenes[0].scene)
    checked = next(line for line in lines if line.startswith("Checked: "))
    checks = sum(len(tree.audit) for record in small_study.scenes for tree in record.trees)
    assert f"{checks:,} comparisons with independent code, none failed" in checked
    many = [
        dataclasses.replace(r, scene=f"{r.scene}{i}") for i in range(20) for r in small_study.scenes
    ]
    assert len(answer(many, small_study.correlations)) <= 10


def test_the_page_answers_before_its_tables(small_study):
    page = small_study.report.read_text()
    order = [
        'class="answer"',
        'id="best"',
        'id="predicted"',
        'id="predictors"',
        'id="where"',
        'id="claims"',
        'id="scenes"',
        'id="tables"',
    ]
    places = [page.index(what) for what in order]
    assert places == sorted(places)
    before = unescape(page[: places[4]])
    assert "<table" not in before
    for one in predictors():
        if one.name in set(small_study.correlations["predictor"]):
            assert f"<b>{one.name}</b><code>{one.formula}</code>" in before


def test_what_many_rows_share_is_made_once(small_study, monkeypatch):
    asked = []
    monkeypatch.setattr(tidy, "simulated_rays", lambda count, width: asked.append(count) or [0])
    rows = tidy.tidy_table(small_study.scenes)
    assert len(asked) == len(small_study.scenes)
    assert set(rows[rows["measurement"] == "warp_cost"]["rays"]) == {1}
    record = small_study.scenes[0]
    assert record.sample("counted_cost") is record.sample("counted_cost")  # fits to it are kept
    assert record.sample("scalar_ns") is not record.sample("counted_cost")


def test_the_page_stands_alone(small_study):
    page = small_study.report.read_text()
    for text in ("cornell", "hairball", "<svg", "data-tip", "data:image/png;base64,"):
        assert text in page
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)|url\((?!#)|@import|fetch\(""", page)
    inside = set(re.findall(r'id="([^"]+)"', page))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= inside
    assert set(re.findall(r"url\(#([^)]+)\)", page)) <= inside


def test_one_scene_is_told_without_a_worst(small_study):
    record = small_study.scenes[0]
    of = small_study.correlations[small_study.correlations["scene"] == record.scene]
    lines = answer([record], of)
    assert any(line.startswith("Predictor: ") for line in lines)
    assert not [line for line in lines if "worst" in line]
    claims = next(sheet for sheet in answers([record], of) if sheet.name == "claims")
    ours = "\n".join(claims.frame["ours"])
    assert not re.search(r"on average, [\d.]+ at worst|\b(\d\.\d\d) to \1\b", ours)


def test_a_line_that_passes_the_panel_by_is_not_drawn():
    """The dearest tree draws the fitted line away from the others, which fill the panel."""
    values, measured = np.array([1.0, 2, 3, 2]), np.array([1.0, 1.01, 1.02, 100])
    assert not together(measured).all()
    sheet = Drawing(200, 160)
    part = Part(0.0, 0.0, 200.0, 160.0)
    panel = Panel(sheet, part, *limits_beside(values, measured))
    before = sum(isinstance(mark, Stroke) for mark in sheet.marks)
    scatter(panel, "abcd", values, measured, ["tip"] * 4)
    assert sum(isinstance(mark, Stroke) for mark in sheet.marks) == before
    assert sheet.svg(part).count("<g class") == 4
