"""The state of a running world as a value that a file holds, and such a value put into a world.

Attributes of a game are JSON: numbers, texts, lists; all else, tuples, sets, dictionaries, arrays and dataclasses, is
{"kind": [...]}. A file is untrusted: a dataclass must be one that the game's own module knows, with all its fields.
"""

from __future__ import annotations

import builtins
import hashlib
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from assets.library import find_asset
from core.errors import BadInput
from display.edit.body_registry import BodiesSnapshot, Member
from display.keep.state_file import SavedAnimation, SavedBody, SavedGame, SceneState, Settings
from display.scene_bodies import pieces_of
from scenes.scene import Scene
from sim.model import BodyModel
from sim.state import MOTION

if TYPE_CHECKING:
    from display.world import World

DEPTH_MAX = 20  # of values in values of a game
ARRAY_MAX = 1 << 20  # numbers of an array
NUMBERS = {"floats": np.float64, "integers": np.int64, "bools": bool}  # kinds of arrays
View = tuple[tuple[float, float, float], tuple[float, float, float]]  # eye and target [m]


def state_of(world: World, about: dict, view: View | None = None) -> SceneState:
    """The state of a world as it is now; without a view it is that of its last picture. Raises BadInput."""
    registry, room = world.registry, world.room
    if np.abs(room.kept - np.eye(4)).max() > 0.0:
        raise BadInput("The room's file has been turned since: begin the play again before you save its state.")
    solver, scene, game = world.device.solver.snapshot(), world.scene, world.scene.game
    bodies = []
    for m, model, asleep in zip(registry.members, solver["bodies"], solver["asleep"], strict=False):
        shape, material = model.shape, model.body.material
        vertices = len(shape.vertices)
        bodies.append(SavedBody(m.source, m.copy, shape.factor, material, m.material, vertices, bool(asleep)))
    models = registry.source_models
    added = tuple((str(asset), models[k].body.name, digest(asset)) for asset, (k, *_) in registry.added.items())
    animations = tuple(SavedAnimation(a.body, a.time, a.world_from_body) for a in registry.animations)
    motion = np.stack([solver[name] for name in MOTION])
    eye, target = view or view_of(world)
    settings = Settings(
        world.time, world.backlog, world.gravity, world.time_scale, world.interaction, world.light,
        tuple(map(float, eye)), tuple(map(float, target)), None if game is None else game_state(game),
        tuple(map(tuple, room.pose.tolist())),
    )  # fmt: skip
    return SceneState(
        located(about), scene_assets(scene), added, tuple(bodies), motion, solver["untangling"], animations,
        solver["grasps"], settings, solver["rest_inverse"],
    )  # fmt: skip


def located(about: dict) -> dict:
    """The options, with absolute paths of the user's files: a state may be opened from another folder."""

    def whole(name: str) -> str:
        return str(Path(name).absolute()) if os.path.isfile(name) else name

    bodies, files = about.get("body"), {}
    if isinstance(bodies, list):
        files["body"] = [whole(name) for name in bodies]
    if about.get("stage"):
        files["stage"] = whole(about["stage"])
    return about | files


def view_of(world: World) -> View:
    """Eye and target of the last picture; the target as far off as the scene's."""
    if not world.cameras:
        return world.scene.eye, world.scene.target
    camera, scene = world.cameras[0], world.scene
    distance = np.linalg.norm(np.subtract(scene.target, scene.eye))
    return tuple(camera.position.tolist()), tuple((camera.position + distance * camera.world_to_camera[2, :3]).tolist())


