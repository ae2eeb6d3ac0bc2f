"""Where things stand in the dining room [m]: y up, the floor at y = 0, the player on the +z side.

Scene files repeat those numbers that their analytic colliders need (floor, walls, table slab).
"""

FLOOR = 0.0
ROOM_LOW = (-2.0, 0.0, -2.2)
ROOM_HIGH = (2.0, 2.6, 2.3)

TABLE_TOP = 0.75
TABLE_SIZE = (1.6, 0.9)  # along x and z, centred on the origin
TABLE_THICKNESS = 0.035

BOTTLE_AT = (0.0, TABLE_TOP, -0.15)  # base of the bottle, which is an asset of its own
BOTTLE_HEIGHT = 0.30
CLEAR_RADIUS = 0.18  # around the bottle: nothing else stands there

RING_MAJOR = 0.08
RING_TUBE = 0.015

EYE = (0.0, 1.5, 1.3)  # where the player stands; sheens are baked for this point
# Corners of the space that the player's head moves in; surfaces that face none of them are covered coarsely.
EYES = ((-1.1, 1.15, 1.0), (1.1, 1.15, 1.0), (-1.1, 1.9, 1.9), (1.1, 1.9, 1.9), (0.0, 1.6, 0.7))

# Openings: (low, high) corners across the wall. The garden door is in the far wall, the window in the left one.
DOOR_X, DOOR_Y = (-1.45, -0.35), (0.04, 2.12)
WINDOW_Z, WINDOW_Y = (-0.55, 0.95), (0.85, 2.12)

REVEAL = 0.14  # [m] depth of door and window in the wall

LAMP_AT = (0.0, 1.72, 0.0)  # lower rim of the pendant lamp
SIDE_LAMP_AT = (1.52, 0.80, -1.96)  # foot of the lamp on the sideboard

# Region of the signed distance grid: the objects on the table, not the table itself.
GRID_LOW = (-0.85, 0.65, -0.5)
GRID_HIGH = (0.85, 1.15, 0.5)
GRID_SPACING = 0.01
