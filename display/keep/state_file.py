"""The state of a scene as an HDF5 file (docs/formats.md, States): its bodies, how they move, and what is set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import h5py
import numpy as np

from assets.file_access import atomic_write
from assets.gaussians import MAGNITUDE_MAX
from assets.hdf5 import Hdf5Reader, new_hdf5, open_hdf5, runs, write_dataset, write_text
from core.material import Material
from core.typed import Range, Size, to_json
from core.vocabulary import Coordinate, Hand, Light, Point
from display.record.recording_file import checked_about
from sim.hands.grasp import Grasp, GraspState
from sim.model import MAX_BODIES
from sim.recovery import DURATION
from sim.state import MOTION

FORMAT, VERSION = "vrgs-state", 2  # 1: no material had a yield strain
TIME_MAX = 1e9  # [s]
FINITE = (-MAGNITUDE_MAX, MAGNITUDE_MAX)
HANDS_MAX, POSES_MAX = 16, 1000
MATERIAL_FIELDS = tuple(f.name for f in fields(Material))
Seconds = Annotated[float, Range(0, TIME_MAX)]
Row = tuple[Coordinate, Coordinate, Coordinate, Coordinate]
Text = Annotated[str, Size(4096)]
Assets = Annotated[tuple[tuple[Text, Text], ...], Size(1000)]
Added = Annotated[tuple[tuple[Text, Text, Text], ...], Size(1000)]


@dataclass(frozen=True)
class SavedBody:
    """A body: the scene's body that it looks like, whether it is a copy of that, its size and material."""

    source: int
    copy: bool
    size: float
    material: Material
    material_name: str
    vertices: int
    asleep: bool


@dataclass(frozen=True)
class SavedAnimation:
    """The animation of body number `body`: `time` [s] since its start, and its place (4, 4)."""

    body: int
    time: float
    world_from_body: np.ndarray


@dataclass(frozen=True)
class SavedGame:
    """Name of a game's class, and its attributes as display/keep/scene_state.py encodes them."""

    name: str
    state: dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """All that belongs to no body. owed: `World.backlog` [s]; room: how far the user's has been turned."""

    time: Seconds
    owed: Seconds
    gravity: Point
    time_scale: Annotated[float, Range(1e-6, 1)]
    interaction: Literal["physics", "transform"]
    light: Light | None
    eye: Point
    target: Point
    game: SavedGame | None
    room: tuple[Row, Row, Row, Row] = tuple(map(tuple, np.eye(4).tolist()))
    material_names: Annotated[tuple[str, ...], Size(MAX_BODIES)] = ()

    def __post_init__(self):
        if self.eye == self.target:
            raise ValueError("the eye is at its target")
        pose = np.array(self.room)
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(pose[:3, :3]) < 0:
            raise ValueError("room is not a rotation and a translation")
        if self.room[3] != (0, 0, 0, 1):
            raise ValueError("the last row of room is not 0, 0, 0, 1")


@dataclass(frozen=True)
class SceneState:
    """Content of the file. `motion` (4, V, 3) float32, `untangling` (3, B) and `rest_inverse` as Solver.snapshot gives
    them."""

    about: dict
    assets: Assets
    added: Added
    bodies: tuple[SavedBody, ...]
    motion: np.ndarray
    untangling: np.ndarray
    animations: tuple[SavedAnimation, ...]
    hands: GraspState | None
    settings: Settings
    rest_inverse: np.ndarray | None = None