def put_state(world: World, state: SceneState, where: str) -> None:
    """Continue a world from a state. Raises BadInput, naming the file `where`, and changes nothing, if the world is of
    another scene or of other files."""
    check_scene(world.scene, state, where)
    game, settings = world.scene.game, state.settings
    if (game is None) != (settings.game is None) or (world.light is None) != (settings.light is None):
        raise BadInput(f"{where}: is of another scene, with or without a game or a light")
    try:
        values = None if game is None else game_values(game, settings.game)
    except BadInput as e:
        raise BadInput(f"{where}: {e}") from e
    registry, sources = world.registry, sources_of(world, state, where)
    models = tuple(model_of(body, sources, registry.source_models, where) for body in state.bodies)
    members = tuple(Member(sources[b.source], b.copy, b.material_name) for b in state.bodies)
    animated = {k: registry.animated.get(m.source) for k, m in enumerate(members)}
    if sorted(a.body for a in state.animations) != [k for k, a in animated.items() if a is not None]:
        raise BadInput(f"{where}: its animations are not those of its bodies")
    animations = tuple(animated[a.body].placed_as(a) for a in state.animations)
    solver = dict(zip(MOTION, state.motion, strict=True))
    there = world.device.solver.snapshot()["grasps"]
    fits = there is not None and state.hands is not None and len(there.grasps) == len(state.hands.grasps)
    solver |= {"bodies": models, "untangling": state.untangling, "grasps": state.hands if fits else None}
    solver["rest_inverse"] = state.rest_inverse
    solver["asleep"] = np.array([body.asleep for body in state.bodies], bool)
    before = world.snapshot()
    try:
        bodies, room = BodiesSnapshot(solver, members, animations), np.array(settings.room)
        world.restore(
            replace(before, bodies=bodies, time=settings.time, backlog=settings.owed, game=values or {}, room=room)
        )
        if game is not None:
            try_game(world, values, where)
    except BadInput:
        world.restore(before)
        raise
    world.set_gravity(settings.gravity)
    world.set_time_scale(settings.time_scale)
    world.device.solver.interaction = settings.interaction
    if settings.light is not None and settings.light != world.light:
        world.set_light(settings.light)
    world.wanted_view = (settings.eye, settings.target)


def try_game(world: World, values: dict, where: str) -> None:
    """Run the game once with values from a file. Raises BadInput if it fails."""
    game = world.scene.game
    try:
        bodies = world.registry.scene_states(world.bodies())
        game.update(world.time, bodies)
        game.hands(world.time, bodies)
        (int(game.score), str(game.message))
    except Exception as e:  # a game is any code
        raise BadInput(f"{where}: its game cannot go on from this state ({type(e).__name__})") from e
    vars(game).update(values)


def check_scene(scene: Scene, state: SceneState, where: str) -> None:
    """Raise BadInput unless the state was saved with the same bodies, of the same files."""
    mine = scene_assets(scene)
    if [name for name, _ in mine] != [name for name, _ in state.assets]:
        raise BadInput(f"{where}: is a state of {state.about['scene']} with other bodies; --state opens it")
    for (name, digest), (_, saved) in zip(mine, state.assets, strict=True):
        if digest != saved:
            raise BadInput(f"{where}: was saved with another {name}")


def sources_of(world: World, state: SceneState, where: str) -> list[int]:
    """Index in this world of each source of the state: the scene's bodies, then the pieces of added assets.

    Raises BadInput if an added asset is gone or has changed.
    """
    sources = list(range(len(world.registry.scene_models)))
    for asset, name, saved in state.added:
        if digest(asset) != saved:
            raise BadInput(f"{where}: was saved with another {Path(asset).name}")
        known = world.registry.added.get(asset)  # as the file is: to read it again takes longer than a frame
        sources += known or world.registry.sources_of(pieces_of(asset, name))
    return sources


def model_of(body: SavedBody, sources: Sequence[int], models: Sequence[BodyModel], where: str) -> BodyModel:
    """The solver's body: its source, in the saved size and material. Raises BadInput."""
    if body.source >= len(sources):
        raise BadInput(f"{where}: names body {body.source} of a scene of {len(sources)}")
    model = models[sources[body.source]]
    if body.vertices != len(model.shape.vertices):
        raise BadInput(f"{where}: was saved with {body.vertices} vertices of body {body.source}, which has others")
    if body.size != 1.0:
        model = model.scaled(body.size)
    return model if body.material == model.body.material else model.with_material(body.material)


def scene_assets(scene: Scene) -> tuple[tuple[str, str], ...]:
    """Name and hash of the file of each of the scene's bodies."""
    return tuple((Path(body.asset).stem, digest(body.asset)) for body in scene.bodies)


def digest(asset: str) -> str:
    """SHA-256 of an asset's file. Raises BadInput."""
    path = find_asset(asset)
    status = path.stat()
    return digest_of(path, status.st_mtime, status.st_size)


