"""Shadows: the floor under a blob darkens with a soft edge, the blob's lit side does not."""

from dataclasses import replace

import numpy as np
import pytest

from assets.gaussians import Gaussians, concatenate
from core.vocabulary import Light

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
    """A floor and a roof, a ball that counts as moving, and their shadow map; the roof is far below unless moved."""
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    floor, roof, blob = sheet(2.0, 0.0, 0.02), sheet(0.6, -50.0, 0.02), ball(BLOB_CENTER, BLOB_RADIUS, 1500)
    splats = Splats(concatenate([floor, roof, blob]))
    return floor, blob, splats, ShadowMap(splats, LIGHT, len(floor) + len(roof), segments=3)


def cast(stage, light: Light):
    """Light on the floor (F,) and on the ball (B,)."""
    floor, _, splats, shadow = stage
    shadow.set_light(light)
    shadow.cast()
    values = splats.visibility.to_numpy()[: splats.count]
    return values[: len(floor)], values[-len(stage[1]) :]


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


def test_the_floor_under_a_small_foot_is_dark_however_coarse_its_gaussians_are(ti_cpu):
    """Such a foot is thinner than the Gaussians of a lawn are wide; without a shadow it seems to float."""
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    floor = sheet(0.6, 0.0, 0.06)
    splats = Splats(concatenate([floor, ball([0.0, 0.02, 0.0], 0.02, 300)]))
    shadow = ShadowMap(splats, LIGHT, len(floor))
    shadow.cast()
    light, away = splats.visibility.to_numpy()[: len(floor)], np.linalg.norm(floor.means, axis=1)
    shadow.destroy()
    splats.destroy()
    assert light[away.argmin()] < 1 - 0.9 * LIGHT.strength
    np.testing.assert_allclose(light[away > 0.05], 1, atol=1e-3)


def test_what_lies_on_a_table_does_not_darken_what_is_under_its_edge(ti_cpu):
    """A ball on a sheet, and another sheet 6 cm below it, which was in the upper one's shadow before."""
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    top, under = sheet(0.8, 0.0, 0.02), sheet(0.5, -0.06, 0.02)
    splats = Splats(concatenate([top, under, ball([0.0, 0.05, 0.0], 0.05, 400)]))
    shadow = ShadowMap(splats, LIGHT, len(top) + len(under))
    shadow.cast()
    light = splats.visibility.to_numpy()
    shadow.destroy()
    splats.destroy()
    assert light[: len(top)].min() == pytest.approx(1 - LIGHT.strength, abs=0.02)
    np.testing.assert_allclose(light[len(top) : len(top) + len(under)], 1, atol=0.02)


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
    moved[shadow.begin : splats.count, 0] += 0.5
    splats.mean.from_numpy(moved)
    np.testing.assert_array_equal(splats.visibility.to_numpy()[: len(floor)], before)  # not before the next cast
    shadow.cast()
    after = splats.visibility.to_numpy()[: len(floor)]
    splats.mean.from_numpy(means)
    assert shadow_center(floor, after)[0] == pytest.approx(0.5 * 2.0 / 1.6, abs=0.02)


def test_static_things_shadow_what_moves_unless_they_are_the_lamp(stage):
    """A roof between light and ball: the ball is dark and casts no second shadow through it; a lampshade casts none."""
    floor, _, splats, shadow = stage
    means = splats.mean.to_numpy()
    roof, under = slice(len(floor), shadow.begin), np.abs(floor.means[:, [0, 2]]).max(1) < 0.9
    for height, shaded in ((0.8, True), (1.8, False)):
        moved = means.copy()
        moved[roof, 1] = height
        splats.mean.from_numpy(moved)
        on_floor, on_ball = cast(stage, LIGHT)
        np.testing.assert_allclose(splats.visibility.to_numpy()[roof], 1, atol=1e-3)
        if shaded:
            np.testing.assert_allclose(on_ball, 1 - LIGHT.strength, atol=0.02)
            np.testing.assert_allclose(on_floor[under], 1, atol=0.02)
        else:
            assert on_ball.max() == 1 and on_floor.min() < 0.5
    splats.mean.from_numpy(means)


