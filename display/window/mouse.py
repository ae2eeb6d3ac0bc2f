"""The mouse: a camera that orbits a target, and a hand that grips what was clicked."""

from __future__ import annotations

from collections import deque

import numpy as np

from core.camera import Camera, look_at, perspective
from core.vocabulary import Hand, Vec3

MAX_PITCH = np.radians(88.0)  # [rad]; nearer to the vertical the horizon would flip
MIN_DISTANCE, MAX_DISTANCE = 0.05, 200.0  # [m] from eye to target
ZOOM_STEP = 0.9  # factor on the distance of one notch of the wheel
FOLLOW_TIME = 0.03  # [s], time constant of the hand behind the cursor: evens out the events of slow mice
MAX_SPEED = 8.0  # [m/s]; a hard throw by a real hand, and a flick of the wrist on a mouse pad can ask for more
MIN_DEPTH, MAX_DEPTH = 0.1, 50.0  # [m] of the hand before the camera
THROW_WINDOW = 0.08  # [s] before the release that decide the throw: fingers slow down as they let go
FOLLOW_THROUGH = 0.03  # [s] that the grip continues at the speed of the throw, so that the whole body takes it up
MIN_THROW_SPEED = 0.2  # [m/s]; slower is putting down


class OrbitCamera:
    """An eye and the target it looks at [m], upright (+y), with a vertical field of view [rad].

    Pictures that are higher than wide see that angle from side to side: a telephone held upright shows the scene too.
    """

    def __init__(self, eye, target, fov_y: float):
        self._home, self.fov_y = (eye, target), fov_y
        self.reset()

    def reset(self) -> None:
        """Back to where the scene begins."""
        self.look_from(*self._home)

    @property
    def view(self) -> tuple[Vec3, Vec3]:
        """Eye and target [m]."""
        return tuple(self.eye.tolist()), tuple(self.target.tolist())

    def look_from(self, eye, target) -> None:
        """Go to an eye and look at a target (3,) [m]."""
        self.eye, self.target = np.array(eye, np.float64), np.array(target, np.float64)

    @property
    def distance(self) -> float:
        """From eye to target [m]."""
        return float(np.linalg.norm(self.eye - self.target))

    def camera(self, width: int, height: int) -> Camera:
        """The camera for a picture of this size [px]."""
        steepness = np.tan(0.5 * self.fov_y) * max(1.0, height / width)
        return perspective(width, height, float(2.0 * np.arctan(steepness)), look_at(self.eye, self.target))

    def turn(self, yaw: float, pitch: float, lowest: float | None = None) -> None:
        """Orbit the target: angles [rad], positive to the right of the target and upwards.

        The eye goes no lower than `lowest` [m], or than it is already.
        """
        offset = self.eye - self.target
        if lowest is not None:
            height = min(lowest - self.target[1], offset[1])
            least, now = np.arcsin(np.clip(np.array([height, offset[1]]) / self.distance, -1.0, 1.0))
            pitch = max(pitch, least - now)
        self.eye = self.target + turn_vector(offset, yaw, pitch)

    def look(self, yaw: float, pitch: float) -> None:
        """Turn the head: angles [rad], positive to the left and upwards."""
        self.target = self.eye + turn_vector(self.target - self.eye, yaw, pitch)

    def move(self, right: float, up: float, forward: float) -> None:
        """Move eye and target along the camera's own axes [m]."""
        axes = look_at(self.eye, self.target)[:3, :3]  # rows: right, down, forward
        step = right * axes[0] - up * axes[1] + forward * axes[2]
        self.eye, self.target = self.eye + step, self.target + step

    def zoom(self, notches: float) -> None:
        """Approach the target (positive) or back off, by a fraction of the distance a notch."""
        offset = self.eye - self.target
        length = np.clip(self.distance * ZOOM_STEP**notches, MIN_DISTANCE, MAX_DISTANCE)
        self.eye = self.target + offset * (length / self.distance)


