"""The stage house: boards and apron, proscenium, curtains, drapes at the sides."""

from __future__ import annotations

import numpy as np

from studio.shapes import Mesh, Surface, box, grid_mesh, join, lathe, quad, superellipsoid, tube
from studio.stage.hall_walls import GILT, HALL_HIGH, X1, wallpaper
from studio.textures import HONEY, WALNUT, cloth, fbm, hash_uniform, mix, plain, smoothstep, srgb, wood

STAGE_TOP = 0.75  # [m] height of the boards; scenes repeat the stage for their analytic colliders
STAGE_HALF_WIDTH, STAGE_FRONT, STAGE_BACK = 2.1, 0.72, -1.75  # [m]
OPENING_HALF_WIDTH, OPENING_TOP = 1.55, 2.70  # [m] of the proscenium
FRAME_Z = (0.30, 0.44)  # [m] the proscenium's back and face
FRAME_WIDTH = 0.30  # [m]
WALL_Z = FRAME_Z[1] - 0.03  # [m] of the wall around the frame
CURTAIN_Z, VALANCE_Z = 0.16, 0.22  # [m]
HOUSE_TOP = 3.25  # [m]
BOARD = 0.12  # [m]
VELVET = "8c1420"


def house() -> list[Surface]:
    """Everything of the stage but its scenery and lights."""
    return [*platform(), *proscenium(), *curtains(), *valance(), *masking()]


def platform() -> list[Surface]:
    """Boards from front to back, a rounded edge, and the panelled front."""
    a, b = STAGE_HALF_WIDTH, X1
    timber = wood(HONEY, axis=2, board=BOARD, across=0, seed=331)

    def boards(p, n):
        index = np.floor(p[:, 0] / BOARD).astype(int)
        tone = 0.40 + 0.36 * hash_uniform(index, 332)
        joint = smoothstep(0.0, 0.008, np.abs(p[:, 0] / BOARD - np.round(p[:, 0] / BOARD)) * BOARD)
        worn = 0.90 + 0.22 * smoothstep(1.5, 0.2, np.hypot(p[:, 0], p[:, 2] + 0.1)) + 0.10 * fbm(p * 2.5, 3, 333)
        return timber(p, n) * (tone * worn * (0.55 + 0.45 * joint))[:, None]

    top = quad((-a, STAGE_TOP, STAGE_FRONT - 0.03), (2 * a, 0, 0), (0, 0, STAGE_BACK - STAGE_FRONT + 0.03))
    wings = [  # the boards before the proscenium reach from wall to wall
        quad((x, STAGE_TOP, STAGE_FRONT - 0.03), (b - a, 0, 0), (0, 0, WALL_Z - STAGE_FRONT + 0.03)) for x in (-b, a)
    ]
    t = np.linspace(0, np.pi, 9)
    profile = np.stack([STAGE_FRONT - 0.03 + 0.035 * np.sin(t), STAGE_TOP - 0.03 + 0.03 * np.cos(t)], 1)
    edge = grid_mesh(
        np.stack([np.stack([np.full(9, x), profile[:, 1], profile[:, 0]], 1) for x in np.linspace(b, -b, 30)])
    )
    z = STAGE_FRONT - 0.03
    face = quad((-b, 0, z), (2 * b, 0, 0), (0, STAGE_TOP - 0.06, 0))
    mouldings = []
    for k in range(8):
        low, high = -b + 2 * b * k / 8 + 0.06, -b + 2 * b * (k + 1) / 8 - 0.06
        for c, d, e, f in ((low, high, 0.14, 0.165), (low, high, 0.575, 0.60), (low, low + 0.025, 0.165, 0.575),
                           (high - 0.025, high, 0.165, 0.575)):  # fmt: skip
            mouldings.append(_open_back(box((c, e, z), (d, f, z + 0.014)), z))
    mouldings.append(_open_back(box((-b, 0, z), (b, 0.10, z + 0.02)), z))
    return [
        Surface("boards", join(top, *wings), boards, 0.0092, grain=(0, 0, 1), stretch=3.5, gloss=0.04, roughness=0.2),
        Surface("stage edge", edge, wood(HONEY, axis=0, across=2, seed=335), 0.010, grain=(1, 0, 0), stretch=3.0,
                gloss=0.05),
        Surface("stage front", face, wood(WALNUT, axis=1, board=0.2, across=0, seed=337), 0.018, grain=(0, 1, 0),
                stretch=2.0, gloss=0.03),
        Surface("front mouldings", join(*mouldings), plain(GILT, 0.06), 0.024, gloss=0.20, roughness=0.3),
    ]  # fmt: skip


