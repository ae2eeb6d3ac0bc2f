"""Deformable bodies against one another, through the solver."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.physics import box, torus
from bench.physics_contact import run
from core.material import Material
from core.vocabulary import Capsule
from sim.bodies import SoftBody
from sim.contact.nearest_tet import tet_neighbors
from sim.model import RestShape
from sim.solver import Solver
from tests.support.soft_world import FLOOR, soft_solver, vertices_of

SOFT = Material(young=5e4, poisson=0.3, density=1000.0, friction=0.5, damping=8.0)
RUBBER = Material(young=3e4, poisson=0.4, density=1100.0, friction=0.6, damping=4.0)
DT = 1 / 60
SIDE = 0.08


@pytest.fixture(scope="module")
def cubes(ti_cpu):
    """Two cubes, one upon the other, and turned against it."""
    x, tets, surface = box((SIDE,) * 3, (2, 2, 2))
    turned = (np.cos(0.2), 0, np.sin(0.2), 0)
    low = SoftBody("low", x - SIDE / 2, tets, surface, SOFT, position=(0, 0.04, 0))
    high = SoftBody("high", x - SIDE / 2, tets, surface, SOFT, turned, (0.001, 0.122, 0))
    return soft_solver([low, high])


@pytest.fixture(autouse=True)
def gravity_down(request):
    if "cubes" in request.fixturenames:
        request.getfixturevalue("cubes").reset()
        request.getfixturevalue("cubes").gravity = (0.0, -9.81, 0.0)


def speed(solver):
    return np.linalg.norm(solver.v.to_numpy()[: solver.state.sizes.vertices], axis=1)


def rows(solver):
    """Point, distance, normal and impulse of the listed pair rows."""
    contacts = solver.contacts
    r, n = contacts.constraints.candidate.to_numpy(), contacts.constraints.candidate_count[None]
    r = np.sort(r[:n][r[:n] >= contacts.deformable.begin])
    table = (contacts.constraints.phi, contacts.constraints.normal, contacts.constraints.impulse)
    return r - contacts.deformable.begin, *(f.to_numpy()[r] for f in table)


def test_neighbours_share_a_face():
    x, tets, surface = box((1, 1, 1), (3, 2, 2))
    across = tet_neighbors(RestShape(x, tets, surface, None))
    assert (across == -1).sum() == len(surface)
    for t, k in np.argwhere(across >= 0):
        assert set(np.delete(tets[t], k)) < set(tets[across[t, k]])


def test_what_is_pushed_out_of_the_floor_does_not_enter_what_is_above_it(cubes):
    """At rest without gravity nothing is expected to move: the margin of the search covers the first push."""
    cubes.gravity = (0.0, 0.0, 0.0)
    low, high = vertices_of(cubes)
    sunk, above = low - [0, 0.009, 0], high - [0, high[:, 1].min() - (low[:, 1].max() - 0.0075), 0]
    cubes.restore({"x": np.concatenate([sunk, above]), "v": np.zeros((len(low) + len(high), 3))})
    for _ in range(9):
        cubes.step(DT)
        pushed, met = cubes.bodies()
        assert pushed.high[1] - met.low[1] < 1.5e-3
    assert pushed.low[1] > -0.001


def test_a_stack_comes_to_rest_and_stays(cubes):
    run(cubes, 4)
    before, fastest = vertices_of(cubes), speed(cubes).max()
    assert fastest < 5e-3
    run(cubes, 6)
    assert speed(cubes).max() < max(0.5 * fastest, 1e-4)
    drift = np.abs(np.concatenate(vertices_of(cubes)) - np.concatenate(before)).max()
    assert drift < 1e-3, drift
    low, high = cubes.bodies()
    assert low.low[1] > -1e-4
    assert_allclose(high.low[1], low.high[1], atol=2e-3)  # the upper one sinks in where the lower one yields


def test_a_stack_carries_its_weight(cubes):
    run(cubes, 6)
    p, phi, _, impulse = rows(cubes)
    body = cubes.contacts.samples.body.to_numpy()[p]
    force = (impulse * np.where(body == 1, 1, -1)[:, None]).sum(0) / cubes.state.dt[None] ** 2
    weight = SIDE**3 * 1000 * 9.81
    assert_allclose(force, [0, weight, 0], atol=0.02 * weight)
    assert_allclose(cubes.contact_forces(), [[0, weight, 0]] * 2, atol=0.02 * weight)
    assert phi.min() > -1e-4


def test_friction_holds_a_stack_on_a_slope(cubes):
    """Friction 0.5 on both contacts; the ground falls by 10 degrees at once, then by 45."""
    run(cubes, 2)
    before = vertices_of(cubes)
    cubes.gravity = (9.81 * np.sin(np.radians(10)), -9.81 * np.cos(np.radians(10)), 0.0)
    run(cubes, 2)
    moved = [np.abs(a.mean(0) - b.mean(0)).max() for a, b in zip(vertices_of(cubes), before, strict=True)]
    assert max(moved) < 8e-3, moved  # they lean
    cubes.gravity = (9.81 * np.sin(np.radians(45)), -9.81 * np.cos(np.radians(45)), 0.0)
    run(cubes, 1)
    assert vertices_of(cubes)[0][:, 0].mean() > 0.2


def test_a_collision_conserves_momentum(cubes):
    """The upper cube comes down at 5 m/s and must not pass; both momenta to 1e-4 of what is exchanged."""
    cubes.gravity = (0.0, 0.0, 0.0)
    start = cubes.snapshot()
    x, v = start["x"].astype(np.float64), np.zeros_like(start["x"])
    n = cubes.vertex_offset[1]
    x[:, 1] += 0.5
    x[n:, 1] += 0.05
    v[n:, 1] = -5
    cubes.restore({"x": x, "v": v})
    m = cubes.state.mass.to_numpy()[: len(x), None].astype(np.float64)
    before = (m * v).sum(0), (m * np.cross(x, v)).sum(0)
    run(cubes, 0.1)
    x, v = np.concatenate(vertices_of(cubes)), cubes.v.to_numpy()[: len(x)]
    assert_allclose((m * v).sum(0), before[0], atol=1e-4 * 2.5)
    assert_allclose((m * np.cross(x, v)).sum(0), before[1], atol=2e-3 * 0.3)  # normals are those before the step
    assert vertices_of(cubes)[1][:, 1].mean() > vertices_of(cubes)[0][:, 1].mean() + 0.05
    assert v[:n, 1].mean() < -1.5
    assert 0.5 * (m * v**2).sum() < 0.5 * SIDE**3 * 1000 * 25


def test_distance_and_normal_in_a_deformed_host(cubes):
    """For x = A X + t: phi = phi_0 / |A^-T N| and n = A^-T N / |A^-T N| at the host's upper face."""
    A = np.array([[1.1, 0.2, 0.0], [0.1, 0.9, 0.05], [0.0, -0.1, 1.05]])
    rest = cubes.state.rest.to_numpy()[: cubes.state.sizes.vertices].astype(np.float64)
    n = cubes.vertex_offset[1]
    x = np.concatenate([rest[:n] @ A.T, (0.5 * rest[n:] + (0, 0.0615, 0)) @ A.T]) + (0, 1, 0)
    cubes.gravity = (0.0, 0.0, 0.0)
    cubes.restore({"x": x, "v": np.zeros_like(x)})
    cubes.step(1e-6, [])
    p, phi, normal, _ = rows(cubes)
    samples = cubes.contacts.samples
    at = (x[samples.host_ids[p]] * samples.host_weights[p][..., None]).sum(1) - (0, 1, 0)
    X = at @ np.linalg.inv(A).T
    above = (samples.body.to_numpy()[p] == 1) & (np.abs(X[:, 0]) < 0.03) & (np.abs(X[:, 2]) < 0.03) & (X[:, 1] < 0.045)
    assert above.sum() >= 9
    g = np.linalg.inv(A).T @ np.array([0, 1.0, 0])
    assert_allclose(phi[above], (X[above, 1] - SIDE / 2) / np.linalg.norm(g), atol=2e-5)
    assert_allclose(normal[above], np.tile(g / np.linalg.norm(g), (above.sum(), 1)), atol=2e-3)


