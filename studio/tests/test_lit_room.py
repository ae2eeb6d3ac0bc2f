"""Light of a modelled room: how far it is smoothed."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studio.baked_light import BakedLight
from studio.detail import Detail
from studio.finish import sample_albedo, smoothed
from studio.light_sources import Lamp, LightSources, Opening
from studio.lit_room import ROUNDS, more_rounds
from studio.shapes import Surface, quad
from studio.surface_sampling import Viewer, sample_surface
from studio.textures import plain


def test_gathered_light_is_smoothed_over_as_many_metres_at_any_detail():
    """Of more Gaussians each gathers with fewer rays, whose noise showed as blotches when it shared as few of them."""
    floor = Surface("floor", quad((-1, 0, 0.2), (2, 0, 0), (0, 0, -0.4)), plain("808080", 0.0), 0.06, uniform=True)
    widths = []
    for detail in (Detail(), Detail(9.0)):
        finer = Surface("floor", floor.mesh, floor.colour, detail.spacing(floor.spacing), uniform=True)
        surfels = sample_surface(finer, 0, np.random.default_rng(1), None)
        bright = (surfels.points[:, :1] > 0.0).astype(float)
        blurred = smoothed(surfels, bright, 1.3, 16, rounds=ROUNDS + more_rounds(detail))
        inner = np.abs(surfels.points[:, 2]) < 0.1
        widths.append(np.abs(blurred - bright)[inner & (np.abs(surfels.points[:, 0]) < 0.8)].mean())
    assert 0.8 < widths[1] / widths[0] < 1.25


def test_the_sky_shines_into_a_room_through_its_openings_alone():
    """Rays that left behind a skirting board met the sky, and a bright line stood at the foot of the wall."""
    window = Opening(np.array([-1.0, 1.0, -0.5]), np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    origins = np.array([[0.0, 1.5, 0.0], [0.0, 1.5, 0.0], [0.0, 0.2, 0.0], [0.0, 1.5, 0.0]])
    out = np.array([[-1.0, 0.0, 0.1], [1.0, 0.0, 0.1], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    seen = LightSources([window]).sky_beyond(origins, out).max(1) > 0
    assert seen.tolist() == [True, False, False, False]  # towards the window, away from it, below it, along its wall
    assert not LightSources().sky_beyond(origins, out).any()
    assert (LightSources(None).sky_beyond(origins, out) > 0).all()


def test_what_leaves_a_room_at_a_joint_meets_the_light_of_its_place():
    """Black lines stood under mouldings, whose backs are open."""
    pytest.importorskip("open3d")
    rng, viewer = np.random.default_rng(0), Viewer((0.0, 1.0, 0.0), ((0.0, 1.0, 0.0),))
    floor = Surface("floor", quad((-1, 0, 1), (2, 0, 0), (0, 0, -2)), plain("c08040", 0.0), 0.06, uniform=True)
    surfels = sample_surface(floor, 0, rng, None)
    lamp = Lamp(np.array([0.3, 1.2, 0.0]), 0.05, np.ones(3))
    sources = LightSources([], [lamp])
    light = BakedLight([floor], sources, viewer, surfels, sample_albedo(surfels, [floor], rng), rng)
    places, up = np.array([[0.3, 0.0, 0.1], [-0.7, 0.0, 0.6]]), np.tile([0.0, 1.0, 0.0], (2, 1))
    seen = light.radiance(places + 0.5 * up, -up)
    lost = light.reflected(places, up, (0.0, 1.0, 0.0), np.full(2, 0.1), 4, rng)
    assert_allclose(lost, seen, rtol=0.15)
    assert (lost[0] > 2 * lost[1]).all() and (lost > 0).all()
    assert not light.radiance(places + 0.5 * up, up).any()
