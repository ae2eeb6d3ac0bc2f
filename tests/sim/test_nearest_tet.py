"""The search for the tets that points may come into, against all tets in turn, and where they are in them (float64).

Of pairs of a tet and a point of its body, what a separating axis keeps apart never touches.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose
from taichi.math import vec3

from bench.physics import torus
from core.fields import destroy_fields
from core.material import Material
from sim.bodies import RigidBody, SoftBody
from sim.contact.broad_phase import CONTACT_MARGIN, PointHash
from sim.contact.nearest_tet import (
    CELL_SIZE,
    bounding_sphere,
    face_normals,
    neighborhood,
    rest_coordinates,
    stay_apart,
    tet_edges,
    worst_face,
)
from sim.solver import Solver
from tests.support.soft_world import soft_solver

RUBBER = Material(young=3e4, poisson=0.4, density=1100.0)
APART = 0.25  # [m] between the rings' middles; their bodies are 0.04 m from one another
DT = 1 / 60


def outside(x, corners):
    """Distance (N, T) [m] of each point x (N, 3) beyond the worst face of each tet (T, 4, 3), 0 inside."""
    worst = np.zeros((len(x), len(corners)))
    for j, face in enumerate([(1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)]):
        a, b, c = (corners[:, k] for k in face)
        n = np.cross(b - a, c - a)
        n *= (np.sign(np.einsum("ij,ij->i", n, a - corners[:, j])) / np.linalg.norm(n, axis=1))[:, None]
        worst = np.maximum(worst, x @ n.T - (n * a).sum(1))
    return worst


@pytest.fixture(scope="module")
def rings(ti_cpu):
    ring = torus(0.08, 0.025, 24, 3)
    bodies = [SoftBody(f"ring{k}", *ring, RUBBER, position=(k * APART, 0, 0.01 * k)) for k in range(2)]
    return soft_solver(bodies, floor=False, gravity=(0, 0, 0))


def found(rings, speed):
    """Points of the two rings, at `speed` towards each other: where, whose, host (-1: none), the cell's size."""
    rings.reset()
    q = rings.snapshot()
    half = rings.vertex_offset[1]
    v = np.zeros_like(q["x"])
    v[:half, 0], v[half:, 0] = speed, -speed
    rings.restore({"x": q["x"], "v": v})
    rings.step(1e-7)  # searches, and hardly moves
    contacts = rings.contacts
    n = contacts.samples.count[None]
    rings.state.detect_dt[None] = DT
    contacts.detect()
    listed = (
        contacts.constraints.candidate.to_numpy()[: contacts.constraints.candidate_count[None]]
        - contacts.deformable.begin
    )
    host = np.full(n, -1)
    mine = listed[(listed >= 0) & (listed < n)]
    host[mine] = contacts.deformable.hosts.host.to_numpy()[mine]
    ids, weight = contacts.samples.ids.to_numpy()[:n], contacts.samples.weight.to_numpy()[:n]
    x = rings.x.to_numpy().astype(np.float64)
    points = (weight[:, :, None] * x[ids]).sum(1)
    return points, contacts.samples.body.to_numpy()[:n], host, contacts.deformable.hosts.hash.cell[None], x


@pytest.mark.long
@pytest.mark.parametrize(("speed", "far"), [(3.0, 0), (12.0, 40)])
def test_what_is_fast_finds_the_nearest_tet_of_the_other_from_afar(rings, speed, far):
    """At 12 m/s as many, at least, are found that are farther than a cell."""
    points, body, host, cell, x = found(rings, speed)
    tets, of = rings.state.tets.to_numpy()[: rings.state.sizes.tets], rings.state.body_of_tet.to_numpy()
    far_and_found = 0
    for b in range(2):
        mine, others = np.flatnonzero(body == b), np.flatnonzero(of[: len(tets)] != b)
        distance = outside(points[mine], x[tets[others]])
        nearest = distance.min(1)
        listed = host[mine] >= 0
        way = 2 * speed * DT
        towards = np.array([1.0 if b == 0 else -1.0, 0.0, 0.0])  # in the other's frame, with the speed of both
        path = [outside(points[mine] + f * way * towards, x[tets[others]]).min(1) for f in np.linspace(0, 1, 20)]
        assert listed[np.min(path, 0) == 0.0].all()  # what flies into the other until the next search
        assert not listed[nearest > 1.5 * way + 0.01].any()
        middles = x[tets].mean(1)
        gap = np.linalg.norm(points[mine[listed], None] - middles[others], axis=2).min(1)
        chosen = np.linalg.norm(points[mine[listed]] - middles[host[mine[listed]]], axis=1)
        assert (chosen <= gap + 2 * cell).all()
        far_and_found += (nearest[listed] > cell).sum()
    assert far_and_found >= far


