"""`tests/support/parity.py`: what it calls agreement, and what it says where there is nothing to compare."""

import numpy as np
import pytest

from core.errors import BadInput
from tests.support import parity


def images(rng=None) -> list[np.ndarray]:
    rng = rng or np.random.default_rng(0)
    return [rng.uniform(0, 1, (2, 30, 40, 3)), rng.uniform(0.1, 1, (2, 30, 40)), rng.uniform(1, 9, (2, 30, 40))]


@pytest.mark.parametrize("image", [0, 1, 2])
@pytest.mark.parametrize(("by", "passes"), [(5e-5, True), (1e-3, False), (np.nan, False), (np.inf, False)])
def test_a_pixel_that_differs_fails_unless_it_is_at_a_threshold(image, by, passes):
    a, b = images(), images()
    a[image][1, 4, 7] += by
    sure = np.zeros((2, 30, 40), bool)
    at_threshold = sure.copy()
    at_threshold[1, 4, 7] = True
    assert parity.compare("a; z, 2", a, b, sure)["pass"] == passes
    assert parity.compare("a; z, 2", a, b, at_threshold)["pass"] == bool(np.isfinite(by))
    assert parity.compare("a; z, 2", a, b, None)["pass"] == bool(np.isfinite(by))  # one of 2,400


def test_many_pixels_that_differ_fail():
    a, b = images(), images()
    a[0][0, :, :5] += 1e-3
    row = parity.compare("a; z, 2", a, b, None)
    assert not row["pass"] and row["left_out"] == pytest.approx(150 / 2400)
    assert not parity.compare("a; z, 2", b, b, np.ones((2, 30, 40), bool))["pass"]  # nothing was compared


def test_what_is_hardly_there_has_no_depth_and_what_is_bright_is_measured_by_its_light():
    a, b = images(), images()
    for one in (a, b):
        one[1][0, 0, 0] = 0.001
        one[0] *= 100.0
    a[2][0, 0, 0] += 1.0
    a[0][0, 0, 1] += 5e-3
    assert parity.compare("a; z, 2", a, b, np.zeros((2, 30, 40), bool))["pass"]


def test_only_hard_pictures_have_a_twin_that_knows_thresholds():
    hard = parity.hard_pictures()
    for way in parity.WAYS:
        doubts = parity.doubts_of(f"a cloud; {way}, 2", hard)
        assert doubts.shape == (2, 37, 53) and 0 < doubts.mean() < parity.MOST_DOUBTS
    assert parity.doubts_of("broken numbers 0; z, 1", hard) is None


def test_without_a_gpu_there_is_nothing_to_compare(monkeypatch, capsys):
    def start(arch):
        raise BadInput("--arch cuda: no CUDA GPU was found")

    monkeypatch.setattr(parity, "start_taichi", start)
    assert parity.main([]) == 2
    said = capsys.readouterr().err
    assert "no CUDA GPU was found" in said and said.count("\n") == 1
