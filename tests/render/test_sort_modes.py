"""Order of Gaussians by depth or by distance: what a turn of the head changes, and the pictures."""

import numpy as np
import pytest

from tests.render.test_projection import CAMERA, gaussians
from tests.support import popping
from tests.support import reference_render as reference
from tests.support.drawing import Drawing


@pytest.fixture(scope="module")
def drawings(ti_cpu):
    """A drawing for each order that is the same in all pixels."""
    return {sort: Drawing(3000, 1, CAMERA.width, degree=0, sort=sort) for sort in ("z", "radial")}


def order(drawing, camera) -> np.ndarray:
    """Gaussians front to back."""
    drawing.draw(gaussians(3000, 0), [camera])
    return drawing.depth_order()


def changes(drawing) -> int:
    """Number of neighbours in order that change places when the head turns by five degrees."""
    before, after = order(drawing, CAMERA), order(drawing, popping.turned(CAMERA, 5.0))
    both = np.intersect1d(before, after)
    assert len(both) > 1000
    before, after = before[np.isin(before, both)], after[np.isin(after, both)]
    rank = np.empty(before.max() + 1, int)
    rank[after] = np.arange(len(after))
    return int((np.diff(rank[before]) < 0).sum())


def test_turning_the_head_keeps_the_order_by_distance_but_not_by_depth(drawings):
    assert changes(drawings["radial"]) <= 3  # of Gaussians equally far but for rounding
    assert changes(drawings["z"]) > 100


def test_the_order_is_by_distance(drawings):
    found = order(drawings["radial"], CAMERA)
    distance = np.linalg.norm(gaussians(3000, 0).means[found] - CAMERA.position, axis=1)
    assert (np.diff(distance) > -1e-6).all()


def test_one_gaussian_before_another_looks_the_same_either_way(drawings):
    """Pictures of both orders agree, with each other and with the twin, where the orders agree."""
    g = gaussians(3000, 0)
    g = g.select(np.flatnonzero(np.linalg.norm(g.means - CAMERA.position, axis=1) > 0.5)[:6])
    by_z, by_distance = (drawing.draw(g, [CAMERA])[0][0] for drawing in drawings.values())
    np.testing.assert_allclose(by_z, reference.render(g, CAMERA)[0], atol=1e-4)
    np.testing.assert_allclose(by_distance, by_z, atol=1e-6)


def test_an_unknown_order_is_refused(ti_cpu):
    with pytest.raises(ValueError, match="sort must be one of"):
        Drawing(10, 1, 8, degree=0, sort="sideways")


@pytest.mark.long
def test_the_measure_of_popping_sees_what_sorting_by_distance_avoids(ti_cpu):
    """Large translucent Gaussians of many colours, for which the order matters."""
    from assets.gaussians import Gaussians
    from display.viewed_file import camera_around

    rng = np.random.default_rng(5)
    n = 300
    means, sh = rng.uniform(-0.5, 0.5, (n, 3)), rng.choice([-1.5, 1.5], (n, 1, 3))
    g = Gaussians.of(means, rng.normal(size=(n, 4)), np.full((n, 3), np.log(0.1)), np.zeros(n), sh)
    camera = camera_around(g, popping.SHARPER * 120, popping.SHARPER * 90, 0.4)
    found = popping.measure(g, camera, size=(120, 90), buffer_size=24)  # a buffer that compiles in seconds
    rows = {row["sort"]: row for row in found}
    assert list(rows) == ["reference", "z", "radial", "pixel"]
    assert rows["radial"]["change"] < 0.75 * rows["z"]["change"]
    assert rows["z"]["popping"] > max(0.01, 1.2 * rows["radial"]["popping"])
    assert rows["pixel"]["popping"] < 0.5 * rows["radial"]["popping"]
    assert rows["pixel"]["error"] < 0.5 * rows["radial"]["error"]
    assert rows["reference"]["popping"] == rows["reference"]["error"] == 0