def read_state(path: str | Path) -> SceneState:
    """Read and check a file. Raises BadInput."""
    with open_hdf5(Path(path)) as file:
        version = file.check_format(FORMAT, "a saved state", VERSION)
        about = checked_about(file.text("", "about"), str(path))
        assets = file.json("", "assets", Assets)
        added = file.json("", "added", Added)
        settings = file.json("", "settings", Settings)
        bodies = read_bodies(file, settings.material_names, len(MATERIAL_FIELDS) - (version < 2))
        count, vertices = len(bodies), sum(b.vertices for b in bodies)
        motion = np.stack([file.floats(f"motion/{name}", (vertices, 3), within=FINITE) for name in MOTION])
        untangling = file.floats("bodies/untangling", (3, count), np.float64, within=(0.0, DURATION + 3.0))
        if (untangling > np.array([[DURATION], [1.0], [3.0]])).any():
            raise file.error("bodies/untangling holds values out of range")
        animations = read_animations(file, count)
        hands = read_hands(file, bodies) if file.has("hands") else None
        rest = file.floats("rest_inverse", (None, 3, 3), within=FINITE) if file.has("rest_inverse") else None
    return SceneState(about, assets, added, bodies, motion, untangling, animations, hands, settings, rest)


def read_bodies(file: Hdf5Reader, names: Sequence[str], numbers: int) -> tuple[SavedBody, ...]:
    """The bodies, without their motion; `numbers` of a material in this file."""
    source = file.indices("bodies/source", (None,))
    count = len(source)
    if count > MAX_BODIES or len(names) != count:
        raise file.error(f"claims {count} bodies, and names of {len(names)}; there may be {MAX_BODIES}")
    copies, asleep = (file.indices(f"bodies/{name}", (count,), np.uint8) != 0 for name in ("copy", "asleep"))
    vertices = file.indices("bodies/vertices", (count,))
    size = file.floats("bodies/size", (count,), np.float64, within=(1e-6, 1e3))
    materials = []
    for k, row in enumerate(file.floats("bodies/material", (count, numbers), np.float64).tolist()):
        materials.append(Material(*row[:5], *(None if math.isnan(n) else n for n in row[5:])))
        materials[k].check(f"{file.path}: body {k}")
    columns = (source.tolist(), copies.tolist(), size.tolist(), materials, names, vertices.tolist(), asleep.tolist())
    return tuple(SavedBody(*row) for row in zip(*columns, strict=True))


def read_animations(file: Hdf5Reader, bodies: int) -> tuple[SavedAnimation, ...]:
    """The animations of the first `bodies` bodies."""
    body = file.indices("animations/body", (None,), high=bodies - 1)
    time = file.floats("animations/time", (len(body),), np.float64, within=(0.0, TIME_MAX))
    place = file.floats("animations/place", (len(body), 4, 4), np.float64, within=(-1e6, 1e6))
    if (place[:, 3] != [0, 0, 0, 1]).any() or (len(body) and np.abs(np.linalg.det(place)).min() < 1e-12):
        raise file.error("animations/place holds a transform that is not affine")
    return tuple(SavedAnimation(int(b), float(t), p) for b, t, p in zip(body, time, place, strict=True))


def read_hands(file: Hdf5Reader, bodies: tuple[SavedBody, ...]) -> GraspState:
    """Grasp and pose of each hand."""
    held = file.indices("hands/held", (None,), np.int64, low=-1, high=len(bodies) - 1)
    count = len(held)
    if count > HANDS_MAX:
        raise file.error(f"claims {count} hands; there may be {HANDS_MAX}")
    taken = file.indices("hands/count", (count,), np.int64, high=np.iinfo(np.int32).max)
    poses = file.indices("hands/poses", (count,), np.int64, high=POSES_MAX)
    vertex = file.indices("hands/vertex", (int(taken.sum()),), np.int64)
    position = file.floats("hands/position", (len(vertex), 3), np.float64, within=FINITE)
    last = file.floats("hands/last", (count, 10), np.float64, within=FINITE)
    history = file.floats("hands/history", (int(poses.sum()), 8), np.float64, within=FINITE)
    if (history[:, 0] < 0).any():
        raise file.error("hands hold negative times")
    if not (np.linalg.norm(history[:, 4:], axis=1) > 1e-6).all():
        raise file.error("hands/history holds a quaternion of length 0")
    grasps, hands, histories = [], [], []
    for h, (mine, own) in enumerate(zip(runs(taken), runs(poses), strict=True)):
        body = int(held[h])
        if body < 0:
            grasps.append(None)
        elif taken[h] == 0 or vertex[mine].max() >= bodies[body].vertices or last[h, 0] == 0:
            raise file.error("hands/vertex holds an index beyond the body's vertices")
        else:
            grasps.append(Grasp(body, vertex[mine], position[mine]))
        there, *numbers = last[h].tolist()
        if there and math.hypot(*numbers[3:7]) <= 1e-6:
            raise file.error("hands/last holds a quaternion of length 0")
        hand = Hand(tuple(numbers[:3]), tuple(numbers[3:7]), bool(numbers[7]), numbers[8]) if there else None
        hands.append(hand)
        histories.append(tuple((row[0], tuple(row[1:])) for row in history[own].tolist()))
    return GraspState(tuple(grasps), tuple(hands), tuple(histories))


