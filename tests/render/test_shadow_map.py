"""Shadows: the floor under a blob darkens with a soft edge, the blob's lit side does not."""

import numpy as np
import pytest

from assets.gaussians import Gaussians, concatenate
from scenes.scene import Light

BLOB_CENTER, BLOB_RADIUS = np.array([0.0, 0.4, 0.0]), 0.1
LIGHT = Light(position=(0.0, 2.0, 0.0), target=(0.0, 0.0, 0.0), strength=0.6, softness=0.02)


def sheet(side: float, height: float, spacing: float) -> Gaussians:
    """A square floor of flat opaque Gaussians at y = height."""
    x, z = np.meshgrid(*[np.arange(-side / 2, side / 2 + 1e-9, spacing)] * 2)
    n = x.size
    means = np.stack([x.ravel(), np.full(n, height), z.ravel()], 1)
    scales = np.log(np.tile([0.7 * spacing, 0.001, 0.7 * spacing], (n, 1)))
    return Gaussians.of(means, np.tile([1, 0, 0, 0], (n, 1)), scales, np.full(n, 5.0), np.zeros((n, 1, 3)))


def ball(center, radius: float, count: int) -> Gaussians:
    """A sphere of opaque Gaussians on its surface."""
    k = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    d = np.stack([np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)], 1)
    size = radius * np.sqrt(4 * np.pi / count) * 0.6
    quats = np.tile([1, 0, 0, 0], (count, 1))
    scales = np.full((count, 3), np.log(size))
    return Gaussians.of(center + radius * d, quats, scales, np.full(count, 5.0), np.zeros((count, 1, 3)))


@pytest.fixture(scope="module")
def stage(ti_cpu):
    """A floor, a ball above it that counts as moving, and their shadow; shared, as compiling takes seconds."""
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    floor, blob = sheet(2.0, 0.0, 0.02), ball(BLOB_CENTER, BLOB_RADIUS, 1500)
    splats = Splats(concatenate([floor, blob]))
    return floor, blob, splats, ShadowMap(splats, LIGHT, (len(floor), len(floor) + len(blob)))


def cast(stage, light: Light):
    """Light on the floor (F,) and on the ball (B,)."""
    floor, _, splats, shadow = stage
    shadow.set_light(light)
    shadow.cast()
    values = splats.visibility.to_numpy()[: splats.count]
    return values[: len(floor)], values[len(floor) :]


def shadow_center(floor: Gaussians, on_floor: np.ndarray) -> np.ndarray:
    dark = 1 - on_floor
    return (floor.means * dark[:, None]).sum(0) / dark.sum()


def test_the_floor_under_the_ball_is_dark_and_the_rest_is_not(stage):
    floor = stage[0]
    on_floor, _ = cast(stage, LIGHT)
    r = np.linalg.norm(floor.means[:, [0, 2]], axis=1)
    radius = BLOB_RADIUS + 1.6 * np.exp(stage[1].log_scales[0, 0])  # where one Gaussian's alpha is 0.3
    edge = radius * 2.0 / np.sqrt((2.0 - BLOB_CENTER[1]) ** 2 - radius**2)  # of the light's cone around the ball
    np.testing.assert_allclose(on_floor[r < edge - 0.03], 1 - LIGHT.strength, atol=0.02)
    np.testing.assert_allclose(on_floor[r > edge + 0.03], 1, atol=1e-3)
    area = (1 - on_floor).sum() / LIGHT.strength * 0.02**2
    assert area == pytest.approx(np.pi * edge**2, rel=0.15)


def test_the_edge_is_as_soft_as_asked(stage):
    """More softness, more Gaussians in half shade."""
    shares = []
    for softness in (0.005, 0.04, 0.1):
        on_floor, _ = cast(stage, Light(position=(0, 2, 0), strength=0.6, softness=softness))
        shares.append(((on_floor > 0.45) & (on_floor < 0.95)).sum())
    assert shares[0] < shares[1] < shares[2]


