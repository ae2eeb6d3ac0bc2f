"""The real window under Xvfb, driven by a mouse and keys from outside (xdotool)."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from core.camera import look_at, perspective, project
from core.errors import BadInput
from display.window.dialogs import LINUX_DIALOGS
from display.window.gl_window import has_display
from display.window.window import Window
from tests.support.fake_world import RADIUS, fake_scene
from tests.support.watched import Watched
from tests.support.xvfb import NEEDS_XVFB, XServer

pytestmark = NEEDS_XVFB
ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 640, 480
CAMERA = perspective(WIDTH, HEIGHT, 0.9, look_at((0, 0, 3), (0, 0, 0)))
BALL = (WIDTH // 2, HEIGHT // 2)
FREE = (WIDTH - 60, HEIGHT - 60)  # neither ball nor panel


class Session(Watched):
    """A running window on the ball's world."""

    def __init__(self, screen: XServer, folder: Path, *more, size=(WIDTH, HEIGHT)):
        options = {"env": screen.env, "patience": 20.0, "stdout": subprocess.PIPE, "text": True}
        super().__init__("fake_world.py", folder, "--size", *size, *more, **options)
        self.screen, self.folder = screen, folder
        self.window = screen.wait_for_window("Ball")
        self.until(lambda frame: frame["steps"] > 3)


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    with XServer(1280, 800) as screen:
        session = Session(screen, tmp_path_factory.mktemp("window"))
        yield session
        session.close()


@pytest.fixture
def session(running):
    """The window as it begins: ball at rest, first view, no button held."""
    running.screen.mouse_move(*FREE)
    running.screen.key("Home")
    running.screen.key("r")
    running.until(lambda f: f["ball"] == [0, 0, 0] and f["eye"] == [0, 0, 3] and not f["grip"])
    yield running
    if running.process.poll() is None:
        running.screen.mouse_up()


def is_red(colour) -> bool:
    return int(colour[0]) > 2 * int(colour[1])


def test_the_picture_fills_the_window_the_right_way_up(session):
    pixels = session.screen.pixels()[:HEIGHT, :WIDTH]
    edge = CAMERA.fy * RADIUS / np.sqrt(3**2 - RADIUS**2)  # [px] the ball's radius on the screen
    for dx, dy in [(0, 0), (edge - 3, 0), (0, edge - 3), (0, 3 - edge)]:
        assert is_red(pixels[round(BALL[1] + dy), round(BALL[0] + dx)])
    for dx, dy in [(edge + 3, 0), (0, edge + 3), (0, -edge - 3)]:
        assert not is_red(pixels[round(BALL[1] + dy), round(BALL[0] + dx)])
    lit, dark = pixels[BALL[1] - 40, BALL[0]], pixels[BALL[1] + 40, BALL[0]]
    assert lit[0] > dark[0] + 30  # the light is above
    left, right = pixels[HEIGHT - 5, 5].astype(int), pixels[HEIGHT - 5, WIDTH - 5].astype(int)
    for colour, u in ((left, 5.5), (right, WIDTH - 4.5)):
        d = CAMERA.ray(u, HEIGHT - 4.5)[1]
        sky = 255 * np.array([0.3 + 0.25 * d[0], 0.45 + 0.3 * d[1], 0.6 + 0.2 * d[2]])
        assert np.abs(colour - sky).max() < 3


def test_the_panel_is_there_and_f1_hides_it(session):
    shown = session.screen.pixels()[:HEIGHT, :WIDTH].astype(int)
    session.screen.key("F1")
    session.after()
    hidden = session.screen.pixels()[:HEIGHT, :WIDTH].astype(int)
    changed = np.abs(shown - hidden).max(-1) > 20
    rows, columns = np.nonzero(changed[: HEIGHT - 60])  # below is the hint
    assert changed[60:200, 30:250].mean() > 0.9  # a dark sheet at the top left
    assert columns.max() < WIDTH / 2 + 20 or rows[columns > WIDTH / 2].max() < 60  # elsewhere only the score moves
    session.screen.key("F1")
    session.after()
    again = session.screen.pixels()[:HEIGHT, :WIDTH].astype(int)
    assert (np.abs(again - shown).max(-1) > 20)[60:200, 30:250].mean() < 0.05


def test_a_body_is_grabbed_dragged_and_thrown(session):
    end = (BALL[0] + 120, BALL[1] - 60)
    session.screen.drag(BALL, end, seconds=0.8, steps=20, release=False)
    held = session.until(lambda f: f["grip"])
    assert np.allclose(held["hand"][2], RADIUS, atol=1e-6)  # the near side of the ball
    still = session.until(lambda f: f["hand"] and np.allclose(project(CAMERA, np.array(f["hand"])), end, atol=1.5))
    assert still["held"] and still["eye"] == [0, 0, 3]  # the camera stays
    session.screen.mouse_up()
    session.until(lambda f: not f["grip"] and not f["held"])


