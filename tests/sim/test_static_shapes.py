"""Distances of static shapes against float64 twins, the distance grid of a cage, samples, and lines of sight."""

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from bench.physics import box, torus
from core.distance_grid import DistanceGrid
from core.fields import destroy_fields
from core.rotation import matrices_from_quaternions
from core.vocabulary import Box, Capsule, Plane
from sim.bodies import RigidBody
from sim.contact.contact_samples import CapsuleSamples, points_of, skin_depth, spacing_for, surface_points, thin_out
from sim.contact.static_shapes import UNKNOWN_DISTANCE, LineOfSight, StaticGrid, StaticShapes, rest_grid
from sim.model import BodyModel

PLANE = Plane((0.1, 0.2, -0.3), (0.0, 3.0, 4.0), friction=0.25)
CAPSULE = Capsule((0.1, 0.0, 0.2), (0.3, 0.4, 0.1), 0.05, friction=0.75)
BOX = Box((-0.2, 0.3, 0.1), (0.1, 0.3, 0.2))


def plane_twin(p):
    return (p - PLANE.point) @ np.array([0, 0.6, 0.8])


def capsule_twin(p):
    a, b = np.array(CAPSULE.a), np.array(CAPSULE.b)
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - CAPSULE.radius


def box_twin(p):
    q = np.abs(p - BOX.center) - BOX.half_size
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)


def trilinear_twin(grid: DistanceGrid, p):
    q = (p - grid.origin) / grid.spacing
    i = np.minimum(q.astype(int), np.array(grid.values.shape) - 2)
    f = q - i
    phi = np.zeros(len(p))
    for corner in np.ndindex(2, 2, 2):
        phi += np.where(corner, f, 1 - f).prod(1) * np.asarray(grid.values, np.float64)[tuple((i + corner).T)]
    return phi


def measure(shapes, points):
    """Distance, normal, friction of the nearest shape at points (N, 3)."""
    colliders, n = StaticShapes(shapes), len(points)
    p, normal = ti.Vector.field(3, ti.f32, n), ti.Vector.field(3, ti.f32, n)
    phi, friction = ti.field(ti.f32, n), ti.field(ti.f32, n)
    p.from_numpy(points.astype(np.float32))

    @ti.kernel
    def run():
        for i in range(n):
            phi[i], friction[i] = UNKNOWN_DISTANCE, 0.0
            for k in range(colliders.count[None]):
                d, direction = colliders.distance(k, p[i])
                if d < phi[i]:
                    phi[i], normal[i], friction[i] = d, direction, colliders.friction[k]

    run()
    result = phi.to_numpy(), normal.to_numpy(), friction.to_numpy()
    destroy_fields(colliders)
    return result


def numeric_gradient(f, p, h=1e-6):
    return np.stack([(f(p + h * e) - f(p - h * e)) / (2 * h) for e in np.eye(3)], -1)


@pytest.mark.parametrize("shape, twin", [(PLANE, plane_twin), (CAPSULE, capsule_twin), (BOX, box_twin)])
def test_analytic_distance_and_normal(ti_cpu, shape, twin):
    points = np.random.default_rng(0).uniform(-0.7, 0.9, (4000, 3)).astype(np.float32).astype(np.float64)
    phi, normal, friction = measure([shape], points)
    assert_allclose(phi, twin(points), atol=3e-7)  # a few float32 steps at 1 m
    gradient = numeric_gradient(twin, points)
    smooth = np.abs(np.linalg.norm(gradient, axis=1) - 1) < 1e-5  # away from edges, where the direction jumps
    assert smooth.mean() > 0.95
    assert_allclose(normal[smooth], gradient[smooth], atol=2e-4)  # r / |r| near an axis, in float32
    assert (friction == np.float32(shape.friction)).all()


def test_centre_of_a_capsule_and_of_a_box_have_a_normal(ti_cpu):
    points = np.array([CAPSULE.a, BOX.center])
    _, normal, _ = measure([CAPSULE, BOX], points)
    assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)


