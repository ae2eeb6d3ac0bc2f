"""Filling: summed opacity against its definition, and what counts as inside."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.gaussians import Gaussians
from core.rotation import matrices_from_quaternions
from prepare.cage.level_set import density_of, interior, solid_cells
from tests.support.shells import ball, ring

BLUR, CUTOFF = 0.5, 3.0  # [cells], [standard deviations]


def random_gaussians(n: int, low: float, high: float, seed=0) -> Gaussians:
    rng = np.random.default_rng(seed)
    means, quats = rng.uniform(low, high, (n, 3)), rng.normal(size=(n, 4))
    return Gaussians.of(means, quats, np.log(rng.uniform(0.02, 0.25, (n, 3))), rng.normal(size=n), np.zeros((n, 1, 3)))


def reference_density(g: Gaussians, origin, spacing, shape) -> np.ndarray:
    """sum_g o_g exp(-1/2 d^T Sigma^-1 d) for d^T Sigma^-1 d < CUTOFF^2, in float64."""
    nodes = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    total = np.zeros(shape)
    axes = matrices_from_quaternions(g.quats) * (np.exp(g.log_scales.astype(float)) / spacing)[:, None]
    for mean, a, opacity in zip((g.means - origin) / spacing, axes, g.opacities, strict=True):
        d = nodes - mean
        q = np.einsum("...i,ij,...j->...", d, np.linalg.inv(a @ a.T + BLUR**2 * np.eye(3)), d)
        total += np.where(q < CUTOFF**2, opacity * np.exp(-q / 2), 0)
    return total


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sides", [(), (0,), (1,), (0, 1)])
def test_a_box_is_filled_up_to_one_side_and_a_tube_is_not(axis, sides):
    """Whichever side is open; where the direction up must hit as well, one that is open there is not filled either."""
    shell = np.ones((12, 13, 14), bool)
    shell[1:-1, 1:-1, 1:-1] = False
    ends = np.moveaxis(shell, axis, 0)
    for side in sides:
        ends[-side, 1:-1, 1:-1] = False
    inside = np.zeros_like(shell)
    inside[1:-1, 1:-1, 1:-1] = len(sides) < 2
    assert np.array_equal(interior(shell, up=None)[1:-1, 1:-1, 1:-1], inside[1:-1, 1:-1, 1:-1])
    for sign in (1, -1):
        closed = (1 if sign > 0 else 0) not in sides
        assert interior(shell, up=(axis, sign))[1:-1, 1:-1, 1:-1].all() == (closed and len(sides) < 2)


@pytest.mark.parametrize("low, high", [(0.0, 1.0), (-0.6, 1.6)])  # well inside, and across the grid's border
def test_density_is_the_sum_of_the_gaussians(ti_cpu, low, high):
    g, origin, spacing, shape = random_gaussians(60, low, high), np.full(3, -0.2), 0.08, (18, 21, 17)
    found = density_of(g, origin, spacing, shape)
    expected = reference_density(g, origin, spacing, shape)
    # A node at the very end of a Gaussian's reach (exp(-4.5) = 0.011) may fall on either side in float32.
    assert (np.abs(found - expected) > 1e-4).mean() < 1e-3
    assert_allclose(found, expected, atol=0.03)


def test_absurd_gaussians_do_no_harm(ti_cpu):
    """Far away, as large as float32 allows, or vanishingly thin: the sum stays finite and nothing else is touched."""
    means = np.array([[1e14, 0, 0], [0, -1e14, 0], [0.5, 0.5, 0.5], [0.5, 0.5, 0.5]])
    log_scales = np.array([[0, 0, 0], [39, 39, 39], [-60, -60, -60], [-60, 0, 5]])
    g = Gaussians.of(means, np.tile([1.0, 0, 0, 0], (4, 1)), log_scales, np.zeros(4), np.zeros((4, 1, 3)))
    density = density_of(g, np.zeros(3), 0.1, (11, 11, 11))
    assert np.isfinite(density).all()
    assert 0.5 <= density[5, 5, 5] <= 2.0


def box(hole=None) -> np.ndarray:
    """A hollow box of cells, 30 x 30 x 30 in a grid of 40; `hole` = (axis, end) leaves out most of one side."""
    shell = np.zeros((40, 40, 40), bool)
    shell[5:35, 5:35, 5:35] = True
    shell[6:34, 6:34, 6:34] = False
    if hole:
        index = [slice(7, 33)] * 3
        index[hole[0]] = 5 if hole[1] < 0 else 34
        shell[tuple(index)] = False
    return shell


def test_a_closed_box_is_filled():
    shell = box()
    found = interior(shell)
    assert found[6:34, 6:34, 6:34].all()
    assert found.sum() == 28**3


@pytest.mark.parametrize("hole", [(1, -1), (0, 1), (2, -1)])
def test_a_box_open_on_one_side_is_filled(hole):
    found = interior(box(hole))
    assert found[6:34, 6:34, 6:34].mean() > 0.98
    assert found.sum() <= 28**3 + 28**2  # at most the hole itself comes on top


def test_a_cup_is_not_filled_to_the_brim():
    shell = box((1, 1))
    assert not interior(shell)[7:33, :, 7:33].any()  # what stands under the rim has a lid
    assert interior(shell, up=None).sum() > 0.98 * 28**3


def test_nothing_is_inside_an_empty_grid_or_a_sheet():
    assert not interior(np.zeros((9, 9, 9), bool)).any()
    sheet = np.zeros((9, 9, 9), bool)
    sheet[:, 4] = True
    assert not interior(sheet).any()


def grid_of(g: Gaussians, cells=64):
    low, high = g.means.min(0) - 0.3, g.means.max(0) + 0.3
    spacing = float((high - low).max()) / cells
    shape = tuple(int(k) for k in np.ceil((high - low) / spacing) + 1)
    nodes = low + spacing * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    return density_of(g, low, spacing, shape), nodes, spacing


def test_a_ball_without_underside_is_recovered(ti_cpu):
    """A third of the surface is missing below; at least 98 % of the interior that rays can tell must be filled."""
    density, nodes, spacing = grid_of(ball(open_below=-0.75))
    solid = solid_cells(density)
    radius = np.linalg.norm(nodes, axis=-1)
    assert solid[(radius < 1 - spacing) & (nodes[..., 1] > -0.75 + spacing)].mean() > 0.98
    assert solid[radius > 1.2].sum() == 0


def test_the_hole_of_a_ring_stays_open(ti_cpu):
    density, nodes, spacing = grid_of(ring())
    solid = solid_cells(density)
    tube = np.hypot(np.hypot(nodes[..., 0], nodes[..., 2]) - 1, nodes[..., 1])
    assert solid[tube < 0.25 - spacing].all()
    assert not solid[np.hypot(nodes[..., 0], nodes[..., 2]) < 0.5].any()
