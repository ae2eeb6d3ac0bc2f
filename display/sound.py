"""Blows to bodies, and their sound.

A blow is found in the velocities of the bodies. Its sound is that of the modes of the body and of what it falls on,
as an impulse excites them (modal synthesis).
"""

from __future__ import annotations

import contextlib
import ctypes
import shutil
import subprocess
import sys
import wave
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

import numpy as np

from assets.file_access import atomic_write
from core.camera import Camera
from core.errors import BadInput
from core.material import Material
from core.vocabulary import BodyState
from display.preferences import Preferences
from display.protocol import Closing, Frame
from display.user_commands import SetSound, last_of

RATE = 48_000  # [1/s] samples
MODES = 12  # the lowest of a body
HIGHEST = 16_000.0  # [Hz] that is synthesised
LOSS_MODULUS, LOSS_MAX = 2e6, 0.5  # [Pa]; eta = LOSS_MODULUS / E: in woods and polymers loss falls as stiffness grows
USUAL_DAMPING = 2.0  # [1/s], the damping of a Material to which these losses belong
RIGID_YOUNG = 1e8  # [Pa] of a rigid body, of which no stiffness is known: wood's here
BOARD = np.array([96.0, 157.0, 243.0, 361.0, 518.0])  # [Hz] of a table top or floor, what things fall on
BOARD_LOSS, BOARD_SHARE = 0.08, 0.4  # how loud it is beside the body
AUDIBLE_FROM = 120.0  # [Hz]: things of this size radiate less below
LENGTH_MAX, FADE = 0.8, 0.005  # [s]


@dataclass(frozen=True)
class Modes:
    """Modes: frequencies [Hz], decay rates [1/s] and amplitudes, each (K,); `attack` [s] is half the contact's time."""

    frequency: np.ndarray
    decay: np.ndarray
    amplitude: np.ndarray
    attack: float


def body_modes(extents: np.ndarray, material: Material, *, rigid: bool = False) -> Modes:
    """Modes that a blow to a body excites.

    f = c/2 |(i/a, j/b, k/c)| of a free block of extents a, b, c [m], c = sqrt(E / rho): they go as sqrt(E/rho)/L.
    The contact lasts for half a swing of the body as a spring with its mass, T = pi L / c; above 1/T it excites less.
    """
    young = RIGID_YOUNG if rigid else material.young
    speed = np.sqrt(young / material.density)
    orders = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)[1:]
    own = np.sort(0.5 * speed * np.linalg.norm(orders / np.maximum(extents, 1e-3), axis=1))[:MODES]
    loss = min(LOSS_MODULUS / young * material.damping / USUAL_DAMPING, LOSS_MAX)
    frequency = np.concatenate([own, BOARD])
    decay = np.pi * frequency * np.concatenate([np.full(len(own), loss), np.full(len(BOARD), BOARD_LOSS)])
    time = np.pi * float(np.max(extents)) / speed
    amplitude = 1 / (1 + 2 * frequency * time)
    amplitude *= frequency**2 / (frequency**2 + AUDIBLE_FROM**2)
    amplitude[: len(own)] /= np.sqrt(np.arange(1, len(own) + 1))
    amplitude[len(own) :] *= BOARD_SHARE
    heard = frequency < HIGHEST
    return Modes(frequency[heard], decay[heard], amplitude[heard], float(np.clip(0.5 * time, 0.0005, 0.02)))


def waveform(modes: Modes) -> np.ndarray:
    """Sound (N,) float32 of a blow of unit loudness: sum a e^(-d t) sin(2 pi f t), faded in and out.

    The peak is the square root of the sum of the modes: this compresses the range of loudness, as ears do.
    """
    length = min(LENGTH_MAX, 7.0 / max(float(modes.decay.min()), 1e-3))
    t = np.arange(int(RATE * length)) / RATE
    swing = np.exp(-np.outer(modes.decay, t)) * np.sin(2 * np.pi * np.outer(modes.frequency, t))
    sound = modes.amplitude @ swing
    rise = np.clip(t / modes.attack, 0, 1)
    sound *= 0.5 - 0.5 * np.cos(np.pi * rise)
    sound *= np.clip((length - t) / FADE, 0, 1)
    return (sound / np.sqrt(max(float(np.abs(sound).max()), 1e-9))).astype(np.float32)


SPEED_MIN = 0.2  # [m/s] of a fall from 2 mm: slower blows, and the shaking of soft bodies, are not heard
SUPPORT = 2.0  # times gravity's push in a frame: what a body that rests, rolls or sways gets from the ground
FORGET = 0.08  # [s] after a blow, which lasts for some frames where bodies are soft, until a lesser one is heard


class Impacts:
    """`detect` once a frame. Held bodies and those moved by the program make no sound."""

    def __init__(self):
        self.forget()

    def forget(self) -> None:
        """Forget the last frame: bodies were moved by something other than the simulation."""
        self._velocity: np.ndarray | None = None  # (B, 3) [m/s] of the last frame
        self._free = self._heard = np.empty(0)  # (B,) not held then; speed [m/s] that was heard and still rings

    def detect(self, bodies: Sequence[BodyState], dt: float, gravity: Sequence[float]) -> list[tuple[int, float]]:
        """Index of each body that was struck in the frame of `dt` [s], and the speed [m/s] of the blow.

        Contacts have changed the velocity by dv - g dt, along n. A body that hits something had been moving against n
        with the speed that counts; one that is hit was not, and the change itself counts, less what bears its weight. A
        change that is no larger than that is none.
        """
        velocity = np.array([b.velocity for b in bodies]).reshape(-1, 3)
        free = np.array([not (b.held or b.driven) for b in bodies], bool)
        before, was_free, heard = self._velocity, self._free, self._heard
        self._velocity, self._free = velocity, free
        if before is None or len(before) != len(velocity) or dt <= 0.0:
            self._heard = np.zeros(len(velocity))
            return []
        fall = dt * np.asarray(gravity)
        change = velocity - before - fall
        size = np.linalg.norm(change, axis=1)
        closing = -np.einsum("bi,bi->b", before, change) / np.maximum(size, 1e-9)
        beyond = size - SUPPORT * np.linalg.norm(fall)
        speed = np.where(closing > SPEED_MIN, closing, beyond)
        heard = np.where(beyond > 0, heard, heard * np.exp(-dt / FORGET))
        struck = free & was_free & (beyond > 0) & (speed > SPEED_MIN) & (speed > heard) & np.isfinite(speed)
        self._heard = np.where(struck, speed, heard)
        return [(int(k), float(speed[k])) for k in np.flatnonzero(struck)]


