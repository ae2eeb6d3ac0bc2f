"""Files that are dropped on the window or chosen in its dialog; without a window."""

import pytest

from assets.asset import Asset
from assets.formats.ply import write_ply
from assets.library import find_asset
from display.panel import demos, line_of, picture_file, variants
from display.preferences import Preferences
from display.user_commands import AddBody, OpenScene, SwapRoom
from display.window.dialogs import OpenDialog
from tests.support.samples import some_gaussians


@pytest.fixture
def dialog():
    return OpenDialog(Preferences())


def test_a_body_and_a_room_are_opened_at_once_and_of_a_splat_it_is_asked(dialog, tmp_path):
    write_ply(tmp_path / "cat.ply", some_gaussians(5))
    Asset(some_gaussians(5)).save(tmp_path / "room.h5")
    dialog.offer([str(find_asset("ball")), str(tmp_path / "room.h5")])
    assert not dialog.shown
    assert dialog.draw() == [AddBody(str(find_asset("ball"))), SwapRoom(str(tmp_path / "room.h5"))]
    assert dialog.draw() == []
    dialog.offer([str(tmp_path / "cat.ply")])
    assert dialog.shown and not dialog._commands
    dialog.close()
    assert not dialog.shown


@pytest.mark.parametrize("name", ["nothing.ply", "notes.txt", "."])
def test_what_cannot_be_opened_is_told_in_the_dialog(name, dialog, tmp_path):
    (tmp_path / "notes.txt").write_text("a")
    dialog.offer([str(tmp_path / name)])
    assert dialog.shown and dialog._problem and "\n" not in dialog._problem


def test_every_scene_and_each_choice_of_it_has_a_picture_and_a_line():
    requests = [request for demo in demos() for request in variants(demo)]
    assert OpenScene("manipulation", {"animal": "bear"}) in requests
    assert all(picture_file(request) for request in requests)
    assert len({picture_file(request) for request in requests}) >= len(requests) - 1
    assert all(0 < len(line_of(demo)) < 90 and "--" not in line_of(demo) for demo in demos())
