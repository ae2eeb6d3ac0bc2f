"""The theatre, in which the dance plays: its stage, the two tables before it with things to throw, and its light."""

from __future__ import annotations

from scenes.scene import Body, Box, Light, Plane, Room, Vec3

STAGE_TOP = 0.75  # [m] height of the boards
STAGE_FRONT, STAGE_BACK, STAGE_HALF_WIDTH = 0.72, -1.75, 2.1  # [m]
OPENING_HALF_WIDTH = 1.55  # [m] between the pilasters
TABLE_TOP = 0.86  # [m]
TABLES = ((-0.70, TABLE_TOP, 1.18), (0.70, TABLE_TOP, 1.18))  # [m] centres of their tops
TABLE_HALF = (0.31, 0.17)  # [m] along x and z
HALL_HALF_WIDTH, HALL_BACK = 2.9, 5.2  # [m]
PLAY_RADIUS = 0.8  # [m] of the stage that a play needs
BACKGROUND = (0.10, 0.03, 0.03)  # velvet in the dark, behind the few pixels that no Gaussian covers


def furniture() -> list[Body]:
    """The static body: theatre and hall."""
    return [Body("stage")]


def colliders() -> list[Plane | Box]:
    """Floor and walls of the hall, the stage with its footlights, backdrop and pilasters, and the tables."""
    middle, half = 0.5 * (STAGE_FRONT + STAGE_BACK), 0.5 * (STAGE_FRONT - STAGE_BACK)
    pilaster = 0.5 * (HALL_HALF_WIDTH - OPENING_HALF_WIDTH)
    return [
        Plane((0, 0, 0), (0, 1, 0)),
        Plane((-HALL_HALF_WIDTH, 0, 0), (1, 0, 0)),
        Plane((HALL_HALF_WIDTH, 0, 0), (-1, 0, 0)),
        Plane((0, 0, STAGE_BACK), (0, 0, 1)),
        Plane((0, 0, HALL_BACK), (0, 0, -1)),
        Box((0, 0.5 * STAGE_TOP, middle), (HALL_HALF_WIDTH, 0.5 * STAGE_TOP, half), friction=0.5),
        Box((0, STAGE_TOP + 0.035, 0.635), (1.32, 0.035, 0.045)),  # the footlights
        *(Box((s * (OPENING_HALF_WIDTH + pilaster), 2.2, 0.37), (pilaster, 1.5, 0.07)) for s in (-1, 1)),
        *(Box((x, y - 0.02, z), (TABLE_HALF[0], 0.02, TABLE_HALF[1]), friction=0.6) for x, y, z in TABLES),
    ]


def room() -> Room:
    """The theatre, from which a play moves on to a floor: the things to throw then lie on that."""
    return Room(("stage",), tuple(colliders()), (0.0, STAGE_TOP, 0.0), PLAY_RADIUS, on_floor=True)


def spotlight(target: Vec3) -> Light:
    """The spot above the hall that follows what dances."""
    return Light(position=(0.55, 3.2, 1.35), target=target)
