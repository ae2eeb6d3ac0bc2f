"""Screens: their Gaussians lie where the picture's pixels do, and take the colours of each moment's picture."""

import numpy as np
from numpy.testing import assert_allclose

from assets.gaussians import concatenate
from core.spherical_harmonics import C0
from core.vocabulary import Screen
from render.film_screen import FilmScreen, screen_gaussians
from render.splats import Splats
from tests.support.samples import some_gaussians


def test_a_screen_takes_the_colours_of_the_nearest_picture(ti_cpu):
    """Also when the film has begun again; other Gaussians keep theirs."""
    rng, times = np.random.default_rng(0), np.array([0.0, 0.05, 0.2])
    pictures = rng.integers(0, 256, (3, 4, 6, 3)).astype(np.uint8)
    screen = Screen((1.0, 2.0, 0.0), (0.6, 0.0, 0.0), (0.0, -0.4, 0.0), pictures, times, 0.3)
    before = some_gaussians(5, 1)
    splats = Splats(concatenate([before, screen_gaussians(screen)]))
    film = FilmScreen(splats, len(before), screen)
    for moment, picture, changes in (
        (0.02, 0, False),
        (0.03, 1, True),
        (0.12, 1, False),
        (0.59, 2, True),
        (0.61, 0, True),
    ):
        assert film.show(moment) is changes
        sh = splats.sh.to_numpy()[: splats.count]
        assert_allclose(0.5 + C0 * sh[5:, 0], pictures[picture].reshape(-1, 3) / 255.0, atol=1e-6)
        assert_allclose(sh[:5], before.sh, atol=1e-6)


def test_the_gaussians_of_a_screen_cover_it_row_by_row():
    pictures = np.zeros((1, 2, 3, 3), np.uint8)
    right, down = np.array([0.3, 0.0, 0.3]), np.array([0.1, -0.2, -0.1])
    g = screen_gaussians(Screen((0.0, 1.0, 0.0), tuple(right), tuple(down), pictures, np.zeros(1), 1.0))
    expected = [[0.0, 1.0, 0.0] + (c + 0.5) / 3 * right + (r + 0.5) / 2 * down for r in range(2) for c in range(3)]
    assert_allclose(g.means, expected, atol=1e-6)
    xx, xy, xz, yy, yz, zz = g.covariances[0]
    S, normal = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.cross(right, down)
    across = [a @ S @ a / (a @ a) for a in (right, down, normal)]
    assert_allclose(np.sqrt(across[:2]), [0.6 * np.linalg.norm(right) / 3, 0.6 * np.linalg.norm(down) / 2], rtol=1e-5)
    assert across[2] < 0.02 * min(across[:2])
