"""The user's bodies and rooms in any scene: they play the roles that it declares, and replace its room.

A scene lists `roles` and says what its `room` is. A user's body stands upright in place of the one that it replaces, as
large if the role asks for that, of its own material or else of that body's. A user's room is put around the play, which
stays where it is: the room's free table or floor comes to lie under the middle of the play, turned so that its user
stands where the scene's does. So a scene's game and scripted player work as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.environment import Environment
from assets.hdf5 import open_hdf5
from assets.library import animated_height, asset_material, cage_vertices, default_material, find_asset
from assets.quantisation import read_grid
from assets.room_folder import is_room_folder, read_room
from core.camera import Camera
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from scenes.scene import Body, Plane, Quat, Role, Scene, Vec3

CELL = 0.05  # [m] of the map of a room's free floor
FREE_HEIGHTS = np.arange(0.1, 1.3, 0.1)  # [m] over a floor at which nothing may be in the way
TOUCHES = 0.03  # [m] between a point and what is solid there, below which it is not free
MIDDLE_WEIGHT = 0.1  # of the distance from a floor's middle against free space: as `prepare --static` does
EYE_CLEARANCE = 0.15  # [m] between what is solid and the eye, or the user's body under it
USER_POINTS = 16  # heights at which that is tested: every 0.1 m, for a table top
NEAREST_EYE = 0.4  # of the way from target to eye: nearer, one would not see the play
TURNS = np.pi / 8 * np.array([0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6, -6, 7, -7, 8])  # [rad] of a room around a play
BOX_POINTS = 0.1 + 0.4 * np.indices((3, 3, 3)).reshape(3, -1).T  # of a body's bounding box, in its extents
SHIFTS_ASIDE, SHIFTS_UP = np.linspace(0.0, 1.0, 21), (0.0, 0.2, 0.4, 0.6, 0.8)  # of the way to the spot; [m]
UNSEEN_WEIGHT = 0.3  # [m] of free space, and of the way to the eye, for a view that no photograph is like


# The user's bodies


def places(scene: Scene) -> list[tuple[Role, str, int]]:
    """Role, its name (numbered if several bodies play it) and index of each body that can be replaced."""
    result = []
    for role in scene.roles:
        indices = [i for i, body in enumerate(scene.bodies) if body.asset in role.assets]
        names = [f"{role.name} {k + 1}" for k in range(len(indices))] if len(indices) > 1 else [f"the {role.name}"]
        result += [(role, name, i) for name, i in zip(names, indices, strict=False)]
    return result


def cast_bodies(scene: Scene, played: Sequence[str], assets: Sequence[str], material: str | None) -> Scene:
    """The scene with these assets in its roles, in their order. Raises BadInput.

    played    assets of the user that the scene has placed itself
    material  a name; None: the asset's own, or else that of the body that it replaces
    """
    bodies, cast, free = list(scene.bodies), [], []
    for role, name, i in places(scene):
        if bodies[i].asset in played:
            cast.append((bodies[i].asset, name))
        else:
            free.append((role, name, i))
    if len(assets) > len(free):
        there = ", ".join(name for _, name, _ in free) or "none"
        raise BadInput(f"{len(played) + len(assets)} bodies are too many for this scene; roles: {there}")
    for asset, (role, name, i) in zip(assets, free, strict=False):
        bodies[i] = in_place_of(bodies[i], asset, role, name, material)
        cast.append((asset, name))
    return replace(scene, bodies=bodies, cast=(*scene.cast, *cast))


def in_place_of(body: Body, asset: str, role: Role, name: str, material: str | None) -> Body:
    """An asset in place of a body of the scene. Raises BadInput."""
    height = animated_height(asset)
    if role.animated is not None and role.animated != (height is not None):
        moves = "is not animated" if role.animated else "moves by itself"
        how = "; such an asset is made by vrgs.py prepare PERSON.ply --rig RIG.glb" if role.animated else ""
        raise BadInput(f"{asset}: {moves}, so that it cannot be {name}{how}")
    low, high = bounds(body.asset, body)
    its_low, its_high = bounds(asset, replace(body, scale=1.0, position=(0.0, 0.0, 0.0)))
    scale = float(np.linalg.norm(high - low) / np.linalg.norm(its_high - its_low)) if role.resize else 1.0
    foot, its_foot = ([0.5 * (a[0] + b[0]), a[1], 0.5 * (a[2] + b[2])] for a, b in ((low, high), (its_low, its_high)))
    made_of = Material.named(material) if material is not None else asset_material(asset) or body.material
    if height is not None:
        made_of = (default_material(asset) if material is None else made_of).animated(scale * height)
    position = tuple(map(float, np.subtract(foot, np.multiply(scale, its_foot))))
    return replace(body, asset=asset, material=made_of, scale=scale, position=position, asleep=False, captured=False)


def bounds(asset: str, placed: Body) -> tuple[np.ndarray, np.ndarray]:
    """Corners of an asset's bounding box in the world [m], placed as a body is. Raises BadInput."""
    x = cage_vertices(asset).astype(np.float64)
    if not len(x) or not np.isfinite(x).all() or not np.ptp(x, axis=0).max() > 0:
        raise BadInput(f"{asset}: its cage has no extent")
    x = placed.scale * x @ matrices_from_quaternions(np.array(placed.rotation)).T + placed.position
    return x.min(0), x.max(0)


