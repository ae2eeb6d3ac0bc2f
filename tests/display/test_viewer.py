"""Looking at a splat: where the camera stands, the window, the picture, the film."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import vrgs
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians, write_gaussians
from display.viewed_file import camera_around, middle_and_radius
from tests.support.waiting import until
from tests.support.xvfb import NEEDS_XVFB, XServer

PROGRAM = Path(__file__).resolve().parents[2] / "vrgs.py"
CROSS = np.array([255, 199, 64])  # colour of a point that is measured
RED, WHITE = (0.9, 0.1, 0.1), (0.9, 0.9, 0.9)


def ball(count=4000, *, middle=(3.0, -2.0, 5.0), radius=0.4) -> Gaussians:
    """A ball of small opaque Gaussians, red in the half towards +x; and a faint speck a long way off."""
    rng = np.random.default_rng(3)
    way = rng.normal(size=(count, 3))
    means = np.asarray(middle) + radius * way / np.linalg.norm(way, axis=1, keepdims=True)
    colours = np.where(way[:, :1] > 0, RED, WHITE)
    means = np.vstack([means, np.asarray(middle) + 100.0])
    sh = ((np.vstack([colours, WHITE]) - 0.5) / 0.28209479177387814)[:, None, :]
    quats = np.tile([1.0, 0, 0, 0], (count + 1, 1))
    logits = np.r_[np.full(count, 4.0), -6.0]
    return Gaussians.of(means, quats, np.full((count + 1, 3), np.log(0.02)), logits, sh)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "ball.ply"
    write_gaussians(path, ball())
    return path


def run(*words, **more):
    return subprocess.run([sys.executable, PROGRAM, *map(str, words)], capture_output=True, text=True, **more)


@pytest.mark.parametrize(("width", "height"), [(300, 300), (600, 300), (200, 400)])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_camera_shows_the_whole_thing_and_it_fills_the_picture(width, height, yaw):
    g = ball()
    camera = camera_around(g, width, height, yaw)
    p = g.means[:-1] @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    u, v = camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy
    assert u.min() > 0 and u.max() < width and v.min() > 0 and v.max() < height
    assert max(np.ptp(u) / width, np.ptp(v) / height) > 0.8


def test_a_single_gaussian_has_a_size_too():
    middle, radius = middle_and_radius(ball().select([0]))
    np.testing.assert_allclose(middle, ball().means[0])
    assert radius == pytest.approx(0.06, rel=1e-3)


def test_the_picture_of_the_command(file, tmp_path):
    done = run("view", file, "--arch", "cpu", "--up", "+x", "--size", "200x160", "--snapshot", tmp_path / "a.png")
    assert done.returncode == 0, done.stderr
    assert "4001 Gaussians" in done.stderr and "+x is up" in done.stderr
    picture = cv2.imread(str(tmp_path / "a.png"))[..., ::-1].astype(int)
    assert picture.shape == (160, 200, 3)
    np.testing.assert_allclose(picture[45, 100], 255 * np.array(RED), atol=20)  # what was +x is on top
    np.testing.assert_allclose(picture[120, 100], 255 * np.array(WHITE), atol=20)


def test_the_film_of_the_command_goes_round(file, tmp_path):
    out = tmp_path / "turn.mp4"
    words = ["--turntable", "--frames", 8, "--size", "96x64", "--up", "+y", "--elevation", 0]
    done = run("render", file, "--arch", "cpu", *words, "--out", out)
    assert done.returncode == 0, done.stderr
    film = cv2.VideoCapture(str(out))
    pictures = [film.read()[1].astype(int) for _ in range(8)]
    assert not film.read()[0]
    red = [(p[..., 2] - p[..., 1] > 80).sum() for p in pictures]
    assert np.argmax(red) == 2 and np.argmin(red) == 6  # the red side is seen from +x, a quarter of a turn from +z
    assert sorted(p.name for p in tmp_path.iterdir()) == ["turn.mp4"]


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["view", "nowhere.ply", "--snapshot", "a.png"], "nowhere.ply: no such file"),
        (["view", "{file}"], "no display"),
        (["view", "{file}", "--snapshot", "nowhere/a.png"], "cannot write"),
        (["render", "{file}", "--out", "a.png"], "--camera CAM.json, or --turntable"),
        (["render", "{file}", "--turntable", "--out", "a.png"], "must end in .mp4"),
        (["render", "{file}", "--turntable", "--out", "a.mp4", "--elevation", "100"], "between -89 and 89"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(file, tmp_path, monkeypatch, capsys, words, what):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert vrgs.main([w.format(file=file) for w in words]) == 2
    said = capsys.readouterr().err
    assert what in said and "Traceback" not in said and not list(tmp_path.glob("*.p*"))


@NEEDS_XVFB[0]
@NEEDS_XVFB[1]
def test_the_window_turns_with_the_mouse_measures_and_closes(file, tmp_path):
    out = tmp_path / "measured.ply"
    with XServer(400, 300) as screen:
        words = [sys.executable, PROGRAM, "view", file, "--arch", "cpu", "--up", "+y", "--size", "400x300"]
        words += ["--out", out]
        process = subprocess.Popen(list(map(str, words)), env=screen.env, stderr=subprocess.PIPE)
        try:
            screen.wait_for_window("ball.ply", seconds=60)

            def becomes(x, check):
                until(lambda: check(screen.pixels()[145:155, x : x + 10].astype(int).mean((0, 1))))

            def crossed(y, there):
                def seen():
                    near = screen.pixels()[y - 6 : y + 7, 194:207].reshape(-1, 3).astype(int)
                    return (np.abs(near - CROSS).sum(axis=1) < 150).any() == there

                until(seen, what="a cross where it was clicked" if there else "the end of the question")

            becomes(310, lambda c: c[0] - c[1] > 80)  # its right side is red
            screen.key("F1")  # the panel is over it
            becomes(120, lambda c: c.min() > 180)  # its left side is white
            screen.drag((330, 250), (190, 250))
            becomes(120, lambda c: c[0] - c[1] > 80)  # its red side came round
            screen.key("k")
            for y in (90, 125):  # above the dialog
                screen.click(200, y)
                crossed(y, True)
            screen.key("2")  # the two points are 2 m apart
            screen.key("Return")
            crossed(90, False)
            screen.key("o")
            until(out.exists)
            screen.key("Escape")
            assert process.wait(30) == 0
        finally:
            process.kill()
    size = np.ptp(read_gaussians(out).means[:-1], axis=0).max()  # but for the speck
    assert 12.0 < size < 30.0  # the ball of 0.8 m: the points are an eighth of the picture apart, on its near side
