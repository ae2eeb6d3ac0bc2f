"""Bodies and rooms of the user's in any scene: they play the roles that it declares, and replace its room.

A scene lists `roles` and says what its `room` is. A body of the user's is put where the one was that it replaces:
upright on the same spot, as large if the role asks for that, of its own material or else of the role's. A room of the
user's is put around the play, which stays where it is: its free table or floor comes to lie under the play's middle,
turned so that its user stands where the scene's does. So a scene's game and scripted player work as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt

from assets.environment import Environment
from assets.hdf5 import open_hdf5
from assets.integers import read_grid
from assets.library import animated_height, asset_material, cage_vertices, find_asset
from assets.room_folder import RoomManifest, is_room_folder, read_room
from core.camera import Camera
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from scenes.free_ground import SIZES, ground_of, laid_out, line_of_sight
from scenes.scene import Body, Box, Plane, Quat, Role, Room, Spot, Vec3

if TYPE_CHECKING:  # a module that has it is taken for a scene
    from scenes.scene import Scene

CELL = 0.05  # [m] of the map of a room's free floor
FREE_HEIGHTS = np.arange(0.1, 1.3, 0.1)  # [m] over a floor at which nothing may be in the way
TOUCHES = 0.03  # [m] between a point and what is solid there, below which it is not free
MIDDLE_WEIGHT = 0.1  # of the distance from a floor's middle against free space: as `prepare --static` does
EYE_CLEARANCE = 0.15  # [m] between what is solid and the eye, or the user's body under it
USER_POINTS = 16  # heights at which that is tested: every 0.1 m, for a table top
TURNS = np.pi / 8 * np.array([0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6, -6, 7, -7, 8])  # [rad] of a room around a play
BOX_POINTS = 0.1 + 0.4 * np.indices((3, 3, 3)).reshape(3, -1).T  # of a body's bounding box, in its extents
SHIFTS_ASIDE, SHIFTS_UP = np.linspace(0.0, 1.0, 21), (0.0, 0.2, 0.4, 0.6, 0.8)  # of the way to the spot; [m]
UNSEEN_WEIGHT = 0.3  # [m] of free space, and of the way to the eye, for a view that no photograph is like
EYES_TRIED = 16  # photographers from whose places a play is looked for
PAD, PAD_FRICTION = 0.85, 0.8  # of a station's radius: half a side of the level pad in its ground
SHOWN = 0.8  # of the view from there, in which its ground must lie
NEAREST_EYE = 0.4  # of the way from target to eye: nearer, one would not see the play


def places(scene: Scene) -> list[tuple[Role, str, int]]:
    """Each role, its name with a number if several bodies play it, and the index of its body in the scene."""
    result = []
    for role in scene.roles:
        indices = [i for i, body in enumerate(scene.bodies) if body.asset in role.assets]
        names = [f"{role.name} {k + 1}" for k in range(len(indices))] if len(indices) > 1 else [f"the {role.name}"]
        result += [(role, name, i) for name, i in zip(names, indices, strict=False)]
    return result


def cast_bodies(scene: Scene, played: Sequence[str], assets: Sequence[str], material: str | None) -> Scene:
    """The scene with these assets in its roles, in their order. Raises BadInput.

    played    assets of the user's that the scene has put in their places itself
    material  a name, or None: each asset's own, or else that of the body that it replaces
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
    """The body of an asset that plays a role instead of a scene's body. Raises BadInput."""
    height = animated_height(asset)
    if role.animated is not None and role.animated != (height is not None):
        moves = "does not move by itself" if role.animated else "moves by itself"
        raise BadInput(f"{asset}: {moves}, so that it cannot be {name}")
    low, high = bounds(body.asset, body)
    its_low, its_high = bounds(asset, replace(body, scale=1.0, position=(0.0, 0.0, 0.0)))
    scale = float(np.linalg.norm(high - low) / np.linalg.norm(its_high - its_low)) if role.resize else 1.0
    foot, its_foot = ([0.5 * (a[0] + b[0]), a[1], 0.5 * (a[2] + b[2])] for a, b in ((low, high), (its_low, its_high)))
    made_of = Material.named(material) if material is not None else asset_material(asset) or body.material
    if height is not None:
        made_of = made_of.animated(scale * height)
    position = tuple(map(float, np.subtract(foot, np.multiply(scale, its_foot))))
    return replace(body, asset=asset, material=made_of, scale=scale, position=position, asleep=False, captured=False)


