"""Sound: onsets of a known bounce, silence of what rests and rolls, spectra of materials, mixing, the film's track."""

import shutil
import subprocess
import sys
import threading
import wave
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as N

import numpy as np
import pytest

from core.camera import look_at, perspective
from core.material import MATERIALS
from core.vocabulary import BodyState
from display.headless.video import Video
from display.preferences import Preferences
from display.protocol import Frame
from display.sound import (
    LOUD,
    RATE,
    VOICES,
    AudioDevice,
    Impacts,
    Mixer,
    Sound,
    SoundTrack,
    body_modes,
    heard_from,
    waveform,
)
from display.user_commands import Reset, SetSound

G = (0.0, -9.81, 0.0)
BRICK = np.array([0.075, 0.025, 0.025])


def state(velocity, **changes) -> BodyState:
    box = {"low": np.zeros(3), "high": np.full(3, 0.1), "axis": np.array([0.0, 1.0, 0.0])}
    body = BodyState("ball", np.zeros(3), np.array(velocity, float), held=False, **box)
    return replace(body, **changes)


def bounce(height: float, restitution: float, seconds: float, dts) -> tuple[list[float], list[float], np.ndarray]:
    """Times of impact of a ball dropped from `height` [m], and times and speeds (F,) at the end of frames of `dts`."""
    impacts, begin, speed = [], 0.0, 0.0
    rows, time = [], 0.0
    next_hit = np.sqrt(2 * height / 9.81)
    for dt in dts:
        time += dt
        while time >= next_hit and next_hit < seconds:
            impacts.append(next_hit)
            speed = restitution * (9.81 * (next_hit - begin) - speed)
            begin = next_hit
            next_hit += 2 * speed / 9.81
        rows.append((time, speed - 9.81 * (time - begin)))
    return impacts, *np.array(rows).T


@pytest.mark.parametrize("dt", [1 / 90, 1 / 60, 1 / 25])
def test_each_bounce_of_a_ball_is_heard_in_its_frame(dt):
    hits, times, speeds = bounce(1.0, 0.7, 1.9, [dt] * round(2 / dt))
    listener, heard = Impacts(), []
    for time, v in zip(times, speeds, strict=True):
        heard += [(time, speed) for _, speed in listener.detect([state((0.0, v, 0.0))], dt, G)]
    assert len(heard) == len(hits) == 4
    for (time, _), hit in zip(heard, hits, strict=True):
        assert 0 <= time - hit < dt + 1e-9
    expected = np.sqrt(2 * 9.81) * 0.7 ** np.arange(4)
    assert np.allclose([speed for _, speed in heard], expected, atol=9.81 * dt + 0.05)


def test_a_soft_landing_over_some_frames_is_one_blow():
    listener = Impacts()
    speeds = [-2.0, -2.1, -1.4, -0.5, 0.3, 0.6, 0.5, 0.3, 0.1]
    heard = [listener.detect([state((0, v, 0))], 1 / 60, G) for v in speeds]
    assert [bool(h) for h in heard] == [False, False, True, *[False] * 6]


@pytest.mark.parametrize("dt", [1 / 90, 1 / 20])
def test_what_rests_rolls_slides_sways_or_is_held_is_silent(dt):
    rng, listener = np.random.default_rng(0), Impacts()
    for k in range(100):
        bodies = [
            state((0, 0, 0)),
            state((1.0, 0, 0)),  # rolls
            state((1.0 - 0.5 * 9.81 * dt * min(k, 1 / dt / 5), 0, 0)),  # slides and slows down
            state((0, 0.1 * np.sin(20 * k * dt), 0)),  # sways on the spot
            state(rng.normal(size=3), held=True),
            state(rng.normal(size=3), driven=True),
        ]
        assert listener.detect(bodies, dt, G) == []


def test_a_resting_body_that_is_hit_is_heard():
    listener = Impacts()
    listener.detect([state((0, 0, 0))], 1 / 60, G)
    assert [k for k, _ in listener.detect([state((1.5, 0, 0))], 1 / 60, G)] == [0]