def proscenium() -> list[Surface]:
    """Ivory pilasters and a beam with gilt ornament, and the papered wall around them."""
    w, h, (back, front) = OPENING_HALF_WIDTH, OPENING_TOP, FRAME_Z
    ivory, gold = srgb("e3d6b6"), srgb(GILT)

    def ornament(p, n):
        x, y = np.abs(p[:, 0]), p[:, 1]
        u = np.where(y < h, x - w, y - h) / FRAME_WIDTH  # 0 at the opening, 1 outside
        along = np.where(y < h, y, x)
        edge = (np.abs(u - 0.09) < 0.05) | (np.abs(u - 0.91) < 0.05)
        flutes = (np.cos(2 * np.pi * 7 * u) > 0.55) & (u > 0.2) & (u < 0.8) & (y < h)
        bead = np.hypot(along / 0.11 - np.round(along / 0.11), (u - 0.5) * 2.4) < 0.32
        shade = 1 - 0.28 * flutes
        c = mix(ivory, gold, 0.92 * (edge | (bead & (y >= h))))
        return c * shade[:, None] * (1 + 0.04 * fbm(p * 8, 2, 341))[:, None]

    def face(low, high):
        return grid_mesh(np.array([[(x, y, front) for y in (low[1], high[1])] for x in (low[0], high[0])]))

    inner = FRAME_WIDTH + w
    frame = [
        face((-inner, STAGE_TOP), (-w, h)),
        face((w, STAGE_TOP), (inner, h)),
        face((-inner, h), (inner, h + FRAME_WIDTH)),
    ]
    reveal = [
        quad((-w, STAGE_TOP, front), (0, 0, back - front), (0, h - STAGE_TOP, 0)),
        quad((w, STAGE_TOP, back), (0, 0, front - back), (0, h - STAGE_TOP, 0)),
        quad((-w, h, back), (2 * w, 0, 0), (0, 0, front - back)),
    ]
    y1 = HALL_HIGH[1]
    wall = [
        grid_mesh(np.array([[(x, y, WALL_Z) for y in (STAGE_TOP, y1)] for x in (-X1, -inner)])),
        grid_mesh(np.array([[(x, y, WALL_Z) for y in (STAGE_TOP, y1)] for x in (inner, X1)])),
        grid_mesh(np.array([[(x, y, WALL_Z) for y in (h + FRAME_WIDTH, y1)] for x in (-inner, inner)])),
    ]
    trim = []
    for s in (-1, 1):
        x = s * (w + 0.5 * FRAME_WIDTH)
        for y, height, extra in ((STAGE_TOP, 0.16, 0.03), (h - 0.16, 0.16, 0.035)):  # base and capital
            half = 0.5 * FRAME_WIDTH + extra
            trim.append(_open_back(box((x - half, y, front), (x + half, y + height, front + 0.05)), front))
    trim.append(
        _open_back(
            box((-inner - 0.05, h + FRAME_WIDTH, front), (inner + 0.05, h + FRAME_WIDTH + 0.07, front + 0.08)), front
        )
    )
    mask = superellipsoid((0.34, 0.34, 0.10), 0.9, 20).moved(translation=(0, h + 0.17, front + 0.02))
    ring = tube(
        [(0.22 * np.cos(a), h + 0.17 + 0.22 * np.sin(a), front + 0.02) for a in np.linspace(0, 2 * np.pi, 40)],
        0.022,
        10,
    )
    return [
        Surface("proscenium", join(*frame), ornament, 0.0125),
        Surface("proscenium reveal", join(*reveal), plain("d9c9a2", 0.03), 0.020),
        Surface("proscenium wall", join(*wall), wallpaper(343), 0.020, width=1.1),
        Surface("proscenium trim", join(*trim, ring), plain(GILT, 0.05), 0.018, gloss=0.22, roughness=0.3),
        Surface("sun", mask, sun_face, 0.011, gloss=0.2, roughness=0.3),
    ]


