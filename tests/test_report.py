"""The report's tables, in every form, and its figures as files."""

import csv
import io
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from mibvh.studies.record.sheet import Column, Sheet
from mibvh.studies.report.plots import panels

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


@pytest.mark.parametrize("name", ["overview-counted_cost", "trees", "stopwatch"])
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
        assert (small_study.folder / f"figures/{scene}-{name}.png").stat().st_size > 5000
        drawn = (small_study.folder / f"figures/{scene}-{name}.svg").read_text()
        assert "currentColor" not in drawn
        assert drawn.count('data-builder="lbvh"') == 2  # once per panel


def test_builders_are_named_below_the_curves_of_a_file_and_once_on_the_page(small_study):
    scene = small_study.scenes[0].scene
    drawn = (small_study.folder / f"figures/{scene}-depth.svg").read_text()
    assert re.findall(r">(\w*bvh)</text>", drawn) == ["bbvh", "lbvh"]
    for panel in panels(drawn):
        assert ElementTree.fromstring(panel).tag.endswith("svg")
        assert "lbvh</text>" not in panel


def test_the_page_stands_alone(small_study):
    page = small_study.report.read_text()
    for text in ("cornell", "hairball", "<svg", "data-tip", "data:image/png;base64,"):
        assert text in page
    assert not re.findall(r"""(?:src|href)=["'](?!#|data:)|url\((?!#)|@import|fetch\(""", page)
    inside = set(re.findall(r'id="([^"]+)"', page))
    assert set(re.findall(r'href="#([^"]+)"', page)) <= inside
    assert set(re.findall(r"url\(#([^)]+)\)", page)) <= inside
