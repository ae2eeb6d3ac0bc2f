"""The attic's floor, on which boxes are moved: the room's colliders, the boxes, the pallet, and what they hide."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from core.material import Material
from scenes.scene import Body, Box, Capsule, Game, Light, Plane, Quat, Room, Spot, Vec3

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
# Place of each box: x, height of its foot, z [m], turn about y [degrees]; then its place on the pallet.
STARTS = {
    "box_parcel": (0.03, 0.36, -0.87, -7.0),
    "box_tin": (-0.47, 0.30, -0.84, 12.0),
    "box_crate": (-0.46, 0.0, -0.86, 0.0),
    "box_cardboard": (0.0, 0.0, -0.88, 0.0),
}
STATIONS = ((0.90, 0.02, 0.65), (0.0, -0.88, 0.33), (-0.46, -0.86, 0.28))  # x, z, radius: the pallet, two stacks [m]
PLACES = {
    "box_parcel": (-0.26, 0.21),
    "box_tin": (0.26, 0.21),
    "box_crate": (0.26, -0.20),
    "box_cardboard": (-0.25, -0.18),
}


def furniture() -> list[Body]:
    """The static bodies: the room, and the pallet."""
    return [Body("attic"), Body("pallet", position=PALLET[0])]


def boxes() -> list[Body]:
    """The boxes, in the order in which they can be taken away."""
    bodies = []
    for asset, (x, foot, z, turn) in STARTS.items():
        half = np.radians(turn) / 2
        rotation: Quat = (float(np.cos(half)), 0.0, float(np.sin(half)), 0.0)
        at = (x, foot + 0.5 * SIZES[asset][1], z)
        bodies.append(
            Body(asset, FULL[asset], position=at, rotation=rotation, kind="rigid" if asset in RIGID else "soft")
        )
    return bodies


def colliders() -> list[Plane | Box | Capsule]:
    """The room's, and the pallet's."""
    (x, _, z), (w, h, d) = PALLET
    return [*room_colliders(), Box((x, h / 2, z), (w / 2, h / 2, d / 2), friction=0.6)]


def room(game_at: Callable[[Sequence[Spot], float], Game]) -> Room:
    """The attic, from which the play moves on to another floor: boxes and pallet come along."""
    return Room(("attic",), tuple(room_colliders()), (0.3, 0.0, -0.3), 1.0, True, STATIONS, game_at)


def room_colliders() -> list[Plane | Box | Capsule]:
    """Floor, walls, slopes, and what stands about."""
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


def lamp(target: Vec3 = (0.3, 0.2, -0.4)) -> Light:
    """The bulb."""
    return Light(position=(0.42, 1.66, 0.34), target=target)