def test_the_lit_side_has_no_acne_and_the_far_side_is_dark(stage):
    blob = stage[1]
    _, on_blob = cast(stage, LIGHT)
    upwards = (blob.means - BLOB_CENTER)[:, 1] / BLOB_RADIUS
    np.testing.assert_allclose(on_blob[upwards > 0.3], 1, atol=1e-3)
    np.testing.assert_allclose(on_blob[upwards < -0.7], 1 - LIGHT.strength, atol=0.05)


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_moving_the_light_moves_the_shadow(stage, kind):
    floor = stage[0]
    for x in (-0.8, 0.8):
        on_floor, _ = cast(stage, Light(position=(x, 2.0, 0.0), kind=kind))
        to_floor = 2.0 / 1.6 if kind == "point" else None
        expected = x + (0 - x) * to_floor if kind == "point" else -x * BLOB_CENTER[1] / 2.0
        np.testing.assert_allclose(shadow_center(floor, on_floor), [expected, 0, 0], atol=0.02)


def test_a_moving_ball_takes_its_shadow_along_at_the_next_cast(stage):
    floor, _, splats, shadow = stage
    before, _ = cast(stage, LIGHT)
    means = splats.mean.to_numpy()
    moved = means.copy()
    moved[len(floor) : splats.count, 0] += 0.5
    splats.mean.from_numpy(moved)
    np.testing.assert_array_equal(splats.visibility.to_numpy()[: len(floor)], before)  # nothing happens by itself
    shadow.cast()
    after = splats.visibility.to_numpy()[: len(floor)]
    splats.mean.from_numpy(means)
    assert shadow_center(floor, after)[0] == pytest.approx(0.5 * 2.0 / 1.6, abs=0.02)


def test_static_things_shadow_what_moves_unless_they_are_the_lamp(ti_cpu):
    """A roof between light and ball: the ball is dark and casts no second shadow through it; a lampshade is nothing."""
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    floor, roof, blob = sheet(4.0, 0.0, 0.04), sheet(0.6, 0.8, 0.02), ball(BLOB_CENTER, BLOB_RADIUS, 1500)
    splats = Splats(concatenate([floor, roof, blob]))
    parts = [len(floor), len(floor) + len(roof)]
    shadow = ShadowMap(splats, LIGHT, (parts[1], splats.count))
    shadow.cast()
    on_floor, on_roof, on_blob = np.split(splats.visibility.to_numpy()[: splats.count], parts)
    np.testing.assert_allclose(on_blob, 1 - LIGHT.strength, atol=0.02)
    np.testing.assert_allclose(on_floor, 1, atol=0.02)
    np.testing.assert_allclose(on_roof, 1, atol=1e-3)

    means = splats.mean.to_numpy()
    means[parts[0] : parts[1], 1] = 1.8
    splats.mean.from_numpy(means)
    shadow.set_light(LIGHT)
    shadow.cast()
    on_floor, on_roof, on_blob = np.split(splats.visibility.to_numpy()[: splats.count], parts)
    assert on_blob.max() == 1 and on_floor.min() < 0.5
    np.testing.assert_allclose(on_roof, 1, atol=1e-3)


def test_nothing_that_moves_means_no_shadow(ti_cpu):
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    splats = Splats(sheet(0.2, 0.0, 0.02))
    splats.visibility.fill(0.5)
    ShadowMap(splats, LIGHT, (splats.count, splats.count)).cast()
    np.testing.assert_array_equal(splats.visibility.to_numpy()[: splats.count], 1)


def test_a_cast_without_room_is_made_again_when_it_is_settled(stage):
    floor, _, splats, shadow = stage
    expected = np.concatenate(cast(stage, LIGHT))
    assert not shadow.finish()
    shadow.rasterizer.reserve(16)
    shadow.cast()
    assert (splats.visibility.to_numpy()[: len(floor)] == 1.0).all()  # nothing was drawn
    assert shadow.finish() and not shadow.finish()
    np.testing.assert_array_equal(splats.visibility.to_numpy()[: splats.count], expected)
