"""Materials: the table, and what cannot be one."""

from dataclasses import fields, replace

import pytest

from core.errors import BadInput
from core.material import MATERIALS, Material


@pytest.mark.parametrize("name", MATERIALS)
def test_each_material_is_one_that_the_solver_is_tested_with(name):
    m = Material.named(name)
    m.check(name)
    assert 1e2 <= m.young <= 1e8 and 0 <= m.poisson <= 0.49 and 10 <= m.density <= 10_000
    assert Material.named(name, young=1.0) == replace(m, young=1.0)


def test_an_unknown_name_is_answered_by_the_known_ones():
    with pytest.raises(BadInput, match="'glass' is unknown; one of foam"):
        Material.named("glass")


def test_a_small_animated_body_is_softer_and_a_giant_is_not_stiffer():
    """Young's modulus goes with the square of the height: inertial stresses do."""
    flesh = Material.named("flesh")
    half, quarter = (flesh.animated(height) for height in (0.8, 0.4))
    assert half.young == pytest.approx(4 * quarter.young) and half.young < flesh.young
    assert replace(half, young=flesh.young) == flesh == flesh.animated(3.0)
    assert flesh.animated(0.01).young == 1e3


def test_the_sliding_friction_is_the_static_one_unless_it_is_given():
    assert Material(1e4, 0.3, 100.0, friction=0.7).sliding_friction == 0.7
    assert Material(1e4, 0.3, 100.0, friction=0.7, kinetic_friction=0.0).sliding_friction == 0.0


@pytest.mark.parametrize(
    "changes",
    [
        *({f.name: float("nan")} for f in fields(Material)),
        *({f.name: -0.1} for f in fields(Material)),
        {"young": 0.0},
        {"young": 1e13},  # stiffer than diamond
        {"density": 0.0},
        {"poisson": 0.5},
        {"kinetic_friction": 0.6},
    ],
)
def test_what_no_body_is_made_of_is_refused_by_name(changes):
    with pytest.raises(BadInput, match="here: .*" + next(iter(changes))) as error:
        replace(Material.named("foam"), **changes, **({} if "friction" in changes else {"friction": 0.5})).check("here")
    assert "\n" not in str(error.value)


def test_lame_parameters_give_back_young_and_poisson():
    mu, lam = Material(2e5, 0.3, 1000.0).lame_parameters
    assert mu * (3 * lam + 2 * mu) / (lam + mu) == pytest.approx(2e5) and lam / (2 * (lam + mu)) == pytest.approx(0.3)