def sphere_grid(n=24, radius=0.3, dtype=np.float16):
    spacing = 0.04
    origin = np.array([-0.5, -0.45, -0.4])
    at = origin + spacing * np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1)
    return DistanceGrid((np.linalg.norm(at, axis=-1) - radius).astype(dtype), origin, spacing)


def test_grid_is_trilinear_in_its_own_frame(ti_cpu):
    grid, q = sphere_grid(), np.array([0.8, 0.0, 0.6, 0.0])
    R, scale, t = matrices_from_quaternions(q[None])[0], 1.7, np.array([0.3, -1.0, 0.2])
    rng = np.random.default_rng(1)
    local = grid.origin + grid.spacing * rng.uniform(0.01, 22.99, (4000, 3))
    phi, normal, _ = measure([StaticGrid(grid, tuple(q), tuple(t), scale)], scale * local @ R.T + t)
    expected = trilinear_twin(grid, local)
    shell = expected > -3.99 * grid.spacing
    assert_allclose(phi[shell], scale * expected[shell], atol=2e-6)
    f = (local - grid.origin) / grid.spacing % 1
    inner = shell & (np.abs(f - 0.5).max(1) < 0.499)  # the gradient jumps from cell to cell
    gradient = numeric_gradient(lambda p: trilinear_twin(grid, p), local[inner])
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert_allclose(normal[inner], gradient @ R.T, atol=2e-3)  # float32 positions in cells of 0.04


def test_grid_says_nothing_outside_and_deep_inside(ti_cpu):
    grid = sphere_grid()
    outside, deep, shell = [2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.28, 0.0, 0.0]
    phi, _, _ = measure([StaticGrid(grid)], np.array([outside, deep, shell]))
    assert phi[0] > 100 and phi[1] > 100
    assert_allclose(phi[2], -0.02, atol=2e-3)


def test_outside_its_box_a_grid_is_extrapolated(ti_cpu):
    """A ball's distance, exactly along the axes and by at most sqrt(2) too large anywhere; its box is never nearer."""
    from sim.contact.static_shapes import DistanceGrids

    grid, n = sphere_grid(dtype=np.float32), 1000
    grids = DistanceGrids([grid])
    grids.load([grid])
    points = np.random.default_rng(4).uniform(-1.2, 1.2, (n, 3))
    points[:100, 1:] = 0.0
    p, out, normal = ti.Vector.field(3, ti.f32, n), ti.Vector.field(2, ti.f32, n), ti.Vector.field(3, ti.f32, n)
    p.from_numpy(points.astype(np.float32))

    @ti.kernel
    def run():
        for i in range(n):
            phi, gradient, beyond = grids.extrapolated(0, p[i])
            out[i], normal[i] = ti.Vector([phi, beyond]), gradient

    run()
    (phi, beyond), exact = out.to_numpy().T, np.linalg.norm(points, axis=1) - 0.3
    low, high = np.asarray(grid.origin), np.asarray(grid.upper)
    assert_allclose(beyond, np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1), atol=1e-6)
    outside = beyond > 0
    assert outside.sum() > 500 and (beyond[outside] < exact[outside]).all()
    assert_allclose(phi[:100][outside[:100]], exact[:100][outside[:100]], atol=2e-3)
    assert (phi > exact - 3e-3)[outside].all() and (phi < np.sqrt(2) * exact)[outside].all()
    cosine = (normal.to_numpy() * points).sum(1) / np.linalg.norm(points, axis=1)
    assert (cosine[outside] > np.sqrt(0.5)).all()
    destroy_fields(grids)