def sun_face(p, n):
    """Gilt disc with rays, the house's emblem."""
    x, y = p[:, 0], p[:, 1] - OPENING_TOP - 0.17
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    rays = (np.cos(16 * angle) > 0) & (r > 0.085)
    eyes = (np.hypot(np.abs(x) - 0.03, y - 0.018) < 0.011) | ((np.abs(r - 0.045) < 0.006) & (y < -0.02))
    return mix(mix(srgb("d8a63a"), srgb("8a5a1c"), 0.8 * rays), srgb("4a2c10"), eyes)


def velvet(seed: int, hem: float, depth: float = 0.05):
    """Colour of red velvet that is dark in its folds, with a gold fringe below the height `hem` [m]."""
    pile = cloth(VELVET, 0.010, 0.10, 0.06, seed)
    gold = cloth("c9962f", 0.008, 0.4, 0.05, seed + 1)

    def colour_at(p, n):
        sheen = 0.72 + 0.75 * np.abs(n[:, 2]) ** 2
        c = pile(p, n) * sheen[:, None]
        return np.where((p[:, 1] < hem)[:, None], gold(p, n), c)

    return colour_at


def curtains() -> list[Surface]:
    """The main curtain, drawn to both sides and held by cords with tassels."""
    surfaces, cords = [], []
    top, bottom, tie = OPENING_TOP + 0.12, STAGE_TOP + 0.012, 1.55
    u = np.linspace(0, 1, 200)[:, None]
    v = np.linspace(0, 1, 60)[None, :]
    y = bottom + (top - bottom) * v
    for s in (-1, 1):
        outer = OPENING_HALF_WIDTH + 0.10
        waist = np.exp(-(((y - tie) / 0.30) ** 2))
        hang = smoothstep(tie, top, y)
        inner = 1.30 - 0.02 * (1 - hang) - 0.42 * hang**1.4 + 0.06 * waist - 0.10 * smoothstep(tie - 0.1, bottom, y)
        along = outer + (inner - outer) * u
        folds = 9
        sway = 0.9 * np.sin(4 * u + s) + 0.35 * np.sin(3 * y + 2 * u)
        depth = 0.042 * (1 - 0.45 * waist) * np.sin(2 * np.pi * folds * u + sway) + 0.010 * np.sin(23 * u + 5 * y)
        x, z = s * along, CURTAIN_Z + depth + 0 * y
        points = np.stack(np.broadcast_arrays(x, y, z), -1)
        mesh = grid_mesh(points if s < 0 else points[::-1])
        surfaces.append(
            Surface("curtain", mesh, velvet(351, STAGE_TOP + 0.075), 0.0132, grain=(0, 1, 0), stretch=2.6, width=1.12,
                    translucency=0.04)
        )  # fmt: skip
        middle, half = 0.5 * (outer + 1.36), 0.5 * (outer - 1.36) + 0.05
        a = np.linspace(-0.15 * np.pi, 1.15 * np.pi, 30)
        cord = [
            (s * (middle - half * np.cos(t)), tie - 0.05 * np.sin(t), CURTAIN_Z + 0.085 * np.sin(t) + 0.03) for t in a
        ]
        cords.append(tube(cord, 0.014, 10))
        foot = np.array([s * 1.40, tie - 0.06, CURTAIN_Z + 0.13])
        cords.append(superellipsoid((0.045, 0.05, 0.045), 1.0, 10).moved(translation=foot))
        tassel = lathe([(0.018, 0.0), (0.024, -0.03), (0.030, -0.15), (0.0, -0.15)][::-1], 16).moved(translation=foot)
        cords.append(tassel)
    return [*surfaces, Surface("curtain cords", join(*cords), plain("c4922e", 0.10, 0.01), 0.010, gloss=0.05)]


