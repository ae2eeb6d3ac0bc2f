"""Recordings play again exactly, with all kinds of hands, also after an abnormal end; anything else is refused."""

import dataclasses
import json
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace as N

import h5py
import numpy as np
import pytest

import scenes
import vrgs
from commands.parser import parse
from commands.play import open_display, open_film, open_replay
from core.camera import fitted, look_at, perspective
from core.errors import BadInput
from core.material import Material
from core.vocabulary import BodyState, Hand, Light, Touch
from display import user_commands as cmd
from display.headless.video import FILM_FPS, frame_count
from display.protocol import Frame
from display.record.recording import Recording, Replay
from display.record.recording_file import JOURNAL, VERSION
from display.timing import Timings
from scenes import registry
from scenes.sandbox import TOYS
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


def record(path, frames, world=None, close=True, scene="ring_toss"):
    """A recording of these frames."""
    world = world or Ball()
    recording = Recording(path)
    recording.about = {"scene": scene, "seed": 3, "arch": "cpu", "world": {"sort": "radial"}}
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
    camera = perspective(100, 50, 0.9, look_at((2, 1, 0), (0, 0, 0)))  # from elsewhere than it was recorded
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
        assert all(np.array_equal(cameras[0].world_to_camera, CAMERA.world_to_camera) for cameras in drawn[2:])
        assert abs(len(drawn) - min(200, wanted)) <= 3, "a picture of each frame for which there is time"
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
    assert c.fx == c.fy
    seen = fitted(
        CAMERA.resized(64, 40), 320, 120, stretch=1.1
    )  # from and for pictures that are shown in another shape
    assert (seen.fy, seen.cx, seen.cy) == pytest.approx((c.fy, 160.0, 60.0)) and seen.fx == pytest.approx(1.1 * c.fx)


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


def test_what_was_played_is_played_again_bit_for_bit(tmp_path, monkeypatch, capsys, unwarmed):
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


def test_a_recording_of_the_sandbox_has_the_toys_of_then(tmp_path):
    record(tmp_path / "play.h5", some_frames(3), scene="sandbox")
    words = ["--headless", "--replay", str(tmp_path / "play.h5")]
    assert bodies_of(words) == list(TOYS)
    with h5py.File(tmp_path / "play.h5", "r+") as file:
        file.attrs["version"] = 5
    assert bodies_of(words) == ["ring_red", "ball", "toy_duck"]
    as_version_3(tmp_path / "play.h5")
    assert bodies_of(words) == ["ring_red"]


def bodies_of(words: list[str]) -> list[str]:
    """Assets of what lies about in the scene of a command line."""
    options = parse(words)[1]
    open_replay(options)
    return [b.asset for b in registry.load(options.scene, body=options.body).bodies if b.material is not None]


ROOT = Path(__file__).resolve().parents[2]

DIES = """
import sys; sys.path.insert(0, {root!r})
from tests.display.test_recording import record, some_frames
recording = record({path!r}, some_frames(460), close=False)
recording.flush()
print("written", flush=True)
import time
while True: time.sleep(1)
"""


