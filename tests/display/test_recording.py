"""Recordings play again exactly, with all kinds of hands, also after an abnormal end; anything else is refused."""

import dataclasses
import re
from types import SimpleNamespace as N

import h5py
import numpy as np
import pytest

import scenes
import vrgs
from commands.parser import parse
from commands.play import open_display, open_film
from core.camera import look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.vocabulary import BodyState, Hand, Light, Touch
from display import user_commands as cmd
from display.headless.video import FILM_FPS, frame_count
from display.protocol import Frame
from display.record.recording import Recording
from display.record.recording_file import VERSION
from display.record.replay import Replay, fitted
from display.timing import Timings
from tests.support.fake_world import fake_scene

CAMERA = perspective(64, 48, 0.9, look_at((0, 1, 2), (0, 0, 0)))


class Ball:
    """A world of one ball that follows the first hand."""

    def __init__(self):
        self.at, self.frames = np.zeros(3), []

    def step(self, frame):
        self.frames.append((frame, frame.cameras() if callable(frame.cameras) else frame.cameras))
        if frame.hands and frame.hands[0] is not None:
            self.at = self.at + frame.dt * (np.array(frame.hands[0].position) - self.at)

    def bodies(self):
        return [BodyState("ball", self.at, self.at, self.at, self.at, self.at, False)]


def some_frames(count=200, dt=1 / 90):
    rng = np.random.default_rng(5)
    frames = []
    for k in range(count):
        q = rng.normal(size=4)
        hands = [Hand(tuple(rng.normal(size=3).tolist()), tuple((q / np.linalg.norm(q)).tolist()), k % 7 > 3, 0.05)]
        hands += [Hand()] if k % 3 else []
        commands = {
            5: [cmd.Pause(True)],
            6: [cmd.SingleStep()],
            9: [cmd.SetLight(Light((1.0, 2.0, 3.0))), cmd.Reset()],
        }.get(k, [])
        cameras = [dataclasses.replace(CAMERA, cx=30.0 + 0.01 * k)] * (k % 3)
        frames.append(Frame(dt, dt * (k + 1), cameras, hands, commands, max_step=None if k % 2 else 1 / 90))
    return frames


def record(path, frames, world=None, close=True):
    """A recording of these frames."""
    world = world or Ball()
    recording = Recording(path)
    recording.about = {"scene": "ring_toss", "seed": 3, "arch": "cpu", "world": {"sort": "radial"}}
    for frame in frames:
        world.step(recording.note(frame))
        recording.after(world)
    if close:
        recording.close()
    return recording


def same(a, b) -> bool:
    cameras = [[dataclasses.astuple(c)[:6] + (c.world_to_camera.tobytes(),) for c in f.cameras] for f in (a, b)]
    mine, theirs = (dataclasses.replace(f, cameras=[]) for f in (a, b))
    return cameras[0] == cameras[1] and mine == theirs


def test_frames_come_back_as_they_were(tmp_path):
    frames = some_frames()
    record(tmp_path / "play.h5", frames)
    replay = Replay.load(tmp_path / "play.h5")
    assert len(replay) == 200 and all(same(a, b) for a, b in zip(frames, replay.recorded, strict=True))
    assert [p.name for p in tmp_path.iterdir()] == ["play.h5"]
    assert sorted(replay.states) == [0, 90, 180, 199]


def test_cameras_are_taken_down_when_the_world_asks_for_them(tmp_path):
    asked = []
    late = Frame(0.1, 0.1, lambda: (asked.append(1), [CAMERA, CAMERA])[1], [])
    world = Ball()
    record(tmp_path / "play.h5", [late, Frame(0.1, 0.2, [], []), late], world)
    assert len(asked) == 2 and [len(cameras) for _, cameras in world.frames] == [2, 0, 2]
    assert [len(f.cameras) for f in Replay.load(tmp_path / "play.h5").recorded] == [2, 0, 2]


