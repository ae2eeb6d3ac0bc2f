"""The dancer: a small puppet of painted wood with a skeleton and a dance."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from assets.asset import Asset
from assets.formats.gltf_skin import Rig
from prepare.rig.joint_names import SIDES
from prepare.rig.landmarks import NAMES, Landmarks
from prepare.rig.retargeting import BONES, PARENTS
from studio.detail import Detail
from studio.finish import flat_sh, sample_albedo, sharpened, to_gaussians, tone_map
from studio.shapes import Mesh, Surface, superellipsoid, tube
from studio.surface_sampling import sample_surfaces
from studio.textures import plain

HEIGHT = 0.34  # [m]
VERTICES = 1600  # of the cage
FPS, BEATS, BEAT_SECONDS = 30.0, 8, 0.5
WOOD, SHIRT, TROUSERS, SHOES, HAIR = "d9a066", "c8452f", "2f5d8c", "4a3020", "5b3a1e"
# Joints of the left side and the midline in the rest pose, in units of the height; the puppet faces +z.
JOINTS = {
    "pelvis": (0.0, 0.55, 0.0), "spine": (0.0, 0.61, 0.0), "chest": (0.0, 0.67, 0.0), "neck": (0.0, 0.84, 0.0),
    "head": (0.0, 0.87, 0.0), "clavicle": (0.03, 0.815, 0.0), "shoulder": (0.125, 0.8, 0.0),
    "elbow": (0.245, 0.675, 0.0), "wrist": (0.345, 0.565, 0.02), "hand": (0.4, 0.505, 0.04),
    "hip": (0.065, 0.52, 0.0), "knee": (0.085, 0.29, 0.012), "ankle": (0.095, 0.06, 0.0), "foot": (0.105, 0.03, 0.1),
}  # fmt: skip


def joint_positions() -> dict[str, np.ndarray]:
    """Positions (3,) [m] of the joints and extremities of both sides, by name."""
    result = {}
    for name, at in JOINTS.items():
        if at[0] == 0.0:
            result[name] = HEIGHT * np.array(at)
        else:
            for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
                result[f"{side}_{name}"] = HEIGHT * np.array([sign * at[0], *at[1:]])
    return result | {"head_top": np.array([0.0, HEIGHT, 0.0])}


def body_surfaces(at: dict[str, np.ndarray]) -> list[Surface]:
    """Painted surfaces of the puppet around its joints `at`."""
    surfaces = []

    def add(name: str, mesh: Mesh, colour: str) -> None:
        surfaces.append(
            Surface(name, mesh, plain(colour, 0.03, 0.06, seed=len(surfaces)), 0.0034 * HEIGHT / 0.34, uniform=True)
        )

    def limb(name: str, path: list, radii: list, colour: str) -> None:
        t = np.linspace(0, len(path) - 1, 14)
        k = np.arange(len(path))
        line = np.stack([np.interp(t, k, np.array(path)[:, c]) for c in range(3)], 1)
        r = HEIGHT * np.interp(t, k, radii)
        taper = np.minimum(np.arange(14), np.arange(14)[::-1]).clip(0, 3) / 3
        add(name, tube(line, r * np.sqrt(1 - 0.75 * (1 - taper) ** 2)), colour)

    head = 0.5 * (at["head"] + at["head_top"])
    add("head", superellipsoid(HEIGHT * np.array([0.115, 0.15, 0.125]), 1.0).moved(None, head), WOOD)
    cap = superellipsoid(HEIGHT * np.array([0.12, 0.085, 0.13]), 1.0).moved(
        None, head + HEIGHT * np.array([0, 0.042, -0.008])
    )
    add("hair", cap, HAIR)
    for s in (-1.0, 1.0):
        eye = head + HEIGHT * np.array([0.024 * s, 0.008, 0.058])
        add("eye", superellipsoid(HEIGHT * np.array([0.016, 0.022, 0.012]), 1.0, 10).moved(None, eye), "1c1410")
    neck = at["neck"] + HEIGHT * np.array([0, -0.02, 0])
    limb("neck", [neck, at["head"] + HEIGHT * np.array([0, 0.02, 0])], [0.032, 0.03], WOOD)
    chest = at["chest"] + HEIGHT * np.array([0, 0.055, 0])
    add("chest", superellipsoid(HEIGHT * np.array([0.215, 0.27, 0.145]), 0.8).moved(None, chest), SHIRT)
    hips = at["pelvis"] + HEIGHT * np.array([0, 0.0, 0])
    add("hips", superellipsoid(HEIGHT * np.array([0.2, 0.17, 0.145]), 0.8).moved(None, hips), TROUSERS)
    for s in SIDES:
        shoulder, elbow, wrist, hand = (at[f"{s}_{n}"] for n in ("shoulder", "elbow", "wrist", "hand"))
        inner = shoulder * [0.4, 1.0, 1.0]
        outer = shoulder + HEIGHT * np.array([0.0, -0.008, 0.0])
        limb(f"{s} arm", [inner, outer, elbow, wrist], [0.058, 0.05, 0.038, 0.028], SHIRT)
        limb(f"{s} hand", [wrist, 0.5 * (wrist + hand), hand], [0.024, 0.033, 0.022], WOOD)
        hip, knee, ankle, foot = (at[f"{s}_{n}"] for n in ("hip", "knee", "ankle", "foot"))
        limb(f"{s} leg", [hip, knee, ankle], [0.062, 0.047, 0.036], TROUSERS)
        heel = ankle + HEIGHT * np.array([0, -0.025, -0.025])
        limb(f"{s} foot", [heel, foot], [0.036, 0.034], SHOES)
    return surfaces


def dance_rig(at: dict[str, np.ndarray]) -> Rig:
    """Skeleton and BEATS beats of a dance: arms swing up in turn, knees bend, hips sway."""
    x = np.array([at[n] for n in BONES])
    offsets = np.where((PARENTS >= 0)[:, None], x - x[PARENTS], x)
    count = round(BEATS * BEAT_SECONDS * FPS)
    beat = 2 * np.pi * np.arange(count + 1) / (BEAT_SECONDS * FPS)  # phase [rad]: a revolution per beat
    sway, dip = beat / 4, 0.5 - 0.5 * np.cos(beat)  # phase of a sway over four beats; knees bend on each beat
    rotation_vectors = np.zeros((count + 1, len(BONES), 3))

    def rotate(name: str, x_=0.0, y_=0.0, z_=0.0) -> None:
        rotation_vectors[:, BONES.index(name)] = np.stack(np.broadcast_arrays(x_, y_, z_, beat)[:3], -1)

    rotate("pelvis", 0.0, 0.3 * np.sin(sway), 0.08 * np.sin(2 * sway))
    rotate("chest", 0.05 * dip, -0.35 * np.sin(sway), -0.1 * np.sin(2 * sway))
    rotate("head", 0.1 * dip, 0.15 * np.sin(sway), 0.08 * np.sin(2 * sway))
    for s, sign in zip(SIDES, (1.0, -1.0), strict=True):
        up = 0.5 + 0.5 * np.sin(sway + (0.0 if sign > 0 else np.pi))
        rotate(f"{s}_shoulder", -0.3 * (1 - up), 0.0, sign * (1.05 * up - 0.2))
        rotate(f"{s}_elbow", -0.9 * (1 - up) - 0.25, 0.0, sign * 0.35 * up)
        bend = 0.45 * dip + 0.1
        out = 0.06 * sign
        rotate(f"{s}_hip", -bend, 0.0, out)
        rotate(f"{s}_knee", 2 * bend)
        rotate(f"{s}_ankle", -bend)
    q = (
        Rotation.from_rotvec(rotation_vectors.reshape(-1, 3))
        .as_quat(scalar_first=True)
        .reshape(*rotation_vectors.shape[:2], 4)
    )
    translations = np.tile(offsets, (count + 1, 1, 1))
    translations[:, 0, 0] += 0.07 * HEIGHT * np.sin(sway)
    rest = (offsets, np.tile([1.0, 0, 0, 0], (len(BONES), 1)), np.ones((len(BONES), 3)))
    inverse = np.tile(np.eye(4), (len(BONES), 1, 1))
    inverse[:, :3, 3] = -x
    frames = (translations, q.reshape(count + 1, len(BONES), 4), np.ones((count + 1, len(BONES), 3)))
    return Rig(list(BONES), PARENTS, np.arange(len(BONES)), inverse, rest, frames, FPS, "from side to side")


def dancer(rng: np.random.Generator, detail: Detail, report) -> Asset:
    """The asset `dancer`. Taichi must be running."""
    from prepare.pipeline import Options, prepare
    from prepare.rig.rigging import animate_person

    at = joint_positions()
    surfaces = body_surfaces(at)
    c = sample_surfaces(surfaces, rng, detail)
    lit = 0.72 + 0.3 * c.normals[:, 1] + 0.12 * c.normals[:, 2]
    colour = sharpened(c, tone_map(1.1 * sample_albedo(c, surfaces, rng) * lit.clip(0.35)[:, None]))
    solids = []
    options = Options(vertices=detail.cage_vertices(VERTICES), up="+y", material="flesh")
    asset = prepare(to_gaussians(c, flat_sh(colour), np.ones(len(c))), options, look=solids.append)
    normalised = asset.provenance  # scale and offset that `prepare` applied
    points = {n: normalised["metres_per_unit"] * at[n] + normalised["moved"] for n in NAMES}
    landmarks = Landmarks(points, dict.fromkeys(points, "given"), [], {n: n for n in BONES})
    return animate_person(asset, dance_rig(at), landmarks, solids[0].distance)