def test_pictures_are_missed_only_while_something_moves(session):
    session.after(3)
    begin, rested = (session.after(count) for count in (3, 8))
    assert begin["missed"] == rested["missed"]
    session.screen.key_down("w")
    session.until(lambda f: f["missed"] > rested["missed"])
    session.screen.key_up("w")


def test_editing_keys_and_buttons_reach_the_world(session):
    keys = {"ctrl+z": "undo", "ctrl+shift+z": "redo", "u": "undo", "Delete": "remove", "plus": "rescale", "n": "step"}
    for key, command in keys.items():
        before = len(session.frames())
        session.screen.key(key)
        session.until(lambda f, c=command, n=before: any(c in g["commands"] for g in session.frames()[n:]))
    session.screen.key("space")  # n has paused it
    assert session.until(lambda f: not f["paused"])["eye"] == [0, 0, 3]  # no key walks
    before = len(session.frames())
    session.screen.click(58, 98)
    session.until(lambda f: any("undo" in g["commands"] for g in session.frames()[before:]))
    session.screen.mouse_move(*FREE)


def test_the_panel_has_the_mouse_while_it_is_under_it(session):
    """Its buttons work, and a drag on it neither turns the camera nor grabs."""
    session.screen.click(64, 69)
    session.until(lambda f: f["paused"])
    session.screen.click(64, 69)
    session.until(lambda f: not f["paused"])
    session.screen.click(182, 127)
    session.until(lambda f: f["interaction"] == "transform")
    session.screen.click(77, 127)
    session.until(lambda f: f["interaction"] == "physics")
    session.screen.click(80, 225)  # unfolds the light's sliders, of which the first is that of x
    session.after(5)
    session.screen.drag((148, 292), (60, 292), seconds=0.3)
    lit = session.until(lambda f: f["light"][0] < -2.0)
    assert lit["eye"] == [0, 0, 3] and not lit["grip"]
    session.screen.wheel(2)
    assert session.after()["eye"] == [0, 0, 3]
    session.screen.wheel(5)  # back to the top of the panel
    session.screen.key_down("ctrl")
    session.after(3)
    session.screen.click(100, 292)
    session.after(3)
    session.screen.key_up("ctrl")
    session.after(3)
    session.screen.do("type", "--", "1.25")
    session.screen.key("Return")
    session.until(lambda f: f["light"][0] == 1.25)
    session.screen.click(80, 225)


def test_the_gizmo_moves_the_body_under_the_cursor_and_escape_puts_it_away(session):
    session.screen.mouse_move(*BALL)
    session.after()
    session.screen.key("g")
    session.until(lambda f: f["selected"] == 0)
    session.after()
    before = len(session.frames())
    handle = (BALL[0] + 36, BALL[1])  # the arrow along x
    session.screen.drag(handle, (handle[0] + 80, handle[1]), seconds=0.5)
    moved = session.until(lambda f: f["ball"][0] > 0.2)
    assert moved["eye"] == [0, 0, 3] and not moved["held"] and abs(moved["ball"][1]) < 1e-6
    assert any("place" in f["commands"] for f in session.frames()[before:])
    session.screen.key("Escape")
    session.after()
    session.screen.click(120, 180)  # the list of materials
    session.after()
    session.screen.key("Escape")
    session.after()
    session.screen.key("h")  # the card of keys, which lies over all
    session.after()
    session.screen.key("Escape")
    session.after()
    session.screen.drag(FREE, (FREE[0] - 100, FREE[1]), seconds=0.3)
    session.until(lambda f: f["eye"][0] > 0.5)


