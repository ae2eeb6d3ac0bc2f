"""Lengths as people write them, and the scale that two points and a length give."""

import pytest

from core.errors import BadInput
from core.measured_length import length_of, scale_between


@pytest.mark.parametrize(
    ("text", "metres"), [("1.2", 1.2), (" 35 cm", 0.35), ("1,5 m", 1.5), ("120MM", 0.12), ("6 ft", 1.8288), (".5", 0.5)]
)
def test_a_length_is_read_as_it_is_written(text, metres):
    assert length_of(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["", "cm", "-1", "1 mile", "0", "1e9", "nan", "5 5"])
def test_what_is_no_length_is_said(text):
    with pytest.raises(BadInput, match="length"):
        length_of(text)


def test_points_that_are_one_give_no_scale():
    assert scale_between((0, 0, 0), (0, 3, 4), 10.0) == pytest.approx(2.0)
    with pytest.raises(BadInput, match="different"):
        scale_between((1, 1, 1), (1, 1, 1), 1.0)
