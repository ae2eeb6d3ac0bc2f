"""The dancer's body: torso in a bodice, limbs, hands, shoes, a face and hair."""

from __future__ import annotations

import numpy as np

from prepare.rig.landmarks import SIDES
from studio.dancer.skeleton import HEIGHT
from studio.shapes import Mesh, Surface, grid_mesh, join, smooth_curve, superellipsoid, tube
from studio.textures import Colour, cloth, fbm, mix, plain, smoothstep, srgb

SKIN, BODICE, GOLD, STOCKING, SHOE, HAIR = "efbd98", "146a78", "d9a83c", "f0e6d8", "7a1420", "4a2412"
HEAD_SIZE, SKULL = 1.14, (0.108, 0.146, 0.126)  # a doll's head is large; size in units of the height and of that
FINE, MEDIUM = 0.0034, 0.0058  # [m] spacing of Gaussians on face and hands, and elsewhere
# Heights of the torso's sections, half widths along x and z, shift along z; in units of the height.
TORSO = np.array([
    (0.470, 0.030, 0.030, 0.000), (0.485, 0.066, 0.052, 0.000), (0.520, 0.088, 0.064, -0.002),
    (0.550, 0.090, 0.064, -0.002), (0.580, 0.076, 0.054, 0.000), (0.610, 0.064, 0.047, 0.002),
    (0.645, 0.068, 0.050, 0.004), (0.690, 0.080, 0.060, 0.008), (0.725, 0.086, 0.066, 0.008),
    (0.760, 0.088, 0.056, 0.002), (0.790, 0.084, 0.046, -0.002), (0.810, 0.064, 0.038, -0.002),
    (0.825, 0.038, 0.032, 0.000), (0.850, 0.029, 0.029, 0.002), (0.880, 0.027, 0.027, 0.004),
])  # fmt: skip


def body_surfaces(at: dict[str, np.ndarray]) -> list[Surface]:
    """Surfaces of the dancer around its joints `at`, without what swings."""
    return [
        torso(),
        *(s for side in SIDES for s in limbs(side, at)),
        *head(at["head_top"] - [0.0, HEAD_SIZE * HEIGHT * 0.5 * SKULL[1], 0.0]),
    ]


def surface(name: str, mesh: Mesh, colour: Colour | str, spacing: float = MEDIUM) -> Surface:
    """A surface of even spacing."""
    colour = plain(colour, 0.03, 0.06) if isinstance(colour, str) else colour
    return Surface(name, mesh, colour, spacing, uniform=True)


def sections(levels: np.ndarray, segments: int = 36) -> Mesh:
    """Mesh around elliptical sections (y, half x, half z, shift z), (K, 4) [m], closed at both ends."""
    a = 2 * np.pi * np.arange(segments) / segments
    y, rx, rz, z = (levels[:, k, None] for k in range(4))
    points = np.stack(np.broadcast_arrays(rx * np.cos(a), y, z - rz * np.sin(a)), -1)
    ends = [np.repeat(points[k : k + 1].mean(1, keepdims=True), segments, 1) for k in (0, -1)]
    return grid_mesh(np.concatenate([ends[0], points, ends[1]]).transpose(1, 0, 2), close_u=True)


def torso() -> Surface:
    """Bodice with gold lacing and a heart-shaped neckline; neck and shoulders bare."""
    silk, skin = cloth(BODICE, 0.006, 0.10, 0.05, 501), plain(SKIN, 0.02, 0.05, 502)
    gold, dark = srgb(GOLD), srgb("0c4450")

    def colour_at(p, n):
        x, y, front = p[:, 0] / HEIGHT, p[:, 1] / HEIGHT, p[:, 2] > 0
        neckline = np.where(front, 0.752 + 0.012 * np.cos(np.abs(x) / 0.086 * 2 * np.pi - np.pi), 0.765)
        c = silk(p, n)
        panel = front & (np.abs(x) < 0.016 + 0.12 * (y - 0.61).clip(0))
        c = np.where(panel[:, None], dark, c)
        zigzag = np.abs(np.abs(x) - 0.016 * np.abs(((y - 0.61) / 0.034) % 1.0 * 2 - 1)) < 0.0035
        c = mix(c, gold, (panel & zigzag & (y > 0.62)) * 0.95)
        trim = (np.abs(y - neckline + 0.006) < 0.006) | (np.abs(y - 0.612) < 0.010)
        c = mix(c, gold, 0.95 * trim)
        c = np.where((y < 0.595)[:, None], srgb(STOCKING), c)
        return np.where((y > neckline)[:, None], skin(p, n), c)

    levels = HEIGHT * smooth_curve(TORSO, 60)
    return surface("torso", sections(levels), colour_at)


