"""Box moving: carry the attic's boxes to the pallet, and see what the biggest one hid (VR-GS, Sec. 6.2)."""

from __future__ import annotations

import numpy as np

from core.material import Material
from scenes.scene import Body, BodyState, Box, Capsule, Hand, Light, Plane, Quat, Role, Room, Scene
from scenes.scripted_hands import ease

# The attic
KNEE, RIDGE = (2.1, 0.62), 2.55  # [m] x and height of the knee walls, height of the ridge
FAR, NEAR = -1.1, 2.5  # [m] z of the gable walls
BACKGROUND = (0.10, 0.08, 0.06)  # dark timber, behind the few pixels that no Gaussian covers
PALLET = ((0.90, 0.0, 0.02), (1.04, 0.12, 0.78))  # [m] middle of its foot, and size
HOLE = (-0.14, 0.14, 0.27)  # [m] along x, from and to, and height of the hole in the far wall that the big box hides
SIZES = {  # [m] of the boxes
    "box_cardboard": (0.46, 0.36, 0.38),
    "box_parcel": (0.30, 0.17, 0.22),
    "box_crate": (0.40, 0.30, 0.30),
    "box_tin": (0.22, 0.12, 0.22),
}
FULL = {  # material of a box with all that is in it: cardboard and paper give way where they are pressed
    "box_cardboard": Material(young=5e4, poisson=0.2, density=45.0, friction=0.6, damping=20.0),
    "box_parcel": Material(young=4e4, poisson=0.2, density=140.0, friction=0.6, damping=20.0),
    "box_crate": Material.named("wood", density=90.0),
    "box_tin": Material.named("wood", density=180.0, friction=0.4, kinetic_friction=0.3),
}
RIGID = ("box_crate", "box_tin")
STARTS = {  # place of each box: x, height of its foot, z [m], turn about y [degrees]
    "box_parcel": (0.03, 0.36, -0.87, -7.0),
    "box_tin": (-0.47, 0.30, -0.84, 12.0),
    "box_crate": (-0.46, 0.0, -0.86, 0.0),
    "box_cardboard": (0.0, 0.0, -0.88, 0.0),
}
PLACES = {  # x, z of each box on the pallet, from its middle [m]
    "box_parcel": (-0.26, 0.21),
    "box_tin": (0.26, 0.21),
    "box_crate": (0.26, -0.20),
    "box_cardboard": (-0.25, -0.18),
}

# The scripted hand
NAMES = list(PLACES)
APPROACH, LIFT, CARRY, LOWER, LEAVE = 0.3, 0.5, 0.9, 0.5, 0.2  # [s] with each box
WIDE_GRIP = 0.4  # its reach over a box's width: held by a small spot, a soft box swings
CLEARANCE = 0.30  # [m] between a box that is carried and the pallet
TURN = APPROACH + LIFT + CARRY + LOWER + LEAVE  # [s]


