"""Styles of traversal in a study: timed, and simulated beside it."""

import json

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mibvh
from mibvh.cli import app
from mibvh.metrics.predictor import pearson
from mibvh.studies.analyse.styles import style_agreement, style_trees
from mibvh.studies.measure.styles import StylesResult
from mibvh.studies.run import read_study
from mibvh.traversal.styles import STYLES
from mibvh.variant import lane_width

BUILDERS = ("bbvh", "sbvh", "lbvh")
CHOICES = {"width": 24, "height": 16, "scalar_rays": 256, "seconds": 0.0, "builders": BUILDERS}


@pytest.fixture(scope="module")
def finished(tmp_path_factory, cornell):
    folder = tmp_path_factory.mktemp("styles")
    return mibvh.study([cornell], folder, styles=tuple(STYLES), **CHOICES)


def test_costs_are_what_the_kernels_packets_issue(finished, cornell):
    rays = mibvh.diffuse_rays(cornell, width=24, height=16, samples=1)
    found = finished.scenes[0].result(StylesResult)
    assert [run.style for run in found.runs] == list(STYLES)
    assert found.lane_width == lane_width()
    for run in found.runs:
        for builder, tree in zip(BUILDERS, run.trees, strict=True):
            hits = mibvh.trace(
                mibvh.build(cornell.triangles, builder),
                cornell.triangles,
                rays,
                style=run.style,
                repeats=1,
            )
            if run.style == "wide":
                assert tree.scalar_cost == hits.steps.mean()
                assert tree.cost == hits.issued / len(rays)
                continue
            assert tree.scalar_cost == pytest.approx(hits.counted_cost(), rel=1e-12)
            # A node step costs 1.2, a triangle step 1.0, and both are steps of the packet.
            steps = hits.issued / len(rays)
            if run.style == "single":
                # Lanes that want a node and lanes that want a triangle take their steps at once.
                assert steps <= tree.cost <= 2.2 * steps
            else:
                assert steps <= tree.cost <= 1.2 * steps


def test_single_is_timed_once(finished):
    record = finished.scenes[0]
    run = record.result(StylesResult).runs[0]
    assert [tree.simd_ns for tree in run.trees] == record.column("simd_ns").tolist()
    assert [tree.scalar_ns for tree in run.trees] == record.column("scalar_ns").tolist()
    assert all(tree.simd_ns > 0 for run in record.result(StylesResult).runs for tree in run.trees)


def test_tables_and_files(finished):
    trees = style_trees(finished.scenes)
    assert len(trees) == len(STYLES) * len(BUILDERS)
    for _, of in trees.groupby("style"):
        np.testing.assert_allclose(of[["timed", "simulated"]].mean(), 0, atol=1e-12)
        ratio = np.log(of["cost"] / of["scalar_cost"])
        np.testing.assert_allclose(of["simulated"], ratio - ratio.mean())
    agreement = style_agreement(trees).set_index("style")
    wide = trees[trees["style"] == "wide"]
    assert agreement["r"]["wide"] == pytest.approx(
        pearson(wide["simulated"].to_numpy(), wide["timed"].to_numpy())
    )
    tidy = pd.read_parquet(finished.folder / "results.parquet")
    tidy = tidy[tidy["experiment"] == "styles"].set_index(["builder", "measurement"])["value"]
    of = trees.set_index(["style", "builder"])
    for style in STYLES:
        name = style.replace("-", "_")
        for builder in BUILDERS:
            assert tidy[builder, f"{name}_simd_ns"] == of["simd_ns"][style, builder]
            assert tidy[builder, f"{name}_packet_cost"] == of["cost"][style, builder]
    assert "Does the simulation foretell" in finished.report.read_text()
    assert read_study(finished.folder).scenes[0].result(StylesResult) is not None


def test_a_second_run_measures_nothing_and_the_default_has_no_styles(finished, cornell):
    again = mibvh.study([cornell], finished.folder, styles="single,wide", **CHOICES)
    reused = again.scenes[0].reused["styles"]
    assert reused == 2 * (2 + len(BUILDERS))
    first, second = (
        {run.style: run for run in study.scenes[0].result(StylesResult).runs}
        for study in (finished, again)
    )
    assert second == {style: first[style] for style in ("single", "wide")}
    plain = mibvh.study([cornell], finished.folder, **CHOICES)
    assert plain.scenes[0].results.keys() == {"depth"}


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"styles": "double"}, "style must be one of single, while-while, speculative, wide"),
        ({"styles": ()}, "styles names no style"),
        ({"styles": "wide,wide"}, "styles names one twice"),
        ({"styles": "wide", "cull": True}, "does not re-test popped nodes"),
    ],
)
def test_impossible_styles(choices, said):
    with pytest.raises(mibvh.MibvhError, match=said):
        mibvh.StudyOptions(**choices)


def test_command(tmp_path):
    found = CliRunner().invoke(
        app,
        [
            "study",
            "cornell@300",
            "-o",
            str(tmp_path),
            "--builders",
            "bbvh,lbvh,sbvh",
            "--seconds",
            "0",
            "--styles",
            "single,speculative",
            "--json",
        ],
    )
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout.splitlines()[-1])["event"] == "result"
    (record,) = read_study(tmp_path).scenes
    assert [run.style for run in record.result(StylesResult).runs] == ["single", "speculative"]
    assert record.options.styles == ("single", "speculative")
