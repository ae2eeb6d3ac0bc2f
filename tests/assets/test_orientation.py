"""The up axis: known scenes, downloaded splats, confidence; and the front of a body."""

import numpy as np
import pytest

from assets import orientation
from assets.asset import Asset
from assets.gaussians import Gaussians
from assets.library import find_asset
from assets.splat_files import read_gaussians
from prepare.cleaning import clean
from prepare.pipeline import Options, clean_and_orient
from prepare.progress import no_progress
from tests.support.cage_cases import case
from tests.support.sample_scenes import brick, garden, room, table_and_jug
from tests.support.samples import discs
from tests.support.shells import ball

EVEN = dict.fromkeys(orientation.AXES, 1 / 6)
SCENES = {"room": room, "open room": lambda: room(ceiling=False), "garden": garden, "table": table_and_jug}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_stands_on_its_floor_whatever_axis_is_up(name):
    """Walls, a shelf and a chest do not mislead."""
    g = SCENES[name]()
    g = g.select(np.arange(0, len(g), 3))
    for up in orientation.AXES:
        p = orientation.up_probabilities(g.transformed(orientation.rotation_to_up(up).T), EVEN)
        assert max(p, key=p.get) == up and p[up] > 0.4, (up, p)


def test_what_misleads_makes_unsure():
    """A mug whose underside is missing looks as if it were open below, too: the truth is among the alternatives."""
    p = orientation.up_probabilities(clean(case("mug", 12_000))[0], EVEN)
    assert "+y" in orientation.alternatives(p) and len(orientation.alternatives(p)) > 1


def test_alternatives_are_likely_and_only_asked_for_where_the_guess_is_unsure():
    p = orientation.up_probabilities(case("capsule", 6000))  # it lies on any side
    assert sum(p.values()) == pytest.approx(1.0)
    assert orientation.alternatives(p) == sorted((up for up in p if p[up] > 0.02), key=p.get, reverse=True)
    assert orientation.alternatives(dict.fromkeys(orientation.AXES, 0.02) | {"-y": 0.9}) == ["-y"]
    chances = {"-y": 0.5, "+y": 0.3, "+z": 0.19, "-z": 0.01}
    assert orientation.question(chances) == "which way is up is not sure: --up -y 50%, --up +y 30%, --up +z 19%"
    assert orientation.question({"-y": 0.97, "+y": 0.03}) == ""


def test_no_guess_is_surer_than_the_lapses_of_the_model_leave_it():
    """A table on its legs is beyond doubt, but the cues may mean nothing there."""
    assert max(orientation.up_probabilities(table_and_jug(), EVEN).values()) <= 1 - orientation.LAPSE * 5 / 6 + 1e-12


@pytest.mark.parametrize("name", ["toy_cat", "plush_dragon", "biker_human"])
def test_downloaded_splats_stand_on_their_feet(name, shared):
    """None of which the model was fitted to."""
    found = orientation.guess_up_axis(read_gaussians(shared / f"data/splats/{name}.ply"))
    assert found[0] == {"toy_cat": "-y", "plush_dragon": "+y", "biker_human": "-y"}[name] and found[1] > 0.6


def empty_box() -> Gaussians:
    """A closed empty room has no floor that could be told from its ceiling."""
    return brick(np.random.default_rng(0), (-2, 0, -2.5), (2, 2.2, 2.5), 0.08, 0.0)


def mirrored_sphere() -> Gaussians:
    """Points of a sphere mirrored in all planes: no cue tells its axes apart."""
    points = np.random.default_rng(0).normal(size=(40, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    turned = np.concatenate([np.roll(points, k, axis=1) for k in range(3)])
    signs = np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 1, 3)
    return discs((signs * turned).reshape(-1, 3), np.exp(-4.0))


@pytest.mark.parametrize(("make", "prior"), [(empty_box, EVEN), (mirrored_sphere, orientation.FILE_PRIOR)])
def test_what_looks_the_same_upside_down_is_not_sure(make, prior):
    p = orientation.up_probabilities(make(), prior)
    assert max(p.values()) < 0.7 and len(orientation.alternatives(p)) > 1


def toy(name: str, degrees: float):
    """A shipped body, whose front is +z, turned about the vertical."""
    return Asset.load(find_asset(name)).gaussians.transformed(orientation.turned_about_up(np.radians(degrees)))


@pytest.mark.parametrize(("name", "degrees"), [("toy_penguin", 130.0), ("sheep", -75.0)])
def test_the_front_is_found_however_a_body_is_turned(name, degrees):
    angle, sure = orientation.front_of(toy(name, degrees))
    off = (np.degrees(angle) - degrees + 180.0) % 360.0 - 180.0
    assert abs(off) <= 10.0 and sure > 0.9


def test_a_body_without_a_front_keeps_that_of_its_file():
    """A plain ball is alike from all sides."""
    assert orientation.front_of(ball())[1] < orientation.FRONT_SURE


def test_preparing_turns_the_front_to_the_player_or_by_what_is_asked():
    """None: the guess, which the provenance tells; a number: degrees; by default nothing."""
    g = toy("toy_penguin", 100.0)
    height = np.percentile(g.means[:, 1], 50)

    def ahead(**options) -> np.ndarray:
        """Direction of the upper half's middle with what was +x before."""
        found = clean_and_orient(g, Options(up="+y", **options), no_progress)
        return found["means"][found["means"][:, 1] > height]

    as_it_is, turned = ahead(), ahead(front=-100.0)
    np.testing.assert_allclose(as_it_is @ orientation.turned_about_up(np.radians(-100.0)).T, turned, atol=1e-5)
    guessed = ahead(front=None)
    cosine = (guessed * turned)[:, [0, 2]].sum() / np.sum(turned[:, [0, 2]] ** 2)
    assert cosine > np.cos(np.radians(10.0))
