"""Texts of the panel and of the lines over the picture, without a window."""

import pytest

from core.material import MATERIALS
from display.panel import called, changed, material_sliders, pascals
from display.window.overlay import DEMONSTRATION, PAUSED, lines_of
from display.window.widgets import ACCENT
from tests.support.fake_world import BallWorld, fake_scene


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
