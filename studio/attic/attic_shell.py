"""The shell of the attic: floorboards, boarded slopes under rafters, gable walls, the window and the sky behind it."""

from __future__ import annotations

import numpy as np

from studio.light_sources import Opening, Sun
from studio.shapes import Mesh, Surface, box, grid_mesh, join, quad, welded
from studio.textures import fbm, hash_uniform, mix, noise, plain, smoothstep, srgb, wood
from studio.walls import reveal, wall_sheet, within

KNEE, RIDGE = (
    (2.1, 0.62),
    2.55,
)  # [m] x and height of the knee walls, height of the ridge; scenes/box_moving.py repeats
Z0, Z1 = -1.1, 2.5  # [m] the gable walls
WINDOW_X, WINDOW_Y, REVEAL = (-0.36, 0.36), (1.18, 1.92), 0.14  # [m] in the far gable
HOLE_X, HOLE_HEIGHT = (-0.14, 0.14), 0.27  # [m] of the hole in the far gable that the boxes hide
PLANK, BOARD = 0.17, 0.13  # [m] width of floorboards, of the boards on walls and slopes
SUN = Sun(np.array([0.30, -0.60, 0.74]) / np.linalg.norm([0.30, -0.60, 0.74]), np.array([1.0, 0.86, 0.64]) * 22)
GAP, VERGE = 0.006, 0.15  # [m] between rafters and slopes, and by which slopes stand out over the gables
PINE = ((0.46, 0.31, 0.17), (0.27, 0.165, 0.085))
OLD = ((0.29, 0.195, 0.115), (0.135, 0.085, 0.048))
DUST = (0.36, 0.33, 0.29)
FILL_LIGHT = (0.12, 0.12, 0.12)  # added to frames seen against the sky, like a photographer's fill light


def attic_shell() -> list[Surface]:
    """Floor, slopes, rafters, walls, window and sky."""
    return [floorboards(), *slopes(), *rafters(), *gables(), *knee_walls(), *window(), sky()]


def openings() -> list[Opening]:
    """The window."""
    (x0, x1), (y0, y1) = WINDOW_X, WINDOW_Y
    return [Opening(np.array([x0, y0, Z0 - 0.03]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]))]


def roof_height(x: float) -> float:
    """Height of the slopes at x [m]."""
    return RIDGE - (RIDGE - KNEE[1]) * abs(x) / KNEE[0]


def old_boards(tones, axis: int, across: int, width: float, seed: int, dust: float = 0.0):
    """Colour of old boards with gaps between them; `dust` lightens them in blotches."""
    grain = wood(tones, axis=axis, board=width, across=across, seed=seed, ring=0.014)

    def colour_at(p, n):
        index = np.floor(p[:, across] / width)
        c = grain(p, n) * (0.62 + 0.7 * hash_uniform(index.astype(int), seed + 50))[:, None]
        to_gap = np.abs(p[:, across] / width - np.round(p[:, across] / width)) * width
        c = c * (0.25 + 0.75 * smoothstep(0.002, 0.011, to_gap))[:, None]
        stain = smoothstep(0.15, 0.55, fbm(p * 1.7, 3, seed + 60))
        c = c * (1 - 0.35 * stain)[:, None]
        return mix(c, DUST, dust * smoothstep(-0.35, 0.5, fbm(p * 2.3, 4, seed + 70)))

    return colour_at


def floorboards() -> Surface:
    """Wide, dusty boards along z."""
    mesh = quad((-KNEE[0], 0, Z1), (2 * KNEE[0], 0, 0), (0, 0, Z0 - Z1))
    colour = old_boards(PINE, 2, 0, PLANK, 3, 0.35)
    return Surface("floorboards", mesh, colour, 0.0118, grain=(0, 0, 1), stretch=3.0, gloss=0.01)


def slopes() -> list[Surface]:
    """Boards along z on both slopes, under the slates; beyond the gables they cover the joint from outside."""
    surfaces = []
    for side in (-1, 1):
        run = np.array([side * KNEE[0], KNEE[1] - RIDGE, 0.0])
        length = Z1 - Z0 + 2 * VERGE
        mesh = quad((0, RIDGE, Z1 + VERGE), run, (0, 0, -length))
        if side > 0:
            mesh = quad((0, RIDGE, Z0 - VERGE), run, (0, 0, length))
        colour = old_boards(OLD, 2, 0, BOARD * 0.73, 11 + side)
        surfaces.append(Surface(f"slope {side}", mesh, colour, 0.026, grain=(0, 0, 1), stretch=3.0))
    return surfaces


