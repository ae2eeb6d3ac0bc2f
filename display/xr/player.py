"""The player in the play space: hands from controllers, finger poke, snap turn, teleport, and haptics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from core.vocabulary import BodyState, Hand, Touch
from display.protocol import WorldView
from display.user_commands import Command, Redo, SetInteraction, Undo
from display.xr import avatar
from display.xr.actions import FINGER_RADIUS, PRESS_ABOVE, RELEASE_BELOW, ActionSet, Controller
from display.xr.poses import PlaySpace, interpolate_pose, pose_matrix, position_rotation
from scenes.scene import Scene
from sim.hands.grasp import MAX_HAND_FORCE

GRAB_RADIUS, PINCH_RADIUS = 0.05, 0.02  # [m] within which a fist, and finger and thumb, take hold
SNAP_TURN = np.pi / 6  # [rad] of a step to the side: smooth turns make many people sick
STICK_PUSHED, STICK_CENTRED = 0.7, 0.3  # deflection of the stick
MAX_TELEPORT = 6.0  # [m]
PINCH_MARGIN = 0.05  # [m] from a body's bounds within which a pinch may be meant for it
MIN_AIM_DOWN = 0.12  # sine of the angle below the horizon above which a hand points at the floor, and not just ahead
POKE_ABOVE = 0.1  # of the trigger
POKE_RATE = 1 / 6  # of its length in a frame: at full length at once, it would be inside near bodies
TAP_STRENGTH, TAP_SECONDS = 0.6, 0.02  # of the tap with which a hand takes hold
PULL_STRENGTH, PULL_SECONDS = 0.8, 0.02  # at the hand's full force; of each pulse while something pulls at it
TOUCH_FORCE = 8.0  # [N] of a finger that feel like MAX_HAND_FORCE of a fist
CONTACT_FORCE = 0.05  # [N], mean of some frames, above which a finger touches
TOUCH_SMOOTHING = 0.5  # weight of a frame's force in that mean: contact forces jitter from substep to substep
MIN_STRENGTH = 0.03  # below which nothing is felt anyway
LEAD_SPEED, LEAD_TURN_RATE = 2.0, 2 * np.pi  # [m/s], [rad/s] at which a hand moves to where tracking found it
MAX_LEAD_TIME = 0.5  # [s]
MAX_HAND_JUMP = 1.0  # [m] in a frame; faster than any arm, so the tracking was lost


class Player:
    """The player's place and hands. `advance` gives the hands once a frame, `feel` the haptics.

    `pointing` is the ray of a teleport in the world, from (3,) to a place on the floor (3,) [m], while it is aimed.
    """

    def __init__(self, scene: Scene):
        self.play_space, self._eye_height, self._floor = PlaySpace.of(scene), float(scene.eye[1]), scene.floor
        self.pointing: tuple[np.ndarray, np.ndarray] | None = None
        self._grips = [False, False]
        self._poses: list[np.ndarray | None] = [None, None]  # of the hands in the play space, as last tracked
        self._by_pinch = [False, False]
        self._shown = [Controller(), Controller()]
        self._pokes = [FingerPoke(), FingerPoke()]
        self._stick_pushed, self._teleport = False, PinchTeleport(scene.floor)
        self._held, self._touch_force = [False, False], [0.0, 0.0]

    def stand(self, *, on_floor: bool) -> None:
        """Put y = 0 of the play space on the floor, or, where a runtime without a floor has it at the head, as high as
        the scene's eye."""
        self.play_space.y = self._floor if on_floor else self._eye_height

    def advance(
        self, controllers: list[Controller], head: np.ndarray, world: WorldView
    ) -> tuple[list[Hand], list[Command]]:
        """Hands in the world, and commands. `head` (4, 4) is in the play space.

        A controller that is not tracked leaves its hand where it was, holding what it holds.
        """
        world_from_play, hands = self.play_space.world_from_play, []
        controllers = [self._teleport.apply(controllers[0], world_from_play, world), controllers[1]]
        for h, c in enumerate(controllers):
            touch = ()
            if c.grip is not None:
                self._update_grip(h, c)
                self._pokes[h].advance(c, self._grips[h])
                self._poses[h] = c.grip
                if self._grips[h] and self._by_pinch[h]:
                    self._poses[h] = pose_matrix(pinch_point(c), c.grip[:3, :3])
                touch = world_touches(world_from_play, self._pokes[h].capsules(c))
            if self._poses[h] is None:
                hands.append(Hand())
            else:
                pose = position_rotation(world_from_play @ self._poses[h])
                reach = PINCH_RADIUS if self._by_pinch[h] else GRAB_RADIUS
                hands.append(Hand(*pose, self._grips[h], reach, touch))
        self._walk(controllers, head)
        mode = "transform" if world.interaction == "physics" else "physics"
        left, right = (c.pressed for c in controllers)
        offered = [("upper" in left, SetInteraction(mode)), ("upper" in right, Undo()), ("lower" in right, Redo())]
        return hands, [command for pressed, command in offered if pressed]

    def prop_poses(self, controllers: list[Controller]) -> np.ndarray:
        """World poses of the player's avatar (display/xr/avatar.py).

        A side that is not tracked, but holds something, stays in view.
        """
        result = avatar.hidden()
        for h, c in enumerate(controllers):
            if c.grip is not None or not self._grips[h]:
                self._shown[h] = c
            avatar.show_hand(result, h, self._shown[h], self.play_space.world_from_play, self._pokes[h].extension)
        if self.pointing is not None:
            avatar.show_ray(result, *self.pointing)
        return result

    def _update_grip(self, h: int, c: Controller) -> None:
        gripped = max(c.grab, c.pinch) > (RELEASE_BELOW if self._grips[h] else PRESS_ABOVE)
        if gripped and not self._grips[h]:
            self._by_pinch[h] = c.pinch > c.grab
        self._grips[h] = gripped

    def _walk(self, controllers: list[Controller], head: np.ndarray) -> None:
        """Snap turn and teleport by the stick.

        Pushed sideways it turns by a step. Pushed forward it shows where that hand points on the floor, and released it
        goes there; drawn back instead, it does not.
        """
        world_from_play = self.play_space.world_from_play
        head_position = (world_from_play @ head)[:3, 3]
        threshold = STICK_CENTRED if self._stick_pushed else STICK_PUSHED
        pushed = next((c for c in controllers if np.hypot(*c.stick) > threshold), None)
        if pushed is None:
            if self.pointing is not None:
                self.play_space.move(self.pointing[1], head_position)
            self._stick_pushed, self.pointing = False, None
            return
        x, y = pushed.stick
        if not self._stick_pushed and abs(x) > abs(y):
            self.play_space.turn(-np.sign(x) * SNAP_TURN, head_position)
        elif (self.pointing is not None or not self._stick_pushed) and y > -STICK_CENTRED and pushed.aim is not None:
            aim = world_from_play @ pushed.aim
            target = floor_hit(aim, self._floor)
            self.pointing = None if target is None else (aim[:3, 3], target)
        else:
            self.pointing = None
        self._stick_pushed = True

    def feel(self, world: WorldView, actions: ActionSet) -> None:
        """Vibrate: a tap where a hand takes hold or touches, then in proportion to the force on it."""
        none = [np.zeros(3)] * 2
        pulls, pushes = [*world.hand_forces(), *none], [*world.touch_forces(), *none]
        for h in (0, 1):
            force, touch = float(np.linalg.norm(pulls[h])), float(np.linalg.norm(pushes[h]))
            holds, before = self._grips[h] and force > 0.0, self._touch_force[h]
            self._touch_force[h] += TOUCH_SMOOTHING * (touch - before)
            touched = self._touch_force[h] > CONTACT_FORCE >= before
            pull = force / MAX_HAND_FORCE if holds else 0.0
            level = PULL_STRENGTH * max(pull, min(self._touch_force[h] / TOUCH_FORCE, 1.0))
            if (holds and not self._held[h]) or touched:
                actions.pulse(h, TAP_STRENGTH, TAP_SECONDS)
            elif level > MIN_STRENGTH:
                actions.pulse(h, level, PULL_SECONDS)
            self._held[h] = holds