@pytest.mark.parametrize("cosine", [0.2, 0.4])
def test_a_face_is_held_by_what_it_faces_and_returns_through_the_rest(cubes, cosine):
    """The middle of a face, a millimetre inside of another; the normals' cosine says if it came in or went through."""
    n = cubes.vertex_offset[1]
    rest = cubes.state.rest.to_numpy()[: cubes.state.sizes.vertices].astype(np.float64)
    sine = np.sqrt(1 - cosine**2)
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    x = rest + (0, 1, 0)
    x[n:] = (rest[n:] - (0, SIDE / 2, 0)) @ turn.T + (0, 1 + SIDE / 2 - 1e-3, 0)
    cubes.gravity = (0.0, 0.0, 0.0)
    cubes.restore({"x": x, "v": np.zeros_like(x)})
    cubes.step(1e-4, [])
    p, *_, impulse = rows(cubes)
    samples = cubes.contacts.samples
    at = (x[samples.host_ids[p]] * samples.host_weights[p][..., None]).sum(1)
    off = np.linalg.norm(at - (0, 1 + SIDE / 2 - 1e-3, 0), axis=1) + (samples.body.to_numpy()[p] != 1)
    middle = off.argmin()
    assert off[middle] < 1e-6
    assert (np.linalg.norm(impulse[middle]) > 0) == (cosine < 0.3)