def test_a_session_that_is_killed_leaves_what_was_until_then(tmp_path):
    path = tmp_path / "play.h5"
    program = DIES.format(root=str(ROOT), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "written\n"
        process.send_signal(signal.SIGKILL)
    assert not path.exists()
    replay = Replay.load(tmp_path / "play.h5.part")
    assert len(replay) == 451 and all(same(a, b) for a, b in zip(some_frames(451), replay.recorded, strict=True))
    with pytest.raises(BadInput, match=r"play\.h5\.part was left by an interrupted session"):
        Recording(path)


def test_the_end_of_a_play_that_fails_is_kept(tmp_path):
    with pytest.raises(RuntimeError), Recording(tmp_path / "play.h5") as recording:
        recording.about = {"scene": "ring_toss"}
        world = Ball()
        for frame in some_frames(30):
            world.step(recording.note(frame))
            recording.after(world)
        raise RuntimeError("the runtime went away")
    assert len(Replay.load(tmp_path / "play.h5")) == 30


def test_a_play_that_never_began_leaves_nothing(tmp_path):
    with pytest.raises(BadInput), Recording(tmp_path / "play.h5"):
        raise BadInput("no headset")
    assert list(tmp_path.iterdir()) == []


def test_where_nothing_can_be_written_a_line_says_so_at_once(tmp_path):
    with pytest.raises(BadInput, match="cannot write"):
        Recording(tmp_path / "nowhere" / "play.h5")
    with pytest.raises(BadInput, match="is a folder"):
        Recording(tmp_path)


FILLS = """
import resource, sys
from core.errors import BadInput
from tests.display.test_recording import record, some_frames
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
try:
    print(record(sys.argv[1], some_frames(3000)).frames, "frames played")
except BadInput as e:
    sys.exit(str(e))
"""


def play_until_full(path: Path, limit: int) -> subprocess.CompletedProcess:
    """A recorded play of 3000 frames, where a limit of the size of files [bytes] stands for the full disk."""
    pytest.importorskip("resource")
    words = [sys.executable, "-c", FILLS, path, str(limit)]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_disk_that_fills_up_ends_the_recording_and_not_the_play(tmp_path):
    """The frames until then are a complete recording."""
    path = tmp_path / "play.h5"
    done = play_until_full(path, 400_000)
    assert done.returncode == 0 and done.stdout.endswith("3000 frames played\n"), done.stderr
    assert done.stderr == f"{path}: the recording ends here (File too large)\n"
    replay = Replay.load(path)
    assert 1000 < len(replay) < 2900 and len(replay) % 90 == 1
    assert all(same(a, b) for a, b in zip(some_frames(len(replay)), replay.recorded, strict=True))
    assert [p.name for p in tmp_path.iterdir()] == ["play.h5"]


def test_a_journal_of_which_no_recording_can_be_written_stays(tmp_path, capsys, monkeypatch):
    def full(path, journal):
        raise BadInput(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr("display.record.recording_file.write_recording", full)
    path = tmp_path / "play.h5"
    record(path, some_frames(100))
    assert capsys.readouterr().err == (
        f"{path}: cannot be written (No space left on device);"
        f" all that was recorded is in {path}.part, and --replay plays it\n"
    )
    assert len(Replay.load(tmp_path / "play.h5.part")) == 100 and not path.exists()


def test_a_disk_that_is_full_at_once_leaves_nothing(tmp_path):
    """It is refused before the play where not even an empty journal has space, else a line tells of it."""
    path = tmp_path / "play.h5"
    done = play_until_full(path, 10)
    assert (done.returncode, done.stderr) == (1, f"{path}: cannot be written (File too large)\n")
    done = play_until_full(path, 100)
    assert (done.returncode, done.stderr) == (0, f"{path}: nothing is recorded (File too large)\n")
    assert list(tmp_path.iterdir()) == []


def test_a_journal_is_read_up_to_its_last_whole_block(tmp_path):
    """Whole, cut off anywhere, or damaged: what was recorded until then, or one line."""
    recording = record(tmp_path / "play.h5", some_frames(300), close=False)
    recording.flush()
    whole = recording.part.read_bytes()
    recording.close()
    path, counts, rng = tmp_path / "cut.part", [], np.random.default_rng(0)
    for size in np.linspace(len(JOURNAL), len(whole), 40).astype(int):
        path.write_bytes(whole[:size])
        try:
            counts.append(len(Replay.load(path)))
        except BadInput as e:
            assert str(e).startswith(f"{path}: ")
            counts.append(0)
    assert counts == sorted(counts) and counts[-1] == 271 and set(counts) == {0, 1, 91, 181, 271}
    for _ in range(100):
        data = bytearray(whole)
        data[rng.integers(len(JOURNAL), len(JOURNAL) + 400)] = rng.integers(256)
        path.write_bytes(data)
        try:
            Replay.load(path)
        except BadInput as e:
            assert str(e).startswith(f"{path}: ") and "\n" not in str(e)


def spoil(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def put(name, value, at=0):
    def change(file):
        file[name][at] = value

    return change


def attribute(key, value):
    return lambda file: file.attrs.__setitem__(key, value)


def about(**changes):
    return attribute("about", json.dumps({"scene": "ring_toss", **changes}))


def longer(name, rows=5):
    def change(file):
        values = file[name][()]
        del file[name]
        file[name] = np.concatenate([values, values[:rows]])

    return change


def huge(file):
    del file["frames/dt"]
    file.create_dataset("frames/dt", (10**12,), np.float64, chunks=(10**6,))


def linked(file):
    del file["hands/numbers"]
    file["hands/numbers"] = h5py.ExternalLink("/etc/passwd", "/x")


SPOILED = {
    "is not a recording": attribute("format", "vrgs-asset"),
    "of version 9": attribute("version", 9),
    "not JSON": attribute("about", "{"),
    "it is \\[\\], not an object": attribute("about", "[]"),
    "seed is 'x'": about(seed="x"),
    "arch is 'tpu', not one of cpu, cuda": about(arch="tpu"),
    "world.sort is \\[1\\]": about(world={"sort": [1]}),
    "frames/dt holds": put("frames/dt", np.nan, 3),
    "frames/step holds": put("frames/step", 1e9),
    "frames/hands holds": put("frames/hands", 1000),
    "hands/numbers holds": put("hands/numbers", np.nan),
    "hands/touches holds": put("hands/touches", 1001),
    "hands/numbers has shape": put("hands/touches", 7),
    "cameras/values holds a camera": put("cameras/values", np.zeros(22)),
    "frames/time has shape": longer("frames/dt"),
    "commands/text is no text": put("commands/text", 255),
    "a line of commands is not JSON": put("commands/text", ord("x")),
    "states/count holds": put("states/count", 10**7),
    "states/frame holds": put("states/frame", 10**9),
    "claims": huge,
    "is a link": linked,
}  # fmt: skip


@pytest.mark.parametrize("says", SPOILED)
def test_a_bad_file_is_refused_in_one_line(tmp_path, says):
    path = tmp_path / "play.h5"
    record(path, some_frames(12))
    spoil(path, SPOILED[says])
    with pytest.raises(BadInput, match=says) as raised:
        Replay.load(path)
    assert str(raised.value).startswith(f"{path}: ") and "\n" not in str(raised.value) and len(str(raised.value)) < 400
