"""Toy collection: gather the plush toys of a children's room in the basket, and carry it (VR-GS, Sec. 6.2)."""

from __future__ import annotations

import numpy as np

from assets.library import default_material
from scenes.childrens_room import BACKGROUND, FLOOR, TOYS, colliders, furniture, lamp, room, toys
from scenes.scene import Body, BodyState, Hand, Role, Scene
from scenes.scripted_carry import Carry
from scenes.scripted_throw import ease

BASKET_AT, RIM_RADIUS, BASKET_HEIGHT = (0.0, FLOOR, 0.30), 0.335, 0.264  # [m]
TURNS = ((0, 2, 4), (1, 3))  # toys that the scripted hands gather, left and right
PERIOD, LIFT_AT, LIFT_TIME = 1.5, 4.7, 0.9  # [s]


class ToyCollection:
    """Each toy in the basket scores; with all of them in it, it may be carried off."""

    duration = LIFT_AT + 2.1
    goal = len(TOYS)

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        self.inside: set[int] = set()
        self.carried = False
        self.carries: dict[tuple[int, int], Carry] = {}
        self.rim: np.ndarray | None = None  # where the scripted hands take the basket [m], (2, 3)

    def update(self, time: float, bodies: list[BodyState]) -> None:
        basket, *toys = bodies
        self.inside = {k for k, toy in enumerate(toys) if lies_in(basket, toy) and not toy.held}
        self.carried = bool(self.inside) and basket.held and basket.low[1] > FLOOR + 0.15

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        if time >= LIFT_AT:
            return self.lifting(time - LIFT_AT, bodies[0])
        hands = []
        for h, own in enumerate(TURNS):
            begun = time - 0.5 * h * PERIOD  # by turns, so that they do not meet
            turn = int(np.clip(begun // PERIOD, 0, len(own) - 1))
            toy = bodies[1 + own[turn]]
            if (h, turn) not in self.carries:
                over = bodies[0].centroid + [(2 * h - 1) * 0.08, 0.15, 0.08 * (turn - 1)]
                self.carries[h, turn] = Carry(
                    tuple(toy.centroid), tuple(over), height=0.55, reach=0.09, approach_time=0.3, carry_time=0.45
                )
            hands.append(self.carries[h, turn].hand(begun - turn * PERIOD))
        return hands

    def lifting(self, t: float, basket: BodyState) -> list[Hand]:
        """Both hands below the rim: they close, and lift it."""
        if self.rim is None:
            x, y, z = basket.centroid[0], basket.low[1] + 0.75 * BASKET_HEIGHT, basket.centroid[2]
            self.rim = np.array([(x + s * (RIM_RADIUS + 0.01), y, z) for s in (-1, 1)])
        up = 0.3 * ease((t - 0.5) / LIFT_TIME)
        return [Hand(tuple(p + [0.0, up, 0.6 * up]), grip=t >= 0.4, reach=0.05) for p in self.rim]

    @property
    def score(self) -> int:
        return len(self.inside)

    @property
    def message(self) -> str:
        if self.score == self.goal:
            return "All of them! Lift the basket." if not self.carried else "Tidied up. Press R to play again."
        return f"{self.score} of {self.goal} toys in the basket. Gather them."

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        gathered = sum(map(len, TURNS))  # of which one may roll off the heap
        assert self.score >= gathered - 1, f"only {self.score} of {gathered} toys in the basket"
        assert self.carried, "the basket was not lifted with the toys in it"
        assert all(b.low[1] > FLOOR - 0.03 for b in bodies), "something fell through the floor"


def lies_in(basket: BodyState, body: BodyState) -> bool:
    """Test if the body's centroid is within the basket, or heaped on what is in it."""
    up = basket.axis if basket.axis[1] > 0 else -basket.axis
    offset = body.centroid - basket.centroid
    height = float(offset @ up)
    return up[1] > 0.5 and -0.12 < height < 0.28 and np.linalg.norm(offset - height * up) < RIM_RADIUS


def build() -> Scene:
    return Scene(
        bodies=[*furniture(), Body("basket", default_material("basket"), position=BASKET_AT, kind="rigid"), *toys()],
        colliders=colliders(),
        light=lamp(),
        background=BACKGROUND,
        eye=(0.0, 1.25, 1.62),
        target=(0.0, 0.22, -0.05),
        game=ToyCollection(),
        roles=(Role("toy", tuple(TOYS)), Role("basket", ("basket",))),
        room=room(),
    )