def limbs(side: str, at: dict[str, np.ndarray]) -> list[Surface]:
    """Arm with a puffed sleeve and a hand, leg with stocking and shoe."""
    shoulder, elbow, wrist, hand = (at[f"{side}_{n}"] for n in ("shoulder", "elbow", "wrist", "hand"))
    hip, knee, ankle, foot = (at[f"{side}_{n}"] for n in ("hip", "knee", "ankle", "foot"))
    skin = plain(SKIN, 0.02, 0.05, 503)
    inner = shoulder * [0.60, 1.0, 1.0] - [0, 0.010 * HEIGHT, 0]
    start = shoulder - [0, 0.010 * HEIGHT, 0]
    biceps, forearm = start + 0.45 * (elbow - start), elbow + 0.28 * (wrist - elbow)
    arm = limb(  # thinnest at elbow and wrist
        [inner, start, biceps, elbow, forearm, wrist, wrist + 0.2 * (hand - wrist)],
        [0.022, 0.028, 0.0265, 0.0185, 0.0230, 0.0145, 0.014],
    )
    sleeve = superellipsoid(HEIGHT * np.array([0.092, 0.094, 0.088]), 0.9, 20)
    middle = shoulder + 0.10 * (elbow - shoulder)
    puff = cloth("f4ead8", 0.006, 0.10, 0.05, 505)

    def gathered(p, n):
        fold = 0.90 + 0.14 * np.cos(26 * np.arctan2(p[:, 2] - middle[2], p[:, 0] - middle[0]))
        return puff(p, n) * fold[:, None]

    # calf: thicker a third of the way down the shin, towards the back
    calf = knee + 0.30 * (ankle - knee) + HEIGHT * np.array([0.0, 0.0, -0.008])
    leg = limb([hip, 0.5 * (hip + knee), knee, calf, ankle], [0.056, 0.050, 0.035, 0.037, 0.021])
    heel = ankle + HEIGHT * np.array([0.0, -0.030, -0.022])
    sole = np.array([1.0, 0.0, 1.0])
    toe = foot * sole + [0, 0.016 * HEIGHT, 0]
    instep = 0.5 * (ankle + foot) + HEIGHT * np.array([0.0, -0.004, 0.0])
    shoe = limb([heel, 0.5 * (heel + instep), instep - [0, 0.010 * HEIGHT, 0], toe], [0.022, 0.026, 0.025, 0.015])
    return [
        surface("arm", arm, skin),
        surface("sleeve", sleeve.moved(None, middle), gathered),
        *hand_surfaces(wrist, hand),
        surface("leg", leg, cloth(STOCKING, 0.006, 0.04, 0.03, 507)),
        surface("shoe", shoe, SHOE),
    ]


def limb(path: list, radii: list) -> Mesh:
    """Tube through points (K, 3) [m] with radii (K,) [heights], rounded at both ends."""
    path, radii = np.array(path), HEIGHT * np.array(radii)
    line = smooth_curve(np.column_stack([path, radii]), 26)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :3], axis=0), axis=1))])
    end = np.minimum(s, s[-1] - s)
    r = line[:, 3]
    cap = np.sqrt(1 - (1 - (end / r).clip(0, 1)) ** 2)  # half balls
    return tube(line[:, :3], np.maximum(r * cap, 0.08 * r), 22)