# The user's rooms


def in_room(scene: Scene, stage: str) -> Scene:
    """The scene in a room of the user, made by `prepare --static` or `capture`.

    The play goes to the room's free table or, if it belongs there, to the largest free part of its floor. Raises
    BadInput, also if it must fit and does not.
    """
    own, path = scene.room, find_asset(stage)
    environment = Environment.load(path)
    with open_hdf5(path) as file:
        grid = read_grid(file, "sdf/values")
    grid.check(stage)
    cameras = photographs_of(stage)
    at, free = spot_in(scene, environment, grid, cameras)
    if own.must_fit and free < own.radius:
        space = f"{2 * own.radius:.1f} m of level, free floor, and {2 * free:.1f} m are there"
        raise BadInput(f"{stage}: there is no room for this play: it takes {space}")
    floor = own.spot[1] - (at[1] - environment.floor_height)
    to_user, to_eye = np.subtract(environment.eye_position, at), np.subtract(scene.eye, own.spot)
    facing = np.arctan2(to_eye[0], to_eye[2]) - np.arctan2(to_user[0], to_user[2])
    angles = facing + TURNS if own.on_floor else [facing]
    turned = (placed_room(scene, stage, grid, cameras, at, angle, floor) for angle in angles)
    _, room, bodies, eye = max(turned, key=lambda p: p[0])  # of equals the first: nearest to where the user stood
    small = f" ({100 * free:.0f} cm are free around the play, which takes {100 * own.radius:.0f} cm)"
    outside = [c for c in scene.colliders if c not in own.colliders]
    return replace(
        scene,
        bodies=[room, *bodies],
        colliders=[Plane((0.0, floor, 0.0), (0.0, 1.0, 0.0)), *outside],
        eye=eye,
        floor=floor,
        game=own.game or scene.game,
        cast=(*scene.cast, (stage, f"the room{small if free < own.radius else ''}")),
    )


def placed_room(
    scene: Scene,
    stage: str,
    grid: DistanceGrid,
    cameras: Sequence[Camera],
    at: np.ndarray,
    angle: float,
    floor: float,
) -> tuple[tuple[float, int], Body, list[Body], Vec3]:
    """The room turned by an angle about +y [rad], its point `at` (3,) on the play's spot, its floor at `floor` [m].

    Returns a rank, the room, the bodies in it and the player's eye. The better placement has the larger rank: the
    widest view of what was photographed, then the fewest bodies in the way.
    """
    own = scene.room
    rotation: Quat = (float(np.cos(0.5 * angle)), 0.0, float(np.sin(0.5 * angle)), 0.0)
    position = tuple(map(float, np.subtract(own.spot, matrices_from_quaternions(np.array(rotation)) @ at)))
    eye, part = free_eye(scene, grid, rotation, position, floor)
    kept = (replace(b, asleep=False) for b in scene.bodies if b.asset not in own.assets)  # nothing need be under them
    played = [*kept, *own.marks]
    bodies = clear_of_room(played, grid, rotation, position, own.spot)
    moved = sum(a is not b for a, b in zip(bodies, played, strict=True))
    unseen = float(unphotographed(scene, cameras, at[None], np.array([angle]))[0])
    return (part - UNSEEN_WEIGHT * unseen, -moved), Body(stage, rotation=rotation, position=position), bodies, eye


def photographs_of(stage: str) -> tuple[Camera, ...]:
    """Cameras of the photographs from which a room was captured; () for other rooms. Raises BadInput."""
    folder = Path(find_asset(stage)).parent
    if not is_room_folder(folder):
        return ()
    room = read_room(folder)
    return room.cameras if Path(room.background).name == Path(stage).name else ()


def spot_in(
    scene: Scene, environment: Environment, grid: DistanceGrid, cameras: Sequence[Camera] = ()
) -> tuple[np.ndarray, float]:
    """The point (3,) of a room around which to play, and the radius [m] of free space there."""
    own, drop = scene.room, np.array(environment.drop_point)
    if not own.on_floor or not environment.planes:
        return drop, environment.clear_radius
    from scipy.ndimage import distance_transform_edt  # here, since every play imports this module

    _, height, *corners = environment.planes[0]
    low, high = np.array(corners).reshape(2, 2)
    size = np.maximum((high - low) / CELL, 1).astype(int)
    at = low + CELL * (np.moveaxis(np.indices(size), 0, -1) + 0.5)

    def distance(over: float) -> np.ndarray:
        return grid.sample(np.stack([at[..., 0], np.full(size, height + over), at[..., 1]], -1))

    free = np.abs(distance(0.0)) < 2 * TOUCHES + 0.5 * grid.spacing  # there is a floor
    for over in FREE_HEIGHTS:
        free &= distance(over) > TOUCHES
    radius = CELL * (distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] - 0.5).clip(0)
    if not free.any():  # no floor was captured
        return drop, environment.clear_radius
    score = np.minimum(radius, 1.5 * own.radius) - MIDDLE_WEIGHT * np.linalg.norm(at - 0.5 * (low + high), axis=-1)
    if cameras:
        points = np.insert(at[free], 1, height, axis=1)
        views = [unphotographed(scene, cameras, points, np.full(len(points), turn)) for turn in TURNS]
        score[free] -= UNSEEN_WEIGHT * np.min(views, axis=0)
    best = np.unravel_index(np.where(free, score, -np.inf).argmax(), free.shape)
    return np.array([at[best][0], height, at[best][1]]), float(radius[best])


