"""Settings that a play takes from the last one: the light of its scene, and the state that was saved last."""

from __future__ import annotations

from dataclasses import replace

from core.errors import BadInput
from core.typed import from_plain, to_plain
from core.vocabulary import Light
from display.preferences import Preferences
from display.protocol import Frame
from display.user_commands import LoadState, SetLight


class Remembered:
    """The memory of a scene: `given` adds to the commands of its frames, `keep` notes its light at the end.

    Without `light` that is none of its matters.
    """

    def __init__(self, preferences: Preferences, scene: str, *, light: bool):
        self._preferences, self._scene, self._lit, self._fresh = preferences, scene, light, light

    def given(self, frame: Frame, world) -> Frame:
        """The frame, with the remembered light in the first one, and with the path of the last state to be loaded."""
        commands = frame.commands
        if any(isinstance(c, LoadState) and not c.path for c in commands):
            last = self._preferences.get(f"state.{self._scene}", "")
            commands = [replace(c, path=c.path or last) if isinstance(c, LoadState) else c for c in commands]
        light = self._light() if self._fresh and world.light is not None else None
        self._fresh = False
        frame.commands = commands if light is None else [SetLight(light), *commands]
        return frame

    def _light(self) -> Light | None:
        stored = self._preferences.get(f"light.{self._scene}", {})
        try:
            light = from_plain(Light, stored, "light")
        except BadInput:
            return None
        sound = all(abs(x) < 1e3 for x in (*light.position, *light.target)) and light.position != light.target
        return light if sound else None

    def keep(self, world) -> None:
        """Note the light that the user has left, if it is not the scene's own."""
        own, now = world.scene.light, world.light
        if self._lit and now is not None:
            self._preferences.set(f"light.{self._scene}", None if now == own else to_plain(now))
