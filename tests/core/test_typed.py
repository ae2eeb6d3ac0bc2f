"""Typed data from outside: what fits its type is read, all else is refused in one line that names key and defect."""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from core.errors import BadInput
from core.typed import Form, Range, Shape, Size, from_json, from_plain, to_json, to_plain


@dataclass(frozen=True)
class Lamp:
    name: Annotated[str, Size(5, least=1)]
    position: tuple[float, float, float]
    kind: Literal["point", "sun"] = "point"
    strength: Annotated[float, Range(0, 1)] = 0.5
    file: Annotated[str, Form(r"\w+\.h5", "the name of an .h5 file")] | None = None

    def __post_init__(self):
        if self.kind == "sun" and self.position == (0, 0, 0):
            raise ValueError("the sun has no direction")


@dataclass(frozen=True, eq=False)
class Room:
    lamps: Annotated[tuple[Lamp, ...], Size(2)]
    turn: Annotated[np.ndarray, Shape(2, 2)]
    path: Annotated[np.ndarray, Shape(None, 2), Range(0, 9)] | None = None
    count: Annotated[int, Range(0, 10)] = 0
    lit: bool = True
    limits: dict[str, float | str] = field(default_factory=dict)
    about: Any = None


LAMP = {"name": "a", "position": [0, 1, 2.5]}
TURN = [[1, 0], [0, 1]]


def test_a_value_comes_back_as_it_was():
    lamps = (Lamp("a", (0.0, 1.0, 2.5), file="x.h5"), Lamp("b", (1.0, 0.0, 0.0), "sun", 1.0))
    room = Room(lamps, np.eye(2), np.array([[1.0, 2.0]]), 3, False, {"x": 1.0, "y": "no"}, about=[1, {"a": None}])
    back = from_json(Room, to_json(room), "r.json")
    assert back.lamps == lamps and back.limits == room.limits and back.about == room.about
    assert (back.turn == room.turn).all() and (back.path == room.path).all() and (back.count, back.lit) == (3, False)
    assert type(back.lamps[0].position[0]) is float


def test_what_is_none_by_default_is_left_out():
    assert to_plain(Lamp("a", (0.0, 1.0, np.float64(2.5)))) == LAMP | {"kind": "point", "strength": 0.5}


@pytest.mark.parametrize(
    ("plain", "error"),
    [
        ([], "it is [], not an object with lamps, turn, path, count, lit, limits, about"),
        ({"turn": TURN}, "lamps is missing"),
        ({"lamps": [], "turn": TURN, "colour": 1}, "colour is unknown"),
        ({"lamps": [LAMP] * 3, "turn": TURN}, "not a list of 0 to 2"),
        ({"lamps": [LAMP, {"name": "b"}], "turn": TURN}, "lamps[1].position is missing"),
        ({"lamps": [LAMP | {"position": [0, 1]}], "turn": TURN}, "lamps[0].position is [0, 1], not a list of 3"),
        ({"lamps": [LAMP | {"position": [0, 1, True]}], "turn": TURN}, "lamps[0].position[2] is True, not a number"),
        ({"lamps": [LAMP | {"position": [0, 1, 10**400]}], "turn": TURN}, "lamps[0].position[2] is 1000"),
        ({"lamps": [LAMP | {"position": [0, 0, 0], "kind": "sun"}], "turn": TURN}, "lamps[0]: the sun has no dir"),
        ({"lamps": [LAMP | {"kind": ["point"]}], "turn": TURN}, "lamps[0].kind is ['point'], not one of point, sun"),
        ({"lamps": [LAMP | {"name": ""}], "turn": TURN}, "lamps[0].name is '', not a text of 1 to 5 characters"),
        ({"lamps": [LAMP | {"strength": 2}], "turn": TURN}, "lamps[0].strength is 2, not a number from 0 to 1"),
        ({"lamps": [LAMP | {"strength": float("nan")}], "turn": TURN}, "lamps[0].strength is nan, not a number"),
        ({"lamps": [LAMP | {"file": "../x.h5"}], "turn": TURN}, "lamps[0].file is '../x.h5', not the name of an .h5"),
        ({"lamps": [], "turn": [[1, 0], [0]]}, "turn is [[1, 0], [0]], not 2x2 finite numbers"),
        ({"lamps": [], "turn": [[1, 0], [0, "1"]]}, "not 2x2 finite numbers"),
        ({"lamps": [], "turn": [[1, 0], [0, True]]}, "not 2x2 finite numbers"),
        ({"lamps": [], "turn": [[1, 0], [0, float("inf")]]}, "not 2x2 finite numbers"),
        ({"lamps": [], "turn": TURN, "path": [[0, 10]]}, "path is [[0, 10]], not Nx2 finite numbers from 0 to 9"),
        ({"lamps": [], "turn": TURN, "count": 1.5}, "count is 1.5, not a whole number from 0 to 10"),
        ({"lamps": [], "turn": TURN, "lit": 1}, "lit is 1, not true or false"),
        ({"lamps": [], "turn": TURN, "limits": {"x": None}}, "limits.x is None, not a text"),
        ({"lamps": [], "turn": TURN, "limits": [1]}, "limits is [1], not an object"),
    ],
)
def test_what_does_not_fit_is_refused(plain, error):
    with pytest.raises(BadInput) as caught:
        from_plain(Room, plain, "r.json")
    assert str(caught.value).startswith("r.json: ") and error in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("text", ["", "[1", "[" * 100_000, b"\xff", '{"a": 1e', "9" * 5000])
def test_text_that_is_no_json_is_refused(text):
    with pytest.raises(BadInput, match=r"^r.json: "):
        from_json(Lamp, text, "r.json")


def test_messages_are_tuples():
    assert from_plain(tuple[float, bool], [1, True], "move") == (1.0, True)
    assert from_plain(tuple[()], [], "blur") == ()
    for wrong in ([1], [1, True, 2], {"a": 1}):
        with pytest.raises(BadInput, match=r"^move: "):
            from_plain(tuple[float, bool], wrong, "move")
