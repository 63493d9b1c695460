"""The progress of a study: JSON lines for machines, next to nothing where nobody looks."""

import io
import json

import pytest

from mibvh.studies.record.progress import LEFT_OUT, MISSING, Progress
from mibvh.studies.report import board
from mibvh.studies.report.board import Board

STEPS = [
    Progress("one", "", "rays", None, 0.0),
    Progress("one", "", "build", "bbvh", 0.25),
    Progress("one", "rotation", "build", "bbvh", 0.5),
    Progress("one", "", "done", None, 1.0),
    Progress("two", "", "count", "lbvh", 0.5),
    Progress("two", "", "done", None, 1.0),
]


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that goes on by ten seconds at each step of a study."""
    now = [100.0]
    monkeypatch.setattr(board.time, "monotonic", lambda: now[0])
    return now


def show(clock, lines):
    with Board(2, lines) as shown:
        for step in STEPS:
            shown(step)
            clock[0] += 10


def test_lines_for_machines(capsys, clock):
    show(clock, lines=True)
    out, err = capsys.readouterr()
    lines = [json.loads(line) for line in out.splitlines()]
    assert err == ""
    assert {line["event"] for line in lines} == {"progress"}
    told = (
        "scene",
        "experiment",
        "stage",
        "builder",
        "done",
        "seconds_left",
        "scenes_done",
        "all_seconds_left",
    )
    assert [tuple(line[name] for name in told) for line in lines] == [
        ("one", "", "rays", None, 0.0, None, 0, None),
        # A quarter of the first of two scenes took ten seconds.
        ("one", "", "build", "bbvh", 0.25, 30.0, 0, 70.0),
        ("one", "rotation", "build", "bbvh", 0.5, 20.0, 0, 60.0),
        ("one", "", "done", None, 1.0, 0.0, 1, 30.0),
        ("two", "", "count", "lbvh", 0.5, 0.0, 1, 13.3),
        ("two", "", "done", None, 1.0, 0.0, 2, 0.0),
    ]


def test_a_stage_is_told_once_a_second(capsys, clock):
    with Board(1, lines=True) as shown:
        for i in range(30):
            shown(Progress("one", "", "time scalar", None, 0.5 + i / 100))
            clock[0] += 0.1
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_quiet_where_nobody_looks(capsys, clock):
    show(clock, lines=False)
    assert capsys.readouterr() == ("", "one: done (1 of 2)\ntwo: done (2 of 2)\n")


def test_bars_on_a_terminal(monkeypatch, clock):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    show(clock, lines=False)
    assert "study: 2 of 2 scenes" in terminal.getvalue()
    assert "\x1b[" in terminal.getvalue()


def test_a_step_in_words():
    assert str(STEPS[0]) == "rays"
    assert str(STEPS[2]) == "build bbvh (rotation)"


def test_a_piped_study_gives_signs_of_life(capsys, clock):
    """Before the first scene, within a step that takes long, and while the report is written."""
    with Board(1, lines=False) as shown:
        shown._sign_of_life()
        shown(STEPS[0])
        clock[0] += 30
        shown(STEPS[1])
        shown._sign_of_life()
        shown(STEPS[3])
        shown._sign_of_life()
    assert capsys.readouterr().err.splitlines() == [
        "study: load (0%)",
        "one: build bbvh (25%, 1:30 left)",
        "one: done (1 of 1)",
        "study: report (0%)",
    ]


def test_scenes_that_are_left_out_are_over(capsys, clock):
    """The last stage is the report, also where a scene could not be studied."""
    with Board(2, True) as shown:
        for step in (STEPS[0], STEPS[3], Progress("two", "", LEFT_OUT, None, 1.0)):
            shown(step)
        shown._sign_of_life()
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["scenes_done"] for line in lines] == [0, 1, 2, 2]
    assert [line["stage"] for line in lines] == ["rays", "done", "left out", "report"]
    with Board(1, False) as shown:
        shown(Progress("two", "", LEFT_OUT, None, 1.0))
    assert capsys.readouterr().err == "two: left out (1 of 1)\n"


def test_what_is_missing_is_told_at_once(capsys, clock):
    """In lines, in words and between bars; it is no step, so that nothing begins anew."""
    mine = Progress("one", "", MISSING, "mine", 0.0, missing="tree mine is missing: [no] luck")
    gone = Progress("two", "", LEFT_OUT, None, 1.0, missing="left out: no camera")
    steps = (STEPS[1], mine, mine, STEPS[2], gone)
    with Board(2, True) as shown:
        for step in steps:
            shown(step)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    told = [None, mine.missing, mine.missing, None, gone.missing]
    assert [line["missing"] for line in lines] == told
    assert lines[3]["done"] == 0.5
    with Board(2, False) as shown:
        for step in steps:
            shown(step)
    assert capsys.readouterr().err.splitlines() == [
        "mibvh: one: tree mine is missing: [no] luck",
        "mibvh: one: tree mine is missing: [no] luck",
        "mibvh: two: left out: no camera",
        "two: left out (1 of 2)",
    ]


def test_what_is_missing_is_told_beside_bars(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    screen = Terminal()
    monkeypatch.setattr(board.sys, "stderr", screen)
    with Board(1, False) as shown:
        shown(Progress("one", "", MISSING, "mine", 0.0, missing="tree mine is missing: [no] luck"))
    assert "one: tree mine is missing: [no] luck" in screen.getvalue()
