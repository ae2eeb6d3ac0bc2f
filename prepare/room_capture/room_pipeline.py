"""From trained Gaussians and the cameras of their photographs to the parts of a ROOM/ folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from assets.asset import Asset
from assets.gaussians import Gaussians, concatenate
from assets.room_folder import RoomManifest, RoomObject
from core.errors import BadInput
from core.measured_length import length_of, scale_between
from prepare.cleaning import MIN_GAUSSIANS
from prepare.progress import Progress, no_progress
from prepare.room_capture.capture_orientation import CaptureOrientation, capture_orientation
from prepare.room_capture.captured_background import RoomView, captured_environment, room_extent, view_of
from prepare.room_capture.contributions import Contributions, depth_at, needed
from prepare.room_capture.objects import Support, object_body, object_files, placed_points, seated, support_of, turn_of
from prepare.train.capture import Capture

OBJECT_SHARE = 0.002  # least share of an object in what the pictures show
NEAR_MARGIN = 0.03  # [m] around an object where the collider is fine


@dataclass(frozen=True)
class PlacedRoom:
    """A capture in metres, +y up, with the floor at y = 0.

    gaussians    that the photographs need, and the `weight` of each in them, (N,)
    view         the cameras, and what they show
    orientation  from the capture's frame
    """

    gaussians: Gaussians
    weight: np.ndarray
    view: RoomView
    orientation: CaptureOrientation

    @property
    def names(self) -> list[str]:
        """Names of the objects."""
        ids = np.unique(self.gaussians.object_id)
        return [object_name(self.gaussians, k) for k in ids if k]

    def parts(self) -> tuple[list[Gaussians], Gaussians]:
        """Gaussians of each object, and all others."""
        ids = self.gaussians.object_id
        return [self.gaussians.select(ids == k) for k in np.unique(ids) if k], self.gaussians.select(ids == 0)


def object_name(gaussians: Gaussians, k: int) -> str:
    """Name of the object with an id."""
    return gaussians.objects[k - 1] if k <= len(gaussians.objects) else f"object_{k}"


def without_supports(gaussians: Gaussians, capture: Capture, progress: Progress = no_progress) -> Gaussians:
    """The Gaussians in another order, those of objects that lie in the surface that these stand on as parts of the
    background: masks took them along, and a body would carry them away."""
    from prepare.inpaint import inpaint_pipeline

    ids = gaussians.object_id
    objects = {object_name(gaussians, k): gaussians.select(ids == k) for k in np.unique(ids) if k}
    background, objects = inpaint_pipeline.without_supports(
        gaussians.select(ids == 0),
        objects,
        capture.cameras(),
        lambda name, *_: lambda _, done: progress(f"support of {name}", done),
    )
    return concatenate([background, *objects.values()])


def placed_room(gaussians: Gaussians, capture: Capture, found: Contributions, scale: float | None) -> PlacedRoom:
    """The room in metres, pruned but for objects, which also have sides that no photograph shows; `scale`: measured
    metres per unit of the capture, None: guessed."""
    cameras = capture.cameras()
    keep = needed(gaussians, cameras, found) | (gaussians.object_id > 0)
    gaussians, weight = gaussians.select(keep), found.weight[keep]
    o = capture_orientation(capture, gaussians, scale)
    placed = [replace(c, world_to_camera=o.pose(c.world_to_camera)) for c in cameras]
    view = RoomView(placed, o.scale * found.depth, o.floor_seen)
    return PlacedRoom(o.gaussians(gaussians), weight, view, o)


@dataclass(frozen=True)
class MeasuredLength:
    """Two points of a capture that are `length` [m] apart.

    points  each a photograph's name and a pixel (x, y) of it, or "" and a point (x, y, z) in the frame of the files
    """

    points: tuple[tuple[str, list[float]], ...]
    length: float

    @classmethod
    def of(cls, texts: Sequence[str]) -> MeasuredLength:
        """From the texts of --scale-points: PHOTOGRAPH:x,y or x,y,z twice, and a length. Raises BadInput."""
        points = []
        for text in texts[:2]:
            name, _, numbers = text.rpartition(":")
            try:
                values = [float(x) for x in numbers.split(",")]
            except ValueError:
                values = []
            if len(values) != (2 if name else 3) or not np.isfinite(values).all():
                raise BadInput(f"--scale-points: {text!r} is neither PHOTOGRAPH:x,y nor x,y,z")
            points.append((name, values))
        try:
            return cls(tuple(points), length_of(texts[2]))
        except BadInput as e:
            raise BadInput(f"--scale-points: {e}") from e

    def check(self, sizes: dict[str, tuple[int, int]]) -> None:
        """Raise BadInput for a point outside of the photographs, by name (width, height) [px]."""
        for name, (x, y, *_) in self.points:
            if name and name not in sizes:
                known = ", ".join(list(sizes)[:5])
                raise BadInput(f"--scale-points: there is no photograph {name}; there are: {known} ...")
            if name and not (0 <= x < sizes[name][0] and 0 <= y < sizes[name][1]):
                size = "{}x{}".format(*sizes[name])
                raise BadInput(f"--scale-points: {x:g},{y:g} is not in {name}, which has {size} pixels")

    def scale(self, gaussians: Gaussians, capture: Capture, turn: np.ndarray) -> float:
        """Metres per unit of the Gaussians of a capture, whose frame is that of its files turned by `turn` (3, 3).

        Raises BadInput. Taichi must be running.
        """
        cameras, found = {view.name: view.camera() for view in capture.views}, []
        self.check({name: (camera.width, camera.height) for name, camera in cameras.items()})
        for name, values in self.points:
            if not name:
                found.append(turn @ values)
                continue
            camera = cameras[name]
            depth = depth_at(gaussians, camera, *values)
            if not np.isfinite(depth):
                raise BadInput(f"{name}: nothing was captured at {values[0]:g},{values[1]:g}")
            origin, direction = camera.ray(*values)
            found.append(origin + direction * depth / (camera.world_to_camera[2, :3] @ direction))
        return scale_between(*found, self.length)


def held_objects(room: PlacedRoom, say: Callable[[str], None]) -> tuple[PlacedRoom, list[Support]]:
    """The room whose objects can be grabbed, and what holds each of them.

    An object of too few Gaussians, or one that nothing holds, stays in the background, as a line to `say` tells. Raises
    BadInput if no object is left.
    """
    g, lost = room.gaussians, {}
    for k in sorted({*range(1, len(g.objects) + 1), *np.unique(g.object_id).tolist()} - {0}):
        own = g.object_id == k
        opaque, share = len(g.select(own).opaque()), room.weight[own].sum() / room.weight.sum()
        if opaque < MIN_GAUSSIANS:
            why = f"only {opaque} opaque Gaussians belong to it; train longer (--steps) or mark more of it"
            lost[object_name(g, k)] = why
        elif share < OBJECT_SHARE:
            lost[object_name(g, k)] = "the photographs hardly show it; mark more of it, or leave it out"
    while True:
        room, lost, held = without_objects(room, lost, say), {}, []
        parts, rest = room.parts()
        for name, part in zip(room.names, parts, strict=True):
            try:
                held.append(support_of(part, rest))
            except BadInput as e:
                lost[name] = str(e)
        if not lost:  # else what stays in the background may hold another
            return room, held


def without_objects(room: PlacedRoom, lost: dict[str, str], say: Callable[[str], None]) -> PlacedRoom:
    """The room with objects left in its background; `lost` tells why, by name. Raises BadInput if no object is left."""
    if not lost:
        return room
    g, (name, why) = room.gaussians, next(iter(lost.items()))
    if not set(room.names) - set(lost):
        raise BadInput(f"{name}: {why}")
    for name, why in lost.items():
        say(f"{name} stays in the background: {why}")
    ids = g.object_id.copy()
    for k in np.unique(ids):
        if k and object_name(g, k) in lost:
            ids[ids == k] = 0
    return replace(room, gaussians=replace(g, object_id=ids))


def inpainted(
    room: PlacedRoom, progress: Callable[[str, int, int], Progress], say: Callable[[str], None], painter=None
) -> Gaussians:
    """The background with the places of its objects closed; left open where there is no surface to go on with, as a
    line to `say` tells. Raises BadInput."""
    from prepare.inpaint.inpaint_pipeline import inpaint

    parts, rest = room.parts()
    objects = dict(zip(room.names, parts, strict=True))
    return inpaint(rest, objects, room.view.cameras, painter=painter, progress=progress, say=say)[0]


def bodies(
    room: PlacedRoom,
    held: Sequence[Support],
    *,
    vertices: Sequence[int],
    material: str | None,
    progress: Callable[[str, int, int], Progress],
    say: Callable[[str], None],
) -> tuple[list[tuple[Asset, RoomObject]], dict[str, str]]:
    """A body for each object, with its place; and why the other objects have none, by name."""
    parts, _ = room.parts()
    found, lost, files = [], {}, object_files(room.names)
    make = partial(object_body, vertices=vertices, material=material, say=say)
    for k, (name, part, support) in enumerate(zip(room.names, parts, held, strict=True)):
        try:
            found.append(make(name, files[k], part, support, progress=progress(name, k, len(parts))))
        except BadInput as e:
            lost[name] = str(e)
    return found, lost


def background(
    room: PlacedRoom,
    rest: Gaussians,
    bodies: Sequence[tuple[Asset, RoomObject]],
    *,
    cell: float | None,
    progress: Progress,
) -> Asset:
    """The environment of the room without its objects, with a seat for each."""
    near = []
    for asset, placed in bodies:
        x = placed_points(asset.cage.vertices, placed)
        near.append((x.min(0) - NEAR_MARGIN, x.max(0) + NEAR_MARGIN))
    extent = room_extent(room.gaussians, room.weight, room.view)
    made = captured_environment(rest, room.view, extent, near=near, cell=cell, progress=progress)
    return seated(made, bodies)


def with_objects(rest: Gaussians, bodies: Sequence[tuple[Asset, RoomObject]]) -> Gaussians:
    """The Gaussians of the room with its objects in their places."""
    turned = [asset.gaussians.transformed(turn_of(placed), placed.position) for asset, placed in bodies]
    return concatenate([replace(g, objects=()) for g in (rest, *turned)])


def manifest(room: PlacedRoom, bodies: Sequence[RoomObject]) -> RoomManifest:
    """The manifest of the room."""
    eye, target, fov = view_of(room.view)
    o, matrix = room.orientation, np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = o.scale * o.rotation, o.shift
    where = (eye, target, fov, room.view.floor, o.scale, matrix)
    return RoomManifest("room.h5", tuple(bodies), *where, tuple(room.view.cameras))
