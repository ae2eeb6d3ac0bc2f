"""Pictures, films and cameras that the user asks for in play."""

import cv2
import numpy as np
import pytest

from assets.camera_file import read_cameras
from core.camera import look_at, perspective
from core.errors import BadInput
from display.keep.keeper import Keeper
from display.picture import output_path
from display.protocol import Frame
from display.user_commands import Film, TakePicture, WriteCamera
from tests.support.fake_world import RED, FakeWorld, fake_scene

SIZE = (160, 90)


@pytest.fixture
def world(ti_cpu, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = FakeWorld(fake_scene(), width=SIZE[0] // 2, height=SIZE[1] // 2)
    world.told = []
    world.tell = world.told.append
    return world


def play(world, keeper, *commands, time: float = 0.0) -> None:
    width, height = world.picture_size
    frame = Frame(1 / 60, time, [perspective(width, height, 0.9, look_at((0, 0, 3), (0, 0, 0)))], [], list(commands))
    world.step(frame)
    keeper.after(frame, world)


def test_a_picture_is_written_as_large_as_asked_and_never_over_another(world, tmp_path):
    with Keeper("ring_toss") as keeper:
        for _ in range(2):
            play(world, keeper, TakePicture(SIZE))
    files = sorted(tmp_path.iterdir())
    assert len(files) == 2 and all(f.name.startswith("ring_toss_") and f.suffix == ".png" for f in files)
    picture = cv2.imread(str(files[0]))[..., ::-1]
    assert picture.shape == (SIZE[1], SIZE[0], 3) and world.picture_size == (SIZE[0] // 2, SIZE[1] // 2)
    middle, corner = picture[SIZE[1] // 2, SIZE[0] // 2].astype(float), picture[0, 0].astype(float)
    assert middle[0] > 2 * middle[2] and corner[2] > corner[0], "the ball is in the middle, the sky around it"
    assert np.abs(middle / middle.max() - np.array(RED) / max(RED)).max() < 0.05


def test_a_film_lasts_as_long_as_the_play(world, tmp_path):
    with Keeper("sandbox") as keeper:
        play(world, keeper, Film(True, SIZE), time=3.0)
        for k in range(1, 21):
            play(world, keeper, time=3.0 + 0.05 * k)  # a second, of frames slower than the film's
        assert world.film_seconds == pytest.approx(1.0 + 1 / 60)
        play(world, keeper, Film(False), time=4.05)
        assert world.film_seconds is None
    (path,) = tmp_path.iterdir()
    video = cv2.VideoCapture(str(path))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) / video.get(cv2.CAP_PROP_FPS) == pytest.approx(1.0, abs=0.04)
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == SIZE


def test_a_film_under_way_is_finished_at_the_end(world, tmp_path, capsys):
    keeper = Keeper("sandbox")
    play(world, keeper, Film(True, SIZE))
    play(world, keeper, time=0.5)
    keeper.close()
    (path,) = tmp_path.iterdir()
    assert path.suffix == ".mp4" and str(path) in capsys.readouterr().err


def test_the_camera_is_written_for_the_renderer(world, tmp_path):
    with Keeper("sandbox") as keeper:
        play(world, keeper, WriteCamera(SIZE))
    (path,) = tmp_path.iterdir()
    (camera,) = read_cameras(path)
    assert (camera.width, camera.height) == SIZE
    assert np.allclose(camera.world_to_camera, look_at((0, 0, 3), (0, 0, 0)))
    assert camera.fy == pytest.approx(SIZE[1] / 2 / np.tan(0.45))


@pytest.mark.parametrize("command", [TakePicture(), Film(True), WriteCamera()])
def test_what_cannot_be_written_is_told_in_a_line_and_the_play_goes_on(world, monkeypatch, command):
    def full(*_, **__):
        raise BadInput("x.png: cannot write here (No space left on device)")

    monkeypatch.setattr("display.picture.check_writable", full)
    with Keeper("sandbox") as keeper:
        play(world, keeper, command)
        play(world, keeper, time=1.0)
    assert world.told == ["x.png: cannot write here (No space left on device)"]


def test_a_disk_that_fills_up_ends_the_film_and_keeps_it(world, tmp_path, monkeypatch):
    with Keeper("sandbox") as keeper:
        play(world, keeper, Film(True, SIZE))
        play(world, keeper, time=0.5)
        monkeypatch.setattr("display.headless.video.FILM_RESERVE", 1e18)
        for k in range(1, 41):
            play(world, keeper, time=0.5 + 0.05 * k)
        assert world.film_seconds is None and "disk" in world.told[0]
    (path,) = tmp_path.glob("*.mp4")
    assert 10 <= cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) <= 60


def test_where_the_current_folder_cannot_be_written_the_pictures_folder_is_taken(tmp_path, monkeypatch):
    home, here = tmp_path / "home", tmp_path / "here"
    (home / "Pictures").mkdir(parents=True)
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    assert output_path("my/scene.py", ".png").parent == here and output_path("my/scene.py", ".png").stem[:6] == "scene_"
    here.rmdir()
    monkeypatch.setattr("pathlib.Path.cwd", lambda: here)
    assert output_path("sandbox", ".png").parent == home / "Pictures"
