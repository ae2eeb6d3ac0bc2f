"""Holes where surfaces meet: a ball in the corner of a floor and two walls, each of its own colour."""

import cv2
import numpy as np
import pytest

from core.camera import look_at, perspective
from prepare.inpaint.hole_patch import target
from prepare.inpaint.hole_views import HoleView, Surroundings
from prepare.inpaint.inpaint_pipeline import Hole, paint_hole, textures_around

COLORS = np.array([[0.7, 0.3, 0.3], [0.6, 0.5, 0.35], [0.3, 0.6, 0.5]])  # of the planes x, y, z = 0
CENTRE, RADIUS = np.full(3, 0.12), 0.11  # [m] of the ball
SPHERE = Surroundings(CENTRE, RADIUS)


def traced(index: int, camera) -> tuple[HoleView, np.ndarray]:
    """A view of the ball in the corner, and the picture without it."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    rays, eye = rays @ camera.world_to_camera[:3, :3], camera.position
    depths = np.where(rays < -1e-6, -eye / np.minimum(rays, -1e-6), np.inf)  # of the planes, the nearest shows
    depth, color = depths.min(axis=-1).clip(0.0, 9.0), COLORS[depths.argmin(axis=-1)]
    depth += 0.002 * np.random.default_rng(index).normal(size=depth.shape)
    a, b = (rays**2).sum(-1), rays @ (eye - CENTRE)
    root = b**2 - a * (((eye - CENTRE) ** 2).sum() - RADIUS**2)
    on, front = root > 0, (-b - np.sqrt(root.clip(0))) / a
    pictures = (np.where(on[..., None], 0.0, color), ~on, depth, on, front)  # nothing is drawn behind the ball
    return HoleView(index, camera, *(p.astype(np.float32) for p in pictures)), color


def paint(picture: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    pixels = (picture * 255).round().astype(np.uint8)
    return cv2.inpaint(pixels, unknown.astype(np.uint8), 3, cv2.INPAINT_TELEA) / np.float32(255)


@pytest.fixture(scope="module")
def corner():
    """Views, pictures without the ball, and the painted textures."""
    turns, heights = np.radians(np.linspace(15.0, 75.0, 8)), [0.25, 0.45, 0.65, 0.35] * 2
    eyes = [(0.7 * np.cos(a), y, 0.7 * np.sin(a)) for a, y in zip(turns, heights, strict=True)]
    cameras = [perspective(120, 90, 0.8, look_at(eye, CENTRE)) for eye in eyes]
    views, truth = zip(*(traced(k, camera) for k, camera in enumerate(cameras)), strict=True)
    textures = textures_around(views, ball(), SPHERE, photographed=True)
    hole = Hole(None, 0, ball(), SPHERE, views, textures[0], [t for t in textures if t.hole.any()])
    return views, truth, textures, paint_hole(hole, paint)


class Means:
    """The ball's Gaussians, but for those in the corner, which no camera saw."""

    def __init__(self):
        k = np.arange(400) + 0.5
        y, turn = 1 - k / 200, np.pi * (1 + 5**0.5) * k
        points = np.stack([np.sqrt(1 - y * y) * np.cos(turn), y, np.sqrt(1 - y * y) * np.sin(turn)], axis=1)
        self.means = CENTRE + RADIUS * points[points.min(axis=1) > -0.9]


def ball() -> Means:
    return Means()


def test_all_surfaces_of_a_corner_have_a_hole(corner):
    _, _, textures, painted = corner
    assert len(painted) == len(textures) == 3
    np.testing.assert_allclose(np.sum([t.surface.axes[2] for t in painted], axis=0), 1.0, atol=0.03)


def test_a_texture_has_no_colour_of_another_surface(corner):
    for texture in corner[3]:
        own = COLORS[texture.surface.axes[2].argmax()]
        assert texture.known.sum() > 500 and texture.hole.sum() > 100
        off = np.abs(texture.color[texture.known | texture.hole] - own).max(axis=1)
        assert (off < 0.06).mean() > 0.97


def test_each_pixel_of_the_hole_shows_the_surface_that_its_ray_meets(corner):
    views, truth, _, painted = corner
    pixels = 0
    for view, expected in zip(views, truth, strict=True):
        color, hole, _ = target(view, painted)
        pixels += hole.sum()
        assert (np.abs(color - expected)[hole].max(axis=1) < 0.06).mean() > 0.92
    assert pixels > 3000