def test_a_hand_without_a_pose_is_recorded_as_none(tmp_path):
    capsules = tuple(Touch((0.0, 1.0, 0.1 * k), (1.0, 2.0, 3.0), 0.01) for k in range(11))
    hands = [Hand(), Hand((1.0, 2.0, 3.0), (0.0, 1.0, 0.0, 0.0), True, 0.1, capsules)]
    record(tmp_path / "play.h5", [Frame(0.1, 0.1, [], [Hand((float("nan"), 0.0, 0.0)), None, *hands])])
    assert Replay.load(tmp_path / "play.h5").recorded[0].hands == [None, None, *hands]


def as_version_3(path):
    """Write texts, hands and lights of a recording as before version 4."""
    with h5py.File(path, "r+") as file:
        touches = file["hands/touches"][()]
        del file["hands/touches"]
        capsule = '{"c": "Touch", "f": {"a": ["t", 3, "f"], "b": ["t", 3, "f"], "radius": "f"}}'
        layout = (
            '{"c": "Hand", "f": {"position": ["t", 3, "f"], "rotation": ["t", 4, "f"], "grip": "b", "reach": "f", '
            '"touch": %s}}'
        )
        layouts = ['"n"', layout % '["t"]', layout % f'["t", 2, {capsule}]']
        file["hands/layout"] = np.searchsorted([-1, 0, 2], touches).astype(np.int32)
        about = bytes(file.attrs["about"]).decode()
        file.attrs["format"], file.attrs["version"], file.attrs["about"] = "vrgs-recording", 3, about
        file.attrs["layouts"] = f"[{', '.join(layouts)}]"
        text = bytes(file["commands/text"][()]).decode()
        del file["commands/text"]
        text = re.sub(r'"light": (\{.*?\})', r'"light": {"Light": \1}', text)
        file["commands/text"] = np.frombuffer(text.encode(), np.uint8)


def test_recordings_of_version_3_are_read(tmp_path):
    capsules = tuple(Touch((0.0, 1.0, 0.1 * k), (1.0, 2.0, 3.0), 0.01) for k in range(2))
    frames = [*some_frames(20), Frame(0.1, 1.0, [], [None, Hand(touch=capsules)], [cmd.SetMaterial(0, "jelly")])]
    record(tmp_path / "play.h5", frames)
    as_version_3(tmp_path / "play.h5")
    replay = Replay.load(tmp_path / "play.h5")
    assert replay.version == 3 and all(same(a, b) for a, b in zip(frames, replay.recorded, strict=True))


def test_commands_come_back_as_they_were_and_others_are_refused():
    commands = [cmd.Reset(), cmd.SetInteraction("transform"), cmd.SetLight(Light((0.0, 1.0, 2.0), kind="directional"))]
    commands += [cmd.Duplicate(None), cmd.Select(3), cmd.Rescale(None, 1.5), cmd.Rotate(2, (1.0, 0.0, 0.0, 0.0))]
    commands += [cmd.SetMaterial(0, Material(1e4, 0.3, 900.0)), cmd.Undo(), cmd.PlayDemo(False)]
    commands += [cmd.SetGravity((0.0, -1.6, 0.0)), cmd.SetTimeScale(0.5, True)]
    commands += [cmd.Place(1, (0.0, 0.1, 0.0), continued=True)]
    assert cmd.commands_from_text(cmd.commands_to_text(7, commands), "x") == (7, commands)
    before_drags = cmd.commands_from_text('{"frame": 7, "material": [0, "jelly"]}', "x")
    assert before_drags == (7, [cmd.SetMaterial(0, "jelly")])
    of_numpy = cmd.commands_to_text(7, [cmd.Rescale(np.int64(2), np.float64(1.5))])
    assert cmd.commands_from_text(of_numpy, "x") == (7, [cmd.Rescale(2, 1.5)])
    for text in (
        "", "3", "{}", "[" * 100_000, '{"frame": 1.5}', '{"frame": 1, "select": -1}',
        '{"frame": true}', '{"frame": 1, "eval": "x"}', '{"frame": 1, "pause": 1}',
        '{"frame": 1, "interaction": "both"}', '{"frame": 1, "light": 3}',
        '{"frame": 1, "light": {"Light": {"colour": 1}}}',
        '{"frame": 1, "light": {"Light": {"position": [1, 2]}}}', '{"frame": 1, "rescale": [1, NaN]}',
        '{"frame": 1, "rotate": [1, [1, 2, 3]]}', '{"frame": 1, "material": [1, 5]}',
        '{"frame": 1, "gravity": [0, -1, 0]}', '{"frame": 1, "place": [1]}',
        '{"frame": 1, "time_scale": [1, true, 2]}',
    ):  # fmt: skip
        with pytest.raises(BadInput):
            cmd.commands_from_text(text, "x")