def hand_surfaces(wrist: np.ndarray, tip: np.ndarray) -> list[Surface]:
    """Palm, four fingers and a thumb."""
    along = (tip - wrist) / np.linalg.norm(tip - wrist)
    thumb_side = np.array([0.0, 0.0, 1.0]) - along[2] * along
    thumb_side /= np.linalg.norm(thumb_side)
    out = np.cross(along, thumb_side)
    frame = np.stack([thumb_side, along, out], 1)
    h = HEIGHT
    palm = superellipsoid(h * np.array([0.034, 0.046, 0.018]), 0.75, 16).moved(frame, wrist + 0.024 * h * along)
    fingers = []
    for k, (u, length) in enumerate(((0.0125, 0.036), (0.0042, 0.041), (-0.0042, 0.039), (-0.0120, 0.031))):
        root = wrist + h * (0.040 * along + u * thumb_side)
        bent = along + 0.22 * (k - 1.5) * -0.12 * thumb_side
        path = [root, root + 0.5 * h * length * bent, root + h * length * (bent + 0.08 * out * np.sign(-wrist[0]))]
        fingers.append(tube(path, h * np.array([0.0055, 0.0052, 0.0036]), 10))
    root = wrist + h * (0.016 * along + 0.014 * thumb_side)
    path = [root, root + h * (0.014 * along + 0.010 * thumb_side), root + h * (0.030 * along + 0.012 * thumb_side)]
    fingers.append(tube(path, h * np.array([0.0070, 0.0062, 0.0042]), 10))
    return [surface("palm", palm, SKIN, FINE), surface("fingers", join(*fingers), SKIN, FINE)]


def head(centre: np.ndarray) -> list[Surface]:
    """Head with eyes, lashes, brows, nose, lips, ears with earrings, hair with a bun, and a flower."""
    h = HEIGHT * HEAD_SIZE
    skull = superellipsoid(SKULL, 1.0, 40)
    v = _jawed(skull.vertices)
    skull = Mesh(h * v, skull.faces).moved(None, centre)
    surfaces = [surface("head", skull, _face(centre), FINE)]

    def ball(name, size, at, colour, spacing=FINE, count=12):
        mesh = superellipsoid(h * np.array(size), 1.0, count).moved(None, centre + h * np.array(at))
        surfaces.append(surface(name, mesh, colour, spacing))

    def line(name, x, y, radii, colour, out=0.001):
        """A tube on the face along (x, y) on either side."""
        for s in (-1, 1):
            path = np.stack([s * x, y, _front(x, y) + out], 1)
            surfaces.append(surface(name, tube(h * path + centre, h * radii, 10), colour, 0.0021))

    ball("nose", (0.013, 0.024, 0.018), (0.0, -0.012, 0.0615), "eab08a", 0.0026)
    u = np.linspace(0, 1, 11)
    arch = np.sin(np.pi * u)
    line(
        "brow",
        0.0115 + 0.026 * u,
        0.0340 + 0.0058 * arch - 0.005 * u,  # higher towards the nose: lower there looks angry
        0.0006 + 0.0011 * np.sin(np.pi * u**0.7),
        "7a4a2a",
    )
    a = np.pi * (0.86 - 0.80 * u)  # along the eye's upper rim, from the nose outwards
    line("lash", 0.0235 + 0.0128 * np.cos(a), 0.006 + 0.0120 * np.sin(a), 0.0005 + 0.0005 * u, "3a2014", 0.0022)
    mouth = np.linspace(0, 1, 12)
    half = 0.0205 * mouth
    smile = 0.0110 * mouth**2
    line("upper lip", half, -0.0365 + smile - 0.001 * mouth, 0.0019 * np.sqrt(1.02 - mouth), "c4424a", 0.0)
    line("lower lip", 0.9 * half, -0.0402 + smile, 0.0024 * np.sqrt(1.02 - mouth), "d8606a", 0.0)
    for s in (-1, 1):
        at = np.array([0.0235 * s, 0.006, _front(np.array(0.0235), np.array(0.006)) - 0.0042])
        ball("eye", (0.0235, 0.0225, 0.0170), at, _eye(centre + h * at, h), 0.0013, 16)
        ball("ear", (0.012, 0.028, 0.020), (0.0535 * s, -0.006, -0.004), SKIN)
        ball("earring", (0.011, 0.011, 0.011), (0.0560 * s, -0.027, 0.000), GOLD, 0.0028)
        ball("bun", (0.050, 0.050, 0.050), (0.020 * s, 0.050, -0.056), _strands(centre, 0.9), 0.0042)
    cap = superellipsoid((0.121, 0.152, 0.140), 1.0, 60)
    v = _jawed(cap.vertices) + (0, 0.006, -0.006)
    c = v[cap.faces].mean(1)
    bare = (c[:, 1] < _hairline(c[:, 0], c[:, 2])) & (c[:, 2] > -0.035)
    faces = cap.faces[~bare & (c[:, 1] > -0.062)]
    surfaces.append(surface("hair", Mesh(h * v, faces).moved(None, centre), _strands(centre), 0.0042))
    for k in range(6):
        a = k * np.pi / 3
        at = (0.055 + 0.005 * np.cos(a), 0.034 + 0.012 * np.sin(a), 0.010 + 0.011 * np.cos(a))
        ball("petal", (0.017, 0.017, 0.011), at, "c81e2c", 0.0032, 8)
    ball("pistil", (0.010, 0.010, 0.010), (0.064, 0.034, 0.012), "f4c838", 0.0026, 8)
    return surfaces