def rafters() -> list[Surface]:
    """Rafters along the slopes, collar ties, the ridge beam."""
    slope = np.arctan2(RIDGE - KNEE[1], KNEE[0])
    length = np.hypot(RIDGE - KNEE[1], KNEE[0])
    c, s = np.cos(slope), np.sin(slope)
    surfaces = []
    for side in (-1, 1):
        along, inward = np.array([side * c, -s, 0.0]), np.array([-side * s, -c, 0.0])
        rotation = np.stack([along, -inward, np.cross(along, -inward)], 1)
        middle = np.array([0, RIDGE, 0]) + 0.5 * length * along
        # In their own frame x runs down the slope and y out of the roof. They end just below the slope, since light
        # from above would reach edges in it, and their upper faces, which nobody sees, are left out.
        beams = [box((-length / 2, -0.11, z - 0.04), (length / 2, -GAP, z + 0.04)) for z in _bays() * side]
        beams = [within(m, (-9, -9, -9), (9, -GAP, 9)) for m in beams]
        colour = old_boards(OLD, 0, 2, 4.0, 21)
        surfaces.append(
            Surface(f"rafters {side}", join(*beams), colour, 0.019, grain=(1, 0, 0), stretch=3.0).placed(
                rotation, middle
            )
        )
    half = KNEE[0] * (RIDGE - 2.06) / (RIDGE - KNEE[1])
    ties = [box((-half, 2.0, z + 0.04), (half, 2.11, z + 0.10)) for z in _bays()[1::2]]
    ridge = box((-0.05, RIDGE - 0.17, Z0), (0.05, RIDGE - 0.02, Z1))
    return [
        *surfaces,
        Surface("ties", join(*ties), old_boards(OLD, 0, 1, 4.0, 23), 0.018, grain=(1, 0, 0), stretch=3.0),
        Surface("ridge", ridge, old_boards(OLD, 2, 0, 4.0, 25), 0.022, grain=(0, 0, 1), stretch=3.0),
    ]


def _bays() -> np.ndarray:
    """z of the rafters [m]."""
    return np.arange(Z0 + 0.06, Z1, 0.68)


def gables() -> list[Surface]:
    """The far gable of upright boards with window and mouse hole, its skirting, and the near gable."""
    far = _gable(Z0, [(*WINDOW_X, *WINDOW_Y), (*HOLE_X, 0.0, HOLE_HEIGHT)], 1)
    near = _gable(Z1, [], -1)
    colour = old_boards(PINE, 1, 0, BOARD, 31, 0.15)
    skirting = [
        box((-KNEE[0], 0.0, Z0), (HOLE_X[0] - 0.02, 0.11, Z0 + 0.016)),
        box((HOLE_X[1] + 0.02, 0.0, Z0), (KNEE[0], 0.11, Z0 + 0.016)),
    ]
    return [
        Surface("far gable", join(far, _arch()), colour, 0.0118, grain=(0, 1, 0), stretch=2.5),
        Surface("near gable", near, colour, 0.036, grain=(0, 1, 0), stretch=2.0),
        Surface(
            "skirting", _in_room(join(*skirting)), old_boards(OLD, 0, 1, 4.0, 33), 0.014, grain=(1, 0, 0), stretch=2.5
        ),
    ]


def _gable(z: float, holes, facing: int) -> Mesh:
    """A gable wall up to the slopes: what stood out of them would be sunlit. It looks towards +z if `facing` is 1."""
    import trimesh

    x = np.unique([*np.linspace(-KNEE[0], KNEE[0], 15), *(h for hole in holes for h in hole[:2])])
    y = np.unique([*np.linspace(0.0, RIDGE, 10), *(h for hole in holes for h in hole[2:])])
    mesh = grid_mesh(np.array([[(a, b, z) for b in y] for a in x[::facing]]))
    centre = mesh.vertices[mesh.faces].mean(1)
    inside = np.ones(len(centre), bool)
    for x0, x1, y0, y1 in holes:
        inside &= ~((centre[:, 0] > x0) & (centre[:, 0] < x1) & (centre[:, 1] > y0) & (centre[:, 1] < y1))
    vertices, faces = mesh.vertices, mesh.faces[inside]
    for side in (-1, 1):
        inward = (side * (KNEE[1] - RIDGE), -KNEE[0], 0.0)
        vertices, faces, _ = trimesh.intersections.slice_faces_plane(vertices, faces, inward, (0.0, RIDGE, z))
    return welded(Mesh(vertices, faces))


def _in_room(mesh: Mesh) -> Mesh:
    """The mesh without faces that lie in a wall."""
    return within(mesh, (-KNEE[0], 0.0, Z0), (KNEE[0], RIDGE, Z1))


