"""Hands without controllers (XR_EXT_hand_tracking): trackers, gestures, choice of hand or controller on each side."""

from __future__ import annotations

import contextlib
import ctypes

import numpy as np

from core.rotation import matrices_from_quaternions
from display.xr.actions import SIDES, Controller
from display.xr.hand_joints import INDEX_TIP, JOINT_COUNT, PALM, THUMB_TIP, HandJoints
from display.xr.poses import pose_matrix

EXTENSION = "XR_EXT_hand_tracking"
PINCH_BELOW, PINCH_UNTIL = 0.015, 0.03  # [m] from thumb tip to index tip: a pinch begins, ends
FIST_ABOVE, FIST_UNTIL = np.radians(150.0), np.radians(105.0)  # a finger's bends; a fist has 220 degrees, rest 60
HANDOVER = 2.0  # [s] after the last use of a controller until a tracked hand takes over
LOST_TIMEOUT = 0.5  # [s] for a hand that was lost to come back before a controller takes over
LOCATION = np.dtype(
    [("flags", "<u8"), ("orientation", "<f4", 4), ("position", "<f4", 3), ("radius", "<f4")]
)  # XrHandJointLocationEXT


def joints_of(table: np.ndarray) -> HandJoints | None:
    """Joints of an array of XrHandJointLocationEXT; None if it holds no poses at all."""
    q, p, radius = (table[name].astype(np.float64) for name in ("orientation", "position", "radius"))
    length = np.linalg.norm(q, axis=1)
    if not (np.isfinite(p).all() and np.isfinite(radius).all() and (length > 0.1).all() and np.isfinite(length).all()):
        return None
    return HandJoints(p, matrices_from_quaternions(q[:, [3, 0, 1, 2]]), radius)


def supported(xr, instance, system) -> bool:
    """True if this headset tracks hands; the extension must be enabled."""
    answer = xr.SystemHandTrackingPropertiesEXT()
    properties = xr.SystemProperties()
    properties.next = ctypes.cast(ctypes.pointer(answer), ctypes.c_void_p)
    result = xr.check_result(xr.raw_functions.xrGetSystemProperties(instance, system, ctypes.byref(properties)))
    return not result.is_exception() and bool(answer.supports_hand_tracking)


class HandTrackers:
    """Both hands' XrHandTrackerEXT in a session; none where the runtime gives none, though it may have promised."""

    def __init__(self, runtime, session):
        self._runtime, self.xr, self._trackers = runtime, runtime.xr, []
        if runtime.tracks_hands:
            xr, joints = self.xr, self.xr.HandJointSetEXT.DEFAULT
            hands = [xr.HandEXT[side.upper()] for side in SIDES]
            infos = [xr.HandTrackerCreateInfoEXT(hand=hand, hand_joint_set=joints) for hand in hands]
            with contextlib.suppress(xr.exception.ResultException):
                self._trackers = [xr.create_hand_tracker_ext(session, info) for info in infos]

    def read(self, space, time: int) -> list[HandJoints | None]:
        """Both hands at `time` [XrTime] in `space`, None where one is not tracked."""
        return [self._joints(tracker, space, time) for tracker in self._trackers] or [None, None]

    def _joints(self, tracker, space, time: int) -> HandJoints | None:
        xr = self.xr
        locations = (xr.HandJointLocationEXT * JOINT_COUNT)()
        found = xr.HandJointLocationsEXT(joint_count=JOINT_COUNT, joint_locations=locations)
        info = xr.HandJointsLocateInfoEXT(base_space=space, time=time)
        self._runtime.call("xrLocateHandJointsEXT", tracker, ctypes.byref(info), ctypes.byref(found))
        both = int(xr.SpaceLocationFlags.ORIENTATION_VALID_BIT | xr.SpaceLocationFlags.POSITION_VALID_BIT)
        table = np.frombuffer(locations, LOCATION)
        return joints_of(table) if found.is_active and ((table["flags"] & both) == both).all() else None

    def close(self) -> None:
        """Destroy the trackers. Further calls do nothing."""
        for tracker in self._trackers:
            with contextlib.suppress(self.xr.exception.ResultException):  # they may have gone with their session
                self.xr.destroy_hand_tracker_ext(tracker)
        self._trackers = []


class HandGestures:
    """Gestures of one bare hand, frame by frame, as inputs of a controller: a fist grabs, finger and thumb pinch."""

    def __init__(self):
        self._gesture: str | None = None  # "grab" or "pinch"

    def read(self, joints: HandJoints | None) -> Controller:
        """The hand as a controller. A hand that is not tracked keeps its gesture."""
        if joints is None:
            return Controller()
        self._gesture = self._recognise(joints)
        centre = joints.position[PALM] if self._gesture == "grab" else joints.pinch_point()
        return Controller(
            grip=pose_matrix(centre, joints.rotation[PALM]),
            aim=joints.aim(),
            grab=float(self._gesture == "grab"),
            pinch=float(self._gesture == "pinch"),
            joints=joints,
        )

    def _recognise(self, joints: HandJoints) -> str | None:
        gap = float(np.linalg.norm(joints.position[THUMB_TIP] - joints.position[INDEX_TIP]))
        _, index, *others = joints.curls()
        bend = min(index, float(np.mean(others)))  # a hand that points with its index does not grab
        if self._gesture == "grab" and bend > FIST_UNTIL:
            return "grab"
        if self._gesture == "pinch" and gap < PINCH_UNTIL:
            return "pinch"
        if bend > FIST_ABOVE:
            return "grab"
        return "pinch" if gap < PINCH_BELOW else None


class InputSelector:
    """Choice between a controller and a bare hand on each side.

    Each side has a controller, a hand, or both: a runtime may see the hand that holds the controller, or make one up.
    The controller plays while it is used (its trigger, grip, stick or buttons) and HANDOVER seconds longer, and where
    no hand has been tracked for LOST_TIMEOUT seconds; else the hand does. A hand that is lost stays where it was, with
    what it holds.
    """

    def __init__(self):
        self._gestures = [HandGestures(), HandGestures()]
        self._controller_used, self._hand_seen = [-np.inf, -np.inf], [-np.inf, -np.inf]  # [s] last

    def choose(self, controllers: list[Controller], hands: list[HandJoints | None], time: float) -> list[Controller]:
        """The input of each side at `time` [s]."""
        chosen = []
        for h, (controller, joints) in enumerate(zip(controllers, hands, strict=True)):
            hand = self._gestures[h].read(joints)
            if controller.used:
                self._controller_used[h] = time
            if joints is not None:
                self._hand_seen[h] = time
            in_use = controller.grip is not None and time - self._controller_used[h] < HANDOVER
            lost = joints is None and time - self._hand_seen[h] > LOST_TIMEOUT
            chosen.append(controller if in_use or lost else hand)
        return chosen
