"""Splitting and merging references: the tree, its cost and its triangles after every step."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import soup
from test_builders_all import room

import mibvh
from mibvh.builders.finish import draft_boxes, finish
from mibvh.builders.options import Options
from mibvh.builders.registry import Context
from mibvh.builders.resplit import Resplitter, Rules, _put_back, _take_out
from mibvh.builders.splitting import pack_boxes
from mibvh.measures import Flux, Segments
from mibvh.measures.boxes import of_boxes

OPTIONS = Options()


def segments(triangles, count=2000):
    rng = np.random.default_rng(3)
    low, high = triangles.bounds
    ends = (low + (high - low) * rng.random((2, count, 3))).astype(np.float32)
    return Segments(*ends, np.zeros(count, np.int32))


def summed(draft, measure):
    """What splitting and merging are to lower."""
    values = of_boxes(measure, draft_boxes(draft))
    inner = draft.left >= 0
    return OPTIONS.c_inner * values[inner].sum() + OPTIONS.c_tri * values[~inner].sum()


def start_of(triangles, start):
    return Context().start(triangles, start, OPTIONS)


CASES = [
    ("bbvh", "area"),
    ("bbvh", "flux"),
    ("sbvh", "area"),
    ("sbvh", "flux"),
    ("streelet", "flux"),
]


@pytest.fixture(params=CASES, ids="-".join)
def case(request):
    """A scene of long triangles, a tree that may split them already, and a measure."""
    start, name = request.param
    triangles = mibvh.Triangles(room(700))
    draft = start_of(triangles, start)
    flux = Flux(segments(triangles), planes=16)
    measure = flux.compiled(draft.references.scale) if name == "flux" else None
    return triangles, draft, measure


def test_cost_falls_and_the_tree_stays_sound(case):
    triangles, draft, measure = case
    state = Resplitter(triangles, draft, OPTIONS, measure, Rules(budget=1.0, trials=2.0))
    before, references = summed(draft, measure), len(draft.references)
    changed = 0
    for step in (state.split, state.merge, state.split, state.merge):
        done = step(Context())
        changed += done
        now = state.draft({})
        after = summed(now, measure)
        assert after <= before * (1 + 1e-6)
        if done:
            assert after < before
        references += done if step == state.split else -done
        assert len(now.references) == references
        tree = finish(
            now,
            c_inner=1.2,
            c_tri=1.0,
            max_leaf=8,
            meta={"triangles": len(triangles)},
            measure=measure,
        )
        assert tree.validate(triangles) == []
        before = after
    assert changed > 10


def test_nothing_changes_where_nothing_is_worth_its_price(case):
    triangles, draft, measure = case
    state = Resplitter(triangles, draft, OPTIONS, measure, Rules(budget=1.0, price=1e6, trials=2.0))
    before = summed(draft, measure)
    assert state.split(Context()) == 0
    now = state.draft({})
    assert summed(now, measure) == pytest.approx(before, rel=1e-9)
    assert sorted(now.references.triangle) == sorted(draft.references.triangle)


def test_everything_merges_where_references_are_dear():
    triangles = mibvh.Triangles(room(700))
    draft = start_of(triangles, "sbvh")
    assert len(draft.references) > len(triangles)
    state = Resplitter(triangles, draft, OPTIONS, None, Rules(budget=1.0, price=1e9))
    for _ in range(9):
        state.merge(Context())
    now = state.draft({})
    np.testing.assert_array_equal(np.sort(now.references.triangle), np.arange(len(triangles)))


def test_the_budget_holds():
    triangles = mibvh.Triangles(room(700))
    draft = start_of(triangles, "bbvh")
    for budget in (0.0, 0.02):
        state = Resplitter(triangles, draft, OPTIONS, None, Rules(budget=budget, trials=2.0))
        state.split(Context())
        assert len(state.draft({}).references) <= (1 + budget) * len(triangles)


def test_what_is_taken_out_and_put_back_is_where_it_was():
    triangles = soup(60)
    draft = start_of(triangles, "bbvh")
    state = Resplitter(triangles, draft, OPTIONS, None, Rules(budget=0.0))
    tree = state.rows, state.rows.view(np.int32), state.up, state.entry_of
    rows, up, entry_of = state.rows.copy(), state.up.copy(), state.entry_of.copy()
    boxes = pack_boxes(draft.references)
    for r in range(len(triangles)):
        entry = int(state.entry_of[r])
        box = np.r_[boxes[r, :3], -boxes[r, 4:7], 0].astype(np.float32)
        saved, place, row = _take_out(None, *tree, entry)
        assert row == entry >> 1
        assert saved > 0
        _put_back(None, *tree, place, entry, box, ~r)
        np.testing.assert_array_equal(state.rows.view(np.int32), rows.view(np.int32))
        np.testing.assert_array_equal(state.up, up)
        np.testing.assert_array_equal(state.entry_of, entry_of)
