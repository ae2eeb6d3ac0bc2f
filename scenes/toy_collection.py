"""Toy collection: gather the plush toys of a children's room in the basket, and carry it (VR-GS, Sec. 6.2)."""

from __future__ import annotations

import numpy as np

from assets.library import default_material
from core.material import Material
from scenes.scene import Body, BodyState, Box, Hand, Light, Plane, Quat, Role, Room, Scene, floor_and_walls
from scenes.scripted_hands import Carry, ease

# The children's room
FLOOR = 0.005  # [m] the pile of the rug gives way by as much as it is over the boards
BED_TOP, SHELF_TOP = 0.46, 0.64  # [m]
BACKGROUND = (0.55, 0.5, 0.42)  # behind the few pixels that no Gaussian covers
PLUSH = Material.named("plush")
TOYS = {  # name: (x, y, z) [m], turn about the vertical and forwards [degrees]
    "toy_teddy": ((-0.68, FLOOR, 0.48), 40, 0), "toy_rabbit": ((0.70, FLOOR, 0.45), -35, 0),
    "toy_elephant": ((-0.66, FLOOR, 0.02), 60, 0), "toy_cat": ((0.66, FLOOR, 0.02), -50, 0),
    "toy_duck": ((-0.24, FLOOR, -0.30), 20, 0), "toy_penguin": ((0.22, FLOOR, -0.34), -15, 0),
    "toy_star": ((-0.62, FLOOR + 0.059, -0.46), 30, -90), "toy_frog": ((0.62, FLOOR, -0.42), -25, 0),
    "toy_octopus": ((0.0, FLOOR, -0.74), 0, 0), "toy_ladybird": ((1.02, FLOOR, 0.3), -70, 0),
    "toy_dinosaur": ((-1.33, BED_TOP + 0.005, -0.32), 60, 0), "toy_whale": ((-1.33, BED_TOP + 0.005, -0.85), 50, 0),
}  # fmt: skip

# The play
BASKET_AT, RIM_RADIUS, BASKET_HEIGHT = (0.0, FLOOR, 0.30), 0.335, 0.264  # [m]
TURNS = ((0, 2, 4), (1, 3))  # toys that the scripted hands gather, left and right
PERIOD, LIFT_AT, LIFT_TIME, SET_DOWN_AT = 1.5, 4.7, 0.9, 1.7  # [s]; the last from the lift's beginning


class ToyCollection:
    """Each toy in the basket scores; with all of them in it, it may be carried off."""

    duration = LIFT_AT + SET_DOWN_AT + LIFT_TIME + 0.7
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
        self.carried |= bool(self.inside) and basket.held and basket.low[1] > FLOOR + 0.15

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
        """Both hands below the rim: they close, lift it, set it down nearer to the player, and let go."""
        if self.rim is None:
            x, y, z = basket.centroid[0], basket.low[1] + 0.75 * BASKET_HEIGHT, basket.centroid[2]
            self.rim = np.array([(x + s * (RIM_RADIUS + 0.01), y, z) for s in (-1, 1)])
        lifted, lowered = ease((t - 0.5) / LIFT_TIME), ease((t - SET_DOWN_AT) / LIFT_TIME)
        way = np.array([0.0, 0.3 * (lifted - lowered), 0.18 * lifted])
        after = t - SET_DOWN_AT - LIFT_TIME - 0.1
        apart = np.array([0.15 * ease(after / 0.4), 0.0, 0.0])
        grip = t >= 0.4 and after < 0.0
        return [Hand(tuple(p + way + s * apart), grip=grip, reach=0.05) for p, s in zip(self.rim, (-1, 1), strict=True)]

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
        assert not bodies[0].held and bodies[0].low[1] < FLOOR + 0.02, "the basket was not set down"
        assert all(b.low[1] > FLOOR - 0.03 for b in bodies), "something fell through the floor"


def lies_in(basket: BodyState, body: BodyState) -> bool:
    """Test if the body's centroid is within the basket, or heaped on what is in it."""
    up = basket.axis if basket.axis[1] > 0 else -basket.axis
    offset = body.centroid - basket.centroid
    height = float(offset @ up)
    return up[1] > 0.5 and -0.12 < height < 0.28 and np.linalg.norm(offset - height * up) < RIM_RADIUS


def toys() -> list[Body]:
    """The plush toys, strewn about, at rest."""
    return [
        Body(name, PLUSH, position=at, rotation=_turned(turn, forwards), asleep=True)
        for name, (at, turn, forwards) in TOYS.items()
    ]


def _turned(turn: float, forwards: float) -> Quat:
    """Quaternion of a body that is first tipped forwards, then turned about the vertical [degrees]."""
    a, b = np.radians([turn, forwards]) / 2
    return (np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a) * np.cos(b), -np.sin(a) * np.sin(b))


def room_colliders() -> list[Plane | Box]:
    """Floor and walls, bed, and the boards of the shelf."""
    boards = [Box((-0.19, y, -1.51), (0.67, 0.011, 0.17)) for y in (0.061, 0.334, SHELF_TOP - 0.011)]
    uprights = [Box((-0.849 + 0.4393 * k, 0.31, -1.51), (0.011, 0.31, 0.165)) for k in range(4)]
    return [
        *floor_and_walls((-1.9, 1.9), (-1.7, 2.1), floor=FLOOR, friction=0.7),
        Box((-1.43, BED_TOP / 2, -0.76), (0.45, BED_TOP / 2, 0.92), friction=0.8),
        Box((-1.43, 0.40, -1.65), (0.45, 0.40, 0.03)),
        Box((-1.43, 0.28, 0.13), (0.45, 0.28, 0.03)),
        *boards,
        *uprights,
    ]


def build() -> Scene:
    own = room_colliders()
    basket = Body("basket", default_material("basket"), position=BASKET_AT, kind="rigid")
    return Scene(
        bodies=[Body("childrens_room"), basket, *toys()],
        colliders=own,
        light=Light(position=(0.25, 2.02, 0.35), target=(0.0, 0.0, 0.0), strength=0.36, softness=0.05),
        background=BACKGROUND,
        eye=(0.0, 1.25, 1.62),
        target=(0.0, 0.22, -0.05),
        game=ToyCollection(),
        roles=(Role("toy", tuple(TOYS)), Role("basket", ("basket",))),
        room=Room(("childrens_room",), tuple(own), spot=(0.0, FLOOR, 0.0), radius=0.9, on_floor=True),
    )