@lru_cache(maxsize=256)
def digest_of(path: Path, changed: float, size: int) -> str:
    """SHA-256 of a file that was last changed at a time and is of this size."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def game_state(game) -> SavedGame:
    """The name and the attributes of a game. Raises BadInput that names what cannot be kept."""
    state = {}
    for name, value in vars(game).items():
        try:
            state[name] = encoded(value)
        except BadInput as e:
            raise BadInput(f"the game's {name!r}: {e}") from e
    return SavedGame(type(game).__name__, state)


def game_values(game, saved: SavedGame) -> dict[str, Any]:
    """The attributes of a game of this kind. Raises BadInput."""
    if saved.name != type(game).__name__ or not vars(game).keys() <= saved.state.keys():
        raise BadInput("its game is another one")
    known = vars(sys.modules[type(game).__module__])
    classes = {name: kind for name, kind in known.items() if isinstance(kind, type) and is_dataclass(kind)}
    return {name: decoded(saved.state[name], classes) for name in vars(game)}  # an older game may have had more


def encoded(value: Any, depth: int = 0) -> Any:
    """A value of a game as JSON. Raises BadInput for one of another type."""
    if depth > DEPTH_MAX:
        raise BadInput("values lie too deep in one another")
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": str(value)}
    if isinstance(value, np.generic):
        return encoded(value.item(), depth)
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        kind = {"f": "floats", "b": "bools"}.get(value.dtype.kind, "integers")
        return {kind: [list(value.shape), [encoded(v, depth + 1) for v in value.ravel().tolist()]]}
    if isinstance(value, dict):
        return {"dict": [[encoded(k, depth + 1), encoded(v, depth + 1)] for k, v in value.items()]}
    if is_dataclass(value) and not isinstance(value, type):
        made = {f.name: encoded(getattr(value, f.name), depth + 1) for f in fields(value)}
        return {"object": [type(value).__name__, made]}
    if isinstance(value, (list, tuple, set, frozenset)):
        values = sorted(value, key=repr) if isinstance(value, (set, frozenset)) else value
        items = [encoded(v, depth + 1) for v in values]
        return items if isinstance(value, list) else {type(value).__name__: items}
    raise BadInput(f"a value of type {type(value).__name__} cannot be kept in a file")


def decoded(value: Any, classes: dict[str, type], depth: int = 0) -> Any:
    """The value of `encoded`; `classes` are the dataclasses that it may name. Raises BadInput."""
    if depth > DEPTH_MAX:
        raise BadInput("values lie too deep in one another")
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, list):
        return [decoded(v, classes, depth + 1) for v in value]
    try:
        ((kind, content),) = value.items()
        match kind:
            case "float":
                return float({"nan": "nan", "inf": "inf", "-inf": "-inf"}[content])
            case "floats" | "integers" | "bools":
                return decoded_array(NUMBERS[kind], *content)
            case "tuple" | "set" | "frozenset":
                return getattr(builtins, kind)(decoded(v, classes, depth + 1) for v in list(content))
            case "dict":
                return {decoded(k, classes, depth + 1): decoded(v, classes, depth + 1) for k, v in list(content)}
            case "object":
                name, given = content
                made = object.__new__(classes[name])  # as it was, whatever its constructor would make of the fields
                if given.keys() != {f.name for f in fields(made)}:
                    raise ValueError
                for key, v in given.items():
                    object.__setattr__(made, key, decoded(v, classes, depth + 1))
                return made
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as e:
        raise BadInput(f"{str(value)[:60]!r} is not a value of a game") from e
    raise BadInput(f"{str(value)[:60]!r} is not a value of a game")


def decoded_array(dtype: type, shape, values) -> np.ndarray:
    """An array of numbers. Raises ValueError or the like."""
    sides = [int(side) for side in shape]
    if len(values) > ARRAY_MAX or math.prod(sides) != len(values) or min(sides, default=0) < 0:
        raise ValueError
    numbers = [decoded(v, {}) for v in values]
    if not all(isinstance(n, (bool, int, float)) for n in numbers):
        raise ValueError
    return np.array(numbers, dtype).reshape(sides)