def _arch() -> Mesh:
    """The boards between the rectangular opening and the round arch of the mouse hole."""
    half, spring = HOLE_X[1], HOLE_HEIGHT - HOLE_X[1] - 0.005
    x = half * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 25))
    low = spring + np.sqrt(np.clip((half * 0.93) ** 2 - (0.93 * x) ** 2, 0, None))
    return grid_mesh(np.stack([np.stack([x, y, 0 * x + Z0], 1) for y in (low, 0 * x + HOLE_HEIGHT)], 1))


def knee_walls() -> list[Surface]:
    """Low walls under the eaves."""
    left = wall_sheet((Z1, Z0), (0.0, KNEE[1]), [], lambda u, v: (-KNEE[0], v, u))
    right = wall_sheet((Z0, Z1), (0.0, KNEE[1]), [], lambda u, v: (KNEE[0], v, u))
    colour = old_boards(PINE, 1, 2, BOARD, 41, 0.15)
    return [Surface("knee walls", join(left, right), colour, 0.024, grain=(0, 1, 0), stretch=2.0)]


def window() -> list[Surface]:
    """Small window of four panes in a frame with flaking paint, and a sill."""
    (x0, x1), (y0, y1) = WINDOW_X, WINDOW_Y
    z, w, t = Z0 - 0.07, 0.045, 0.075
    middle = 0.5 * (y0 + y1)
    bars = [
        box((x0, y0, z), (x0 + w, y1, z + 0.04)),
        box((x1 - w, y0, z), (x1, y1, z + 0.04)),
        box((x0 + w, y0, z), (x1 - w, y0 + w, z + 0.04)),
        box((x0 + w, y1 - w, z), (x1 - w, y1, z + 0.04)),
        box((-0.013, y0 + w, z + 0.006), (0.013, y1 - w, z + 0.034)),
        box((x0 + w, middle - 0.013, z + 0.006), (-0.013, middle + 0.013, z + 0.034)),
        box((0.013, middle - 0.013, z + 0.006), (x1 - w, middle + 0.013, z + 0.034)),
    ]
    trim = [
        box((x0 - t, y0 - t, Z0), (x0, y1 + t, Z0 + 0.022)),
        box((x1, y0 - t, Z0), (x1 + t, y1 + t, Z0 + 0.022)),
        box((x0, y1, Z0), (x1, y1 + t, Z0 + 0.022)),
    ]
    sill = box((x0 - 0.09, y0 - 0.035, Z0 - REVEAL), (x1 + 0.09, y0, Z0 + 0.075))
    inner = reveal((x0, y0), (x1, y1), REVEAL, lambda u, v, w_: (u, v, Z0 - w_))

    def paint(p, n):
        bare = smoothstep(0.18, 0.4, fbm(p * 14, 3, 51))
        return mix(srgb("cfc7b4"), srgb("7a6248"), 0.8 * bare)

    return [
        Surface("window", join(*bars), paint, 0.011, emission=FILL_LIGHT),
        Surface("window trim", _in_room(join(*trim)), paint, 0.013),
        Surface("sill", join(sill, inner), paint, 0.014),
    ]


def sky() -> Surface:
    """Clouds and the tops of trees behind the window."""

    def view(p, n):
        cloud = fbm(p * (0.5, 0.9, 0.5), 4, 61)
        c = mix(srgb("bcd4ee"), srgb("f4f2ec"), smoothstep(-0.2, 0.35, cloud + 0.25))
        crown = p[:, 1] - 0.75 - 0.6 * fbm(p * (0.7, 0.0, 0.7), 3, 63) - 0.25 * fbm(p * 2.2, 3, 64)
        return mix(srgb("7f9a66"), c, smoothstep(-0.1, 0.15, crown)) * (1 + 0.03 * noise(p * 4, 65))[:, None]

    back = quad((-4.5, -1.0, -5.0), (9.0, 0, 0), (0, 6.0, 0))
    return Surface("sky", back, view, 0.11, emission=(3.3, 3.4, 3.4), blocks_light=False, uniform=True, width=1.2)


def dusty(colour: str, dust: float = 0.5, size: float = 0.05, seed: int = 0):
    """A colour with dust on what faces up."""
    base = plain(colour, 0.08, size, seed)

    def colour_at(p, n):
        settled = dust * np.clip(n[:, 1], 0, 1) * smoothstep(-0.5, 0.4, fbm(p * 8, 3, seed + 1))
        return mix(base(p, n), DUST, settled)

    return colour_at