def turn_vector(offset: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
    """Turn a vector by `yaw` about +y and lift it by `pitch`, up to MAX_PITCH."""
    length = np.linalg.norm(offset)
    yaw += np.arctan2(offset[0], offset[2])
    pitch = np.clip(pitch + np.arcsin(np.clip(offset[1] / length, -1.0, 1.0)), -MAX_PITCH, MAX_PITCH)
    return length * np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])


class MouseHand:
    """A hand at a screen position (u, v) [px] and a depth [m] along the view axis.

    Both are kept in the camera's frame, so a camera that moves during a drag carries the hand along.
    """

    def __init__(self):
        self.gripping = False
        self.position = np.zeros(3)
        self._u = self._v = self._depth = 0.0
        self._radius = Hand.reach
        self._pace = 1.0
        self._fresh = self._given = False  # did the grip just begin; was there a hand in the last frame
        self._remaining: float | None = None  # [s] of the grip after the release, None before it
        self._velocity = np.zeros(3)  # of the throw
        self._clock = 0.0
        self._goals: deque[tuple[float, np.ndarray]] = deque()  # where the cursor led, over the last THROW_WINDOW

    def grab(self, camera: Camera, u: float, v: float, distance: float, radius: float) -> None:
        """Grip at `distance` [m] along the ray through (u, v); takes what lies within `radius` [m]."""
        origin, direction = camera.ray(u, v)
        self.position = origin + distance * direction
        self._u, self._v, self._radius = u, v, radius
        self._depth = distance * float(direction @ camera.world_to_camera[2, :3])
        self.gripping, self._fresh, self._remaining = True, True, None
        self._goals.clear()

    def drag(self, du: float, dv: float) -> None:
        """Move in the plane parallel to the screen [px]."""
        self._u, self._v = self._u + du, self._v + dv

    def push(self, amount: float) -> None:
        """Move away (positive) or towards the camera by a factor exp(amount) of the depth."""
        self._depth = float(np.clip(self._depth * np.exp(amount), MIN_DEPTH, MAX_DEPTH))

    def release(self) -> None:
        """Let go: what was held flies on with the cursor's mean speed of the last moments."""
        if not self.gripping or len(self._goals) < 2:
            return self.drop()
        (begin, start), (end, goal) = self._goals[0], self._goals[-1]
        self._velocity = clamp_length((goal - start) / (end - begin), MAX_SPEED)
        if np.linalg.norm(self._velocity) < MIN_THROW_SPEED:
            return self.drop()
        self._remaining = min(FOLLOW_THROUGH / self._pace, THROW_WINDOW)  # the solver's throw is of the world's time

    def drop(self) -> None:
        """Let go at once."""
        self.gripping, self._remaining = False, None

    def hands(self, camera: Camera, dt: float, pace: float = 1.0) -> list[Hand]:
        """The hand after `dt` [s], where it closes in on the cursor or follows through; none when it is open.

        `pace`: seconds of the world per second of real time. The hand moves in the world's time, but a throw is as fast
        as the cursor was in the user's.
        A grip begins with a hand that was not there before, so it never seems to come from elsewhere.
        """
        if self._remaining is not None and self._remaining <= 0.0:
            self.drop()
        if not self.gripping or (self._fresh and self._given):
            self._given = False
            return []
        if self._remaining is not None:
            self._remaining -= dt * pace
            self.position = self.position + self._velocity * dt * pace
        elif dt > 0.0:
            self._pace = pace
            origin, direction = camera.ray(self._u, self._v)
            goal = origin + direction * (self._depth / float(direction @ camera.world_to_camera[2, :3]))
            step = (goal - self.position) * (1.0 - np.exp(-dt * pace / FOLLOW_TIME))
            self.position = self.position + clamp_length(step, MAX_SPEED * dt * pace)
            self._clock += dt
            self._goals.append((self._clock, goal))
            while len(self._goals) > 2 and self._clock - self._goals[0][0] > THROW_WINDOW:
                self._goals.popleft()
        self._fresh, self._given = False, True
        return [Hand(position=tuple(map(float, self.position)), grip=True, reach=self._radius)]


def clamp_length(vector: np.ndarray, max_length: float) -> np.ndarray:
    """The vector, no longer than `max_length`."""
    length = np.linalg.norm(vector)
    return vector * (max_length / length) if length > max_length else vector