def valance() -> list[Surface]:
    """The swags of red velvet across the top, fringed with gold."""
    w, swags = OPENING_HALF_WIDTH + 0.06, 5
    u = np.linspace(0, 1, 260)[:, None]
    v = np.linspace(0, 1, 26)[None, :]
    along = (u * swags) % 1.0
    belly = np.sqrt(np.clip(1 - (2 * along - 1) ** 2, 0, 1))
    top, low = OPENING_TOP + 0.12, OPENING_TOP - 0.10 - 0.20 * belly
    y = top + (low - top) * v
    fold = np.sin(2 * np.pi * 4.5 * v**1.3 - 2.2 * belly) * (0.35 + 0.65 * belly)
    z = VALANCE_Z + 0.05 * belly * np.sin(np.pi * v) + 0.020 * fold
    x = -w + 2 * w * u
    mesh = grid_mesh(np.stack(np.broadcast_arrays(x, y, z), -1)[:, ::-1])
    gold = cloth("c9962f", 0.008, 0.4, 0.05, 353)
    red = velvet(355, 0.0)

    def colour_at(p, n):
        along = ((p[:, 0] + w) / (2 * w) * swags) % 1.0
        edge = OPENING_TOP - 0.10 - 0.20 * np.sqrt(np.clip(1 - (2 * along - 1) ** 2, 0, 1))
        return np.where((p[:, 1] < edge + 0.045)[:, None], gold(p, n), red(p, n))

    surfaces = [Surface("valance", mesh, colour_at, 0.0140, grain=(1, 0, 0), stretch=2.0, width=1.1, translucency=0.04)]
    drops = []
    for k in range(swags + 1):
        x = -w + 2 * w * k / swags
        t = np.linspace(0, 2 * np.pi, 40)[:, None]
        h = np.linspace(0, 1, 14)[None, :]
        r = (0.030 + 0.045 * h) * (1 + 0.22 * np.sin(7 * t))
        drop = np.stack(
            np.broadcast_arrays(
                x + r * np.cos(t), OPENING_TOP + 0.12 - 0.46 * h, VALANCE_Z + 0.05 - 0.55 * r * np.sin(t)
            ),
            -1,
        )
        drops.append(grid_mesh(drop[:, ::-1], close_u=False))
    surfaces.append(
        Surface("valance drops", join(*drops), velvet(357, OPENING_TOP - 0.29), 0.0115, grain=(0, 1, 0), stretch=2.0,
                translucency=0.04)
    )  # fmt: skip
    return surfaces


def masking() -> list[Surface]:
    """Dark red drapes at the sides and above that hide the wings, and the black box behind them."""
    surfaces = []
    u = np.linspace(0, 1, 90)[:, None]
    v = np.linspace(0, 1, 12)[None, :]
    for z in (-0.45, -1.1):
        for s in (-1, 1):
            x = s * (2.08 - (0.66 - 0.10 * (z < -1)) * u)
            y = STAGE_TOP + 0.01 + (HOUSE_TOP - STAGE_TOP - 0.02) * v
            depth = z + 0.035 * np.sin(2 * np.pi * 7 * u + 0.4 * np.sin(3 * v + s))
            points = np.stack(np.broadcast_arrays(x, y, depth), -1)
            mesh = grid_mesh(points if s < 0 else points[::-1])
            cloth_ = velvet(361, 0.0)
            surfaces.append(Surface("leg", mesh, lambda p, n, c=cloth_: 0.75 * c(p, n), 0.029, grain=(0, 1, 0),
                                    stretch=2.5, translucency=0.03, width=1.1))  # fmt: skip
        t = np.linspace(0, 1, 60)[:, None]
        x = -2.08 + 4.16 * t
        y = HOUSE_TOP - (HOUSE_TOP - 2.52 - 0.05 * (z < -1)) * v
        points = np.stack(np.broadcast_arrays(x, y, z + 0.10 + 0.02 * np.sin(90 * t)), -1)[:, ::-1]
        cloth_ = velvet(363, 0.0)
        surfaces.append(Surface("border", grid_mesh(points), lambda p, n, c=cloth_: 0.75 * c(p, n), 0.026,
                                translucency=0.03, width=1.1))  # fmt: skip
    a, back, front = STAGE_HALF_WIDTH, STAGE_BACK, WALL_Z
    black = plain("2a2024", 0.1)
    sides = [
        quad((-a, STAGE_TOP, front), (0, 0, back - front), (0, HOUSE_TOP - STAGE_TOP, 0)),
        quad((a, STAGE_TOP, back), (0, 0, front - back), (0, HOUSE_TOP - STAGE_TOP, 0)),
        quad((-a, HOUSE_TOP, back), (2 * a, 0, 0), (0, 0, front - back)),
    ]
    return [*surfaces, Surface("stage box", join(*sides), black, 0.05, width=1.2)]


def _without(mesh: Mesh, inside) -> Mesh:
    """The mesh without the faces whose centres `inside` says are out."""
    centre = mesh.vertices[mesh.faces].mean(1)
    return Mesh(mesh.vertices, mesh.faces[~inside(centre)])


def _open_back(mesh: Mesh, z: float) -> Mesh:
    """A box on a wall without the face that lies in the wall at `z`."""
    return _without(mesh, lambda c: np.abs(c[:, 2] - z) < 1e-6)
