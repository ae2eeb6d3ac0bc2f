"""By what Gaussians are sorted: what a turn of the head changes, and what the pictures are."""

import numpy as np
import pytest

from core.camera import Camera
from tests.render.test_projection import CAMERA, gaussians
from tests.support import reference_render as reference


def raster_of(g, sort):
    from render.rasterizer import Rasterizer
    from render.renderer import FloatImages
    from render.splats import Splats

    sink = FloatImages(1, CAMERA.height, CAMERA.width)
    return Rasterizer(Splats(g), CAMERA.width, CAMERA.height, views=1, sink=sink, sort=sort)


def order(raster, camera) -> np.ndarray:
    """Gaussians front to back."""
    raster.set_camera(0, camera)
    raster.draw(0)
    return raster.order.sorter.sorted_items.to_numpy()[: raster.order.sorter.kept[None]] >> 32


def turned(degrees: float) -> Camera:
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    matrix = np.eye(4)
    matrix[:3] = turn @ CAMERA.world_to_camera[:3]
    return Camera(CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, matrix)


def changes(sort) -> int:
    """How many neighbours in order change places when the head turns by five degrees."""
    raster = raster_of(gaussians(3000, 0), sort)
    before, after = order(raster, turned(0.0)), order(raster, turned(5.0))
    both = np.intersect1d(before, after)
    assert len(both) > 1000
    before, after = before[np.isin(before, both)], after[np.isin(after, both)]
    rank = np.empty(before.max() + 1, int)
    rank[after] = np.arange(len(after))
    return int((np.diff(rank[before]) < 0).sum())


def test_turning_the_head_keeps_the_order_by_distance_but_not_by_depth(ti_cpu):
    assert changes("radial") <= 3  # of what is equally far but for rounding
    assert changes("z") > 100


def test_the_order_is_by_distance(ti_cpu):
    g = gaussians(3000, 0)
    found = order(raster_of(g, "radial"), CAMERA)
    distance = np.linalg.norm(g.means[found] - CAMERA.position, axis=1)
    assert (np.diff(distance) > -1e-6).all()


def test_one_gaussian_before_another_looks_the_same_either_way(ti_cpu):
    """Where both orders agree, so do the pictures, and with the twin."""
    from render.renderer import Renderer
    from render.splats import Splats

    g = gaussians(3000, 0)
    g = g.select(np.flatnonzero(np.linalg.norm(g.means - CAMERA.position, axis=1) > 0.5)[:6])
    pictures = []
    for sort in ("z", "radial"):
        renderer = Renderer(Splats(g), CAMERA.width, CAMERA.height, outputs="float", sort=sort)
        renderer.render([CAMERA])
        pictures.append(renderer.rgb.to_numpy()[0])
    rgb = reference.render(g, CAMERA)[0]
    np.testing.assert_allclose(pictures[0], rgb, atol=1e-4)
    np.testing.assert_allclose(pictures[1], pictures[0], atol=1e-6)


def test_what_it_does_not_know_is_refused(ti_cpu):
    with pytest.raises(ValueError, match="sort must be one of"):
        raster_of(gaussians(10, 0), "sideways")


def test_a_camera_that_looks_elsewhere_is_still_the_same_eye():
    np.testing.assert_allclose(turned(30.0).position, CAMERA.position, atol=1e-12)


@pytest.mark.long
def test_the_measure_of_popping_sees_what_sorting_by_distance_avoids(ti_cpu):
    """Large translucent Gaussians of many colours, where the order matters."""
    from assets.gaussians import Gaussians
    from bench import popping
    from display.viewer import camera_around

    rng = np.random.default_rng(5)
    n = 300
    means, sh = rng.uniform(-0.5, 0.5, (n, 3)), rng.choice([-1.5, 1.5], (n, 1, 3))
    g = Gaussians.of(means, rng.normal(size=(n, 4)), np.full((n, 3), np.log(0.1)), np.zeros(n), sh)
    camera = camera_around(g, popping.SHARPER * 120, popping.SHARPER * 90, 0.4)
    kept = popping.SIZE, popping.REFERENCE
    popping.SIZE, popping.REFERENCE = (120, 90), 24  # a window that compiles in seconds
    try:
        rows = {row["sort"]: row for row in popping.measure(g, camera)}
    finally:
        popping.SIZE, popping.REFERENCE = kept
    assert list(rows) == ["reference", "z", "radial", "pixel"]
    assert rows["radial"]["change"] < 0.75 * rows["z"]["change"]
    assert rows["z"]["popping"] > max(0.01, 1.2 * rows["radial"]["popping"])
    assert rows["pixel"]["popping"] < 0.5 * rows["radial"]["popping"]
    assert rows["pixel"]["error"] < 0.5 * rows["radial"]["error"]
    assert rows["reference"]["popping"] == rows["reference"]["error"] == 0