VOICES = 32  # at once; more make the oldest end
LOUD = 0.6  # from which on peaks are bent, towards 1


@dataclass
class Voice:
    """A sound (N,) that is played with a gain (2,), left and right; `at` is the next sample, negative: a delay."""

    sound: np.ndarray
    gain: np.ndarray
    at: int = 0


class Mixer:
    """`play` puts a voice into a queue (appending to a deque is atomic); `mix` takes it from there."""

    def __init__(self):
        self._queue: deque[Voice] = deque()
        self._voices: list[Voice] = []

    def play(self, sound: np.ndarray, gain: tuple[float, float], *, delay: int = 0) -> None:
        """Start a sound with the next block, or `delay` samples later."""
        self._queue.append(Voice(sound, np.asarray(gain, np.float32), -delay))

    def mix(self, count: int) -> np.ndarray:
        """The next samples (count, 2) float32, within -1..1."""
        while self._queue:
            self._voices.append(self._queue.popleft())
        del self._voices[:-VOICES]
        out = np.zeros((count, 2), np.float32)
        for voice in self._voices:
            first = max(-voice.at, 0)
            piece = voice.sound[max(voice.at, 0) : max(voice.at + count, 0)]
            out[first : first + len(piece)] += piece[:, None] * voice.gain
            voice.at += count
        self._voices = [v for v in self._voices if v.at < len(v.sound)]
        return limited(out)


def limited(x: np.ndarray) -> np.ndarray:
    """Soft clipping: samples above LOUD are compressed smoothly towards 1."""
    over = np.maximum(np.abs(x) - LOUD, 0.0)
    return np.where(over > 0, np.sign(x) * (LOUD + (1 - LOUD) * np.tanh(over / (1 - LOUD))), x).astype(np.float32)


SILENT = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p)(
    lambda *message: None
)  # a handler of ALSA's errors, which must outlive it
BUFFER = 40  # [ms]: less would break off while the program holds Python's lock; an impact is heard that much later


class AudioDevice:
    """Plays what `mix` (count -> (count, 2) float32) gives, in a thread of its own, until `close`.

    `backends` of miniaudio; None: those of the platform. Raises BadInput without the package or a device.
    """

    def __init__(self, mix: Callable[[int], np.ndarray], backends: Sequence | None = None):
        try:
            import miniaudio
        except ImportError as e:
            raise BadInput("no sound: the package miniaudio is not installed (pip install miniaudio)") from e
        real = [b for b in miniaudio.Backend if b is not miniaudio.Backend.NULL]
        with contextlib.suppress(OSError, AttributeError):  # ALSA would print that there is no device
            ctypes.CDLL("libasound.so.2").snd_lib_error_set_handler(SILENT)
        try:
            self._device = miniaudio.PlaybackDevice(
                output_format=miniaudio.SampleFormat.FLOAT32,
                nchannels=2,
                sample_rate=RATE,
                buffersize_msec=BUFFER,
                backends=list(backends or real),
            )
            blocks = blocks_of(mix)
            next(blocks)
            self._device.start(blocks)
        except miniaudio.MiniaudioError as e:
            raise BadInput("no sound: there is no audio device") from e

    def close(self) -> None:
        """Stop playing. Further calls do nothing."""
        self._device.close()


def blocks_of(mix: Callable[[int], np.ndarray]) -> Iterator[bytes]:
    """Generator for miniaudio: it is sent the number of samples, and yields their bytes."""
    count = yield b""
    while True:
        count = yield mix(count).tobytes()


LOUDNESS = 0.5  # of a blow of 1 m/s by MASS at DISTANCE
MASS, DISTANCE = 0.2, 1.0  # [kg], [m]
LOUDEST = 1.5
NEAREST = 0.3  # [m]: nothing is louder because it is nearer
PAN = 0.8  # of a sound straight from the side, which the other ear hears too


class Sound(Closing):
    """Listens to a world `after` each frame of a play.

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

    def close(self) -> None:
        """Stop playing, and finish the sound of the film."""
        if self._opening is not None:
            self._opening.join()
        if self._device is not None:
            self._device.close()
        if self._track is not None:
            self._track.write()

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
            self._track.length = frame.time
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
    """Collects sounds (`add`) and muxes them into a film (`write`), which is `length` [s] long.

    always  write a WAV beside the film if there is no ffmpeg
    """

    def __init__(self, film: Path, *, always: bool):
        self.film, self._always, self.length = Path(film), always, 0.0
        self._sounds: list[tuple[float, np.ndarray, tuple[float, float]]] = []

    def add(self, time: float, sound: np.ndarray, gain: tuple[float, float]) -> None:
        """Start a sound at a time of the film [s]."""
        self._sounds.append((time, sound, gain))

    def samples(self) -> np.ndarray:
        """The whole track (N, 2) float32, as long as the film."""
        mixer, count, blocks = Mixer(), round(self.length * RATE), []
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
