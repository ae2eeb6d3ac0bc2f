"""The gizmo of the selected body or of the room (ImGuizmo): arrows, rings or handles that move, turn or scale it."""

from __future__ import annotations

import numpy as np

from core.camera import Camera
from core.rotation import quaternions_from_matrices
from display.user_commands import Command, Place, Rescale, TurnRoom

NEAR, FAR = 0.01, 1000.0  # [m] of the projection
SIZE = 0.16  # of the gizmo, in half widths of the picture
STILL = 1e-5  # [m]; less is no motion, and no turn as a matrix's entries


class Gizmo:
    """Handles at a body's centre, or at what a room is turned about. A drag of move or turn acts at once, one of scale
    when it ends.

    `over`: the cursor is on a handle or drags it, so that the mouse does nothing else. `scaling` is the factor that a
    drag of scale has now, else 1.
    """

    def __init__(self):
        self.over, self.scaling = False, 1.0
        self._dragging = self._sent = False
        self._matrix = np.eye(4)  # of the handles: world_from_gizmo
        self._turned = np.eye(3)  # how far the body has been turned in this drag

    def hide(self) -> None:
        """Let go of a drag without its end."""
        self.over, self.scaling, self._dragging = False, 1.0, False

    def draw(
        self, kind: str, at: np.ndarray, k: int | None, camera: Camera, area: tuple[float, float, float, float]
    ) -> list[Command]:
        """Draw the handles of `kind` at the centre (3,) of body k into an area (left, top, width, height) [px]; the
        user's commands. None: of the room, which can be turned only."""
        from imgui_bundle import imgui, imguizmo

        gizmo = imguizmo.im_guizmo
        operation = {"move": "translate", "turn": "rotate", "scale": "scale"}[kind]
        if not self._dragging:
            self._matrix, self._turned, self._sent, self.scaling = np.eye(4), np.eye(3), False, 1.0
            self._matrix[:3, 3] = at
        gizmo.begin_frame()
        gizmo.set_drawlist(imgui.get_background_draw_list())
        gizmo.set_rect(*area)
        gizmo.set_gizmo_size_clip_space(SIZE)
        gizmo.allow_axis_flip(False)
        style = gizmo.get_style()
        style.translation_line_thickness = style.scale_line_thickness = 4.0
        style.rotation_line_thickness, style.rotation_outer_line_thickness = 3.0, 2.0
        style.translation_line_arrow_size = style.scale_line_circle_size = 7.0
        view, projection = view_matrices(camera)
        matrix = gizmo.Matrix16(self._matrix.T.ravel().tolist())
        gizmo.manipulate(
            gizmo.Matrix16(view.T.ravel().tolist()),
            gizmo.Matrix16(projection.T.ravel().tolist()),
            gizmo.OPERATION.__members__[operation],
            gizmo.MODE.__members__["world" if kind != "scale" else "local"],
            matrix,
        )
        was, self._dragging = self._dragging, gizmo.is_using()
        self.over = self._dragging or gizmo.is_over()
        self._matrix = np.array(matrix.values, np.float64).reshape(4, 4).T
        if kind == "scale":
            return self._scale(k, ended=was and not self._dragging)
        return self._place(at, k) if self._dragging else []

    def _scale(self, k: int, *, ended: bool) -> list[Command]:
        """The factor of any handle is that of the whole body."""
        factor, self.scaling = self.scaling, 1.0
        if ended:
            return [Rescale(k, factor)]
        if self._dragging:
            axes = np.linalg.norm(self._matrix[:3, :3], axis=0)
            self.scaling = float(axes[np.argmax(np.abs(np.log(np.maximum(axes, 1e-3))))])
        return []

    def _place(self, at: np.ndarray, k: int | None) -> list[Command]:
        """Bring the body to where the handles are, in every frame: it neither falls nor is pushed away."""
        turned = self._matrix[:3, :3] / np.linalg.norm(self._matrix[:3, :3], axis=0)
        rotation, offset = turned @ self._turned.T, self._matrix[:3, 3] - at
        if not self._sent and np.abs(offset).max() < STILL and np.abs(rotation - np.eye(3)).max() < STILL:
            return []
        self._turned, continued, self._sent = turned, self._sent, True
        quaternion = tuple(quaternions_from_matrices(rotation).tolist())
        if k is None:
            return [TurnRoom(quaternion, continued)]
        return [Place(k, tuple(offset.tolist()), quaternion, continued)]


def view_matrices(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """OpenGL's view (4, 4) and projection (4, 4) of a camera: -z forward and +y up."""
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.world_to_camera
    projection = np.zeros((4, 4))
    projection[0, 0], projection[0, 2] = 2 * camera.fx / camera.width, 1 - 2 * camera.cx / camera.width
    projection[1, 1], projection[1, 2] = 2 * camera.fy / camera.height, 2 * camera.cy / camera.height - 1
    projection[2, 2], projection[2, 3] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
    projection[3, 2] = -1.0
    return view, projection