def test_distance_grid_of_a_cage(ti_cpu):
    """Against the exact box, near the surface; signs everywhere."""
    size = np.array([0.3, 0.1, 0.2])
    x, tets, surface = box(size, (3, 2, 2))
    grid = rest_grid(x, tets, surface, nodes=30)
    nodes = grid.nodes()
    q = np.abs(nodes - size / 2) - size / 2
    exact = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)
    near = np.abs(exact) < (2 + np.sqrt(3)) * grid.spacing  # a skin, and a cell
    assert_allclose(grid.values[near], exact[near], atol=2e-6)
    clear = np.abs(exact) > 1e-6
    assert (np.sign(grid.values[clear]) == np.sign(exact[clear])).all()
    assert np.abs(grid.values - exact).max() < 2 * grid.spacing
    assert (grid.values.shape < size / grid.spacing + 2 * 4 + 3).all()  # no larger than it must be


def test_points_are_thinned_out_one_after_the_other():
    """On a line, every second one is left, however many wait for those before them."""
    line = np.arange(40)[:, None] * [0.7, 0.0, 0.0]
    for points, keep in ((line, 1), (np.random.default_rng(1).random((400, 3)), 20)):
        distance = 1.0 if points is line else 0.12
        taken = list(range(keep))
        for k in range(keep, len(points)):
            if np.linalg.norm(points[taken] - points[k], axis=1).min() >= distance:
                taken.append(k)
        assert len(taken) < len(points) and thin_out(points, distance, keep).tolist() == taken


def test_surface_points_cover_the_surface_evenly():
    x, _, surface = torus(0.08, 0.016, 24, 2)
    points = surface_points(x, surface, 0.01)
    at = (x[points.ids] * points.weights[..., None]).sum(1)
    assert_allclose(points.weights.sum(1), 1, atol=1e-12)
    assert set(np.unique(surface)) == set(points.ids[points.weights[:, 0] == 1, 0])
    added = points.weights[:, 0] < 1
    away = np.linalg.norm(at[:, None] - at[None], axis=-1) + np.eye(len(at))
    assert away[added].min() > 0.0075 - 1e-9
    rng = np.random.default_rng(0)
    anywhere = (x[surface[rng.integers(len(surface), size=3000)]] * rng.dirichlet([1, 1, 1], 3000)[..., None]).sum(1)
    assert np.linalg.norm(anywhere[:, None] - at[None], axis=-1).min(1).max() < 0.009
    assert len(surface_points(x, surface, 0.002, most=700).ids) <= 700


@pytest.mark.parametrize(
    ("thinnest", "size", "gap", "most"),
    [(None, 0.2, 0.02, 1200), (0.012, 0.1, 0.006, 3500), (0.001, 0.05, 0.004, 2000)],
)
def test_nothing_slips_between_the_samples_of_a_scene(thinnest, size, gap, most):
    """A thumb of 2 cm nowhere, a rod not by half its radius, and no more than 4 mm: a thinner one has samples itself.

    Less is not worth more points than these on a cube of this size, of two triangles a side.
    """
    x, _, surface = box((size,) * 3, (1, 1, 1))
    spacing = spacing_for([] if thinnest is None else [Capsule((0, 0, 0), (1, 0, 0), thinnest)])
    points = surface_points(x, surface, spacing, most=100_000)
    at = (x[points.ids] * points.weights[..., None]).sum(1)
    rng = np.random.default_rng(0)
    anywhere = (x[surface[rng.integers(len(surface), size=2000)]] * rng.dirichlet([1, 1, 1], 2000)[..., None]).sum(1)
    assert cKDTree(at).query(anywhere)[0].max() < gap
    assert len(at) < most


def test_pegs_that_a_stretched_body_passes_between_its_samples_have_samples(ti_cpu):
    """Stretched fourfold, a body has them 8 cm apart: as far as a peg of 16 cm is thick, but not a column of 50 cm."""
    pegs = [Capsule((0, 0, 0), (0, 1, 0), radius) for radius in (0.25, 0.15, 0.08, 0.02)]
    samples = CapsuleSamples(pegs, spacing_for([]))
    radii = np.unique(samples.radius.to_numpy()[: samples.size])
    destroy_fields(samples)
    assert_allclose(radii, [0.02, 0.08, 0.15])