def test_a_command_that_cannot_be_replayed_is_left_out_with_a_line(tmp_path, capsys):
    given = [[cmd.Rescale(0, np.nan)], [cmd.Reset()]]
    record(tmp_path / "play.h5", [Frame(0.1, 0.1, [], [], commands) for commands in given])
    assert [f.commands for f in Replay.load(tmp_path / "play.h5").recorded] == [[], [cmd.Reset()]]
    assert capsys.readouterr().err == (
        f"{tmp_path / 'play.h5'}: not recorded: the command 'rescale': [1] is None, not a number\n"
    )


def play_again(replay, shown, *, paced, world=None):
    """(world, how often it was presented) after a replay on a display whose frames are these."""
    world, presented = world or Ball(), []
    display = N(frames=lambda world: iter(shown), present=lambda world: presented.append(len(world.frames)))
    for frame in replay.frames(display, world, paced=paced):
        world.step(frame)
        display.present(world)
    return world, presented


def test_a_replay_does_the_same_and_says_so(tmp_path):
    frames = some_frames()
    world = Ball()
    record(tmp_path / "play.h5", frames, world)
    camera = perspective(100, 50, 0.9, look_at((0, 1, 2), (0, 0, 0)))
    for rate, paced in ((90, False), (90, True), (30, True), (144, True)):
        replay = Replay.load(tmp_path / "play.h5")
        shown = [Frame(1 / rate, 0.0, [camera])] * 1000
        again, presented = play_again(replay, shown, paced=paced)
        assert np.array_equal(again.at, world.at) and len(again.frames) == 200
        assert replay.report() == "replayed 200 frames, largest difference 0 m"
        wanted = 200 * rate / 90 if paced else 200
        assert abs(len(presented) - wanted) <= 3, "not at its pace"
        drawn = [cameras for _, cameras in again.frames if cameras]
        assert all((c.width, c.height) == (100, 50) for cameras in drawn for c in cameras)
    replay = Replay.load(tmp_path / "play.h5")
    other = Ball()
    other.at = np.array([1.0, 0.0, 0.0])
    play_again(replay, [Frame(1 / 90, 0.0, [camera])] * 120, paced=False, world=other)
    text = replay.report()
    assert text.startswith("replayed 120 of 200 frames, largest difference 0.9") and text.endswith(" m")


def test_a_replay_in_a_window_is_held_by_its_pause(tmp_path):
    record(tmp_path / "play.h5", some_frames(20))
    shown = [Frame(1 / 90, 0.0, [CAMERA], [], [cmd.Pause(True)] if k in (5, 50) else []) for k in range(80)]
    world, presented = play_again(Replay.load(tmp_path / "play.h5"), shown, paced=True)
    assert len(world.frames) == 20 and len(set(presented[5:50])) == 1


def test_a_view_fills_a_picture_of_another_size():
    c = fitted(CAMERA, 320, 120)
    assert (c.width, c.height, c.fy, c.cx, c.cy) == (320, 120, CAMERA.fy * 2.5, 160.0, 60.0)
    assert c.fx / c.fy == pytest.approx(CAMERA.fx / CAMERA.fy)


@pytest.mark.parametrize(
    ("words", "says"),
    [(["--replay", "none.h5"], "no such file"), (["--replay", "none.h5", "--xr"], "leave out --xr")],
)
def test_the_command_line_says_what_is_wrong(capsys, words, says):
    assert vrgs.main(words) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