def test_f12_writes_the_picture_without_panel_and_f9_films_it(session):
    """The ball and the sky as they are drawn, where the panel covers them too."""
    screen, folder = session.screen, session.folder

    def there(ending: str) -> list[Path]:
        return [path for path in folder.glob(f"ball_*{ending}") if not path.name.startswith(".")]

    def wait_for(ending: str, count: int) -> Path:
        session.eventually(lambda: len(there(ending)) >= count)
        return max(there(ending), key=lambda path: path.stat().st_mtime_ns)

    screen.key("F12")
    written = cv2.imread(str(wait_for(".png", 1)))[..., ::-1].astype(int)
    assert written.shape == (HEIGHT, WIDTH, 3)
    shown = screen.pixels()[:HEIGHT, :WIDTH].astype(int)
    assert np.abs(written - shown)[80:380, WIDTH // 2 :].mean() < 1, "as on the screen, between the lines of text"
    d = CAMERA.ray(60.5, 60.5)[1]
    sky = 255 * np.array([0.3 + 0.25 * d[0], 0.45 + 0.3 * d[1], 0.6 + 0.2 * d[2]])
    assert np.abs(written[60, 60] - sky).max() < 3 < np.abs(shown[60, 60] - sky).max(), "no panel"
    screen.key("F9")
    dot = np.array([0.93, 0.16, 0.14]) * 255
    session.eventually(
        lambda: (np.abs(screen.pixels()[HEIGHT - 40 : HEIGHT, WIDTH - 90 : WIDTH] - dot).max(-1) < 8).any()
    )
    screen.key("F9")
    film = cv2.VideoCapture(str(wait_for(".mp4", 1)))
    assert (film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (WIDTH, HEIGHT)
    _, first = film.read()
    assert np.abs(first[-40:, -90:, ::-1] - dot).max(-1).min() > 60, "the dot is not in the film"
    for path in folder.glob("ball_*"):
        path.unlink()


def test_a_kept_view_is_gone_back_to(session):
    session.screen.key("ctrl+4")
    session.screen.drag(FREE, np.subtract(FREE, (80, 30)))
    session.until(lambda f: np.linalg.norm(np.subtract(f["eye"], (0, 0, 3))) > 0.2)
    session.screen.key("4")
    session.until(lambda f: np.linalg.norm(np.subtract(f["eye"], (0, 0, 3))) < 1e-9)


def test_the_picture_takes_the_size_of_the_window(session):
    session.screen.do("windowsize", session.window, 800, 500)
    session.until(lambda f: f["size"] == [800, 500])
    session.after()
    pixels = session.screen.pixels()
    assert is_red(pixels[250, 400]) and not is_red(pixels[250, 400 + 100])
    assert pixels[495, 795].any() and not pixels[510:, :].any()
    session.screen.do("windowsize", session.window, WIDTH, HEIGHT)
    session.until(lambda f: f["size"] == [WIDTH, HEIGHT])


@pytest.mark.skipif(any(map(shutil.which, LINUX_DIALOGS)), reason="the system asks for files")
def test_a_dialog_has_the_keyboard_and_the_world_waits(session):
    """Also after a mistake, which the next letters replace: none of them is a shortcut."""
    (session.folder / "newspaper.obj").write_text("v 0 0 0\n")
    session.screen.key("ctrl+o")
    session.until(lambda f: f["dt"] == 0.0)
    before = len(session.frames())
    session.screen.do("type", "--delay", 40, "wrap")
    session.screen.key("Return")  # no such file
    session.after(5)
    session.screen.do("type", "--delay", 40, "newspaper.obj")
    session.screen.click(*FREE)  # the field loses the keyboard, the dialog keeps it
    session.screen.do("type", "--delay", 40, "wasdrpn")
    last = session.after()
    assert last["eye"] == [0, 0, 3] and not last["paused"]
    assert not any(f["commands"] or f["dt"] for f in session.frames()[before:])
    session.screen.key("Escape")
    session.until(lambda f: f["dt"] > 0.0)
    session.screen.key("ctrl+o")  # with the text that was typed
    session.after(5)
    session.screen.key("Return")
    session.eventually(lambda: any("AddBody" in f["commands"] for f in session.frames()[before:]))
    (session.folder / "newspaper.obj").unlink()


def test_fewer_pixels_cover_the_window_and_move_nothing(tmp_path):
    """648 x 472 at half a side, in steps of 8 px, is 320 x 240: another shape than the window's."""
    with XServer(1280, 800) as screen:
        session = Session(screen, tmp_path, "--coarse", size=(648, 472))
        screen.key("F1")  # the panel
        session.until(lambda f: f["size"] == [648, 472])
        fine = screen.pixels()[60:420, :648].astype(int)  # between the lines of text
        screen.key_down("w")
        session.until(lambda f: f["size"] == [320, 240])
        screen.key_up("w")
        screen.key("Home")
        session.until(lambda f: f["eye"] == [0, 0, 3])
        session.after()
        coarse = screen.pixels()[60:420, :648].astype(int)
        session.close()
    away = np.abs(fine - coarse).max(-1)
    assert away[:, [0, 1, -2, -1]].max() < 3, "bars at the sides"
    red = [np.argwhere(picture[..., 0] > 2 * picture[..., 1]) for picture in (fine, coarse)]
    assert np.abs(red[0].max(0) - red[1].max(0)).max() <= 1 and np.abs(red[0].min(0) - red[1].min(0)).max() <= 1


def test_escape_quits_with_status_zero_and_a_clean_output(session):
    session.screen.key("Escape")
    assert session.process.wait(20) == 0
    last = session.process.stdout.read().splitlines()[-1]
    assert json.loads(last)["fps"] > 0
    assert [p.name for p in session.folder.iterdir()] == ["log.jsonl"]  # no settings file left behind


def test_no_display_is_one_line_that_names_the_way_out(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not has_display()
    with pytest.raises(BadInput, match="no display to open a window on; run with --headless instead"):
        Window(fake_scene())


def test_a_display_that_does_not_answer_is_no_display(tmp_path):
    code = "from display.window.gl_window import has_display; print(has_display())"
    env = {"DISPLAY": ":987", "PATH": "/usr/bin", "HOME": str(tmp_path)}
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=env, capture_output=True, text=True)
    assert out.stdout.strip() == "False", out.stderr
    assert out.stderr == ""
