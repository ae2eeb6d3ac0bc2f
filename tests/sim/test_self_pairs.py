"""Pairs of a tet and a point of its body: what a separating axis keeps apart never touches."""

import numpy as np
import pytest
import taichi as ti

from sim.contact.broad_phase import CONTACT_MARGIN
from sim.contact.nearest_tet import bounding_sphere, face_normals, neighborhood, stay_apart, tet_edges, worst_face

PAIRS, DT = 400, 1 / 60


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
            x0, e1, e2, e3 = tet_edges(self, t)
            n0, n1, n2, n3 = face_normals(e1, e2, e3)
            self.apart[t, 0] = stay_apart(self, x, v, t, (x - center).normalized())
            self.apart[t, 1] = stay_apart(self, x, v, t, worst_face(x - x0, e1, n0, n1, n2, n3))
            self.sphere[t] = ti.Vector([center[0], center[1], center[2], radius])
            _, self.near[t] = neighborhood(self, t, distance)


@pytest.fixture(scope="module")
def pairs(ti_cpu):
    result = Pairs(np.random.default_rng(0))
    result.evaluate(0.03)
    return result


def outside(pairs, time):
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
        assert (outside(pairs, time)[apart.any(1)] > 0.0).all()


def test_spheres_hold_their_tets_and_neighbourhoods_what_the_narrow_phase_leaves_out(pairs):
    sphere = pairs.sphere.to_numpy().astype(np.float64)
    away = np.linalg.norm(pairs.corners - sphere[:, None, :3], axis=2)
    np.testing.assert_allclose(away.max(1), sphere[:, 3], rtol=1e-5)
    np.testing.assert_allclose(pairs.near.to_numpy(), np.maximum(0.03, sphere[:, 3] + 0.015), rtol=1e-5)


def test_points_that_rest_apart_by_the_margin_stay_so(pairs):
    """Of pairs that do not move, those apart by the margin along the worst face's normal, and no others."""
    pairs.v.fill(0.0)
    pairs.velocity.fill(0.0)
    pairs.evaluate(0.03)
    expected = outside(pairs, 0.0) >= CONTACT_MARGIN
    assert (pairs.apart.to_numpy()[:, 1] == expected).mean() > 0.995  # but for rounding