def bounds(asset: str, placed: Body) -> tuple[np.ndarray, np.ndarray]:
    """Corners of an asset's bounding box in the world [m], placed as a body is. Raises BadInput."""
    x = cage_vertices(asset).astype(np.float64)
    if not len(x) or not np.isfinite(x).all() or not np.ptp(x, axis=0).max() > 0:
        raise BadInput(f"{asset}: its cage has no extent")
    x = placed.scale * x @ matrices_from_quaternions(np.array(placed.rotation)).T + placed.position
    return x.min(0), x.max(0)


def in_room(scene: Scene, stage: str) -> Scene:
    """The scene in a room of the user's, made by `prepare --static`. Raises BadInput."""
    own = scene.room
    environment, grid = load_room(stage)
    cameras = photographs_of(stage)
    at, free = spot_in(environment, grid, own, partial(unphotographed, scene, cameras) if cameras else None)
    if own.stations and grid is not None and free < own.radius:
        grids = [g.scaled(1.0) for g in (grid, *environment.fine_grids)]  # to float32 once, not for each sample
        return set_out(scene, stage, environment, grids)
    floor = own.spot[1] - (at[1] - environment.floor_height)
    facing = angle_between(np.subtract(environment.eye_position, at), np.subtract(scene.eye, own.spot))
    angles = facing + TURNS if own.on_floor and environment.target is None else facing[None]
    kept = (replace(b, asleep=False) for b in scene.bodies if b.asset not in own.assets)  # nothing need be under them
    played = [*kept, *own.marks]
    best = None
    # The widest view, of what was photographed, then the fewest bodies in the way, then nearest to where its user stood
    for angle in angles:
        rotation, position = around(own.spot, at, angle)
        eye, part = free_eye(scene, grid, rotation, position, floor) if environment.target is None else (None, 1.0)
        bodies = clear_of_room(played, grid, rotation, position, own.spot)
        unseen = float(unphotographed(scene, cameras, at[None], np.array([angle]))[0])
        rank = part - UNSEEN_WEIGHT * unseen, -sum(a is not b for a, b in zip(bodies, played, strict=True))
        if best is None or rank > best[0]:
            best = rank, eye, [Body(stage, rotation=rotation, position=position), *bodies]
    _, eye, bodies = best
    target, levels = scene.target, [floor]
    if environment.target is not None:  # a view that was searched: from elsewhere there may be fog
        turn = matrices_from_quaternions(np.array(bodies[0].rotation))
        eye, target = (
            tuple((turn @ np.asarray(p) + bodies[0].position).tolist())
            for p in (environment.eye_position, environment.target)
        )
    levels += [own.spot[1] for kind, *_ in environment.planes if kind == "unseen"]
    small = f" ({100 * free:.0f} cm are free around the play, which takes {100 * own.radius:.0f} cm)"
    return replace(
        scene,
        bodies=bodies,
        colliders=[
            *(Plane((0.0, height, 0.0), (0.0, 1.0, 0.0)) for height in levels),
            *(c for c in scene.colliders if c not in own.colliders),
        ],
        eye=eye,
        target=target,
        floor=floor,
        cast=(*scene.cast, (stage, f"the room{small if free < own.radius else ''}")),
    )


