"""The player in the play space: hands from controllers, turning, going, and what the hands feel."""

from __future__ import annotations

import numpy as np

from display.headset.actions import LET_GO, PRESS, Controller
from display.headset.poses import Standpoint, position_rotation
from scenes.scene import Hand, Scene
from sim.hands import FORCE

GRAB_REACH, PINCH_REACH = 0.05, 0.02  # [m] of a fist, of finger and thumb
TURN = np.pi / 6  # [rad] of a step to the side: smooth turns make many people sick
PUSHED, CENTERED = 0.7, 0.3  # of the stick's way
FARTHEST = 6.0  # [m] to go at once
TAP = (0.6, 0.02)  # strength and [s] of the tap with which a hand takes hold
PULL = (0.8, 0.02)  # strength at the hand's full force, and [s] of each pulse while something pulls at it
LEAST = 0.03  # strength below which nothing is felt anyway


class Player:
    """Where the player stands, what both hands do. `advance` gives them once a frame, `feel` answers."""

    def __init__(self, scene: Scene):
        self.standpoint = Standpoint.before(scene.eye, scene.target)
        self._grips = [False, False]
        self._places: list[np.ndarray | None] = [None, None]  # in the play space, as last tracked
        self._reach = [GRAB_REACH, GRAB_REACH]
        self._pushed = False
        self._took = [False, False]

    def advance(self, controllers: list[Controller], head: np.ndarray, world) -> tuple[list[Hand], dict]:
        """Hands in the world, and commands for it (which may be None yet). `head` (4, 4) is in the play space. A
        controller that is not tracked leaves its hand where it was, holding what it holds."""
        stage, hands = self.standpoint.matrix, []
        for h, c in enumerate(controllers):
            if c.grip is not None:
                self._places[h] = c.grip
                self._grip(h, c)
            if self._places[h] is not None:
                position, rotation = position_rotation(stage @ self._places[h])
                hands.append(Hand(position, rotation, self._grips[h], self._reach[h]))
            else:
                hands.append(Hand())
        self._walk(controllers, head)
        return hands, self._buttons(*controllers, world) if world is not None else {}

    def _buttons(self, left: Controller, right: Controller, world) -> dict:
        commands = {}
        if "upper" in left.pressed:
            commands["interaction"] = "transform" if world.interaction == "physics" else "physics"
        if "upper" in right.pressed:
            commands["undo"] = True
        if "lower" in right.pressed:
            commands["redo"] = True
        return commands

    def _grip(self, h: int, c: Controller) -> None:
        level = max(c.grab, c.pinch)
        gripped = level > (LET_GO if self._grips[h] else PRESS)
        if gripped and not self._grips[h]:
            self._reach[h] = GRAB_REACH if c.grab >= c.pinch else PINCH_REACH
        self._grips[h] = gripped

    def _walk(self, controllers: list[Controller], head: np.ndarray) -> None:
        """Sideways on a stick turns by a step; forward goes to where that hand points on the floor."""
        pushed = next((c for c in controllers if np.hypot(*c.stick) > (CENTERED if self._pushed else PUSHED)), None)
        if pushed is None or self._pushed:
            self._pushed = pushed is not None
            return
        self._pushed = True
        x, y = pushed.stick
        stage = self.standpoint.matrix
        place = (stage @ head)[:3, 3]
        if abs(x) > abs(y):
            self.standpoint.turn(-np.sign(x) * TURN, place)
        elif y > 0 and pushed.aim is not None:
            spot = on_the_floor(stage @ pushed.aim)
            if spot is not None:
                self.standpoint.go(spot, place)

    def feel(self, world, actions) -> None:
        """A tap where a hand has just taken hold, and the pull of what it holds."""
        forces = world.hand_forces()
        for h in (0, 1):
            force = float(np.linalg.norm(forces[h])) if h < len(forces) else 0.0
            holds = self._grips[h] and force > 0.0
            if holds and not self._took[h]:
                actions.pulse(h, *TAP)
            elif holds and PULL[0] * force / FORCE > LEAST:
                actions.pulse(h, PULL[0] * force / FORCE, PULL[1])
            self._took[h] = holds


def on_the_floor(aim: np.ndarray) -> np.ndarray | None:
    """Where a pointing hand (4, 4) meets y = 0 [m], no farther than FARTHEST; None if it points up."""
    start, way = aim[:3, 3], -aim[:3, 2]
    if way[1] >= -1e-3 or start[1] <= 0:
        return None
    spot = start - way * (start[1] / way[1])
    aside = spot - start
    length = np.hypot(aside[0], aside[2])
    return start + aside * min(1.0, FARTHEST / max(length, 1e-9))
