"""Controllers: what the user does with them, whatever make they are, and what they let the user feel.

The names of the profiles and of their inputs are those of the OpenXR specification (chapter "Interaction profiles").
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

import numpy as np

from display.xr.poses import matrix_of

SIDES = ("left", "right")
PRESS, LET_GO = 0.6, 0.4  # of an analog input: two levels, so that a trembling finger does not flicker
IDLE = 0.15  # of an analog input: less may be a finger's weight
KINDS = {"grip": "POSE_INPUT", "aim": "POSE_INPUT", "grab": "FLOAT_INPUT", "pinch": "FLOAT_INPUT"}
KINDS |= {"stick": "VECTOR2F_INPUT", "upper": "BOOLEAN_INPUT", "lower": "BOOLEAN_INPUT", "feel": "VIBRATION_OUTPUT"}
KINDS |= {"point": "BOOLEAN_INPUT"}
NAMES = {
    "grip": "Hand",
    "aim": "Pointing",
    "grab": "Grab",
    "pinch": "Pinch",
    "stick": "Turn and go",
    "upper": "Interaction (left), undo (right)",
    "lower": "Panel (left), redo (right)",
    "feel": "Touch",
    "point": "Stretch out a finger",
}
POSES = {"grip": "input/grip/pose", "aim": "input/aim/pose", "feel": "output/haptic"}
ANALOG = {"grab": "input/squeeze/value", "pinch": "input/trigger/value", "stick": "input/thumbstick"}
PROFILES = {  # action: input of both hands, or (left, right)
    "oculus/touch_controller": {
        **ANALOG,
        "point": "input/trigger/touch",
        "upper": ("input/y/click", "input/b/click"),
        "lower": ("input/x/click", "input/a/click"),
    },
    "valve/index_controller": {
        **ANALOG,
        "point": "input/trigger/touch",
        "upper": "input/b/click",
        "lower": "input/a/click",
    },
    "htc/vive_controller": {
        "grab": "input/squeeze/click",
        "pinch": "input/trigger/value",
        "stick": "input/trackpad",
        "upper": "input/menu/click",
    },
    "microsoft/motion_controller": {
        "grab": "input/squeeze/click",
        "pinch": "input/trigger/value",
        "stick": "input/thumbstick",
        "upper": "input/menu/click",
    },
    "khr/simple_controller": {"grab": "input/select/click", "upper": "input/menu/click"},
}


@dataclass
class Controller:
    """A hand's controller in a frame. Poses (4, 4) in the play space, None while they are not tracked.

    A hand without a controller counts as one (display/xr/hand_tracking.py); then `fingers` (n, 7) are its bones,
    two ends and radius [m], and `tip` (3,) is where finger and thumb meet [m], in the play space.
    """

    grip: np.ndarray | None = None
    aim: np.ndarray | None = None
    grab: float = 0.0
    pinch: float = 0.0
    stick: tuple[float, float] = (0.0, 0.0)
    pressed: set[str] = field(default_factory=set)  # buttons that went down since the last frame
    point: bool = False  # a finger lies on the trigger
    fingers: np.ndarray | None = None
    tip: np.ndarray | None = None
    joints: object | None = None  # hand_tracking.Joints

    @property
    def used(self) -> bool:
        """Whether the user does anything with it but hold it."""
        return max(self.grab, self.pinch) > IDLE or np.hypot(*self.stick) > IDLE or bool(self.pressed)


class Actions:
    """The action set of a session; attached once, as the specification wants it."""

    def __init__(self, runtime, session):
        self.xr = xr = runtime.xr
        self.session = session
        self.hands = [runtime.path(f"/user/hand/{side}") for side in SIDES]
        create = xr.ActionSetCreateInfo(action_set_name="play", localized_action_set_name="Play", priority=0)
        self.set = xr.create_action_set(runtime.instance, create)
        self.actions = {name: self._action(name, kind) for name, kind in KINDS.items()}
        for profile, inputs in PROFILES.items():
            self._suggest(runtime, profile, {**POSES, **inputs})
        sets = (xr.ActionSet * 1)(self.set)
        xr.attach_session_action_sets(session, xr.SessionActionSetsAttachInfo(count_action_sets=1, action_sets=sets))
        self.spaces = {
            name: [
                xr.create_action_space(
                    session, xr.ActionSpaceCreateInfo(action=self.actions[name], subaction_path=hand)
                )
                for hand in self.hands
            ]
            for name in ("grip", "aim")
        }

    def _action(self, name: str, kind: str):
        xr = self.xr
        both = (xr.Path * 2)(*self.hands)
        return xr.create_action(
            self.set,
            xr.ActionCreateInfo(
                action_type=xr.ActionType[kind],
                action_name=name,
                localized_action_name=NAMES[name],
                count_subaction_paths=2,
                subaction_paths=both,
            ),
        )

    def _suggest(self, runtime, profile: str, inputs: dict) -> None:
        """What the actions are on this make of controller; a runtime that does not know it keeps to the others."""
        xr, bindings = self.xr, []
        for name, where in inputs.items():
            for side, at in zip(SIDES, (where, where) if isinstance(where, str) else where, strict=True):
                path = runtime.path(f"/user/hand/{side}/{at}")
                bindings.append(xr.ActionSuggestedBinding(self.actions[name], path))
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
        active = (xr.ActiveActionSet * 1)(xr.ActiveActionSet(self.set, xr.NULL_PATH))
        try:
            xr.sync_actions(self.session, xr.ActionsSyncInfo(count_active_action_sets=1, active_action_sets=active))
        except xr.SessionNotFocused:
            return [Controller(), Controller()]
        return [self._controller(h, space, time) for h in (0, 1)]

    def _controller(self, h: int, space, time: int) -> Controller:
        c = Controller()
        for name in ("grip", "aim"):
            setattr(c, name, self._pose(self.spaces[name][h], space, time))
        for name in ("grab", "pinch"):
            setattr(c, name, float(self._state("float", name, h).current_state))
        at = self._state("vector2f", "stick", h).current_state
        c.stick = (float(at.x), float(at.y))
        c.point = bool(self._state("boolean", "point", h).current_state)
        for name in ("upper", "lower"):
            state = self._state("boolean", name, h)
            if state.current_state and state.changed_since_last_sync:
                c.pressed.add(name)
        return c

    def _state(self, kind: str, name: str, h: int):
        xr = self.xr
        get = getattr(xr, f"get_action_state_{kind}")
        return get(self.session, xr.ActionStateGetInfo(action=self.actions[name], subaction_path=self.hands[h]))

    def _pose(self, of, space, time: int) -> np.ndarray | None:
        xr, flags = self.xr, self.xr.SpaceLocationFlags
        location = xr.locate_space(of, space, time)
        both = flags.ORIENTATION_VALID_BIT | flags.POSITION_VALID_BIT
        return matrix_of(location.pose) if location.location_flags & both == both else None

    def pulse(self, h: int, strength: float, seconds: float) -> None:
        """Let the left (0) or right (1) hand feel something, 0 to 1."""
        xr = self.xr
        vibration = xr.HapticVibration(
            duration=int(seconds * 1e9), frequency=xr.FREQUENCY_UNSPECIFIED, amplitude=float(np.clip(strength, 0, 1))
        )
        where = xr.HapticActionInfo(action=self.actions["feel"], subaction_path=self.hands[h])
        with contextlib.suppress(xr.SessionNotFocused):  # nothing is felt while another program has the hands
            xr.apply_haptic_feedback(self.session, where, vibration)