@pytest.mark.long
def test_segments_make_the_map_that_all_splats_at_once_make(stage):
    """But for what lies behind a finished texel, less than MIN_TRANSMITTANCE."""
    from render.shadow_map import ShadowMap

    splats, shadow = stage[2], stage[3]
    cast(stage, LIGHT)
    got = shadow.map.texel.to_numpy()
    assert (shadow.map.segment.to_numpy()[1:, ..., 1].max((1, 2)) > 0.9).all()  # none of them is idle
    whole = ShadowMap(splats, LIGHT, shadow.begin, segments=1)
    whole.cast()
    expected = whole.map.texel.to_numpy()
    whole.destroy()
    np.testing.assert_allclose(got[..., 1], expected[..., 1], rtol=0, atol=2e-4)
    covered = expected[..., 1] > 0.5
    assert covered[0].mean() > 0.1 and covered[1].mean() > 0.1
    behind = np.abs(got[..., 1] - expected[..., 1]) * 50.0 / expected[..., 1].clip(0.5)  # the roof is 50 m farther away
    assert (np.abs(got[..., 0] - expected[..., 0]) < 4e-3 + behind)[covered].all()


def test_nothing_that_moves_means_no_shadow(stage):
    _, _, splats, shadow = stage
    count, splats.count = splats.count, shadow.begin
    splats.visibility.fill(0.5)
    shadow.cast()
    splats.count = count
    np.testing.assert_array_equal(splats.visibility.to_numpy()[: splats.count], 1)


def test_a_cast_beyond_the_capacity_is_repeated_when_it_is_finished(stage):
    floor, _, splats, shadow = stage
    cast(stage, LIGHT)
    expected = splats.visibility.to_numpy()[: splats.count]
    assert not shadow.finish()
    shadow.rasterizer.reserve(16)
    shadow.cast()
    assert (splats.visibility.to_numpy()[: len(floor)] == 1.0).all()  # nothing was drawn
    assert shadow.finish() and not shadow.finish()
    np.testing.assert_array_equal(splats.visibility.to_numpy()[: splats.count], expected)


N, PLACES = (
    1500,
    np.array([[-0.5, 0.4, 0.0], [0.5, 0.4, 0.0]]),
)  # Gaussians of a ball; of the captured, the modelled one
BETWEEN = 0.5 * (np.array(LIGHT.position) + PLACES[0])  # the captured ball and the light


@pytest.fixture(scope="module")
def photographed(ti_cpu):
    """A captured ball and a modelled one, side by side over a floor; the splats and their shadow map."""
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    splats = Splats(concatenate([sheet(2.0, 0.0, 0.02), *(ball(at, BLOB_RADIUS, N) for at in PLACES)]))
    shadow = ShadowMap(splats, LIGHT, splats.count - 2 * N)
    shadow.keep_captured_shadows([(shadow.begin, shadow.begin + N)])
    return splats, shadow


def lit(photographed, light: Light = LIGHT, modelled_at=PLACES[1]):
    """Visibility of the floor, the captured ball and the modelled one, with that one at a place."""
    splats, shadow = photographed
    means = splats.mean.to_numpy()
    moved = means.copy()
    moved[shadow.begin + N : splats.count] += modelled_at - PLACES[1]
    splats.mean.from_numpy(moved)
    shadow.set_light(light)
    shadow.cast()
    splats.mean.from_numpy(means)
    return np.split(splats.visibility.to_numpy()[: splats.count], [shadow.begin, shadow.begin + N])


def facing_light(center) -> np.ndarray:
    """Cosine of the angle between the normal of each Gaussian of a ball and the direction to the light."""
    to_light = np.array(LIGHT.position) - center
    return ball(0.0, 1.0, N).means @ to_light / np.linalg.norm(to_light)