def test_what_is_slow_lists_nothing(rings):
    assert (found(rings, 0.3)[2] < 0).all()


def test_rigid_bodies_do_not_coarsen_the_hash(ti_cpu):
    """With the edges of a brick among them, its cells held all points of a fine body, and each tet looked at all."""
    ring = SoftBody("ring", *torus(0.08, 0.025, 24, 3), RUBBER)
    bricks = [RigidBody.box("brick", (0.3, 0.2, 0.1), density=500.0, position=(k, 0, 0)) for k in (1, 2)]
    solver = Solver([ring, *bricks])
    assert solver.contacts.deformable.hosts.hash.cell[None] == pytest.approx(
        CELL_SIZE * solver.body_models[0].shape.edge
    )


def test_a_point_goes_on_to_the_tet_that_it_is_in_but_not_to_and_fro_on_a_face(rings):
    hosts = rings.contacts.deformable.hosts
    neighbor = hosts.neighbor.to_numpy()[: rings.state.sizes.tets]
    t = int(np.flatnonzero((neighbor >= 0).sum(1) >= 2)[0])
    j, k = np.flatnonzero(neighbor[t] >= 0)[:2]
    weights, expected = np.full((4, 4), 0.25), [t, neighbor[t, j], neighbor[t, k], t]
    weights[0, j], weights[1, j], weights[2, [j, k]] = -0.006, -0.015, (-0.03, -0.2)
    b, after = ti.Vector.field(4, ti.f32, 4), ti.field(ti.i32, 4)
    b.from_numpy(weights.astype(np.float32))

    @ti.kernel
    def run():
        for i in range(4):
            after[i] = hosts.next_host(t, b[i])

    run()
    assert after.to_numpy().tolist() == expected


def test_a_box_that_has_exploded_is_searched_in_bounded_time(ti_cpu):
    """A tet stretched to ten kilometres would visit 1e18 cells."""
    points = PointHash(10)
    points.cell[None] = 0.01
    extent = ti.Vector.field(3, ti.i32, 2)

    @ti.kernel
    def run():
        for k in range(2):
            size = 1e4 if k == 1 else 0.02
            first, last = points.cell_range(vec3(-size), vec3(size))
            extent[k] = last - first

    run()
    small, large = extent.to_numpy()
    assert (small >= 4).all() and (small <= 5).all() and large.prod() < 20_000
    destroy_fields(points)


def test_rest_coordinates_are_those_of_the_twin_and_crushed_tets_have_none(ti_cpu):
    """Heights from a centimetre to nothing, and inside out: what is left is finite."""
    rng = np.random.default_rng(5)
    heights = np.r_[10.0 ** -np.arange(2, 38, 0.5), 0.0, -1e-9, -0.01]
    N = len(heights)
    X = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
    x = np.tile(X, (N, 1, 1))
    x[:, 3, 2] = heights
    weights = rng.dirichlet(np.ones(4), N)
    state = SimpleNamespace(
        tets=ti.Vector.field(4, ti.i32, N), x=ti.Vector.field(3, ti.f32, 4 * N), rest=ti.Vector.field(3, ti.f32, 4 * N)
    )
    state.tets.from_numpy(np.arange(4 * N, dtype=np.int32).reshape(N, 4))
    state.x.from_numpy(x.reshape(-1, 3).astype(np.float32))
    state.rest.from_numpy(np.tile(X, (N, 1, 1)).reshape(-1, 3).astype(np.float32))
    point, place, normal = (ti.Vector.field(3, ti.f32, N) for _ in range(3))
    b, thick = ti.Vector.field(4, ti.f32, N), ti.field(ti.i32, N)
    point.from_numpy(np.einsum("kj,kji->ki", weights, x).astype(np.float32))

    @ti.kernel
    def run():
        for t in range(N):
            ok, b[t], place[t], G, E = rest_coordinates(state, t, point[t])
            thick[t] = ok
            normal[t] = G @ (E.transpose() @ vec3(0.6, 0.0, 0.8))

    run()
    usable = thick.to_numpy() != 0
    assert usable[heights > 3e-5].all() and not usable[heights < 5e-6].any()  # of 1e-2
    assert_allclose(b.to_numpy()[usable], weights[usable], atol=1e-3)
    assert_allclose(place.to_numpy()[usable], (weights @ X)[usable], atol=1e-5)
    expected = np.stack([np.full(N, 0.6), np.zeros(N), 0.8 * 0.01 / np.where(usable, heights, 1.0)], axis=1)
    assert_allclose(normal.to_numpy()[usable], expected[usable], rtol=1e-4, atol=1e-4)
    assert np.isfinite(np.linalg.norm(normal.to_numpy(), axis=1)).all() and np.isfinite(b.to_numpy()).all()