def write_state(path: str | Path, state: SceneState) -> None:
    """Write the file, whole or not at all. Raises BadInput."""
    bodies = state.bodies
    settings = replace(state.settings, material_names=tuple(b.material_name for b in bodies))
    materials = [[getattr(b.material, name) for name in MATERIAL_FIELDS] for b in bodies]
    with atomic_write(path) as beside, new_hdf5(beside) as file:
        write_text(file, "format", FORMAT)
        file.attrs["version"] = VERSION
        for name, value in {"about": state.about, "assets": state.assets, "added": state.added}.items():
            write_text(file, name, to_json(value))
        write_dataset(file, "settings", np.frombuffer(to_json(settings).encode(), np.uint8), np.uint8)
        for name, kind in (("source", np.int32), ("copy", np.uint8), ("asleep", np.uint8), ("vertices", np.int32)):
            write_dataset(file, f"bodies/{name}", [getattr(b, name) for b in bodies], kind)
        write_dataset(file, "bodies/size", [b.size for b in bodies], np.float64)
        rows = np.array(materials, np.float64).reshape(-1, len(MATERIAL_FIELDS))  # None becomes NaN
        write_dataset(file, "bodies/material", rows, np.float64)
        write_dataset(file, "bodies/untangling", state.untangling, np.float64)
        for name, values in zip(MOTION, state.motion, strict=True):
            write_dataset(file, f"motion/{name}", values, np.float32)
        if state.rest_inverse is not None:
            write_dataset(file, "rest_inverse", state.rest_inverse, np.float32)
        write_dataset(file, "animations/body", [a.body for a in state.animations], np.int32)
        write_dataset(file, "animations/time", [a.time for a in state.animations], np.float64)
        places = np.array([a.world_from_body for a in state.animations]).reshape(-1, 4, 4)
        write_dataset(file, "animations/place", places, np.float64)
        if state.hands is not None:
            write_hands(file, state.hands)


def write_hands(file: h5py.File, hands: GraspState) -> None:
    """Write the grasp and the poses of each hand."""
    grasps = hands.grasps
    last = np.zeros((len(grasps), 10))
    for row, hand in zip(last, hands.last, strict=True):
        if hand is not None:
            row[:] = [1.0, *hand.position, *hand.rotation, hand.grip, hand.reach]
    history = [[age, *pose] for own in hands.histories for age, pose in own]
    taken = [g for g in grasps if g is not None]
    for name, values, kind in (
        ("held", [-1 if g is None else g.body for g in grasps], np.int32),
        ("count", [0 if g is None else len(g.vertices) for g in grasps], np.int32),
        ("vertex", np.concatenate([np.zeros(0, np.int32), *(g.vertices for g in taken)]), np.int32),
        ("position", np.concatenate([np.zeros((0, 3)), *(g.positions for g in taken)]), np.float64),
        ("last", last, np.float64),
        ("poses", [len(own) for own in hands.histories], np.int32),
        ("history", np.array(history).reshape(-1, 8), np.float64),
    ):
        write_dataset(file, f"hands/{name}", values, kind)
