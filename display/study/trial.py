"""A trial: one participant's play of one task, from its start to its goal or its end, and how it is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from display.protocol import Frame, WorldView

SETTINGS = ("physics", "transform")
MIXED = "mixed"  # the setting of a trial with grips in both
THROW_SPEED = 0.5  # [m/s] of a body when it is let go; what is put down is slower
GOAL_HOLD = 1.0  # [s] for which a score must hold: a ring in flight may pass around the bottle's axis
HAND_SPEED_MAX = 10.0  # [m/s]; a hand that is faster was lost, or teleported with its player


@dataclass
class Trial:
    """Record of a participant's play of a task. Times are in the world's time without pauses [s].

    setting     "physics", "transform" or "mixed"
    device      "window", "headset", "browser" or "headless"
    about       options of the scene, roles of the user's own bodies
    seconds     until the goal was reached, or else until the end
    first_grip  until something was held; NaN: never
    goal        score that ends the task; NaN: it has none
    completed   whether the goal was reached
    grips       number of times that a body was taken
    throws      number of times that a body was let go at THROW_SPEED or more
    hand_path   distance moved by the hands [m]
    body_path   distance moved by bodies that were held [m]
    scores      times at which the score changed, with the new one, (K, 2)
    """

    participant: str
    task: str
    setting: str = SETTINGS[0]
    device: str = "headless"
    started: str = ""
    about: dict = field(default_factory=dict)
    seconds: float = 0.0
    first_grip: float = math.nan
    goal: float = math.nan
    completed: bool = False
    grips: int = 0
    throws: int = 0
    hand_path: float = 0.0
    body_path: float = 0.0
    frames: int = 0
    scores: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def score(self) -> float:
        """The last score."""
        return float(self.scores[-1, 1]) if len(self.scores) else 0.0

    @property
    def precision(self) -> float:
        """Score a grip; NaN if nothing was gripped."""
        return self.score / self.grips if self.grips else math.nan


class TrialMeter:
    """Measures a trial: `after` each frame, then `trial`. It is `over` once the goal is reached and has held."""

    def __init__(self, trial: Trial, goal: float | None):
        self.over = False
        self._trial, self._goal = trial, math.nan if goal is None else float(goal)
        self._trial.started = datetime.now(UTC).isoformat(timespec="seconds")
        self._time, self._reached = 0.0, math.nan
        self._hands: list[np.ndarray] = []
        self._held: list[bool] = []
        self._centroids: list[np.ndarray] = []
        self._settings: set[str] = set()
        self._scores: list[tuple[float, float]] = []

    def after(self, frame: Frame, world: WorldView) -> None:
        """Take account of a frame, after the world's step."""
        trial, dt = self._trial, 0.0 if world.paused else frame.dt
        self._time += dt
        trial.frames += 1
        trial.setting = world.interaction
        self._follow_hands(frame, dt)
        self._follow_bodies(world)
        score = float(world.score)
        if not self._scores or self._scores[-1][1] != score:
            self._scores.append((self._time, score))
        if not score >= self._goal:  # also if the goal is NaN
            self._reached = math.nan
        elif math.isnan(self._reached):
            self._reached = self._time
        self.over = self._time - self._reached >= GOAL_HOLD

    def _follow_hands(self, frame: Frame, dt: float) -> None:
        hands = [np.asarray(hand.position, np.float64) for hand in frame.hands]
        if len(hands) == len(self._hands):
            moved = [float(np.linalg.norm(b - a)) for a, b in zip(self._hands, hands, strict=True)]
            self._trial.hand_path += sum(d for d in moved if d <= HAND_SPEED_MAX * dt)
        self._hands = hands

    def _follow_bodies(self, world: WorldView) -> None:
        trial, bodies = self._trial, world.bodies()
        if len(bodies) == len(self._held):  # otherwise one was added or removed
            for before, at, body in zip(self._held, self._centroids, bodies, strict=True):
                if body.held and not before:
                    trial.grips += 1
                    trial.first_grip = self._time if trial.grips == 1 else trial.first_grip
                elif before and not body.held and np.linalg.norm(body.velocity) >= THROW_SPEED:
                    trial.throws += 1
                if body.held:
                    self._settings.add(world.interaction)
                if body.held and before:
                    trial.body_path += float(np.linalg.norm(body.centroid - at))
        self._held, self._centroids = [b.held for b in bodies], [b.centroid for b in bodies]

    def trial(self) -> Trial:
        """The trial up to now."""
        t = self._trial
        t.completed = not math.isnan(self._reached)
        t.seconds, t.goal = self._reached if t.completed else self._time, self._goal
        t.scores = np.array(self._scores, np.float64).reshape(-1, 2)
        if self._settings:
            t.setting = MIXED if len(self._settings) > 1 else next(iter(self._settings))
        return t
