"""Sound of a play: the impacts of each frame, heard from where the camera is; the sound track of a film."""

from __future__ import annotations

import shutil
import subprocess
import sys
import wave
from pathlib import Path
from threading import Thread

import numpy as np

from assets.file_access import atomic_write
from core.camera import Camera
from core.errors import BadInput
from display.preferences import Preferences
from display.protocol import Frame
from display.sound.body_sound import RATE, Impacts, body_modes, waveform
from display.sound.mixer import AudioDevice, Mixer
from display.user_commands import SetSound, last_of

LOUDNESS = 0.5  # of a blow of 1 m/s by MASS at DISTANCE
MASS, DISTANCE = 0.2, 1.0  # [kg], [m]
LOUDEST = 1.5
NEAREST = 0.3  # [m]: nothing is louder because it is nearer
PAN = 0.8  # of a sound straight from the side, which the other ear hears too


class Sound:
    """Listens to a world `after` each frame of a play; `close` ends the sound and finishes that of the film.

    film        that gets a sound track; None: there is no film
    heard       whether to open the loudspeakers, in a thread of its own: it takes some tenths of a second
    asked       whether the user asked for sound: then an error says why there is none
    preferences remember whether the user has switched it off
    """

    def __init__(self, *, film: Path | None, heard: bool, asked: bool, preferences: Preferences):
        self._impacts, self._mixer, self._preferences = Impacts(), Mixer(), preferences
        self._track = None if film is None else SoundTrack(film, always=asked)
        self._device: AudioDevice | None = None
        self._on = asked or bool(preferences.get("sound", bool, True))
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
        """Play the impacts of the frame."""
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
    """Gains (left, right) of a sound at a point [m]: equal power in all directions, inverse to the distance."""
    if not cameras:
        return 0.7, 0.7
    eyes = np.mean([c.world_to_camera for c in cameras], axis=0)
    x, y, z = eyes[:3, :3] @ point + eyes[:3, 3]
    distance = max(float(np.sqrt(x * x + y * y + z * z)), NEAREST)
    angle = 0.25 * np.pi * (1 + PAN * float(np.clip(x / distance, -1, 1)))
    near = DISTANCE / distance
    return float(np.cos(angle)) * near, float(np.sin(angle)) * near


BLOCK = 4096  # samples mixed at once


class SoundTrack:
    """Collects sounds (`add`) and muxes them into a film (`write`).

    always  write a WAV beside the film if there is no ffmpeg
    """

    def __init__(self, film: Path, *, always: bool):
        self.film, self._always, self._length = Path(film), always, 0.0
        self._sounds: list[tuple[float, np.ndarray, tuple[float, float]]] = []

    def add(self, time: float, sound: np.ndarray, gain: tuple[float, float]) -> None:
        """Start a sound at a time of the film [s]."""
        self._sounds.append((time, sound, gain))

    def last(self, time: float) -> None:
        """Note that the film reaches up to `time` [s]."""
        self._length = time

    def samples(self) -> np.ndarray:
        """The whole track (N, 2) float32, as long as the film."""
        mixer, count, blocks = Mixer(), round(self._length * RATE), []
        waiting = sorted(self._sounds, key=lambda s: s[0])
        for start in range(0, count, BLOCK):
            while waiting and waiting[0][0] * RATE < start + BLOCK:
                time, sound, gain = waiting.pop(0)
                mixer.play(sound, gain, delay=max(round(time * RATE) - start, 0))
            blocks.append(mixer.mix(min(BLOCK, count - start)))
        return np.concatenate(blocks) if blocks else np.zeros((0, 2), np.float32)

    def write(self) -> None:
        """Mux the track into the film, if the film is complete and there are sounds."""
        ffmpeg = shutil.which("ffmpeg")
        if not (self._sounds and self.film.is_file()) or (ffmpeg is None and not self._always):
            return
        track = self.film.with_suffix(".wav")
        if ffmpeg is None:
            with atomic_write(track) as beside:
                write_wav(beside, self.samples())
            print(f"{track}: the sound of {self.film.name}; there is no ffmpeg to join them", file=sys.stderr)
            return
        part = self.film.with_name(f".{self.film.stem}.sound.wav")
        try:
            write_wav(part, self.samples())
            with atomic_write(self.film) as beside:
                inputs = ["-i", str(self.film), "-i", str(part), "-c:v", "copy", "-c:a", "aac", "-b:a", "160k"]
                command = [ffmpeg, "-v", "error", "-y", *inputs, "-f", "mp4", str(beside)]
                subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL)
        except (subprocess.CalledProcessError, OSError) as e:
            print(f"{self.film}: stays without sound (ffmpeg: {last_line(e)})", file=sys.stderr)
        finally:
            part.unlink(missing_ok=True)


def last_line(error: Exception) -> str:
    """The last line of ffmpeg, or the system's reason."""
    said = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip().splitlines()
    return said[-1] if said else str(error)


def write_wav(path: Path, samples: np.ndarray) -> None:
    """Write samples (N, 2) within -1..1 as a WAV of 16 bits."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(2)
        file.setframerate(RATE)
        file.writeframes((samples * 32767).astype("<i2").tobytes())
