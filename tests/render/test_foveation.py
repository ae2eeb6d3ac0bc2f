"""Foveated pictures: those of a full renderer where the eye looks, near them around it, steady under a moving gaze."""

import numpy as np
import pytest
import taichi as ti

from core.camera import look_at, perspective
from tests.support.hard_pictures import cloud, round_ones

SIDES = (401, 300)  # [px] no multiple of a tile
GAZES = [(0.0, 0.0), (200.0, 150.0), (400.5, 299.0)]  # [px]


def coordinates(zones, x):
    """Twin in float64: coordinates in the grid of x [px] by integrating the density of samples along a side."""
    ends = np.arange(0.0, x.max() + 0.5, 0.5)
    middles = ends[:-1] + 0.25
    density = np.select(
        [(middles > zones[1]) & (middles < zones[2]), (middles > zones[0]) & (middles < zones[3])], [1.0, 0.5], 0.25
    )
    return np.interp(x, ends, np.append(0.0, np.cumsum(0.5 * density)))


@pytest.mark.parametrize("gaze", GAZES)
def test_places_in_the_grid_have_the_density_of_the_zones_and_an_inverse(ti_cpu, gaze):
    from render.foveation import RADIUS, Fovea

    fovea = Fovea(1, (8, 8))
    fovea.place([gaze], *SIDES)
    x = np.arange(0, 400, 0.5).astype(np.float32)
    u, back = ti.field(ti.f32, (2, len(x))), ti.field(ti.f32, (2, len(x)))
    places = ti.field(ti.f32, len(x))
    places.from_numpy(x)

    @ti.kernel
    def convert():
        for i in places:
            for axis in ti.static(range(2)):
                u[axis, i] = fovea.to_grid(0, axis, places[i])
                back[axis, i] = fovea.to_picture(0, axis, u[axis, i])

    convert()
    for axis, zones in enumerate(fovea.zones([gaze], *SIDES)[0]):
        np.testing.assert_array_equal(u.to_numpy()[axis], coordinates(zones, x.astype(np.float64)))
        np.testing.assert_array_equal(back.to_numpy()[axis], x)
        radius = RADIUS * max(SIDES)
        assert zones[1] <= max(gaze[axis] - radius, 0) and zones[2] >= min(gaze[axis] + radius, SIDES[axis])
        assert not np.any(zones % (4 * 8)), "tiles of the zones are not those of the picture"
    fovea.destroy()


@pytest.fixture(scope="module")
def pair(ti_cpu):
    """Makes full and foveated renderers of the same Gaussians; those without options share their kernels."""
    from render.renderer import Renderer
    from render.splats import Splats

    made = {}

    def make(g, **how):
        key = tuple(how.items())
        if key not in made:
            splats = Splats(g.with_sh_degree(0), capacity=3000)
            made[key] = splats, [Renderer(splats, *SIDES, foveate=foveate, **how) for foveate in (False, True)]
        splats, renderers = made[key]
        splats.replace(g.with_sh_degree(0))
        for renderer in renderers:
            renderer.forget()
        return renderers

    yield make
    for splats, renderers in made.values():
        for renderer in renderers:
            renderer.destroy()
        splats.destroy()


def within(renderer, v):
    """Slices of the picture's rows and columns that the fovea of view v has."""
    (_, left, right, _), (_, top, bottom, _) = renderer.rasterizer.projection.fovea.edges.to_numpy()[v].astype(int)
    return slice(top, bottom), slice(left, right)


@pytest.mark.parametrize("how", [{"antialias": True}, {"sort": "pixel", "outputs": "deep"}])
def test_the_fovea_has_the_pixels_of_a_full_picture_wherever_either_eye_looks(pair, how):
    """Also while only Gaussians or only the gaze change, and the rest keeps its tiles."""
    rng = np.random.default_rng(5)
    full, foveated = pair(cloud(rng, 700, spread=0.7, size=0.05), views=2, **how)
    eyes = [perspective(*SIDES, 1.0, look_at((x, 0, -2), (x, 0, 0))) for x in (-0.03, 0.03)]
    for gazes in (None, [(90.0, 40.0), (120.0, 40.0)], [(390.0, 290.0)] * 2):
        foveated.gazes = gazes
        for renderer in (full, foveated):
            renderer.render(eyes)
        for v, (a, b) in enumerate(zip(full.pixels(), foveated.pixels(), strict=True)):
            rows, columns = within(foveated, v)
            inside = a[rows, columns]
            assert inside[..., :3].std() > 5 and inside[..., 0].size > 60 * 60
            np.testing.assert_array_equal(b[rows, columns], inside)
            assert (a != b).any(), "nothing is coarser"
    fewer = np.prod(foveated.rasterizer.projection.fovea.drawn) / np.prod(SIDES)
    assert fewer < 0.45


def test_what_is_smooth_is_drawn_as_by_a_full_renderer_without_a_seam(pair):
    g = round_ones(np.random.default_rng(2).uniform(-1, 1, (30, 3)), size=0.25)
    full, foveated = pair(g)
    camera = perspective(*SIDES, 1.0, look_at((0, 0, -4), (0, 0, 0)))
    for renderer in (full, foveated):
        renderer.render([camera])
    a, b = (renderer.pixels()[0, ..., :3].astype(int) for renderer in (full, foveated))
    assert a.std() > 5
    assert np.abs(a - b).max() <= 6 and np.abs(a - b).mean() < 0.5


def test_far_from_the_gaze_the_picture_stays_while_it_moves(pair):
    """Samples beyond the ring stand where they stood, and show the same splats with the same filter."""
    _, foveated = pair(cloud(np.random.default_rng(8), 700, spread=0.7, size=0.02))
    camera = perspective(*SIDES, 1.0, look_at((0, 0, -2), (0, 0, 0)))
    pictures, zones = [], set()
    for x in range(60, 140, 8):
        foveated.gazes = [(float(x), 150.0)]
        foveated.render([camera])
        pictures.append(foveated.pixels()[0, :, 320:, :3].copy())
        zones.add(within(foveated, 0)[1].start)
    assert len(zones) > 2 and pictures[0].std() > 5
    for picture in pictures[1:]:
        np.testing.assert_allclose(picture.astype(int), pictures[0], atol=1)  # splats that reach far into both


def test_small_splats_flicker_less_for_the_wider_filter(pair, monkeypatch):
    """Coarse means of the picture's far part change less between close views than those of bare samples."""
    import render.projection as projection

    def flicker(**how):
        full, foveated = pair(cloud(np.random.default_rng(4), 3000, spread=0.5, size=0.006), **how)
        foveated.gazes, means = [(0.0, 0.0)], []
        for k in range(8):
            camera = perspective(*SIDES, 1.0, look_at((0.004 * k, 0, -2), (0.004 * k, 0, 0)))
            for renderer in (full, foveated):
                renderer.render([camera])
            a, b = (r.pixels()[0, 140:300, 200:400, :3].astype(float) for r in (full, foveated))
            means.append((a - b).reshape(20, 8, 25, 8, 3).mean((1, 3)))
        return np.abs(np.diff(means, axis=0)).mean()

    steady = flicker()
    monkeypatch.setattr(projection, "BLUR", 0.0)
    assert steady < 0.75 * flicker(sort="z")  # compiled anew