def test_what_passes_over_a_body_meets_the_tets_that_it_comes_to(cubes):
    """4 cm in a frame, a millimetre above: the tets at its end hold the points, and not those at its beginning."""
    n = cubes.vertex_offset[1]
    rest = cubes.state.rest.to_numpy()[: cubes.state.sizes.vertices].astype(np.float64)
    x = rest + (0, 1, 0)
    x[n:] = rest[n:] + (-0.05, 1 + SIDE + 1e-3, 0.01)
    v = np.zeros_like(x)
    v[n:, 0] = 2.4
    cubes.gravity = (0.0, 0.0, 0.0)
    cubes.restore({"x": x, "v": v})
    cubes.step(1 / 60, [])
    p, samples, x = rows(cubes)[0], cubes.contacts.samples, np.concatenate(vertices_of(cubes))
    p = p[samples.body.to_numpy()[p] == 1]
    at = (x[samples.host_ids[p]] * samples.host_weights[p][..., None]).sum(1)
    corners = x[cubes.state.tets.to_numpy()[cubes.contacts.deformable.hosts.host.to_numpy()[p]]]
    b = np.linalg.solve(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2), (at - corners[:, 0])[..., None])[..., 0]
    beside = np.abs(at[:, 0] - x[:n, 0].mean()) > SIDE / 2 - 2e-3
    inside = ~beside & (at[:, 1] < x[:n, 1].max() + 2e-3)
    assert inside.sum() >= 4
    assert np.c_[1 - b.sum(1), b][inside].min() > -0.4


@pytest.mark.long
def test_rings_stack_on_a_peg_and_rest(ti_cpu):
    """Three rings dropped over a peg, each onto the last, repeatably."""
    x, tets, surface = torus(0.08, 0.016, 16, 2)
    turned = (np.cos(0.1), np.sin(0.1), 0, 0)
    rings = [
        SoftBody(f"ring{k}", x, tets, surface, RUBBER, turned, (0.02 - 0.02 * k, 0.35 + 0.08 * k, 0.01))
        for k in range(3)
    ]
    solver = Solver(rings, [FLOOR, Capsule((0, 0, 0), (0, 0.3, 0), 0.02)], hands=0)
    run(solver, 1.0)
    early = np.concatenate(vertices_of(solver))
    run(solver, 3.0)
    energy = (speed(solver) ** 2).sum()
    run(solver, 2.0)
    states = solver.bodies()
    for s in states:
        assert np.hypot(s.centroid[0], s.centroid[2]) < 0.08 and s.high[1] < 0.15
        assert s.low[1] > -1e-3
    assert states[2].centroid[1] > states[0].centroid[1] + 0.01
    assert (speed(solver) ** 2).sum() <= max(energy, 1e-6)
    assert speed(solver).max() < 0.02
    _, phi, _, impulse = rows(solver)
    assert phi[np.linalg.norm(impulse, axis=1) > 0].min() > -1e-3
    solver.reset()
    run(solver, 1.0)
    assert (np.concatenate(vertices_of(solver)) == early).all()