def unphotographed(scene: Scene, cameras: Sequence[Camera], at: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Difference (N,) between the player's view and the most similar photograph; 0 without photographs.

    The distance between the eyes over that of the eye from the play, and 1 minus the cosine between the directions.

    at      points (N, 3) of a room that come to lie on the scene's spot
    angles  of the room about +y (N,) [rad]
    """
    if not cameras:
        return np.zeros(len(at))
    places = np.array([c.position for c in cameras])
    ahead = np.array([c.world_to_camera[2, :3] for c in cameras])
    way, look = np.subtract(scene.eye, scene.room.spot), np.subtract(scene.target, scene.eye)
    far, look = np.linalg.norm(way), look / np.linalg.norm(look)
    half = -0.5 * np.asarray(angles, np.float64)
    zero = np.zeros_like(half)
    to_room = matrices_from_quaternions(np.stack([np.cos(half), zero, np.sin(half), zero], axis=1))
    eyes, looks = at + to_room @ way, to_room @ look
    apart = np.linalg.norm(eyes[:, None] - places, axis=2) / far
    return (apart + 1.0 - looks @ ahead.T).min(axis=1)


def free_eye(scene: Scene, grid: DistanceGrid, rotation: Quat, position: Vec3, floor: float) -> tuple[Vec3, float]:
    """The scene's eye, moved towards its target as far as the room requires.

    Out.  the eye, where a user can stand on the floor; the free part of the way from the target to the scene's eye
    """
    parts = np.linspace(NEAREST_EYE, 1.0, 25)
    eyes = (1 - parts[:, None]) * scene.target + parts[:, None] * scene.eye
    column = np.repeat(eyes[:, None], USER_POINTS, axis=1)
    column[..., 1] = np.linspace(floor + 2 * EYE_CLEARANCE, scene.eye[1], USER_POINTS)
    to_room = matrices_from_quaternions(np.array(rotation))
    blocked = grid.sample((eyes - position) @ to_room) < EYE_CLEARANCE
    stands = ~blocked
    if scene.room.on_floor:
        stands = (grid.sample((column - position) @ to_room) > EYE_CLEARANCE).all(1)
    seen = np.arange(len(parts)) < (blocked.argmax() if blocked.any() else len(parts))
    good = np.flatnonzero(seen & stands) if (seen & stands).any() else np.flatnonzero(seen)
    last = int(good[-1]) if len(good) else 0
    return tuple(map(float, eyes[last])), float(parts[last]) * (1.0 if stands[last] and seen[last] else 0.5)


def clear_of_room(bodies: list[Body], grid: DistanceGrid, rotation: Quat, position: Vec3, spot: Vec3) -> list[Body]:
    """The bodies, with those that would intersect the room moved towards the spot, or above it.

    What stood on the furniture of the scene's own room falls.
    """
    moving = [i for i, body in enumerate(bodies) if body.material is not None]
    boxes = {i: np.array(bounds(bodies[i].asset, bodies[i])) for i in moving}
    to_room, placed = matrices_from_quaternions(np.array(rotation)), list(bodies)

    def is_solid(box: np.ndarray) -> bool:
        inside = box[0] + (box[1] - box[0]) * BOX_POINTS
        return bool((grid.sample((inside - position) @ to_room) < 0.0).any())

    def meets_others(i: int, box: np.ndarray) -> bool:
        return any((box[0] < other[1]).all() and (other[0] < box[1]).all() for k, other in boxes.items() if k != i)

    for i in moving:
        if not is_solid(boxes[i]):
            continue
        away = np.subtract(spot, boxes[i].mean(0)) * [1.0, 0.0, 1.0]
        shifts = [t * away + [0.0, up, 0.0] for up in SHIFTS_UP for t in SHIFTS_ASIDE]
        clear = (s for s in shifts if not is_solid(boxes[i] + s) and not meets_others(i, boxes[i] + s))
        shift = next(clear, np.zeros(3))
        boxes[i] = boxes[i] + shift
        placed[i] = replace(bodies[i], position=tuple(map(float, bodies[i].position + shift)))
    return placed