PAIRS = 400  # of a tet and a point of its body


@ti.data_oriented
class Pairs:
    """Tets that move, each with a point and an axis: that of the centres, or the normal of the worst face."""

    def __init__(self, rng):
        self.corners, self.speeds = rng.normal(size=(PAIRS, 4, 3)) * 0.02, rng.normal(size=(PAIRS, 4, 3))
        self.points, self.velocities = rng.normal(size=(PAIRS, 3)) * 0.04, rng.normal(size=(PAIRS, 3))
        flip = np.linalg.det(self.corners[:, 1:] - self.corners[:, :1]) < 0
        self.corners[flip] = self.corners[flip][:, [1, 0, 2, 3]]
        self.x, self.v, self.rest = (ti.Vector.field(3, ti.f32, 4 * PAIRS) for _ in range(3))
        self.tets, self.detect_dt = ti.Vector.field(4, ti.i32, PAIRS), ti.field(ti.f32, ())
        self.point, self.velocity = (ti.Vector.field(3, ti.f32, PAIRS) for _ in range(2))
        self.apart = ti.field(ti.i32, (PAIRS, 2))
        self.sphere, self.near = ti.Vector.field(4, ti.f32, PAIRS), ti.field(ti.f32, PAIRS)
        self.x.from_numpy(self.corners.reshape(-1, 3).astype(np.float32))
        self.rest.copy_from(self.x)
        self.v.from_numpy(self.speeds.reshape(-1, 3).astype(np.float32))
        self.tets.from_numpy(np.arange(4 * PAIRS, dtype=np.int32).reshape(-1, 4))
        self.point.from_numpy(self.points.astype(np.float32))
        self.velocity.from_numpy(self.velocities.astype(np.float32))
        self.detect_dt[None] = DT

    @ti.kernel
    def evaluate(self, distance: ti.f32):
        for t in range(PAIRS):
            center, radius = bounding_sphere(self.x, self.tets[t])
            x, v = self.point[t], self.velocity[t]
            x0, e1, e2, e3 = tet_edges(self.x, self.tets[t])
            n0, n1, n2, n3 = face_normals(e1, e2, e3)
            self.apart[t, 0] = stay_apart(self, x, v, t, (x - center).normalized())
            _distance, face = worst_face(x - x0, e1, n0, n1, n2, n3)
            self.apart[t, 1] = stay_apart(self, x, v, t, face)
            self.sphere[t] = ti.Vector([center[0], center[1], center[2], radius])
            _, self.near[t] = neighborhood(self, t, distance)


@pytest.fixture(scope="module")
def pairs(ti_cpu):
    result = Pairs(np.random.default_rng(0))
    result.evaluate(0.03)
    return result


def outside_after(pairs, time):
    """Distance [m] of each point beyond the worst face plane of its tet, after `time` [s]; inf if that is inverted."""
    corners = pairs.corners + time * pairs.speeds
    points = pairs.points + time * pairs.velocities
    most = np.full(PAIRS, -np.inf)
    for face in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)):
        a, b, c = (corners[:, k] for k in face)
        normal = np.cross(b - a, c - a)
        most = np.maximum(most, ((points - a) * normal).sum(1) / np.linalg.norm(normal, axis=1))
    upright = np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0
    return np.where(upright, most, np.inf)


def test_what_stays_apart_does_not_touch(pairs):
    apart = pairs.apart.to_numpy().astype(bool)
    assert 0.1 < apart[:, 0].mean() < 0.9 and 0.1 < apart[:, 1].mean() < 0.9
    assert (apart[:, 0] & ~apart[:, 1]).any() and (apart[:, 1] & ~apart[:, 0]).any()  # both axes are needed
    for time in np.linspace(0, DT, 9):
        assert (outside_after(pairs, time)[apart.any(1)] > 0.0).all()


def test_spheres_hold_their_tets_and_neighbourhoods_what_the_narrow_phase_leaves_out(pairs):
    sphere = pairs.sphere.to_numpy().astype(np.float64)
    away = np.linalg.norm(pairs.corners - sphere[:, None, :3], axis=2)
    assert_allclose(away.max(1), sphere[:, 3], rtol=1e-5)
    assert_allclose(pairs.near.to_numpy(), np.maximum(0.03, sphere[:, 3] + 0.015), rtol=1e-5)


def test_points_that_rest_apart_by_the_margin_stay_so(pairs):
    """Of pairs that do not move, those apart by the margin along the worst face's normal, and no others."""
    pairs.v.fill(0.0)
    pairs.velocity.fill(0.0)
    pairs.evaluate(0.03)
    expected = outside_after(pairs, 0.0) >= CONTACT_MARGIN
    assert (pairs.apart.to_numpy()[:, 1] == expected).mean() > 0.995  # but for rounding
