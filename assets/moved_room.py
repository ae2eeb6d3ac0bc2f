"""A captured room's folder after its background has been turned: objects, cameras and eye go with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.room_folder import RoomManifest, RoomObject
from core.rotation import matrices_from_quaternions, quaternions_from_matrices


def moved_room(room: RoomManifest, rotation: np.ndarray, shift: np.ndarray) -> RoomManifest:
    """The manifest of the room after x -> rotation x + shift, which puts its floor at y = 0."""
    by = np.eye(4)
    by[:3, :3], by[:3, 3] = rotation, shift

    def at(point) -> tuple[float, float, float]:
        return tuple((rotation @ np.asarray(point, np.float64) + shift).tolist())

    def turned(o: RoomObject) -> RoomObject:
        q = quaternions_from_matrices(rotation @ matrices_from_quaternions(np.array(o.rotation)))
        return replace(o, position=at(o.position), rotation=tuple(q.tolist()))

    return replace(
        room,
        objects=tuple(map(turned, room.objects)),
        eye=at(room.eye),
        target=at(room.target),
        floor=0.0,
        room_from_capture=by @ room.room_from_capture,
        cameras=tuple(replace(c, world_to_camera=c.world_to_camera @ np.linalg.inv(by)) for c in room.cameras),
    )