def test_a_captured_ball_in_its_place_is_as_photographed_and_shadows_the_floor(photographed):
    on_floor, captured, modelled = lit(photographed)
    np.testing.assert_allclose(captured, 1, rtol=0, atol=1e-6)
    np.testing.assert_allclose(modelled[facing_light(PLACES[1]) < -0.7], 1 - LIGHT.strength, atol=0.05)
    right = sheet(2.0, 0.0, 0.02).means[:, 0] > 0
    assert (1 - on_floor)[~right].sum() == pytest.approx((1 - on_floor)[right].sum(), rel=0.02)
    assert on_floor[~right].min() == pytest.approx(1 - LIGHT.strength, abs=0.02)


def test_a_new_shadow_darkens_what_was_lit_when_photographed_and_nothing_twice(photographed):
    _, captured, modelled = lit(photographed, modelled_at=BETWEEN)
    facing = facing_light(PLACES[0])
    np.testing.assert_allclose(captured[facing > 0.5], 1 - LIGHT.strength, atol=0.02)
    np.testing.assert_allclose(captured[facing < -0.7], 1, atol=0.05)
    assert modelled[facing_light(BETWEEN) < -0.7].max() < 1 - 0.9 * LIGHT.strength


def test_what_was_half_in_shadow_loses_the_other_half_of_the_light(photographed):
    """With colours c (1 - s) in full shadow and c (1 - s + s e) as photographed it ends with the former, for any s."""
    splats, shadow = photographed
    e = splats.exposed.to_numpy()[shadow.begin : shadow.begin + N].astype(np.float64)
    half = (e > 0.3) & (e < 0.7)
    assert half.sum() > 20
    for s in (0.3, 0.6, 1.0):
        _, captured, _ = lit(photographed, replace(LIGHT, strength=s), BETWEEN)
        np.testing.assert_allclose(captured[half], (1 - s) / (1 - s + s * e[half]), atol=0.02)
        assert np.isfinite(captured).all() and captured.min() >= 0 and captured.max() <= 1


def test_another_light_shadows_another_side_of_a_captured_ball_and_lights_none_up(photographed):
    before = photographed[0].exposed.to_numpy()[photographed[1].begin :]
    _, captured, _ = lit(photographed, Light(position=(-2.5, 0.4, 0.0), target=tuple(PLACES[0]), softness=0.02))
    x, y, _ = ball(0.0, 1.0, N).means.T
    np.testing.assert_allclose(captured[(x > 0.7) & (y > 0.3)], 0.45, atol=0.05)
    np.testing.assert_allclose(captured[x < -0.3], 1, atol=1e-3)
    assert captured.max() <= 1
    _, captured, _ = lit(photographed, replace(LIGHT, strength=0.9))
    np.testing.assert_allclose(captured, 1, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(photographed[0].exposed.to_numpy()[photographed[1].begin :], before)


@pytest.mark.parametrize("far", [0.5, 1.0, 2.0])
def test_a_coarser_map_does_not_darken_what_was_captured_and_nobody_touched(ti_cpu, far):
    """As when a hand widens the cone of the light: a captured ball on a captured board, and one Gaussian far away.

    At soft edges a few Gaussians may darken; with a map of one width alone 2 to 8% of all do.
    """
    from render.shadow_map import ShadowMap
    from render.splats import Splats

    board, mote = sheet(0.3, 0.0, 0.005), ball([0.0, 0.05, 0.0], 0.001, 1)
    splats = Splats(concatenate([ball([0.0, 0.05, 0.0], 0.05, N), board, mote]))
    shadow = ShadowMap(splats, Light((1.0, 2.0, 0.5), kind="directional", softness=0.01), 0)
    shadow.keep_captured_shadows([(0, splats.count - 1)])
    means = splats.mean.to_numpy()
    means[splats.count - 1] += [far, 0.0, 0.0]
    splats.mean.from_numpy(means)
    shadow.cast()
    dark = 1 - splats.visibility.to_numpy()[: splats.count - 1]
    shadow.destroy()
    splats.destroy()
    assert (dark > 0.05).mean() < 0.0035 * far
