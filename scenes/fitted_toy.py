"""Fitted toy: a toy beside the clip that its material was fitted to (vrgs.py fit); pull it.

The screen has the size of life. Both are seen as the clip's camera saw them, and begin again together.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from assets.asset import Asset
from assets.fitted_clip import FittedClip
from assets.library import default_material, find_asset
from core.errors import BadInput
from core.material import Material
from core.rotation import matrices_from_quaternions
from scenes.dining_table import TABLE_TOP, table_scene
from scenes.scene import Body, BodyState, Hand, Plane, Role, Scene, Screen
from scenes.scripted_hands import ease

TOY = "rabbit_fitted"
ASIDE, AWAY = 0.55, 1.9  # of the screen's height: from the middle to screen and toy, and to the eye
FARTHEST = 1.9  # [m] of the eye, which stays in the room; it then sees more
FRAME, FRAME_COLOUR = 2, 40  # [px] around the film, and its grey
BOARD, BOARD_COLOUR = 24, (150, 120, 85)  # sides [px] of the picture of what a toy slides on


class FittedToy:
    """No goal. In the second round of the clip the scripted hand pulls the toy's lower part aside and lets it go."""

    score = 0
    message = "Left the clip, right the toy of the fitted material. Pull it: later it begins again with the clip."

    def __init__(self, period: float, size: float):
        """period: of the clip [s];   size: of the toy [m]."""
        self.period, self.size = period, size
        self.duration = 3.2 * period  # the toy is left alone in the third round, and begins again with the fourth
        self.reset()

    def reset(self) -> None:
        self.early, self.last = np.zeros(3), np.zeros(3)  # its middle in the first round, and in the last frame
        self.grasp: np.ndarray | None = None

    def update(self, time: float, bodies: list[BodyState]) -> None:
        self.last = bodies[0].centroid
        if time <= 0.2 * self.period:
            self.early = self.last
        elif time >= self.period and self.grasp is None:
            low, high = bodies[0].low, bodies[0].high
            self.grasp = np.array([self.last[0], low[1] + 0.25 * (high[1] - low[1]), self.last[2]])

    def hands(self, time: float, bodies: list[BodyState]) -> list[Hand]:
        if self.grasp is None:
            return []
        t = time / self.period - 1.0
        way = self.size * np.array([0.35, 0.0, 0.1]) * ease((t - 0.1) / 0.5)
        return [Hand(tuple(self.grasp + way), grip=0.1 < t < 0.7, reach=0.25 * self.size)]

    def verify(self, bodies: list[BodyState]) -> None:
        """Assert the outcome of the scripted play."""
        assert self.grasp is not None, "the hand has taken nothing"
        assert np.linalg.norm(self.last - self.early) < 0.1 * self.size, "the toy has not begun again with the clip"


def build(body: str = TOY, material: Annotated[str, "in place of the fitted one"] | None = None) -> Scene:
    """`body`: an asset that `vrgs.py fit` has written; `material`: a name (core/material.py)."""
    asset = Asset.load(find_asset(body))
    clip = asset.clip
    if clip is None:
        raise BadInput(f"{body}: has no clip (vrgs.py fit ASSET VIDEO keeps it)")
    made_of = default_material(body) if material is None else Material.named(material)
    middle = clip.positions.mean(0).astype(np.float64)
    screen = screen_of(clip, middle)
    height = float(np.linalg.norm(screen.down))
    spot = np.array([0.0, TABLE_TOP + 0.7 * height, 0.0])
    angle = 0.5 * np.arctan(ASIDE / AWAY)
    toy_turn, screen_turn = ((float(np.cos(angle)), 0.0, side * float(np.sin(angle)), 0.0) for side in (-1, 1))
    R = matrices_from_quaternions(np.array(toy_turn))
    position = spot + [ASIDE * height, 0.0, 0.0] - R @ middle
    toy = Body(body, made_of, position=tuple(position.tolist()), rotation=toy_turn, filmed=True)
    normals = clip.planes[:, :3] @ R.T
    feet = normals * (clip.planes[:, 3] + normals @ position)[:, None]
    planes = [Plane(tuple(p), tuple(n), made_of.friction) for p, n in zip(feet.tolist(), normals.tolist(), strict=True)]
    boards = [board_under(spot + [ASIDE * height, 0.0, 0.0], p, n, height) for p, n in zip(feet, normals, strict=True)]
    way, away = clip.camera.position - middle, min(AWAY * height, FARTHEST)
    return table_scene(
        [toy],
        planes,
        eye=tuple((spot + away * way / np.linalg.norm(way)).tolist()),
        target=tuple(spot.tolist()),
        fov_y=float(2 * np.arctan(np.tan(0.5 * Scene.fov_y) * AWAY * height / away)),
        screens=(placed(screen, middle, screen_turn, spot - [ASIDE * height, 0.0, 0.0]), *boards),
        game=FittedToy(clip.period, float(np.ptp(clip.positions, axis=0).max())),
        roles=(Role("toy", (body,)),),
    )


def screen_of(clip: FittedClip, middle: np.ndarray) -> Screen:
    """The clip's pictures where its camera sees the point `middle` (3,), as large as what they show there."""
    camera, axes = clip.camera, clip.camera.world_to_camera[:3, :3]
    depth = camera.projected(middle)[2]
    right, down = depth * camera.width / camera.fx * axes[0], depth * camera.height / camera.fy * axes[1]
    corner = camera.position + depth * axes[2] - camera.cx / camera.width * right - camera.cy / camera.height * down
    pictures = clip.pictures.copy()
    pictures[:, [*range(FRAME), *range(-FRAME, 0)]] = FRAME_COLOUR
    pictures[:, :, [*range(FRAME), *range(-FRAME, 0)]] = FRAME_COLOUR
    sides = tuple(right.tolist()), tuple(down.tolist())
    return Screen(tuple(corner.tolist()), *sides, pictures, clip.times, clip.period)


def placed(screen: Screen, middle: np.ndarray, turn, position: np.ndarray) -> Screen:
    """The screen turned about a point `middle` (3,), whose place is then `position`."""
    R = matrices_from_quaternions(np.array(turn))
    corner = position + R @ (screen.corner - middle)
    return replace(screen, corner=tuple(corner), right=tuple(R @ screen.right), down=tuple(R @ screen.down))


def board_under(middle: np.ndarray, point: np.ndarray, normal: np.ndarray, side: float) -> Screen:
    """A square board in the plane of a point and a normal (3,), under `middle` (3,)."""
    right = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    right *= side / np.linalg.norm(right)
    down = np.cross(right, normal)
    corner = middle - (middle - point) @ normal * normal - 0.5 * (right + down)
    pictures = np.tile(np.uint8(BOARD_COLOUR), (1, BOARD, BOARD, 1))
    return Screen(tuple(corner), tuple(right), tuple(down), pictures, np.zeros(1), np.inf)
