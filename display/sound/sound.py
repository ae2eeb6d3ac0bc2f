"""Sound of a play: after each frame, the impacts that are in it are heard from where the camera is."""

from __future__ import annotations

import sys
from pathlib import Path
from threading import Thread

import numpy as np

from core.camera import Camera
from core.errors import BadInput
from display.preferences import Preferences
from display.protocol import Frame
from display.sound.audio_device import AudioDevice
from display.sound.body_sound import body_modes, waveform
from display.sound.impacts import Impacts
from display.sound.mixer import Mixer
from display.sound.sound_track import SoundTrack
from display.user_commands import SetSound, last_of

LOUDNESS = 0.5  # of a blow of 1 m/s by MASS at DISTANCE
MASS, DISTANCE = 0.2, 1.0  # [kg], [m]
LOUDEST = 1.5
NEAREST = 0.3  # [m]: nothing is louder because it is nearer
PAN = 0.8  # of a sound straight from the side, which the other ear hears too


class Sound:
    """Listens to a world `after` each frame of a play; `close` ends the sound and finishes that of the film.

    film        of which a sound track is made; None: of none
    heard       open the loudspeakers, which takes a thread of its own some tenths of a second
    asked       the user asked for sound: what is missing is told
    preferences remember whether the user has switched it off
    """

    def __init__(self, *, film: Path | None, heard: bool, asked: bool, preferences: Preferences):
        self._impacts, self._mixer, self._preferences = Impacts(), Mixer(), preferences
        self._track = None if film is None else SoundTrack(film, always=asked)
        self._device: AudioDevice | None = None
        self._on = asked or bool(preferences.get("sound", True))
        self._asked, self._time = asked, 0.0
        self._sounds: dict[int, tuple[np.ndarray, float]] = {}  # of bodies: waveform, mass [kg]
        self._opening = Thread(target=self._open, daemon=True) if heard else None
        if self._opening is not None:
            self._opening.start()

    def __enter__(self) -> Sound:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def close(self) -> None:
        """End the sound; join the track to the film."""
        if self._opening is not None:
            self._opening.join()
        if self._device is not None:
            self._device.close()
            self._device = None
        if self._track is not None:
            self._track.write()
            self._track = None

    def _open(self) -> None:
        try:
            self._device = AudioDevice(self._mixer.mix)
        except BadInput as e:
            if self._asked:
                print(f"vrgs: {e}", file=sys.stderr, flush=True)

    def after(self, frame: Frame, world) -> None:
        """Let what was struck in the frame be heard."""
        switch = last_of(SetSound, frame.commands)
        if switch is not None:
            self._on = switch.on
            self._preferences.set("sound", switch.on)
        world.sound = None if self._device is None else self._on
        passed, self._time = world.time - self._time, world.time
        if self._track is not None:
            self._track.last(frame.time)
        if frame.commands or passed <= 0.0:  # an edit moves bodies too; a reset sets time back
            self._impacts.forget()
            self._sounds.clear()
        if passed <= 0.0 or not (world.sound or self._track):
            return
        for body, speed in self._impacts.detect(world.bodies(), passed, world.gravity):
            sound, mass = self._sound_of(world, body)
            state = world.bodies()[body]
            gain = heard_from(world.cameras, 0.5 * (state.low + state.high))
            gain = tuple(min(LOUDNESS * speed * (mass / MASS) ** 0.5, LOUDEST) * g for g in gain)
            if world.sound:
                self._mixer.play(sound, gain)
            if self._track is not None:
                self._track.add(frame.time, sound, gain)

    def _sound_of(self, world, body: int) -> tuple[np.ndarray, float]:
        """Waveform and mass [kg] of a body, synthesised at its first blow."""
        if body not in self._sounds:
            extents, volume = world.rest_size(body)
            material, name = world.material(body)
            modes = body_modes(extents, material, rigid=name == "rigid")
            self._sounds[body] = waveform(modes), material.density * volume
        return self._sounds[body]


def heard_from(cameras: list[Camera], point: np.ndarray) -> tuple[float, float]:
    """Gains, left and right, of a sound at a point [m]: of equal power in all directions, falling with distance."""
    if not cameras:
        return 0.7, 0.7
    eyes = np.mean([c.world_to_camera for c in cameras], axis=0)
    x, y, z = eyes[:3, :3] @ point + eyes[:3, 3]
    distance = max(float(np.sqrt(x * x + y * y + z * z)), NEAREST)
    angle = 0.25 * np.pi * (1 + PAN * float(np.clip(x / distance, -1, 1)))
    near = DISTANCE / distance
    return float(np.cos(angle)) * near, float(np.sin(angle)) * near