class FingerPoke:
    """The finger that a controller stretches out while its trigger is touched or half pulled, to push with.

    `extension` is its length, 0 to 1.
    """

    def __init__(self):
        self.extension = 0.0

    def advance(self, c: Controller, grips: bool) -> None:
        """Stretch or retract the finger by one frame."""
        wanted = c.joints is None and (c.point or c.pinch > POKE_ABOVE) and c.grab < PRESS_ABOVE and not grips
        self.extension = float(np.clip(self.extension + (POKE_RATE if wanted else -POKE_RATE), 0.0, 1.0))

    def capsules(self, c: Controller) -> np.ndarray:
        """Capsules that this hand touches with, (n, 7): two ends and radius [m] in the play space."""
        if c.joints is not None:
            return c.joints.bones()
        if self.extension == 0.0:
            return np.zeros((0, 7))
        return np.concatenate([c.grip[:3, 3], c.finger(self.extension), [FINGER_RADIUS]])[None]


def pinch_point(c: Controller) -> np.ndarray:
    """Point between finger and thumb, (3,) in the play space; of a controller, the end of its stretched finger."""
    return c.finger() if c.joints is None else c.joints.pinch_point()


def world_touches(world_from_play: np.ndarray, capsules: np.ndarray) -> tuple[Touch, ...]:
    """Capsules (n, 7) of the play space as the solver takes them, in the world."""
    R, t = world_from_play[:3, :3], world_from_play[:3, 3]
    starts, ends = capsules[:, :3] @ R.T + t, capsules[:, 3:6] @ R.T + t
    rows = zip(starts.tolist(), ends.tolist(), capsules[:, 6].tolist(), strict=True)
    return tuple(Touch(tuple(a), tuple(b), r) for a, b, r in rows)


