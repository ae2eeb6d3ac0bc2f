"""Stiffness with which a body bears its own weight, against the theory of columns, and the material it gets."""

from dataclasses import replace

import numpy as np
import pytest

from core.material import MATERIALS
from core.tetmesh import box_mesh
from prepare.standing import bearing_modulus, described, rounded_up, suitable_material

PLUSH = MATERIALS["plush"]
G = 9.81


def column(width: float, height: float, across: int):
    """Vertices and tets of an upright column of square cross section, with cubic cells."""
    x, tets, _ = box_mesh((width, height, width), (across, round(across * height / width), across))
    return x, tets


def test_a_slender_column_keeps_away_from_buckling():
    """A column of width b buckles at q L^3 = 7.84 EI: E = 12 rho g L^3 / (7.84 b^2); we want five times that.

    The foot that is held takes 8 % of the length; linear tets are too stiff in bending, with six across by 10 %.
    """
    b, length = 0.05, 0.5
    wanted = 5 * 12 * PLUSH.density * G * (0.92 * length) ** 3 / (7.84 * b * b)
    assert bearing_modulus(*column(b, length, 6), PLUSH) == pytest.approx(wanted, rel=0.25)


def test_a_stout_body_is_measured_by_its_sag():
    """A wide slab is shortened by its weight: mean strain rho g h / 2E of at most 5 %, with nothing to the sides."""
    x, tets, _ = box_mesh((1.0, 0.2, 1.0), (10, 4, 10))
    flat = replace(PLUSH, poisson=0.0)
    assert bearing_modulus(x, tets, flat) == pytest.approx(PLUSH.density * G * 0.2 / (2 * 0.05), rel=0.25)


def test_it_grows_with_the_cube_of_the_slenderness_and_with_the_size():
    thin, thick = (bearing_modulus(*column(b, 0.4, 3), PLUSH) for b in (0.04, 0.08))
    x, tets = column(0.04, 0.4, 3)
    assert thin > 2.5 * thick
    assert bearing_modulus(3 * x, tets, PLUSH) == pytest.approx(3 * thin, rel=1e-3)  # the dimensions of stress
    assert bearing_modulus(x, tets, replace(PLUSH, density=200.0)) == pytest.approx(2 * thin, rel=1e-6)


def test_iteration_and_elimination_agree(monkeypatch):
    x, tets = column(0.05, 0.3, 4)
    direct = bearing_modulus(x, tets, PLUSH)
    monkeypatch.setattr("prepare.standing.DIRECT_SIZE", 0)
    assert bearing_modulus(x, tets, PLUSH) == pytest.approx(direct, rel=1e-2)


def test_of_several_pieces_each_must_stand():
    (x, tets), (y, other) = column(0.05, 0.5, 3), column(0.2, 0.2, 3)
    both = np.concatenate([x, y + [1.0, 0.3, 0.0]]), np.concatenate([tets, other + len(x)])
    assert bearing_modulus(*both, PLUSH) == pytest.approx(bearing_modulus(x, tets, PLUSH))


def test_a_body_on_an_edge_is_measured_by_what_it_falls_onto():
    """A cube that leans stands on no edge: the lowest part with its middle above it counts."""
    x, tets = column(0.2, 0.2, 4)
    c, s = np.cos(0.35), np.sin(0.35)
    assert bearing_modulus(x @ [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], tets, PLUSH) < PLUSH.young


def test_a_plush_stays_soft_and_a_slender_figure_is_stiffened():
    material, found = suitable_material(*column(0.2, 0.25, 4))
    assert material == PLUSH and "plush; it needs" in described(found)
    material, found = suitable_material(*column(0.04, 0.5, 3))
    assert (
        material == replace(PLUSH, young=found["young"]) and found["needed"] <= found["young"] <= 2.5 * found["needed"]
    )
    assert "stiffened from 1e+04 to" in described(found)


def test_moduli_are_round():
    for young, rounded in ((1e4, 1e4), (1.01e4, 2e4), (3e5, 5e5), (5.1e5, 1e6), (99.0, 100.0)):
        assert rounded_up(young) == pytest.approx(rounded)