SCENE = '''"""Lift: a scripted hand takes a ring from the floor and lifts it."""

from scenes.dining_table import RING_MATERIAL
from scenes.scene import Body, Hand, Light, Plane, Scene


class Lift:
    duration, score, message = 0.4, 0, ""

    def reset(self):
        pass

    def update(self, time, bodies):
        pass

    def interaction(self, time):
        return "transform" if 0.2 < time < 0.3 else "physics"

    def hands(self, time, bodies):
        return [Hand((0.0, 0.02 + max(time - 0.1, 0.0), 0.08), grip=time > 0.05, reach=0.06)]

    def verify(self, bodies):
        pass


def build():
    floor, light = Plane((0, 0, 0), (0, 1, 0)), Light((0.3, 2.0, 0.3))
    ring = Body("ring_red", RING_MATERIAL, position=(0.0, 0.02, 0.0))
    return Scene([ring], light, (0.0, 0.5, 0.9), (0.0, 0.1, 0.0), [floor], game=Lift())
'''


def test_what_was_played_is_played_again_bit_for_bit(tmp_path, monkeypatch, capsys, ti_cpu):
    """A ring is lifted from the floor, for a while in the other interaction; then the same from the recording."""
    from display.world import World

    (tmp_path / "lift.py").write_text(SCENE, encoding="utf-8")
    monkeypatch.setattr(scenes, "__path__", [*scenes.__path__, str(tmp_path)])
    worlds, begin = [], World.__init__
    monkeypatch.setattr(World, "__init__", lambda self, *a, **k: (worlds.append(self), begin(self, *a, **k))[1])
    file, film = tmp_path / "play.h5", tmp_path / "again.png"
    said, ends = [], []
    for words in (
        ["--scene", "lift", "--frames", "24", "--record-input", str(file)],
        ["--replay", str(file), "--snapshot", str(film)],
    ):
        assert vrgs.main([*words, "--headless", "--arch", "cpu", "--size", "32x24"]) == 0
        said.append(capsys.readouterr().out)
        state = worlds[-1].device.solver.snapshot()
        ends.append([state["x"], state["v"], worlds[-1].time])
    assert said == ["", "replayed 24 frames, largest difference 0 m\n"] and film.exists()
    assert all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))
    assert vrgs.main(["--replay", str(file), "--interaction", "transform", "--headless"]) == 2
    assert "--interaction transform: the recording was made with physics" in capsys.readouterr().err
    replay = Replay.load(file)
    assert replay.about["interaction"] == "physics" and replay.version == VERSION
    assert any(f.hands[0].grip for f in replay.recorded)
    first, *_, last = (centroids[0, 1] for _, centroids in sorted(replay.states.items()))
    assert last > first + 0.02


def test_the_film_of_a_replay_keeps_the_time_of_the_play(tmp_path, monkeypatch):
    """Frames of a window are of any length: here 12 in a second."""
    monkeypatch.setattr("display.headless.video.pixels_of", lambda picture: picture)
    shown = {"picture": np.zeros((24, 32, 4), np.uint8), "picture_size": (32, 24)}
    world = N(**shown, timings=Timings(), time=0.0, wanted_view=None, interaction="physics")
    words = ["--replay", "play.h5", "--headless", "--record", str(tmp_path / "again.mp4"), "--size", "32x24"]
    words += ["--frames", "12"]
    args = parse(words)[1]
    with open_display(args, fake_scene(), range(12)) as display, open_film(args, display) as film:
        for frame in display.frames(world):
            film.add(world, 5 * frame.time)
            display.present(world)
    assert frame_count(tmp_path / "again.mp4") == FILM_FPS


def test_a_recording_of_the_first_version_keeps_the_material_of_its_time(tmp_path):
    """Before version 2 a body in the sandbox was of plush, or of flesh, whatever the asset's own material was."""
    record(tmp_path / "play.h5", some_frames(3))
    assert Replay.load(tmp_path / "play.h5").implied_material("sandbox", None) is None
    as_version_3(tmp_path / "play.h5")
    with h5py.File(tmp_path / "play.h5", "r+") as file:
        file.attrs["version"] = 1
    old = Replay.load(tmp_path / "play.h5")
    implied = [old.implied_material("sandbox", body) for body in (None, "ring_red", "dancer")]
    assert implied == ["plush", "plush", "flesh"]
    assert old.implied_material("ring_toss", None) is None
