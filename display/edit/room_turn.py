"""The room of the user's, turned as a whole while it is played in: splats, colliders, light, and the bodies in it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from assets.library import SHIPPED_FOLDER, find_asset
from core.errors import BadInput
from core.vocabulary import Body, Box, Light
from scenes.scene import Scene

if TYPE_CHECKING:
    from display.device_scene import DeviceScene

SAME = 1e-6  # of a rotation's entries


def own_room(scene: Scene) -> Body | None:
    """The static body that is the user's room: the first, beside which there may be the play's own things, as a bottle.

    None: there is none, or one that cannot be turned.
    """
    still = [body for body in scene.bodies if body.material is None]
    shipped = SHIPPED_FOLDER.resolve()
    own = [b for b in still if not find_asset(b.asset).resolve().is_relative_to(shipped)]
    return own[0] if own == still[:1] and own and not any(isinstance(c, Box) for c in scene.colliders) else None


class RoomTurn:
    """The turn of the room since the start: `pose`, a rigid transform (4, 4) of the world.

    own   the room's body; None: it is none of the user's
    kept  the pose that its file has
    """

    def __init__(self, device: DeviceScene):
        self._device, self.pose, self.kept = device, np.eye(4), np.eye(4)
        self.own = own_room(device.scene)

    @property
    def moved(self) -> bool:
        """Is it not as at the start?"""
        return bool(np.abs(self.pose - np.eye(4)).max() > SAME)

    @property
    def turned(self) -> bool:
        """Has it been turned since it was read or kept?"""
        return bool(np.abs(self.pose - self.kept).max() > SAME)

    def about(self, rotation: np.ndarray) -> np.ndarray:
        """The transform (4, 4) that turns the room by (3, 3) about what one looks at. Raises BadInput."""
        if self.own is None:
            raise BadInput("Only a room of your own can be turned: vrgs.py capture, or --stage ROOM.")
        middle, by = self.middle, np.eye(4)
        by[:3, :3] = rotation
        by[:3, 3] = middle - rotation @ middle
        return by

    @property
    def middle(self) -> np.ndarray:
        """The point (3,) [m] that the scene looks at: it stays where it is."""
        return np.asarray(self._device.scene.target, np.float64)

    def place(self, pose: np.ndarray) -> None:
        """Let the room be at a pose, and the light with it."""
        if np.abs(pose - self.pose).max() <= 0.0:
            return
        by = pose @ np.linalg.inv(self.pose)
        self.pose = orthonormal(pose)
        self._device.place_room(self.pose)
        if self._device.light is not None:
            self._device.set_light(turned_light(self._device.light, by))


def orthonormal(pose: np.ndarray) -> np.ndarray:
    """The rigid transform (4, 4) next to one that many turns have rounded."""
    u, _, vt = np.linalg.svd(pose[:3, :3])
    found = pose.copy()
    found[:3, :3] = u @ vt
    return found


def turned_light(light: Light, by: np.ndarray) -> Light:
    """A light after a rigid transform (4, 4)."""
    position, target = (
        tuple((by[:3, :3] @ np.asarray(p, np.float64) + by[:3, 3]).tolist()) for p in (light.position, light.target)
    )
    return replace(light, position=position, target=target)
