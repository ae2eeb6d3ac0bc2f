"""Choice of integrator and substep, the schedule of a frame, and bodies too light and stiff for a usual substep."""

import numpy as np
import pytest

from bench.physics import box
from core.errors import BadInput
from core.material import Material
from sim.bodies import SoftBody
from sim.model import BodyModel
from sim.time_step import (
    Schedule,
    choose_integration,
    clamp_stiffness,
    largest_substep,
    stiffness_bounds,
    wave_speed,
)

FRAME = 1 / 60


def test_the_cheaper_integrator_is_chosen_or_what_is_forced():
    few, many = ((0.3 * 60 * n) ** 2 for n in (100, 1000))  # kappa of so many substeps a frame
    chosen = choose_integration(few, frame_dt=FRAME)
    assert chosen.integrator == "xpbd"
    assert chosen.substep == pytest.approx(FRAME / 100) and chosen.substep == largest_substep(few)
    stiff = choose_integration(many, frame_dt=FRAME)
    assert stiff.integrator == "vbd" and stiff.substep > 10 * largest_substep(many)
    assert choose_integration(many, frame_dt=FRAME, integrator="xpbd").substep == largest_substep(many)
    assert choose_integration(many, frame_dt=FRAME, substep=FRAME / 1000).integrator == "xpbd"
    forced = choose_integration(few, frame_dt=FRAME, substep=FRAME / 50)
    assert (forced.integrator, forced.substep) == ("vbd", FRAME / 50)
    assert choose_integration(few, frame_dt=FRAME, integrator="vbd").integrator == "vbd"
    for wrong, says in (
        ({"integrator": "magic"}, "integrator"),
        ({"substep": 0.0}, "substep"),
        ({"substep": 1.0}, "substep"),
        ({"integrator": "xpbd", "substep": FRAME / 50}, "brick: .*not stable"),
    ):
        with pytest.raises(BadInput, match=says):
            choose_integration(few, frame_dt=FRAME, stiffest="brick", **wrong)
    with pytest.raises(BadInput, match="brick: too stiff"):
        choose_integration(1e6 * many, frame_dt=FRAME, integrator="xpbd", stiffest="brick")


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.49])
def test_kappa_bounds_the_frequency_of_a_tet_and_is_met_where_one_corner_is_light(poisson):
    """K_ab = V (mu (g_a . g_b I + g_b g_a^T) + lambda_L g_a g_b^T), the stiffness of linear elasticity at rest."""
    material, rng = Material(2e5, poisson, 900.0), np.random.default_rng(0)
    mu, lame_lambda = material.lame_parameters
    for k in range(40):
        inverse, volume, w = np.linalg.inv(rng.normal(size=(3, 3))), rng.uniform(0.1, 2.0), rng.uniform(0.5, 2.0, 4)
        w[k % 4] *= 1e6 if k < 20 else 1.0
        g = np.concatenate([-inverse.sum(0, keepdims=True), inverse])
        K = mu * (np.einsum("ac,bc,ij->aibj", g, g, np.eye(3)) + np.einsum("bi,aj->aibj", g, g))
        K = volume * (K + lame_lambda * np.einsum("ai,bj->aibj", g, g)).reshape(12, 12)
        root = np.sqrt(np.repeat(w, 3))
        largest = np.linalg.eigvalsh(root[:, None] * K * root)[-1]
        kappa = stiffness_bounds(inverse[None], np.array([volume]), w[None], material)[0]
        assert largest <= kappa * (1 + 1e-9)
        assert k >= 20 or largest > 0.99 * kappa


@pytest.mark.parametrize("substeps, searches, limit", [(400, 3, 16), (7.2, 1, 16), (1, 10, 128), (100, 7, 128)])
def test_a_frame_is_divided_evenly(substeps, searches, limit):
    """All substeps are made, no launch is too long, and searches are one launch apart from evenly spread at most."""
    schedule = Schedule.of(substeps, searches, limit)
    assert schedule.total_substeps >= substeps and schedule.substeps <= limit and len(schedule.launches) == searches
    assert schedule.total_substeps - max(substeps, searches) < sum(schedule.launches)
    assert min(schedule.launches) >= 1 and np.ptp(schedule.launches) <= 1


def test_a_wave_crosses_few_lengths_of_a_body_in_a_substep():
    """Fewer crossings shorten the substep in proportion; below the least one, the material is softened instead."""
    usual = choose_integration(1e12, frame_dt=FRAME).substep
    short, shorter = (choose_integration(1e12, frame_dt=FRAME, crossing_time=usual / n).substep for n in (20, 40))
    assert choose_integration(1e12, frame_dt=FRAME, crossing_time=usual).substep == usual
    assert short < usual and shorter == pytest.approx(short / 2)
    wood = Material(1e8, 0.3, 500.0)
    assert clamp_stiffness(wood, 0.2) is wood
    assert wave_speed(Material(1e6, 0.0, 1000.0)) == pytest.approx(np.sqrt(1e6 / 1000))  # then lambda_L + 2 mu = E
    x, tets, surface = box((0.06, 0.06, 0.06), (1, 1, 1))
    straw = BodyModel.of(SoftBody("straw", x, tets, surface, Material(1e8, 0.49, 10.0)), [])
    assert straw.material.young < straw.body.material.young and straw.material.density == 10.0
    chosen = choose_integration(1e12, frame_dt=FRAME, crossing_time=straw.crossing_time)
    assert chosen.substep == pytest.approx(
        choose_integration(1e12, frame_dt=FRAME, crossing_time=0.06 / wave_speed(straw.material)).substep
    )
    assert straw.scaled(10.0).material.young == 1e8  # ten times as long to cross
