"""The body that edits mean is marked by corners, and only when the user may want to know."""

from types import SimpleNamespace as N

import numpy as np
from numpy.testing import assert_allclose

from display.edit import selection_marker as marking
from display.edit.editor import Editor
from display.edit.selection_marker import marked, strokes
from display.user_commands import Select, Undo
from display.xr import avatar


def body(held=False, high=(0.2, 0.1, 0.3)):
    return N(low=np.zeros(3), high=np.array(high), held=held)


def world(selected=0, chosen=False, **how):
    return N(selected=selected, recently_selected=chosen, bodies=lambda: [body(**how)])


def test_it_is_marked_when_it_was_chosen_or_an_edit_is_near():
    assert marked(world(), near=False) is None
    assert marked(world(chosen=True), near=False) is not None
    assert marked(world(), near=True) is not None
    for other in (world(selected=None), world(selected=3), world(held=True), world(high=(np.nan, 1, 1))):
        assert marked(other, near=True) is None


def test_strokes_go_along_the_edges_of_a_box_around_the_body():
    found = strokes(body())
    assert found.shape == (24, 2, 3)
    low, high = -marking.CORNER_GAP, np.array([0.2, 0.1, 0.3]) + marking.CORNER_GAP
    assert (found >= low - 1e-9).all() and (found <= high + 1e-9).all()
    along = np.abs(found[:, 1] - found[:, 0])
    assert (np.count_nonzero(along > 1e-9, axis=1) == 1).all()
    assert_allclose(along.max(1), marking.MAX_STROKE)
    assert len(np.unique(found[:, 0].round(6), axis=0)) == 8


def test_the_headset_shows_the_same_strokes():
    parts = avatar.hidden()
    avatar.show_corners(parts, body())
    ends = np.einsum("kij,sj->ksi", parts[avatar.CORNERS :], np.column_stack([np.eye(3), np.ones(3)])).reshape(-1, 3)
    assert_allclose(ends, strokes(body())[:, 1], atol=1e-12)
    assert np.isnan(parts[: avatar.CORNERS]).all()


def test_commands_choose_for_a_moment(monkeypatch):
    now = [10.0]
    monkeypatch.setattr("display.edit.editor.monotonic", lambda: now[0])
    editor = Editor(None, N(members=(None, None)))
    editor.apply([Undo()])
    assert not editor.recently_selected
    editor.apply([Select(1)])
    assert editor.recently_selected
    now[0] += marking.MARKED_SECONDS + 0.1
    assert not editor.recently_selected
