"""Texts of the panel and of the lines over the picture, and the files that are opened; without a window."""

import pytest

from assets.asset import Asset
from assets.formats.ply import write_ply
from assets.library import find_asset
from core.material import MATERIALS
from display.panel import called, changed, demos, line_of, material_sliders, pascals, picture_file, variants
from display.preferences import Preferences
from display.user_commands import AddBody, OpenScene, SwapRoom
from display.window.dialogs import OpenDialog
from display.window.overlay import DEMONSTRATION, PAUSED, lines_of
from display.window.widgets import ACCENT
from tests.support.fake_world import BallWorld, fake_scene
from tests.support.samples import some_gaussians


@pytest.mark.parametrize(
    ("value", "text"), [(812.0, "812 Pa"), (3e4, "30 kPa"), (999.9e3, "1 MPa"), (3.45e6, "3.45 MPa"), (2e9, "2 GPa")]
)
def test_moduli_have_sensible_units(value, text):
    assert pascals(value) == text


@pytest.mark.parametrize(
    ("name", "text"), [("ring_red", "ring red"), ("/home/me/a_cat-b8359fbbd69af50f.h5", "a cat"), ("x-1.h5", "x-1")]
)
def test_a_body_is_called_by_its_file_without_folder_and_digest(name, text):
    assert called(name) == text


def test_what_slides_keeps_its_ratio_to_what_sticks():
    rubber = MATERIALS["rubber"]
    slippery = changed(rubber, "friction", 0.5)
    assert (slippery.friction, slippery.kinetic_friction) == (0.5, pytest.approx(0.4))
    assert changed(rubber, "young", 1e5).kinetic_friction == rubber.kinetic_friction
    changed(changed(rubber, "friction", 0.0), "friction", 0.3).check("here")


def test_rigid_bodies_have_only_the_sliders_that_mean_something():
    world = BallWorld(fake_scene())

    def names() -> list[str]:
        return [slider.name for slider in material_sliders(world, 0)]

    assert names() == ["stiffness", "density", "friction", "damping"]
    world.stuff = MATERIALS["clay"], "clay"
    assert names() == ["stiffness", "density", "friction", "damping", "yields at"]
    world.stuff = world.stuff[0], "rigid"
    assert names() == ["density", "friction"]


def test_lines_over_the_picture_say_that_a_demonstration_plays():
    world = BallWorld(fake_scene())
    assert [[text for text, _ in line] for line in lines_of(world)] == [["Throw the red ball."]]
    world.demo = True
    world.notice = "There is no capacity for that."
    texts = [[text for text, _ in line] for line in lines_of(world)]
    assert texts == [["Throw the red ball."], [DEMONSTRATION], ["There is no capacity for that."]]
    world.paused = True
    assert lines_of(world)[1] == [(PAUSED, ACCENT)]


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
