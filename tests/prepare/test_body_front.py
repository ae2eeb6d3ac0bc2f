"""The front of a body without cameras: in its mirror plane, on the side that has the pattern."""

import numpy as np
import pytest

from assets.asset import Asset
from assets.library import find_asset
from prepare.orientation.body_front import FRONT_SURE, front_of, turned_about_up
from prepare.pipeline import Options, clean_and_orient
from prepare.progress import no_progress
from tests.support.shells import ball


def toy(name: str, degrees: float):
    """A shipped body, whose front is +z, turned about the vertical."""
    return Asset.load(find_asset(name)).gaussians.transformed(turned_about_up(np.radians(degrees)))


@pytest.mark.parametrize(("name", "degrees"), [("toy_penguin", 130.0), ("sheep", -75.0)])
def test_the_front_is_found_however_a_body_is_turned(name, degrees):
    found = front_of(toy(name, degrees))
    off = (np.degrees(found.angle) - degrees + 180.0) % 360.0 - 180.0
    assert abs(off) <= 10.0 and found.sure > 0.9


def test_a_body_without_a_front_keeps_that_of_its_file():
    """A plain ball is alike from all sides."""
    assert front_of(ball()).sure < FRONT_SURE


def test_preparing_turns_the_front_to_the_player_or_by_what_is_asked():
    """None: the guess, which the provenance tells; a number: degrees; by default nothing."""
    g = toy("toy_penguin", 100.0)
    height = np.percentile(g.means[:, 1], 50)

    def ahead(**options) -> np.ndarray:
        """Direction of the upper half's middle with what was +x before."""
        found = clean_and_orient(g, Options(up="+y", **options), no_progress)
        return found["means"][found["means"][:, 1] > height]

    as_it_is, turned = ahead(), ahead(front=-100.0)
    np.testing.assert_allclose(as_it_is @ turned_about_up(np.radians(-100.0)).T, turned, atol=1e-5)
    guessed = ahead(front=None)
    cosine = (guessed * turned)[:, [0, 2]].sum() / np.sum(turned[:, [0, 2]] ** 2)
    assert cosine > np.cos(np.radians(10.0))