def _jawed(v: np.ndarray) -> np.ndarray:
    """Points of an ellipsoid (N, 3) drawn in towards the chin."""
    jaw = smoothstep(0.01, -0.075, v[:, 1])
    return v * np.stack([1 - 0.30 * jaw, 1 + 0 * jaw, 1 - 0.16 * jaw], 1) + np.stack([0 * jaw, 0 * jaw, 0.010 * jaw], 1)


def _front(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """z of the face at (x, y)."""
    jaw = smoothstep(0.01, -0.075, y)
    a, b, c = 0.5 * np.array(SKULL)
    return c * np.sqrt((1 - (x / (1 - 0.30 * jaw) / a) ** 2 - (y / b) ** 2).clip(0)) * (1 - 0.16 * jaw) + 0.010 * jaw


def _hairline(x, z):
    """Height of the hairline over the head's centre: low before the ears, high at the forehead."""
    return 0.047 - 8.0 * (np.abs(x) - 0.004).clip(0) ** 2 - 0.085 * smoothstep(0.034, -0.010, z)


def _face(centre: np.ndarray) -> Colour:
    """Skin with blush and eyelids; hair-coloured where hair covers it."""
    skin, hair = plain(SKIN, 0.02, 0.05, 511), srgb(HAIR)

    def colour_at(p, n):
        q = (p - centre) / (HEIGHT * HEAD_SIZE)
        x, y, z = np.abs(q[:, 0]), q[:, 1], q[:, 2]
        front = z > 0.0
        c = skin(p, n)
        c = mix(c, srgb("e0705c"), 0.6 * front * np.exp(-(((x - 0.031) / 0.013) ** 2 + ((y + 0.020) / 0.011) ** 2)))
        lid = np.hypot((x - 0.0235) / 0.0150, (y - 0.008) / 0.0150)
        c = mix(c, srgb("b87860"), 0.20 * front * smoothstep(1.25, 0.95, lid))
        covered = (y > _hairline(x, z) + 0.012) | (z < -0.030)
        return np.where((covered & (y > -0.058))[:, None], hair, c)

    return colour_at


def _eye(centre: np.ndarray, size: float) -> Colour:
    """White, a brown iris and a pupil with a glint."""

    def colour_at(p, n):
        q = (p - centre) / size
        r = np.hypot(q[:, 0], q[:, 1])
        c = np.where((r < 0.0086)[:, None], srgb("6a3e1a"), srgb("f6f2ea"))
        c = np.where((r < 0.0056)[:, None], srgb("0c0806"), c)
        glint = np.hypot(q[:, 0] - 0.0032, q[:, 1] - 0.0036) < 0.0014
        return np.where(glint[:, None], srgb("ffffff"), c)

    return colour_at


def _strands(centre: np.ndarray, shade: float = 1.0) -> Colour:
    """Hair combed to the back: fine streaks from the brow to the nape, with a soft shine."""
    base, shine = srgb(HAIR), srgb("96562a")

    def colour_at(p, n):
        q = (p - centre) / (HEIGHT * HEAD_SIZE)
        angle = np.arctan2(q[:, 0], q[:, 1] + 0.02)
        along = np.stack([angle * 26, 3.0 * q[:, 2] / 0.06, 0 * angle], 1)
        band = np.exp(-(((n[:, 1] - 0.72) / 0.22) ** 2))
        return shade * mix(base, shine, (0.28 + 0.5 * fbm(along, 3, 521) + 0.30 * band).clip(0, 1))

    return colour_at
