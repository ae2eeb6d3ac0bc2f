"""Hands without controllers: XR_EXT_hand_tracking where the runtime has it, and who plays if both are there.

Each side has a controller, a hand, or both: a runtime may see the hand that holds the controller, or make one up. The
controller plays while it is used (its trigger, grip, stick or buttons) and HANDOVER seconds longer, and where no hand
has been seen for PATIENCE seconds; else the hand does. A hand that is lost stays where it was, with what it holds.
"""

from __future__ import annotations

import contextlib
import ctypes

import numpy as np

from core.rotation import matrices_from_quaternions
from display.xr.actions import SIDES, Controller
from display.xr.hand_joints import COUNT, HandInput, Joints

LOCATION = np.dtype(
    [("flags", "<u8"), ("orientation", "<f4", 4), ("position", "<f4", 3), ("radius", "<f4")]
)  # XrHandJointLocationEXT
EXTENSION = "XR_EXT_hand_tracking"
HANDOVER = 2.0  # [s] after the last use of a controller
PATIENCE = 0.5  # [s] for a hand that was lost to come back


def joints_of(table: np.ndarray) -> Joints | None:
    """What an array of XrHandJointLocationEXT says; None if it is no pose at all."""
    q, p, radius = (table[name].astype(np.float64) for name in ("orientation", "position", "radius"))
    length = np.linalg.norm(q, axis=1, keepdims=True)
    if not (np.isfinite(p).all() and np.isfinite(radius).all() and (length > 0.1).all() and np.isfinite(length).all()):
        return None
    return Joints(p, matrices_from_quaternions(q[:, [3, 0, 1, 2]] / length), radius)


def supported(xr, instance, system) -> bool:
    """Whether this headset tracks hands; the extension must be enabled."""
    says = xr.SystemHandTrackingPropertiesEXT()
    properties = xr.SystemProperties()
    properties.next = ctypes.cast(ctypes.pointer(says), ctypes.c_void_p)
    result = xr.check_result(xr.raw_functions.xrGetSystemProperties(instance, system, ctypes.byref(properties)))
    return not result.is_exception() and bool(says.supports_hand_tracking)


class HandTracking:
    """Both hands' trackers in a session."""

    def __init__(self, runtime, session):
        self.xr = xr = runtime.xr
        address = xr.get_instance_proc_addr(runtime.instance, "xrLocateHandJointsEXT")
        self._locate = ctypes.cast(address, xr.PFN_xrLocateHandJointsEXT)
        self._trackers = []
        for side in SIDES:
            how = xr.HandTrackerCreateInfoEXT(hand=xr.HandEXT[side.upper()], hand_joint_set=xr.HandJointSetEXT.DEFAULT)
            self._trackers.append(xr.create_hand_tracker_ext(session, how))

    def read(self, space, time: int) -> list[Joints | None]:
        """Both hands at `time` [XrTime] in `space`, None where one is not seen."""
        return [self._joints(tracker, space, time) for tracker in self._trackers]

    def _joints(self, tracker, space, time: int) -> Joints | None:
        xr = self.xr
        places = (xr.HandJointLocationEXT * COUNT)()
        found = xr.HandJointLocationsEXT(joint_count=COUNT, joint_locations=places)
        when = xr.HandJointsLocateInfoEXT(base_space=space, time=time)
        result = xr.check_result(self._locate(tracker, ctypes.byref(when), ctypes.byref(found)))
        if result.is_exception():
            raise result
        both = int(xr.SpaceLocationFlags.ORIENTATION_VALID_BIT | xr.SpaceLocationFlags.POSITION_VALID_BIT)
        table = np.frombuffer(places, LOCATION)
        return joints_of(table) if found.is_active and ((table["flags"] & both) == both).all() else None

    def close(self) -> None:
        """Give the trackers back. Further calls do nothing."""
        for tracker in self._trackers:
            with contextlib.suppress(self.xr.exception.ResultException):  # they may have gone with their session
                self.xr.destroy_hand_tracker_ext(tracker)
        self._trackers = []


class Sides:
    """Who plays on each side, a controller or a hand."""

    def __init__(self):
        self._inputs = [HandInput(), HandInput()]
        self._used, self._seen = [-np.inf, -np.inf], [-np.inf, -np.inf]  # [s] a controller, a hand, last

    def choose(self, controllers: list[Controller], hands: list[Joints | None], time: float) -> list[Controller]:
        """What plays at `time` [s], by the rule above."""
        return [self._choose(h, c, joints, time) for h, (c, joints) in enumerate(zip(controllers, hands, strict=True))]

    def _choose(self, h: int, controller: Controller, joints: Joints | None, time: float) -> Controller:
        hand = self._inputs[h].read(joints)
        if controller.used:
            self._used[h] = time
        if joints is not None:
            self._seen[h] = time
        if controller.grip is not None and time - self._used[h] < HANDOVER:
            return controller
        lost = joints is None and time - self._seen[h] > PATIENCE
        return controller if lost else hand
