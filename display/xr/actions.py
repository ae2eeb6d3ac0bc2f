"""The session's action set: controller input of any make, and haptics.

The names of the interaction profiles and of their inputs are those of the OpenXR specification (chapter "Interaction
profiles").
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

import numpy as np

from display.xr.hand_joints import HandJoints
from display.xr.poses import matrix_of

SIDES = ("left", "right")
PRESS_ABOVE, RELEASE_BELOW = 0.6, 0.4  # of an analog input: two levels, so that a trembling finger does not flicker
IDLE_BELOW = 0.15  # of an analog input: less may be a finger's weight
FINGER_LENGTH, FINGER_RADIUS = 0.09, 0.009  # [m] of the finger that a controller stretches out to poke with
ACTIONS = {  # name: (kind of XrActionType, name that the runtime shows)
    "grip": ("POSE_INPUT", "Hand"),
    "aim": ("POSE_INPUT", "Pointing"),
    "grab": ("FLOAT_INPUT", "Grab"),
    "pinch": ("FLOAT_INPUT", "Pinch"),
    "stick": ("VECTOR2F_INPUT", "Turn and go"),
    "upper": ("BOOLEAN_INPUT", "Interaction (left), undo (right)"),
    "lower": ("BOOLEAN_INPUT", "Panel (left), redo (right)"),
    "point": ("BOOLEAN_INPUT", "Stretch out a finger"),
    "haptic": ("VIBRATION_OUTPUT", "Touch"),
}
EVERY_PROFILE = {"grip": "input/grip/pose", "aim": "input/aim/pose", "haptic": "output/haptic"}
ANALOG = {"grab": "input/squeeze/value", "pinch": "input/trigger/value", "stick": "input/thumbstick"}
CLICKS = {"grab": "input/squeeze/click", "pinch": "input/trigger/value", "upper": "input/menu/click"}
TOUCH = {**ANALOG, "point": "input/trigger/touch"}
PROFILES = {  # action: input of both hands, or (left, right)
    "oculus/touch_controller": {
        **TOUCH,
        "upper": ("input/y/click", "input/b/click"),
        "lower": ("input/x/click", "input/a/click"),
    },
    "valve/index_controller": {**TOUCH, "upper": "input/b/click", "lower": "input/a/click"},
    "htc/vive_controller": {**CLICKS, "stick": "input/trackpad"},
    "microsoft/motion_controller": {**CLICKS, "stick": "input/thumbstick"},
    "khr/simple_controller": {"grab": "input/select/click", "upper": "input/menu/click"},
}


@dataclass
class Controller:
    """State of a hand's controller in a frame. Poses (4, 4) in the play space, None while they are not tracked.

    A bare hand counts as a controller as well (display/xr/hand_tracking.py); then it has `joints`.
    """

    grip: np.ndarray | None = None
    aim: np.ndarray | None = None
    grab: float = 0.0
    pinch: float = 0.0
    stick: tuple[float, float] = (0.0, 0.0)
    pressed: set[str] = field(default_factory=set)  # buttons that went down since the last frame
    point: bool = False  # a finger lies on the trigger
    joints: HandJoints | None = None

    @property
    def used(self) -> bool:
        """True if the user does more with it than hold it."""
        return max(self.grab, self.pinch) > IDLE_BELOW or np.hypot(*self.stick) > IDLE_BELOW or bool(self.pressed)

    @property
    def pointer(self) -> np.ndarray:
        """The aim pose, or the grip pose while that one is not tracked, (4, 4)."""
        return self.grip if self.aim is None else self.aim

    def finger(self, extension: float = 1.0) -> np.ndarray:
        """Tip (3,) of the finger that the controller stretches out by `extension`, 0 to 1, in the play space."""
        return self.grip[:3, 3] - extension * FINGER_LENGTH * self.pointer[:3, 2]


class ActionSet:
    """The action set of a session; attached once, as the specification wants it."""

    def __init__(self, runtime, session):
        self.xr = xr = runtime.xr
        self.session = session
        self._hands = [runtime.path(f"/user/hand/{side}") for side in SIDES]
        info = xr.ActionSetCreateInfo(action_set_name="play", localized_action_set_name="Play", priority=0)
        self._set = xr.create_action_set(runtime.instance, info)
        self._actions = {name: self._create(name, *about) for name, about in ACTIONS.items()}
        for profile, inputs in PROFILES.items():
            self._suggest(runtime, profile, {**EVERY_PROFILE, **inputs})
        sets = (xr.ActionSet * 1)(self._set)
        xr.attach_session_action_sets(session, xr.SessionActionSetsAttachInfo(count_action_sets=1, action_sets=sets))
        self._grip_spaces, self._aim_spaces = self._spaces("grip"), self._spaces("aim")

    def _create(self, name: str, kind: str, localized_name: str):
        xr = self.xr
        info = xr.ActionCreateInfo(
            action_type=xr.ActionType[kind],
            action_name=name,
            localized_action_name=localized_name,
            count_subaction_paths=2,
            subaction_paths=(xr.Path * 2)(*self._hands),
        )
        return xr.create_action(self._set, info)

    def _spaces(self, name: str) -> list:
        xr, action = self.xr, self._actions[name]
        infos = [xr.ActionSpaceCreateInfo(action=action, subaction_path=hand) for hand in self._hands]
        return [xr.create_action_space(self.session, info) for info in infos]

    def _suggest(self, runtime, profile: str, inputs: dict) -> None:
        """Suggest bindings for one make of controller; a runtime that does not know it keeps to the others."""
        xr, bindings = self.xr, []
        for name, inputs_of in inputs.items():
            for side, at in zip(SIDES, (inputs_of,) * 2 if isinstance(inputs_of, str) else inputs_of, strict=True):
                path = runtime.path(f"/user/hand/{side}/{at}")
                bindings.append(xr.ActionSuggestedBinding(self._actions[name], path))
        suggestion = xr.InteractionProfileSuggestedBinding(
            interaction_profile=runtime.path(f"/interaction_profiles/{profile}"),
            count_suggested_bindings=len(bindings),
            suggested_bindings=(xr.ActionSuggestedBinding * len(bindings))(*bindings),
        )
        with contextlib.suppress(xr.PathUnsupportedError):
            xr.suggest_interaction_profile_bindings(runtime.instance, suggestion)

    def read(self, space, time: int) -> list[Controller]:
        """Both controllers at `time` [XrTime], their poses in `space`. At rest while another program has the input."""
        xr = self.xr
        active = (xr.ActiveActionSet * 1)(xr.ActiveActionSet(self._set, xr.NULL_PATH))
        try:
            xr.sync_actions(self.session, xr.ActionsSyncInfo(count_active_action_sets=1, active_action_sets=active))
        except xr.SessionNotFocused:
            return [Controller(), Controller()]
        return [self._controller(h, space, time) for h in (0, 1)]

    def _controller(self, h: int, space, time: int) -> Controller:
        xr, session = self.xr, self.session

        def of(name: str):
            return xr.ActionStateGetInfo(action=self._actions[name], subaction_path=self._hands[h])

        stick = xr.get_action_state_vector2f(session, of("stick")).current_state
        buttons = {name: xr.get_action_state_boolean(session, of(name)) for name in ("upper", "lower")}
        return Controller(
            grip=self._pose(self._grip_spaces[h], space, time),
            aim=self._pose(self._aim_spaces[h], space, time),
            grab=float(xr.get_action_state_float(session, of("grab")).current_state),
            pinch=float(xr.get_action_state_float(session, of("pinch")).current_state),
            stick=(float(stick.x), float(stick.y)),
            pressed={name for name, s in buttons.items() if s.current_state and s.changed_since_last_sync},
            point=bool(xr.get_action_state_boolean(session, of("point")).current_state),
        )

    def _pose(self, of, space, time: int) -> np.ndarray | None:
        xr, flags = self.xr, self.xr.SpaceLocationFlags
        location = xr.locate_space(of, space, time)
        both = flags.ORIENTATION_VALID_BIT | flags.POSITION_VALID_BIT
        return matrix_of(location.pose) if location.location_flags & both == both else None

    def pulse(self, h: int, strength: float, seconds: float) -> None:
        """Vibrate the left (0) or right (1) controller with a strength of 0 to 1."""
        xr = self.xr
        vibration = xr.HapticVibration(
            duration=int(seconds * 1e9), frequency=xr.FREQUENCY_UNSPECIFIED, amplitude=float(np.clip(strength, 0, 1))
        )
        info = xr.HapticActionInfo(action=self._actions["haptic"], subaction_path=self._hands[h])
        with contextlib.suppress(xr.SessionNotFocused):  # nothing is felt while another program has the input
            xr.apply_haptic_feedback(self.session, info, vibration)
