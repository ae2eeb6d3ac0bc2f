"""The display without a screen, and the video and picture it leaves behind."""

import contextlib
import shutil
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from assets import file_access
from core.camera import look_at, perspective
from core.errors import BadInput
from core.vocabulary import Hand
from display.headless.video import EYE_DISTANCE, FilmWriter, Headless
from display.picture import pixels_of, side_by_side
from display.protocol import Frame
from display.timing import Timings
from display.user_commands import SetInteraction
from tests.support.fake_view import FakeView
from tests.support.fake_world import FakeWorld, fake_scene

WIDTH, HEIGHT = 320, 180


def play(frames: int, *, film: Path | None = None, width=WIDTH, height=HEIGHT, views=1, stop_after=0, hands=None):
    """Run the ball's world on a headless display, and film it. Returns display, world, frames and pictures."""
    display = Headless(fake_scene(), width=width, height=height, frames=frames, views=views)
    world = FakeWorld(fake_scene(), width=width, height=height, views=views, hands=hands or (lambda time: []))
    seen, pictures = [], []
    with contextlib.ExitStack() as stack:
        writer = film and stack.enter_context(FilmWriter(film, width, height, views=views, seconds=frames / 60))
        for frame in display.frames(world):
            world.step(frame)
            pictures.append(pixels_of(world.picture)[..., :3].copy())
            display.present(world)
            seen.append(frame)
            if writer:
                writer.add(world, frame.time)
            if len(seen) == stop_after:
                raise KeyboardInterrupt
    return display, world, seen, pictures


def swipe(time: float) -> list[Hand]:
    """Grips the ball, pulls it to the right at 2 m/s, lets go after a quarter of a second."""
    return [Hand(position=(2.0 * min(time, 0.25), 0.0, 0.3), grip=time < 0.25)]


def decode(path: Path) -> list[np.ndarray]:
    capture = cv2.VideoCapture(str(path))
    pictures = []
    while True:
        ok, bgr = capture.read()
        if not ok:
            return pictures
        pictures.append(bgr[..., ::-1])


def test_frames_come_in_the_promised_number_at_sixty_a_second(ti_cpu):
    _, world, frames, _ = play(30, hands=swipe)
    assert len(frames) == 30 == world.steps
    assert all(f.dt == 1 / 60 for f in frames)
    assert frames[-1].time == pytest.approx(0.5)
    assert world.ball[0] == pytest.approx(2.0 * 0.5, rel=0.1)  # held, thrown, flying on
    assert world.score == 1
    cameras = {f.cameras[0].world_to_camera.tobytes() for f in frames}
    assert len(cameras) == 1 and frames[0].cameras[0].position.tolist() == [0, 0, 3]


def test_a_mode_that_the_script_changes_is_a_command_that_a_recording_keeps():
    class Scripted(FakeView):
        def scripted_hands(self, time):
            self.interaction = "physics" if time < 0.04 else "transform"
            return []

    world = Scripted(time=0.0, wanted_view=None, interaction="physics", timings=Timings())
    frames = list(Headless(fake_scene(), width=8, height=8, frames=4).frames(world))
    assert [f.commands for f in frames] == [[], [], [SetInteraction("transform")], []]


def test_the_film_plays_and_shows_every_second_picture(ti_cpu, tmp_path):
    path = tmp_path / "ball.mp4"
    _, _, _, pictures = play(40, film=path, hands=swipe)
    seen = decode(path)
    assert len(seen) == 20
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FPS) == pytest.approx(30)
    for k in (0, 6, 19):
        assert cv2.PSNR(seen[k], pictures[2 * k]) > 30, k  # a lossy codec on a smooth picture
    assert cv2.PSNR(seen[19], pictures[0]) < 25  # the ball has moved
    assert [p.name for p in tmp_path.iterdir()] == ["ball.mp4"]


def test_times_that_are_rounded_up_add_no_picture(ti_cpu, tmp_path):
    """(k / 60) * 30 is larger than k / 2 for some k, such as 250."""
    world = FakeWorld(fake_scene(), width=16, height=16)
    world.step(Frame(1 / 60, 0.0, [perspective(16, 16, 0.9, look_at((0, 0, 3), (0, 0, 0)))]))
    with FilmWriter(tmp_path / "a.mp4", 16, 16) as film:
        for k in range(1, 501):
            film.add(world, k * (1 / 60))
    assert len(decode(tmp_path / "a.mp4")) == 250


def test_odd_sizes_gain_a_row_and_a_column(ti_cpu, tmp_path):
    path = tmp_path / "odd.mp4"
    _, _, _, pictures = play(3, film=path, width=161, height=91)
    seen = decode(path)
    assert seen[0].shape == (92, 162, 3)
    assert cv2.PSNR(seen[0][:91, :161], pictures[0]) > 30


def test_two_views_are_two_eyes_side_by_side(ti_cpu, tmp_path):
    _, world, frames, _ = play(2, views=2, film=tmp_path / "pair.mp4")
    left, right = frames[0].cameras
    assert np.allclose(right.position - left.position, (EYE_DISTANCE, 0, 0))
    assert np.allclose((left.position + right.position) / 2, (0, 0, 3))
    image = side_by_side(pixels_of(world.picture)[..., :3], 2).astype(int)
    assert image.shape == (HEIGHT, 2 * WIDTH, 3) == decode(tmp_path / "pair.mp4")[0].shape
    red = image[..., 0] > 2 * image[..., 1]
    columns = [np.nonzero(half.any(0))[0].mean() for half in (red[:, :WIDTH], red[:, WIDTH:])]
    disparity = left.fx * EYE_DISTANCE / 3.0
    assert columns[0] - columns[1] == pytest.approx(disparity, abs=1.0)  # nearer things lie further right on the left


def test_a_play_that_breaks_off_keeps_its_film_which_browsers_play(ti_cpu, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        play(20, film=tmp_path / "a.mp4", stop_after=6)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
    assert len(decode(tmp_path / "a.mp4")) == 3
    with av.open(tmp_path / "a.mp4") as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")


@pytest.mark.parametrize(
    "name, message",
    [("nowhere/a.mp4", "cannot write here"), ("a.avi", "must end in .mp4"), ("folder.mp4", "is a folder")],
)
def test_bad_places_are_refused_before_the_first_frame(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(BadInput, match=message) as error:
        FilmWriter(name, WIDTH, HEIGHT)
    assert "\n" not in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.mp4"]
    with pytest.raises(BadInput, match="at least one"):
        Headless(fake_scene(), width=WIDTH, height=HEIGHT, frames=0)


def test_a_full_disk_is_noticed_before_the_first_frame(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(file_access.shutil, "disk_usage", lambda path: usage._replace(free=1_000_000))
    with pytest.raises(BadInput, match="the disk has 1 MB left, about 52 MB are needed"):
        FilmWriter(tmp_path / "a.mp4", 1920, 1080, seconds=500 / 30)
    assert list(tmp_path.iterdir()) == []
