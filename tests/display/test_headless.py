"""The display without a screen, and the video and picture it leaves behind."""

import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from assets import file_access
from core.errors import BadInput
from core.vocabulary import Hand
from display.headless.headless import EYE_DISTANCE, Headless
from display.headless.video import Video
from display.picture import pixels_of
from tests.support.fake_world import FakeWorld, fake_scene

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 320, 180


def play(
    frames: int,
    *,
    stop_after: int | None = None,
    width: int = WIDTH,
    height: int = HEIGHT,
    hands=lambda time: [],
    **options,
):
    """Run the ball's world on a headless display. Returns display, world, frames and pictures."""
    display = Headless(fake_scene(), width=width, height=height, frames=frames, **options)
    world = FakeWorld(fake_scene(), width=width, height=height, views=display.views, hands=hands)
    seen, pictures = [], []
    for frame in display.frames(world):
        world.step(frame)
        pictures.append(pixels_of(world.picture)[..., :3].copy())
        display.present(world)
        seen.append(frame)
        if len(seen) == stop_after:
            break
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


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2))


def test_frames_come_in_the_promised_number_at_sixty_a_second(ti_cpu):
    _, world, frames, _ = play(30, hands=swipe)
    assert len(frames) == 30 == world.steps
    assert all(f.dt == 1 / 60 for f in frames)
    assert frames[-1].time == pytest.approx(0.5)
    assert world.ball[0] == pytest.approx(2.0 * 0.5, rel=0.1)  # held, thrown, flying on
    assert world.score == 1
    cameras = {f.cameras[0].world_to_camera.tobytes() for f in frames}
    assert len(cameras) == 1 and frames[0].cameras[0].position.tolist() == [0, 0, 3]


def test_the_video_plays_and_shows_the_pictures(ti_cpu, tmp_path):
    path = tmp_path / "ball.mp4"
    _, _, _, pictures = play(40, record=path, hands=swipe)
    seen = decode(path)
    assert len(seen) == 40
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(60)
    for k in (0, 12, 39):
        assert psnr(seen[k], pictures[k]) > 30, k  # a lossy codec on a smooth picture
    assert psnr(seen[39], pictures[0]) < 25  # the ball has moved
    assert [p.name for p in tmp_path.iterdir()] == ["ball.mp4"]


def test_odd_sizes_gain_a_row_and_a_column(ti_cpu, tmp_path):
    path = tmp_path / "odd.mp4"
    _, _, _, pictures = play(3, record=path, width=161, height=91)
    seen = decode(path)
    assert seen[0].shape == (92, 162, 3)
    assert psnr(seen[0][:91, :161], pictures[0]) > 30


def test_the_snapshot_is_the_last_picture_or_a_chosen_one(ti_cpu, tmp_path):
    for chosen, index in ((None, 9), (4, 4)):
        path = tmp_path / f"{index}.png"
        _, _, _, pictures = play(10, snapshot=path, snapshot_frame=chosen, hands=swipe)
        assert (cv2.imread(str(path))[..., ::-1] == pictures[index]).all()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["4.png", "9.png"]


def test_two_views_are_two_eyes_side_by_side(ti_cpu, tmp_path):
    display, _, frames, _ = play(2, views=2, snapshot=tmp_path / "pair.png", record=tmp_path / "pair.mp4")
    left, right = frames[0].cameras
    assert np.allclose(right.position - left.position, (EYE_DISTANCE, 0, 0))
    assert np.allclose((left.position + right.position) / 2, (0, 0, 3))
    image = cv2.imread(str(tmp_path / "pair.png"))[..., ::-1].astype(int)
    assert image.shape == (HEIGHT, 2 * WIDTH, 3) == (*decode(tmp_path / "pair.mp4")[0].shape[:2], 3)
    red = image[..., 0] > 2 * image[..., 1]
    columns = [np.nonzero(half.any(0))[0].mean() for half in (red[:, :WIDTH], red[:, WIDTH:])]
    disparity = left.fx * EYE_DISTANCE / 3.0
    assert columns[0] - columns[1] == pytest.approx(disparity, abs=1.0)  # nearer things lie further right on the left
    assert display.views == 2


def test_a_run_that_breaks_off_leaves_no_file(ti_cpu, tmp_path):
    play(20, record=tmp_path / "a.mp4", snapshot=tmp_path / "a.png", stop_after=5)
    assert list(tmp_path.iterdir()) == []


def test_an_older_video_survives_a_run_that_fails(ti_cpu, tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"precious")
    with Headless(fake_scene(), width=WIDTH, height=HEIGHT, frames=5, record=path) as display:
        next(display.frames(FakeWorld(fake_scene(), width=WIDTH, height=HEIGHT)))
    assert path.read_bytes() == b"precious" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    "options, message",
    [
        ({"record": "nowhere/a.mp4"}, "cannot write here"),
        ({"snapshot": "nowhere/a.png"}, "cannot write here"),
        ({"record": "a.avi"}, "must end in .mp4"),
        ({"record": "folder.mp4"}, "is a folder"),
        ({"frames": 0}, "at least one"),
        ({"snapshot": "a.png", "snapshot_frame": 5}, "no frame 5"),
    ],
)
def test_bad_places_are_refused_before_the_first_frame(tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(BadInput, match=message) as error:
        Headless(fake_scene(), **({"width": WIDTH, "height": HEIGHT, "frames": 5} | options))
    assert "\n" not in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.mp4"]


def test_a_full_disk_is_noticed_before_the_first_frame(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(file_access.shutil, "disk_usage", lambda path: usage._replace(free=1_000_000))
    with pytest.raises(BadInput, match="the disk has 1 MB left, about 52 MB are needed"):
        Headless(fake_scene(), width=1920, height=1080, frames=500, record=tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []


def write_until_full(path: str) -> None:
    """In a process that may write 100 kB a file: a video of noise, which needs more."""
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
    film = Video(path, 320, 180)
    rng = np.random.default_rng(0)
    for _ in range(60):
        film.write(rng.integers(0, 255, (180, 320, 3), np.uint8))
    try:
        film.close()
    except BadInput as error:
        print(error)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot limit the size of a file")
def test_a_disk_that_fills_up_during_the_run_is_told(tmp_path):
    code = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); import sys; sys.path.insert(0, '.'); "
    code += f"from tests.display.test_headless import write_until_full; write_until_full({str(tmp_path / 'a.mp4')!r})"
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "of 60 pictures could be written (disk full?)" in out.stdout, out.stderr
    assert list(tmp_path.iterdir()) == []