def set_out(scene: Scene, stage: str, environment: Environment, grids: list[DistanceGrid]) -> Scene:
    """The scene with its stations laid out on free ground of a room, where one of its photographers saw them all.

    All is smaller where it must be. Raises BadInput where there is no room even so.
    """
    own, fov = scene.room, scene.fov_y
    best, eyes = None, [(environment.eye_position, environment.drop_point)]
    if room := room_around(stage):
        step = -(-len(room.cameras) // EYES_TRIED)
        ahead = [(c.position, c.position + c.world_to_camera[2, :3]) for c in room.cameras[::step]]
        eyes, fov = [(room.eye, room.target), *ahead], room.fov_y
    focus = np.array(room.target if room else environment.drop_point)[[0, 2]]
    ground = ground_of(grids, environment.floor_height)
    for eye, target in eyes:
        sees = partial(in_view, grids, np.array(eye), np.array(target), SHOWN * 0.5 * fov)
        found = laid_out(ground, [radius for *_, radius in own.stations], focus, sees)
        if found is not None and (best is None or found[1] > best[2]):
            best = np.array(eye), *found
    if best is None:
        places = f"{len(own.stations)} places of {200 * SIZES[-1] * min(r for *_, r in own.stations):.0f} cm and more"
        raise BadInput(f"{stage}: there is no room for this play: it needs {places} of free, level ground in view")
    eye, spots, size = best
    middle = np.mean([(s.at[0], s.ground, s.at[1]) for s in spots], axis=0)
    extent = max(np.hypot(*(middle[[0, 2]] - s.at)) + size * r for s, (*_, r) in zip(spots, own.stations, strict=True))
    nearer = extent / (SHOWN * np.tan(0.5 * fov)) / np.linalg.norm(eye - middle)
    eye = middle + np.clip(nearer, NEAREST_EYE, 1.0) * (eye - middle)  # nothing is in between
    at = np.array([middle[0], environment.floor_height, middle[2]])
    rotation, position = around(own.spot, at, angle_between(eye - middle, np.subtract(scene.eye, own.spot)))
    turn = matrices_from_quaternions(np.array(rotation))
    spots = [placed_spot(spot, turn, np.array(position)) for spot in spots]

    def station(at: np.ndarray) -> int:
        return int(np.argmin([np.hypot(at[0] - x, at[2] - z) for x, z, _ in own.stations]))

    def there(at: Vec3, on: float, k: int) -> Vec3:
        x, z, _ = own.stations[k]
        return tuple(map(float, size * np.subtract(at, (x, own.spot[1], z)) + (spots[k].at[0], on, spots[k].at[1])))

    bodies, colliders = [Body(stage, rotation=rotation, position=position)], []
    for body in scene.bodies:
        if body.asset not in own.assets:
            k = station(np.array(body.position))
            on = spots[k].ground if body.material is None else spots[k].top
            bodies.append(replace(body, position=there(body.position, on, k), scale=size * body.scale))
    for mark in own.marks:
        k = station(np.array(mark.position))
        bodies.append(replace(mark, position=there(mark.position, spots[k].top, k), scale=size * mark.scale))
    for box in scene.colliders:
        if box not in own.colliders:  # of what stands on a station: a box
            k = station(np.array(box.center))
            half = tuple(size * h for h in box.half_size)
            colliders.append(replace(box, center=there(box.center, spots[k].ground, k), half_size=half))
    stood_on = {station(np.array(b.position)) for b in scene.bodies if b.material is None and b.asset not in own.assets}
    for k, spot in enumerate(spots):
        if k not in stood_on:  # captured ground is rough: what is slender would fall
            half = PAD * size * own.stations[k][2]
            colliders.append(Box((spot.at[0], spot.top - half, spot.at[1]), (half, half, half), friction=PAD_FRICTION))
    how = f", where the ground is free{'' if size == 1 else f'; all else is {100 * size:.0f} % as large'}"
    return replace(
        scene,
        bodies=bodies,
        colliders=[Plane((0.0, own.spot[1], 0.0), (0.0, 1.0, 0.0)), *colliders],
        eye=tuple(map(float, turn @ eye + position)),
        target=tuple(map(float, turn @ middle + position)),
        fov_y=fov,
        floor=own.spot[1],
        game=own.game_at(spots, size),
        cast=(*scene.cast, (stage, f"the room{how}")),
    )


def in_view(grids: list[DistanceGrid], eye: np.ndarray, target: np.ndarray, half: float, point: np.ndarray) -> bool:
    """True if a point (3,) is seen from an eye, at most the angle `half` [rad] off what it looks at."""
    a, b = target - eye, point - eye
    return a @ b > np.cos(half) * np.linalg.norm(a) * np.linalg.norm(b) and line_of_sight(grids, eye, point)


def placed_spot(spot: Spot, turn: np.ndarray, position: np.ndarray) -> Spot:
    """A spot of a room that is turned about +y by a matrix and then moved."""
    x, _, z = turn @ (spot.at[0], 0.0, spot.at[1]) + position
    return Spot((float(x), float(z)), *(float(h + position[1]) for h in (spot.ground, spot.top, spot.over)))


def clear_of_room(
    bodies: list[Body], grid: DistanceGrid | None, rotation: Quat, position: Vec3, spot: Vec3
) -> list[Body]:
    """The bodies; those that would be in what is solid of the room are moved towards the spot, or over it.

    What the room's own furniture carried falls.
    """
    moving = [i for i, body in enumerate(bodies) if body.material is not None]
    boxes = {i: np.array(bounds(bodies[i].asset, bodies[i])) for i in moving}
    to_room, placed = matrices_from_quaternions(np.array(rotation)), list(bodies)

    def is_solid(box: np.ndarray) -> bool:
        inside = box[0] + (box[1] - box[0]) * BOX_POINTS
        return bool((grid.sample((inside - position) @ to_room) < 0.0).any())

    def meets_others(i: int, box: np.ndarray) -> bool:
        return any((box[0] < other[1]).all() and (other[0] < box[1]).all() for k, other in boxes.items() if k != i)

    for i in moving if grid is not None else ():
        if not is_solid(boxes[i]):
            continue
        away = np.subtract(spot, boxes[i].mean(0)) * [1.0, 0.0, 1.0]
        shifts = [t * away + [0.0, up, 0.0] for up in SHIFTS_UP for t in SHIFTS_ASIDE]
        clear = (s for s in shifts if not is_solid(boxes[i] + s) and not meets_others(i, boxes[i] + s))
        shift = next(clear, np.zeros(3))
        boxes[i] = boxes[i] + shift
        placed[i] = replace(bodies[i], position=tuple(map(float, bodies[i].position + shift)))
    return placed


def load_room(stage: str) -> tuple[Environment, DistanceGrid | None]:
    """The environment and the distances of a room. Raises BadInput if the file is none."""
    path = find_asset(stage)
    environment = Environment.load(path)
    with open_hdf5(path) as file:
        grid = read_grid(file, "sdf/values") if file.has("sdf") else None
    if grid is not None:
        grid.check(stage)
    return environment, grid


def room_around(stage: str) -> RoomManifest | None:
    """The captured room whose background a room is; None if there is none. Raises BadInput."""
    folder = Path(find_asset(stage)).parent
    room = read_room(folder) if is_room_folder(folder) else None
    return room if room and Path(room.background).name == Path(stage).name else None


def photographs_of(stage: str) -> tuple[Camera, ...]:
    """The cameras of the photographs of a room that is the background of a captured one, else none. Raises BadInput."""
    room = room_around(stage)
    return room.cameras if room else ()


def unphotographed(scene: Scene, cameras: Sequence[Camera], at: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Difference (N,) of the player's view from the photograph most like it; 0 if there are none.

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
    to_room = rotations_about_up(-angles)
    eyes, looks = at + to_room @ way, to_room @ look
    apart = np.linalg.norm(eyes[:, None] - places, axis=2) / far
    return (apart + 1.0 - looks @ ahead.T).min(axis=1)


def rotations_about_up(angles: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) about +y."""
    half = 0.5 * np.asarray(angles, np.float64)
    zero = np.zeros_like(half)
    return matrices_from_quaternions(np.stack([np.cos(half), zero, np.sin(half), zero], axis=1))


def spot_in(
    environment: Environment,
    grid: DistanceGrid | None,
    own: Room,
    unseen: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """The point (3,) of a room around which to play, and the radius [m] of free space there.

    unseen  see `unphotographed`, of points and angles
    """
    drop = np.array(environment.drop_point)
    if not own.on_floor or grid is None or not environment.planes:
        return drop, environment.clear_radius
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
    if unseen is not None:
        points = np.insert(at[free], 1, height, axis=1)
        score[free] -= UNSEEN_WEIGHT * np.min([unseen(points, np.full(len(points), t)) for t in TURNS], axis=0)
    best = np.unravel_index(np.where(free, score, -np.inf).argmax(), free.shape)
    return np.array([at[best][0], height, at[best][1]]), float(radius[best])


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle about +y [rad] that turns the horizontal direction of `a` (3,) to that of `b`."""
    return np.arctan2(b[0], b[2]) - np.arctan2(a[0], a[2])


def around(spot: Vec3, at: np.ndarray, angle: float) -> tuple[Quat, Vec3]:
    """Rotation and position of a room that is turned by an angle about +y [rad], so that its point `at` is the spot."""
    rotation = (float(np.cos(0.5 * angle)), 0.0, float(np.sin(0.5 * angle)), 0.0)
    position = np.subtract(spot, matrices_from_quaternions(np.array(rotation)) @ at)
    return rotation, tuple(map(float, position))


def free_eye(
    scene: Scene, grid: DistanceGrid | None, rotation: Quat, position: Vec3, floor: float
) -> tuple[Vec3, float]:
    """The scene's eye, or as far from its target towards there as nothing of the room is in the way.

    Out.  the eye, and how much of the way there is free; at the eye there is room for a user who stands on the floor
    """
    if grid is None:
        return scene.eye, 1.0
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
