"""The player in the play space: hands from controllers, turning, going, and what the hands feel."""

from __future__ import annotations

import numpy as np

from display.protocol import Command, Redo, SetInteraction, Undo
from display.xr import avatar as shown
from display.xr import finger_poke as poking
from display.xr.actions import LET_GO, PRESS, Controller
from display.xr.poses import Standpoint, position_rotation
from display.xr.teleport import Teleport, on_the_floor
from scenes.scene import Hand, Scene
from sim.hands.grasp import FORCE

GRAB_REACH, PINCH_REACH = 0.05, 0.02  # [m] of a fist, of finger and thumb
TURN = np.pi / 6  # [rad] of a step to the side: smooth turns make many people sick
PUSHED, CENTERED = 0.7, 0.3  # of the stick's way
TAP = (0.6, 0.02)  # strength and [s] of the tap with which a hand takes hold
PULL = (0.8, 0.02)  # strength at the hand's full force, and [s] of each pulse while something pulls at it
TOUCH = 8.0  # [N] of a finger that feel like FORCE of a fist
CONTACT = 0.05  # [N] from which on a finger touches, in the mean of some frames
CALM = 0.5  # share of a frame's force in that mean: contact trembles from substep to substep
LEAST = 0.03  # strength below which nothing is felt anyway


class Player:
    """Where the player stands, what both hands do. `advance` gives them once a frame, `feel` answers."""

    def __init__(self, scene: Scene):
        self.standpoint = Standpoint.of(scene)
        self._grips = [False, False]
        self._places: list[np.ndarray | None] = [None, None]  # in the play space, as last tracked
        self._reach = [GRAB_REACH, GRAB_REACH]
        self._by_tip = [False, False]
        self._seen = [Controller(), Controller()]
        self._pokes = [poking.FingerPoke(), poking.FingerPoke()]
        self._touch: list[tuple] = [(), ()]
        self._pushed, self._stride = False, Teleport()
        self.pointing: tuple[np.ndarray, np.ndarray] | None = None  # a ray in the world from (3,) to a spot (3,) [m]
        self._took, self._felt = [False, False], [0.0, 0.0]

    def advance(self, controllers: list[Controller], head: np.ndarray, world) -> tuple[list[Hand], list[Command]]:
        """Hands in the world, and commands for it (which may be None yet). `head` (4, 4) is in the play space. A
        controller that is not tracked leaves its hand where it was, holding what it holds."""
        stage, hands = self.standpoint.matrix, []
        controllers = [self._stride.lead(controllers[0], stage, world), controllers[1]]
        for h, c in enumerate(controllers):
            self._touch[h] = ()
            if c.grip is not None:
                self._grip(h, c)
                tip = self._pokes[h].stretch(c, self._grips[h])
                self._places[h] = poking.moved(c.grip, tip) if self._grips[h] and self._by_tip[h] else c.grip
                self._touch[h] = poking.touches(stage, self._pokes[h].pieces(c))
            if self._places[h] is not None:
                position, rotation = position_rotation(stage @ self._places[h])
                hands.append(Hand(position, rotation, self._grips[h], self._reach[h], self._touch[h]))
            else:
                hands.append(Hand())
        self._walk(controllers, head)
        return hands, self._buttons(*controllers, world) if world is not None else []

    def parts(self, controllers: list[Controller]) -> np.ndarray:
        """Where what the player sees of himself is in the world (display/xr/avatar.py). A side that is lost, but
        holds something, stays in view."""
        result = shown.hidden()
        for h, c in enumerate(controllers):
            if c.grip is not None or not self._grips[h]:
                self._seen[h] = c
            shown.side_of(result, h, self._seen[h], self.standpoint.matrix, self._pokes[h].out)
        if self.pointing is not None:
            shown.pointing(result, *self.pointing, floor=True)
        return result

    def _buttons(self, left: Controller, right: Controller, world) -> list[Command]:
        commands = []
        if "upper" in left.pressed:
            commands.append(SetInteraction("transform" if world.interaction == "physics" else "physics"))
        if "upper" in right.pressed:
            commands.append(Undo())
        if "lower" in right.pressed:
            commands.append(Redo())
        return commands

    def _grip(self, h: int, c: Controller) -> None:
        level = max(c.grab, c.pinch)
        gripped = level > (LET_GO if self._grips[h] else PRESS)
        if gripped and not self._grips[h]:
            self._by_tip[h] = c.pinch > c.grab
            self._reach[h] = PINCH_REACH if self._by_tip[h] else GRAB_REACH
        self._grips[h] = gripped

    def _walk(self, controllers: list[Controller], head: np.ndarray) -> None:
        """Sideways on a stick turns by a step. Forward shows where that hand points on the floor, and let go of, goes
        there; drawn back instead, it does not."""
        stage = self.standpoint.matrix
        place = (stage @ head)[:3, 3]
        pushed = next((c for c in controllers if np.hypot(*c.stick) > (CENTERED if self._pushed else PUSHED)), None)
        if pushed is None:
            if self.pointing is not None:
                self.standpoint.go(self.pointing[1], place)
            self._pushed, self.pointing = False, None
            return
        x, y = pushed.stick
        if not self._pushed and abs(x) > abs(y):
            self.standpoint.turn(-np.sign(x) * TURN, place)
        elif (self.pointing is not None or not self._pushed) and y > -CENTERED and pushed.aim is not None:
            aim = stage @ pushed.aim
            spot = on_the_floor(aim)
            self.pointing = None if spot is None else (aim[:3, 3], spot)
        else:
            self.pointing = None
        self._pushed = True

    def feel(self, world, actions) -> None:
        """A tap where a hand has just taken hold or touched, the pull of what it holds, the push of what it touches."""
        forces, touches = world.hand_forces(), world.touch_forces()
        for h in (0, 1):
            force, touch = strength_of(forces, h), strength_of(touches, h)
            holds = self._grips[h] and force > 0.0
            before = self._felt[h]
            self._felt[h] += CALM * (touch - before)
            begins = self._felt[h] > CONTACT >= before
            level = max(force / FORCE if holds else 0.0, min(self._felt[h] / TOUCH, 1.0)) * PULL[0]
            if (holds and not self._took[h]) or begins:
                actions.pulse(h, *TAP)
            elif level > LEAST:
                actions.pulse(h, level, PULL[1])
            self._took[h] = holds


def strength_of(forces: list[np.ndarray], h: int) -> float:
    """Of hand h's force [N], 0 if there is none."""
    return float(np.linalg.norm(forces[h])) if h < len(forces) else 0.0
