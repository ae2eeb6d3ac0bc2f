"""Static and kinetic friction: a block on a plane and a block on another body, on a slope that is tilted by and by."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.sample_meshes import box
from core.errors import BadInput
from core.material import Material
from scenes.scene import Plane
from sim.soft_body import SoftBody
from sim.solver import Solver

DT, G = 1 / 60, 9.81
HOLDS, SLIDES = 0.5, 0.35  # of block against floor, and of block against slab
BLOCK = Material(1e5, 0.3, 1000.0, friction=HOLDS, kinetic_friction=SLIDES**2 / HOLDS, damping=30.0)
SLAB = Material(1e5, 0.3, 1000.0, friction=HOLDS)


@pytest.fixture(scope="module")
def slope(ti_cpu):
    """A flat block on the plane, and another on a slab whose vertices are all held: response of vertices, and rows."""
    x, tets, surface = box((0.12, 0.04, 0.12), (3, 1, 3))
    slab_x, slab_tets, slab_surface = box((1.6, 0.05, 0.3), (4, 1, 2))
    return Solver(
        [
            SoftBody("block", x, tets, surface, BLOCK),
            SoftBody("rider", x, tets, surface, BLOCK, position=(0.05, 0.1, 3.0)),
            SoftBody(
                "slab", slab_x, slab_tets, slab_surface, SLAB, position=(0, 0.05, 2.9), pinned=np.arange(len(slab_x))
            ),
        ],
        [Plane((0, 0, 0), (0, 1, 0), HOLDS)],
        hands=0,
    )


def lean(solver, angle, seconds):
    """Let the ground fall by `angle` [rad] along +x for so long."""
    solver.gravity = (G * np.sin(angle), -G * np.cos(angle), 0.0)
    for _ in range(round(seconds / DT)):
        solver.step(DT, [])


def tilt(solver, angle, seconds):
    for share in np.linspace(0, 1, 40):
        lean(solver, share * angle, seconds / 40)


def along(solver):
    """Place [m] and velocity [m/s] of both blocks along the slope."""
    blocks = solver.bodies()[:2]
    return np.array([[b.centroid[0], b.velocity[0]] for b in blocks]).T


def test_blocks_hold_up_to_static_friction_then_slide_with_the_kinetic_one(slope):
    slope.reset()
    angle = np.arctan(HOLDS)
    tilt(slope, angle - np.radians(1), 1.5)
    lean(slope, angle - np.radians(1), 0.5)
    before, _ = along(slope)
    lean(slope, angle - np.radians(1), 1.0)
    held, _ = along(slope)
    assert np.abs(held - before).max() < 2e-4, held - before  # what rests on a body still creeps, by 0.1 mm/s
    angle += np.radians(1)
    lean(slope, angle, 0.1)
    _, v = along(slope)
    lean(slope, angle, 0.2)
    x, after = along(slope)
    assert (x - held > 2e-2).all(), x - held
    assert_allclose(after - v, 0.2 * G * (np.sin(angle) - SLIDES * np.cos(angle)), rtol=0.05)


def test_what_slides_keeps_sliding_where_it_would_have_held(slope):
    """Between atan(mu_k) and atan(mu_s): at rest it stays, once pushed it gains speed."""
    slope.reset()
    angle = 0.5 * (np.arctan(HOLDS) + np.arctan(SLIDES))
    tilt(slope, angle, 0.8)
    still = slope.snapshot()
    v = np.zeros_like(still["v"])
    v[: slope.vertex_offset[2], 0] = 0.1
    slope.restore({**still, "v": v})
    lean(slope, angle, 0.1)
    _, v = along(slope)
    lean(slope, angle, 0.2)
    assert_allclose(along(slope)[1] - v, 0.2 * G * (np.sin(angle) - SLIDES * np.cos(angle)), rtol=0.05)


@pytest.mark.parametrize("kinetic", [-0.1, 0.6])
def test_kinetic_friction_out_of_range_is_refused(kinetic):
    x, tets, surface = box((1, 1, 1), (1, 1, 1))
    body = SoftBody("block", x, tets, surface, Material(1e5, 0.3, 1e3, friction=0.5, kinetic_friction=kinetic))
    with pytest.raises(BadInput, match=r"block: .*kinetic_friction"):
        body.check()