class BoxMoving:
    """A box scores while it stands on the pallet and no hand holds it.

    hole  whether the big box hides a mouse hole, as it does in the attic
    """

    duration = TURN * len(NAMES) + 0.6
    goal = len(NAMES)

    def __init__(self, hole: bool = True):
        self.hole = hole
        self.reset()

    def reset(self) -> None:
        self.placed: set[int] = set()
        self.found = False
        self.grasps: dict[int, np.ndarray] = {}  # top of each box as its turn began

    def update(self, time: float, bodies: list[BodyState]) -> None:
        self.placed = {k for k, b in enumerate(bodies) if on_pallet(b) and not b.held}
        self.found = self.hole and (self.found or not any(before_hole(b) for b in bodies))

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        k = min(int(time / TURN), len(NAMES) - 1)
        t = time - k * TURN
        width, height, depth = SIZES[NAMES[k]]
        top = np.array([bodies[k].centroid[0], bodies[k].high[1], bodies[k].centroid[2]])
        start, end = self.grasps.setdefault(k, top), place_of(NAMES[k]) + [0.0, 0.5 * height, 0.0]
        over = np.array([0.0, max(start[1], end[1] + CLEARANCE), 0.0])
        high, ready = np.where([0, 1, 0], over, start), np.where([0, 1, 0], over, end)
        away = np.array([0.0, 0.25, 0.15])
        path = [start + away, start, high, ready, end, end + away]
        keys = np.cumsum([0.0, APPROACH, LIFT, CARRY, LOWER, LEAVE])
        leg = int(np.clip(np.searchsorted(keys, t) - 1, 0, len(path) - 2))
        at = path[leg] + (path[leg + 1] - path[leg]) * ease((t - keys[leg]) / (keys[leg + 1] - keys[leg]))
        return [Hand(tuple(at), grip=keys[1] <= t < keys[4], reach=WIDE_GRIP * min(width, depth))]

    @property
    def score(self) -> int:
        return len(self.placed)

    @property
    def message(self) -> str:
        count = f"{self.score} of {len(NAMES)} boxes"
        if self.score == len(NAMES):
            mouse = ", and the mouse has its door free" if self.hole else ""
            return f"All four are on the pallet{mouse}! Press R to play again."
        if self.found:
            return f"A mouse lives there! {count} on the pallet."
        return f"{count} on the pallet with the chalk cross.{' What does the big box hide?' if self.hole else ''}"

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play: all boxes lie still on the pallet and the hole is free."""
        assert self.score == len(NAMES), f"only {self.score} of {len(NAMES)} boxes are on the pallet"
        assert self.found or not self.hole, "the mouse hole is still hidden"
        assert all(np.linalg.norm(b.velocity) < 0.02 for b in bodies), "a box still moves"


def place_of(name: str) -> np.ndarray:
    """Centre of a box in its place on the pallet [m], a little above it."""
    x, z = PLACES[name]
    return PALLET[0] + np.array([x, PALLET[1][1] + 0.5 * SIZES[name][1], z]) + [0.0, 0.004, 0.0]


def on_pallet(box: BodyState) -> bool:
    """True if a box stands on the pallet, or on another box there."""
    w, height, d = PALLET[1]
    aside = np.abs(box.centroid - PALLET[0])
    return bool(box.low[1] > PALLET[0][1] + height - 0.02 and aside[0] < w / 2 and aside[2] < d / 2)


def before_hole(box: BodyState) -> bool:
    """True if a box blocks the mouse hole."""
    return bool(box.low[0] < HOLE[1] and box.high[0] > HOLE[0] and box.low[1] < HOLE[2] and box.low[2] < FAR + 0.3)


def boxes() -> list[Body]:
    """The boxes, in the order in which they can be removed."""
    bodies = []
    for asset, (x, foot, z, turn) in STARTS.items():
        half = np.radians(turn) / 2
        rotation: Quat = (float(np.cos(half)), 0.0, float(np.sin(half)), 0.0)
        at = (x, foot + 0.5 * SIZES[asset][1], z)
        kind = "rigid" if asset in RIGID else "soft"
        bodies.append(Body(asset, FULL[asset], position=at, rotation=rotation, kind=kind))
    return bodies


def room_colliders() -> list[Plane | Box | Capsule]:
    """Floor, walls and slopes of the attic, and its furniture."""
    slope = np.array([RIDGE - KNEE[1], KNEE[0]]) / np.hypot(RIDGE - KNEE[1], KNEE[0])
    return [
        Plane((0, 0, 0), (0, 1, 0)),
        Plane((0, 0, FAR + 0.016), (0, 0, 1)),
        Plane((0, 0, NEAR), (0, 0, -1)),
        *(Plane((s * KNEE[0], 0, 0), (-s, 0, 0)) for s in (-1, 1)),
        *(Plane((0, RIDGE, 0), (-s * slope[0], -slope[1], 0)) for s in (-1, 1)),
        Box((-1.18, 0.25, -0.50), (0.39, 0.25, 0.23)),  # the trunk
        Box((-1.52, 0.26, 0.32), (0.27, 0.26, 0.19)),  # the suitcases
        Box((1.945, 0.31, -0.72), (0.145, 0.31, 0.30)),  # the shelf
        Capsule((1.00, 0.85, 1.15), (1.00, 1.35, 1.15), 0.13),  # the dress form
        *(Capsule((x, r, 0.35), (x, r, 1.9), r) for x, r in ((1.86, 0.11), (1.68, 0.09))),  # the carpets
    ]


def build() -> Scene:
    attic = room_colliders()
    (x, _, z), (w, h, d) = PALLET
    return Scene(
        bodies=[Body("attic"), Body("pallet", position=PALLET[0]), *boxes()],
        colliders=[*attic, Box((x, h / 2, z), (w / 2, h / 2, d / 2), friction=0.6)],
        light=Light(position=(0.42, 1.66, 0.34), target=(0.3, 0.2, -0.4)),  # the bulb
        background=BACKGROUND,
        eye=(0.15, 1.30, 1.45),
        target=(0.20, 0.42, -0.60),
        game=BoxMoving(),
        roles=(Role("box", tuple(NAMES)),),
        room=Room(
            ("attic",),
            tuple(attic),
            spot=(0.3, 0.0, -0.3),
            radius=1.0,
            on_floor=True,
            must_fit=True,
            game=BoxMoving(hole=False),
        ),
    )