class PinchTeleport:
    """Teleport of a bare left hand: it pinches at nothing, points at the floor, and opens to go there.

    Where a body is between finger and thumb, or within PINCH_MARGIN of them, the pinch is for that. Pointing anywhere
    but at the floor, or a hand that is lost, changes nothing. To turn, the player turns.
    """

    def __init__(self, floor: float = 0.0):
        self._floor = floor  # [m]
        self._pinches = self._aims = False

    def apply(self, c: Controller, world_from_play: np.ndarray, world: WorldView) -> Controller:
        """The controller that stands in for the hand: while it aims, its stick is pushed and it holds nothing."""
        if c.grip is None and self._aims:  # not tracked: it continues, but its direction is unknown
            return replace(c, stick=(0.0, 1.0))
        if c.joints is None:
            self._pinches = self._aims = False
            return c
        pinches = c.pinch > (RELEASE_BELOW if self._pinches else PRESS_ABOVE)
        began, self._pinches = pinches and not self._pinches, pinches
        if began:
            aim = world_from_play @ c.aim
            at_floor = floor_hit(aim, self._floor) is not None and aim[1, 2] > MIN_AIM_DOWN
            point = (world_from_play @ [*pinch_point(c), 1.0])[:3]
            self._aims = at_floor and not any(is_near(body, point) for body in world.bodies())
        self._aims = self._aims and pinches
        return replace(c, stick=(0.0, 1.0), pinch=0.0) if self._aims else c


def is_near(body: BodyState, point: np.ndarray) -> bool:
    """True if a point (3,) is at most PINCH_MARGIN from the bounds of a body."""
    outside = np.maximum(np.maximum(body.low - point, point - body.high), 0.0)
    return float(np.linalg.norm(outside)) <= PINCH_MARGIN


def floor_hit(aim: np.ndarray, floor: float = 0.0) -> np.ndarray | None:
    """Point (3,) [m] where a pointing hand (4, 4) meets the floor, no farther than MAX_TELEPORT; None if it points up.

    floor  its height [m]
    """
    start, direction = aim[:3, 3], -aim[:3, 2]
    if direction[1] >= -1e-3 or start[1] <= floor:
        return None
    hit = start - direction * ((start[1] - floor) / direction[1])
    offset = hit - start
    length = np.hypot(offset[0], offset[2])
    return start + offset * min(1.0, MAX_TELEPORT / max(length, 1e-9))


class PoseFilter:
    """Leads hands that are tracked again from where they were lost to where they are.

    While a controller is not tracked, or another program has the input, its hand stays where it was and holds what it
    holds. Found again somewhere else, or suddenly MAX_HAND_JUMP away, it is led there evenly within a moment, so that
    nothing it holds is flung: at LEAD_SPEED, within MAX_LEAD_TIME, however the hand moves on meanwhile.
    """

    def __init__(self):
        self._shown: list[np.ndarray | None] = [None, None]  # grip poses as they were given on
        self._remaining: list[float | None] = [0.0, 0.0]  # [s] until the hand is there; None while it is lost

    def apply(self, controllers: list[Controller], dt: float) -> list[Controller]:
        """The controllers; grip poses that were just found again are led there. `dt` [s] is the frame's."""
        return [replace(c, grip=self._lead(h, c.grip, dt)) for h, c in enumerate(controllers)]

    def _lead(self, h: int, found: np.ndarray | None, dt: float) -> np.ndarray | None:
        before = self._shown[h]
        if found is None:
            self._remaining[h] = None
            return None
        arrived = self._remaining[h] is not None and self._remaining[h] <= 0.0
        if before is not None and arrived and np.linalg.norm(found[:3, 3] - before[:3, 3]) > MAX_HAND_JUMP:
            self._remaining[h] = None
        if self._remaining[h] is None:
            self._remaining[h] = 0.0
            if before is not None:
                angle = Rotation.from_matrix(before[:3, :3].T @ found[:3, :3]).magnitude()
                distance = float(np.linalg.norm(found[:3, 3] - before[:3, 3]))
                self._remaining[h] = min(MAX_LEAD_TIME, max(distance / LEAD_SPEED, angle / LEAD_TURN_RATE))
        if before is not None and self._remaining[h] > 0.0:
            found = interpolate_pose(before, found, min(1.0, dt / self._remaining[h]))
            self._remaining[h] -= dt
        self._shown[h] = found
        return found
