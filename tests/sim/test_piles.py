"""A pile at rest gains no energy from contact."""

from bench.setups import resting_pile


def test_a_pile_gains_no_energy_and_calms_down(ti_cpu):
    """Five seconds of sixty. A gain of 1e-5 J lifts a cube by 2 um: fp32 positions jitter by a tenth of that."""
    result = resting_pile(5.0)
    assert result["gained"] < 1e-5, result
    assert result["kinetic_end"] < 0.5 * result["kinetic_start"], result
    assert result["drift"] < 5e-3, result
