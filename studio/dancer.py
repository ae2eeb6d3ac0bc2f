"""The dancer: a little puppet of painted wood, with a skeleton and a dance of its own, all from code."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from assets.asset import Asset, DistanceGrid
from assets.gltf_skin import Rig
from prepare.rig.joint_names import SIDES
from prepare.rig.landmarks import NAMES, Landmarks
from prepare.rig.retargeting import BONES, PARENTS
from studio.finish import albedo, flat_sh, gaussians, sharpened, tone
from studio.shapes import Mesh, Part, pillow, tube
from studio.surface_sampling import cover, join_covers
from studio.textures import plain

HEIGHT = 0.34  # [m]
VERTICES = 1600  # of the cage
FPS, BEATS, BEAT = 30.0, 8, 0.5  # [1/s], number, [s]
WOOD, SHIRT, TROUSERS, SHOES, HAIR = "d9a066", "c8452f", "2f5d8c", "4a3020", "5b3a1e"
# Joints of the left side and the middle, in the pose at rest, [shares of the height]: it looks along +z
JOINTS = {
    "pelvis": (0.0, 0.55, 0.0), "spine": (0.0, 0.61, 0.0), "chest": (0.0, 0.67, 0.0), "neck": (0.0, 0.84, 0.0),
    "head": (0.0, 0.87, 0.0), "clavicle": (0.03, 0.815, 0.0), "shoulder": (0.125, 0.8, 0.0),
    "elbow": (0.245, 0.675, 0.0), "wrist": (0.345, 0.565, 0.02), "hand": (0.4, 0.505, 0.04),
    "hip": (0.065, 0.52, 0.0), "knee": (0.085, 0.29, 0.012), "ankle": (0.095, 0.06, 0.0), "foot": (0.105, 0.03, 0.1),
}  # fmt: skip


def places() -> dict[str, np.ndarray]:
    """Joints and tips of both sides [m]."""
    result = {}
    for name, at in JOINTS.items():
        if at[0] == 0.0:
            result[name] = HEIGHT * np.array(at)
        else:
            for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
                result[f"{side}_{name}"] = HEIGHT * np.array([sign * at[0], *at[1:]])
    return result | {"head_top": np.array([0.0, HEIGHT, 0.0])}


def parts(at: dict[str, np.ndarray]) -> list[Part]:
    """Its surfaces."""
    found = []

    def add(name: str, mesh: Mesh, colour: str) -> None:
        found.append(Part(name, mesh, plain(colour, 0.03, 0.06, seed=len(found)), 0.0034 * HEIGHT / 0.34, fixed=True))

    def limb(name: str, path: list, radii: list, colour: str) -> None:
        t = np.linspace(0, len(path) - 1, 14)
        k = np.arange(len(path))
        line = np.stack([np.interp(t, k, np.array(path)[:, c]) for c in range(3)], 1)
        r = HEIGHT * np.interp(t, k, radii)
        ends = np.minimum(np.arange(14), np.arange(14)[::-1]).clip(0, 3) / 3
        add(name, tube(line, r * np.sqrt(1 - 0.75 * (1 - ends) ** 2)), colour)

    head = 0.5 * (at["head"] + at["head_top"])
    add("head", pillow(HEIGHT * np.array([0.115, 0.15, 0.125]), 1.0).moved(None, head), WOOD)
    cap = pillow(HEIGHT * np.array([0.12, 0.085, 0.13]), 1.0).moved(None, head + HEIGHT * np.array([0, 0.042, -0.008]))
    add("hair", cap, HAIR)
    for s in (-1.0, 1.0):
        eye = head + HEIGHT * np.array([0.024 * s, 0.008, 0.058])
        add("eye", pillow(HEIGHT * np.array([0.016, 0.022, 0.012]), 1.0, 10).moved(None, eye), "1c1410")
    neck = at["neck"] + HEIGHT * np.array([0, -0.02, 0])
    limb("neck", [neck, at["head"] + HEIGHT * np.array([0, 0.02, 0])], [0.032, 0.03], WOOD)
    chest = at["chest"] + HEIGHT * np.array([0, 0.055, 0])
    add("chest", pillow(HEIGHT * np.array([0.215, 0.27, 0.145]), 0.8).moved(None, chest), SHIRT)
    hips = at["pelvis"] + HEIGHT * np.array([0, 0.0, 0])
    add("hips", pillow(HEIGHT * np.array([0.2, 0.17, 0.145]), 0.8).moved(None, hips), TROUSERS)
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
    return found


def dance_of_it(at: dict[str, np.ndarray]) -> Rig:
    """Its skeleton and BEATS beats of a dance: arms that swing up by turns, knees that bend, hips that sway."""
    x = np.array([at[n] for n in BONES])
    steps = np.where((PARENTS >= 0)[:, None], x - x[PARENTS], x)
    count = round(BEATS * BEAT * FPS)
    beat = 2 * np.pi * np.arange(count + 1) / (BEAT * FPS)  # a turn is a beat
    slow, low = beat / 4, 0.5 - 0.5 * np.cos(beat)  # from side to side in four beats; down on each
    turns = np.zeros((count + 1, len(BONES), 3))

    def turn(name: str, x_=0.0, y_=0.0, z_=0.0) -> None:
        turns[:, BONES.index(name)] = np.stack(np.broadcast_arrays(x_, y_, z_, beat)[:3], -1)

    turn("pelvis", 0.0, 0.3 * np.sin(slow), 0.08 * np.sin(2 * slow))
    turn("chest", 0.05 * low, -0.35 * np.sin(slow), -0.1 * np.sin(2 * slow))
    turn("head", 0.1 * low, 0.15 * np.sin(slow), 0.08 * np.sin(2 * slow))
    for s, sign in zip(SIDES, (1.0, -1.0), strict=True):
        up = 0.5 + 0.5 * np.sin(slow + (0.0 if sign > 0 else np.pi))
        turn(f"{s}_shoulder", -0.3 * (1 - up), 0.0, sign * (1.05 * up - 0.2))
        turn(f"{s}_elbow", -0.9 * (1 - up) - 0.25, 0.0, sign * 0.35 * up)
        bend = 0.45 * low + 0.1
        out = 0.06 * sign
        turn(f"{s}_hip", -bend, 0.0, out)
        turn(f"{s}_knee", 2 * bend)
        turn(f"{s}_ankle", -bend)
    q = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat()[:, [3, 0, 1, 2]].reshape(*turns.shape[:2], 4)
    moved = np.tile(steps, (count + 1, 1, 1))
    moved[:, 0, 0] += 0.07 * HEIGHT * np.sin(slow)
    still = (steps, np.tile([1.0, 0, 0, 0], (len(BONES), 1)), np.ones((len(BONES), 3)))
    inverse = np.tile(np.eye(4), (len(BONES), 1, 1))
    inverse[:, :3, 3] = -x
    frames = (moved, q, np.ones((count + 1, len(BONES), 3)))
    return Rig(list(BONES), PARENTS, np.arange(len(BONES)), inverse, still, frames, FPS, "from side to side")


def dancer(rng: np.random.Generator) -> Asset:
    """The asset `dancer`. Taichi must be running."""
    from prepare.pipeline import prepare
    from prepare.rig.rigging import dance

    at = places()
    surfaces = parts(at)
    c = join_covers([cover(part, i, rng) for i, part in enumerate(surfaces)])
    lit = 0.72 + 0.3 * c.normals[:, 1] + 0.12 * c.normals[:, 2]
    colour = sharpened(c, tone(1.1 * albedo(c, surfaces, rng) * lit.clip(0.35)[:, None]))
    made = []
    asset = prepare(
        gaussians(c, flat_sh(colour), np.ones(len(c))), vertices=VERTICES, up="+y", material="flesh", look=made.append
    )
    done = asset.provenance
    points = {n: done["metres_per_unit"] * at[n] + done["moved"] for n in NAMES}
    marks = Landmarks(points, dict.fromkeys(points, "given"), [], {n: n for n in BONES})
    solid = DistanceGrid(made[0].phi, made[0].origin, float(made[0].spacing))
    return dance(asset, dance_of_it(at), marks, solid)