def test_a_rigid_body_needs_few_points():
    """A shape that does not bend cannot be entered far between points a tenth of its size apart."""
    shape = BodyModel.of(RigidBody.box("crate", (1.0, 1.0, 1.0), density=500.0), []).shape
    assert 500 < len(points_of(shape, 0.004).ids) < 1500


def test_skin_is_what_the_cage_adds_to_the_visible_surface():
    grid = sphere_grid(48, dtype=np.float32)
    x = 0.33 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]], np.float64)
    points = surface_points(x, np.array([[0, 1, 2], [0, 2, 3]]), 1.0)
    assert_allclose(skin_depth(points, x, grid), 0.03, atol=2e-3)
    assert (skin_depth(points, x, None) == 0).all()


TABLE = Box((0.0, 0.73, 0.0), (0.8, 0.015, 0.5))  # a top of 3 cm
FLOOR = Plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
TOY = np.array([0.1, 0.76, 0.0])


def table_grid(spacing: float = 0.02) -> StaticGrid:
    """The same table as a distance grid, in a frame that is turned by a quarter, moved and half as large."""
    origin = np.array([-1.2, -0.4, -2.0])
    grid = DistanceGrid(np.zeros((60, 40, 100)), origin, 2 * spacing)
    x = grid.nodes() @ np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).T / 2 + (0.0, 0.73, 0.0)
    beyond = np.abs(x - TABLE.center) - TABLE.half_size
    values = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(-1), 0.0)
    quarter = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    return StaticGrid(
        DistanceGrid((2 * values).astype(np.float16), origin, 2 * spacing), quarter, (0.0, 0.73, 0.0), 0.5
    )


def hides(sight: LineOfSight, eye) -> bool:
    return sight.hides(eye, TOY - eye, np.linalg.norm(TOY - eye))


@pytest.mark.parametrize("table", [TABLE, table_grid()], ids=["box", "grid"])
def test_a_table_hides_what_stands_on_it_from_below_and_not_from_above(table):
    sight = LineOfSight([FLOOR, table])
    for eye in ([0.0, 1.5, 1.0], [1.5, 0.77, 0.3], [-1.0, 1.0, -1.0]):
        assert not hides(sight, np.array(eye))
    for eye in ([0.0, 0.2, 0.4], [0.3, 0.5, -0.2]):
        assert hides(sight, np.array(eye))
    eye = np.array([0.0, 0.2, 0.4])
    assert not sight.hides(eye, TOY - eye, 0.3)  # before the table


def test_what_the_eye_is_in_hides_nothing():
    sight = LineOfSight([Box((0.0, 1.0, 1.0), (0.2, 0.2, 0.2))])
    assert not hides(sight, np.array([0.0, 1.0, 1.0]))
    assert hides(sight, np.array([0.0, 1.2, 1.8]))


def test_a_capsule_hides_what_is_behind_it():
    sight = LineOfSight([Capsule((0.1, 0.7, 0.3), (0.1, 1.0, 0.3), 0.04)])
    assert hides(sight, np.array([0.1, 0.8, 1.0])) and not hides(sight, np.array([0.6, 0.8, 1.0]))


@pytest.mark.parametrize("table", [TABLE, table_grid()], ids=["box", "grid"])
def test_the_ground_is_the_table_or_the_floor_and_not_what_stands_there(table):
    bottle = Capsule((0.0, 0.7, 0.0), (0.0, 1.0, 0.0), 0.04)
    sight = LineOfSight([FLOOR, table, bottle])
    assert sight.ground((0.0, 0.9, 0.0)) == pytest.approx(0.745, abs=0.02)
    assert sight.ground((2.0, 0.9, 0.0)) == pytest.approx(0.0, abs=0.02)
    assert LineOfSight([]).ground((0.0, 1.0, 0.0)) is None
    assert LineOfSight([FLOOR]).ground((0.0, 9.0, 0.0)) is None