def spectrum(sound: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    padded = np.concatenate([sound, np.zeros(RATE)])
    return np.fft.rfftfreq(len(padded), 1 / RATE), np.abs(np.fft.rfft(padded))


def test_a_wooden_brick_knocks_with_its_modes():
    """The lowest lies at c / 2L; all go as sqrt(E / rho) / L."""
    wood = MATERIALS["wood"]
    lowest = 0.5 * np.sqrt(wood.young / wood.density) / 0.075
    frequency, power = spectrum(waveform(body_modes(BRICK, wood)))
    near = (frequency > 0.9 * lowest) & (frequency < 1.1 * lowest)
    assert frequency[near][power[near].argmax()] == pytest.approx(lowest, rel=0.01)
    first = [body_modes(s * BRICK, replace(wood, young=e * wood.young)).frequency[0] for s, e in ((2, 1), (1, 4))]
    assert first == pytest.approx([lowest / 2, 2 * lowest])


def test_plush_thuds_and_wood_knocks():
    plush, wood = (waveform(body_modes(np.full(3, 0.1), MATERIALS[name])) for name in ("plush", "wood"))
    centre = [float((f * p**2).sum() / (p**2).sum()) for f, p in (spectrum(plush), spectrum(wood))]
    assert centre[0] < 250 < 600 < centre[1]
    assert np.abs(plush).max() < 0.5 * np.abs(wood).max()  # and softly


@pytest.mark.parametrize("name", MATERIALS)
def test_no_sound_clicks(name):
    """It begins and ends at nothing, and no step between two samples is larger than its frequencies ask for."""
    modes = body_modes(np.array([0.2, 0.1, 0.15]), MATERIALS[name])
    sound = waveform(modes)
    assert sound[0] == 0 and abs(sound[-1]) < 1e-3 and np.isfinite(sound).all()
    steepest = 2 * np.pi * modes.frequency.max() / RATE * 2 * np.abs(sound).max()
    assert np.abs(np.diff(sound)).max() < steepest


def test_the_mixer_adds_in_blocks_as_in_one_piece_and_limits():
    sound = (0.2 * np.sin(np.arange(1000) / 9)).astype(np.float32)
    whole, pieces = Mixer(), Mixer()
    for mixer in (whole, pieces):
        mixer.play(sound, (1.0, 0.5))
        mixer.play(sound, (0.0, 1.0), delay=333)
    expected = whole.mix(1500)
    assert np.array_equal(np.concatenate([pieces.mix(n) for n in (100, 233, 7, 660, 500)]), expected)
    assert np.allclose(expected[:333], sound[:333, None] * [1.0, 0.5]) and not expected[1333:].any()
    for _ in range(2 * VOICES):
        whole.play(np.full(100, 0.5, np.float32), (1.0, 1.0))
    assert LOUD < np.abs(whole.mix(100)).max() <= 1


def test_what_is_quiet_is_played_as_it_is_and_what_is_loud_is_bent_towards_1():
    """The twin: x up to 0.6, and 0.6 + 0.4 tanh((x - 0.6) / 0.4) from there on, without a step or a kink."""
    mixer, x = Mixer(), np.linspace(-4, 4, 8001).astype(np.float32)
    mixer.play(x, (1.0, 0.1))
    loud, quiet = mixer.mix(len(x)).T.astype(float)
    over = np.maximum(np.abs(x.astype(float)) - 0.6, 0.0)
    assert np.allclose(loud, np.sign(x) * (np.minimum(np.abs(x), 0.6) + 0.4 * np.tanh(over / 0.4)), atol=1e-6)
    assert np.allclose(quiet, 0.1 * x, atol=1e-6)


def test_32_voices_sound_at_once_and_the_oldest_give_way():
    mixer = Mixer()
    for k in range(40):
        mixer.play(np.full(10, 0.5 if k < 8 else 0.01, np.float32), (1.0, 1.0))
    assert np.allclose(mixer.mix(10), 0.32, atol=1e-6)


def test_loudness_goes_with_speed_and_mass_and_falls_with_the_distance():
    """0.5 of a blow of 1 m/s by 200 g a metre away, as the square root of the mass (energy), at most 1.5; equal power
    in all directions, and of a sound from the side the far ear hears the sine of a tenth of a right angle."""
    world, blows = Bouncing(), []
    with Sound(film=Path("none.mp4"), heard=False, asked=False, preferences=Preferences()) as sound:
        sound._track.add = lambda time, waveform, gain: blows.append((time, *gain))
        for frame in world.frames():
            sound.after(frame, world)
        first, *rest = np.linalg.norm(np.array(blows)[:, 1:], axis=1)
    far = float(np.hypot(1.0, 0.05))  # the middle of the body's box
    density, volume = MATERIALS["wood"].density, 0.0005
    speeds = np.sqrt(2 * 9.81) * 0.7 ** np.arange(4)
    assert np.allclose([first, *rest], np.minimum(0.5 * speeds * np.sqrt(density * volume / 0.2), 1.5) / far, rtol=0.1)
    camera = perspective(320, 180, 0.9, look_at((0, 0, 1), (0, 0, 0)))
    for at in np.random.default_rng(0).normal(size=(50, 3)):
        assert np.hypot(*heard_from([camera], at)) == pytest.approx(1 / max(np.linalg.norm(at - [0, 0, 1]), 0.3))
    left, right = heard_from([camera], np.array([1.0, 0.0, 1.0]))
    assert (left, right) == pytest.approx((np.sin(np.pi / 20), np.cos(np.pi / 20)))


def test_a_sound_comes_from_where_it_is():
    camera = perspective(320, 180, 0.9, look_at((0, 0, 1), (0, 0, 0)))
    (left, right), middle = heard_from([camera], np.array([0.9, 0, 0])), heard_from([camera], np.zeros(3))
    assert right > 2 * left and middle[0] == pytest.approx(middle[1])
    assert heard_from([camera], np.array([0, 0, -1.0])) == pytest.approx(tuple(m / 2 for m in middle))


class Bouncing:
    """A world of one ball that is dropped from a metre."""

    gravity, sound, time = G, None, 0.0
    cameras = [perspective(320, 180, 0.9, look_at((0, 0, 1), (0, 0, 0)))]

    def __init__(self):
        self.hits, self._times, self._speeds = bounce(1.0, 0.7, 1.9, [1 / 60] * 120)
        self._velocity = (0.0, 0.0, 0.0)

    def frames(self):
        for time, v in zip(self._times.tolist(), self._speeds, strict=True):
            self.time, self._velocity = time, (0.0, v, 0.0)
            yield Frame(1 / 60, time, [])

    def bodies(self):
        return [state(self._velocity)]

    def material(self, body):
        return MATERIALS["wood"], "wood"

    def rest_size(self, body):
        return np.full(3, 0.1), 0.0005


def onsets(track: np.ndarray) -> np.ndarray:
    """Times [s] at which the loudness rises out of what sounded before."""
    window = RATE // 100
    loud = np.abs(track).max(axis=1)
    loud = loud[: len(loud) // window * window].reshape(-1, window).max(axis=1)
    rises = (loud[1:] > 0.02) & (loud[1:] > 3 * loud[:-1])
    return (np.flatnonzero(rises) + 1) * window / RATE


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
def test_a_film_gets_its_bounces_at_their_times(tmp_path):
    world, film = Bouncing(), tmp_path / "ball.mp4"
    with Sound(film=film, heard=False, asked=False, preferences=Preferences()) as sound:
        video = Video(film, 32, 24, fps=60)
        for frame in world.frames():
            video.write(np.zeros((24, 32, 3), np.uint8))
            sound.after(frame, world)
        video.close()
    wav = tmp_path / "ball.wav"
    subprocess.run(["ffmpeg", "-v", "error", "-i", film, wav], check=True)
    with wave.open(str(wav)) as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, 2) / 32768
        assert file.getframerate() == RATE and len(samples) / RATE == pytest.approx(2.0, abs=0.1)
    assert onsets(samples) == pytest.approx(world.hits, abs=0.04)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ball.mp4", "ball.wav"]


def test_without_ffmpeg_a_wav_lies_beside_the_film_if_sound_was_asked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    film = tmp_path / "ball.mp4"
    film.write_bytes(b"film")
    for always in (False, True):
        track = SoundTrack(film, always=always)
        track.add(0.1, np.full(100, 0.3, np.float32), (1.0, 1.0))
        track.length = 0.2
        track.write()
        assert (tmp_path / "ball.wav").exists() == always
    assert capsys.readouterr().err.count("ball.wav: the sound of ball.mp4") == 1


def test_a_reset_and_an_edit_are_silent():
    world = Bouncing()
    with Sound(film=None, heard=False, asked=False, preferences=Preferences()) as sound:
        sound._track = N(add=lambda *what: pytest.fail("heard"), write=lambda: None)
        for frame in world.frames():
            sound.after(replace(frame, commands=[Reset()]), world)


def test_without_a_device_only_who_asked_is_told(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "miniaudio", None)
    for asked in (False, True):
        with Sound(film=None, heard=True, asked=asked, preferences=Preferences()) as sound:
            sound._opening.join()
            world = Bouncing()
            sound.after(Frame(1 / 60, 1 / 60, []), world)
            assert world.sound is None
    assert capsys.readouterr().err.count("no sound: the package miniaudio is not installed") == 1


def test_a_device_plays_from_a_thread_of_its_own_until_it_is_switched_off(tmp_path):
    miniaudio = pytest.importorskip("miniaudio")
    played, threads = threading.Event(), set()

    def mix(count):
        threads.add(threading.get_ident())
        played.set()
        return np.zeros((count, 2), np.float32)

    device = AudioDevice(mix, backends=[miniaudio.Backend.NULL])
    assert played.wait(10) and threading.get_ident() not in threads
    device.close()
    preferences = Preferences(tmp_path / "settings.json")
    with Sound(film=None, heard=False, asked=False, preferences=preferences) as sound:
        sound._device, world = N(close=lambda: None), Bouncing()
        sound.after(Frame(1 / 60, 1 / 60, [], commands=[SetSound(False)]), world)
    assert world.sound is False and Preferences(tmp_path / "settings.json").get("sound", True) is False
