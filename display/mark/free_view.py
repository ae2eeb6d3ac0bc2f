"""A free camera on a splat, and the views from it that have been marked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.camera import Camera, look_at
from display.window.orbit_camera import OrbitCamera


class FreeView:
    """An OrbitCamera in a frame that is upright, and marked views in that of the splat's file.

    orbit    the camera that the user moves
    size     (width, height) [px] of its pictures
    upright  (4, 4) rotation from the file's frame
    cameras  of the marked views by name, in the file's frame
    """

    def __init__(self, orbit: OrbitCamera, size: tuple[int, int], upright: np.ndarray, cameras: dict[str, Camera]):
        self.orbit, self.size, self._upright, self.cameras = orbit, size, upright, dict(cameras)

    @property
    def camera(self) -> Camera:
        """The free camera in the frame of the file."""
        camera = self.orbit.camera(*self.size)
        return replace(camera, world_to_camera=camera.world_to_camera @ self._upright)

    def shown(self) -> str | None:
        """The view that was marked from here, if there is one."""
        here = self.camera
        return next((name for name, camera in self.cameras.items() if same_camera(camera, here)), None)

    def named(self) -> str:
        """The view from here, which is given a name if it has none."""
        name = self.shown()
        if name is None:
            number = len(self.cameras) + 1
            while f"view_{number}" in self.cameras:
                number += 1
            name = f"view_{number}"
            self.cameras[name] = self.camera
        return name

    def go_to(self, view: str) -> None:
        """Look from where a view was marked; its roll is ignored."""
        pose = self.cameras[view].world_to_camera @ self._upright.T
        eye = -pose[:3, :3].T @ pose[:3, 3]
        self.orbit.eye, self.orbit.target = eye, eye + self.orbit.distance * pose[2, :3]
        if np.allclose(look_at(self.orbit.eye, self.orbit.target), pose, atol=1e-6):
            self.cameras[view] = replace(self.cameras[view], world_to_camera=self.camera.world_to_camera)


def same_camera(a: Camera, b: Camera) -> bool:
    """True if two cameras take the same picture."""
    lenses = ([c.width, c.height, c.fx, c.fy, c.cx, c.cy] for c in (a, b))
    return np.allclose(*lenses) and np.allclose(a.world_to_camera, b.world_to_camera, atol=1e-6)
