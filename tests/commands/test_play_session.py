"""A session replaces its world while the display stays; the worlds here are empty."""

import sys
import time
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
import pytest

import vrgs
from assets.asset import Asset
from assets.splat_files import write_gaussians
from commands import opening
from commands import play as playing
from commands.opening import Opening, opened_options
from commands.play_options import PlayOptions
from core.errors import BadInput, Cancelled
from core.vocabulary import Body
from display.preferences import Preferences
from display.protocol import Frame
from display.user_commands import AddBody, CancelOpening, Measure, OpenScene, Pause, SwapRoom
from sim.model import CapacityError
from tests.support.compiling import compiled
from tests.support.fake_view import FakeView
from tests.support.leaning_room import leaning_room
from tests.support.shells import ball
from tests.support.waiting import until


class NamedScene(str):
    """A scene of which there is but the name."""

    light = None


class EmptyWorld(FakeView):
    """A world that remembers what was done with it."""

    def __init__(self, scene, *, reserve=(), **options):
        super().__init__(scene=scene, reserve=tuple(reserve), light=None, added=[], told=[], adopted=None, closed=False)
        self.editor = self.registry = self
        if scene == "fails":
            raise BadInput("it fails on the device")
        if scene == "slow":
            raise Cancelled(quits=False)

    def draw_start(self):
        self.picture = "picture"

    def warm_up(self):
        assert self.picture

    def tell(self, text):
        self.told.append(text)

    @property
    def guests(self):
        return [asset for asset, _ in self.added]

    def prepared(self, asset, name):
        return asset, name

    def add(self, joining):
        asset, name = joining
        if asset == "large" and asset not in self.reserve:
            raise CapacityError("no capacity")
        self.added.append((asset, name))

    def snapshot(self):
        return f"state of {self.scene}"

    def adopt(self, snapshot):
        self.adopted = snapshot

    def close(self):
        self.closed = True


class Immediately:
    """An executor in place of a thread's."""

    def __init__(self, threads):
        pass

    def submit(self, work):
        done = Future()
        done.set_result(work())
        return done


class ScriptedDisplay:
    """Frames with these commands, one after the other; then it ends."""

    def __init__(self, *script):
        self.script, self.shown = list(script), []

    size = (32, 32)

    def loading(self, text, picture=None):
        assert not text and picture == "picture"

    def show_scene(self, scene, title, name):
        self.shown.append(scene)

    def frames(self, world):
        while self.script:
            yield Frame(0.01, 0.0, [], [], self.script.pop(0))


@pytest.fixture
def session(monkeypatch):
    """A session of the scene "one" with a display's script."""

    def begin(*script, **outputs):
        kinds = dict.fromkeys(("film", "recording", "study", "sound")) | {"keeper": SimpleNamespace(scene="")} | outputs
        return playing.Session(
            PlayOptions(scene="one", arch="cpu", state="no light of the user's"), NamedScene("one"),
            ScriptedDisplay(*script), **kinds, replay=None, world_options={}, preferences=Preferences(),
        )  # fmt: skip

    def load(options, replay=None):
        if options.scene == "broken":
            raise BadInput("broken: cannot be read")
        return NamedScene(options.scene if options.stage is None else f"{options.scene} in {options.stage}")

    monkeypatch.setattr("display.world.World", EmptyWorld)
    monkeypatch.setattr(playing, "load_scene", load)
    monkeypatch.setattr(playing, "end_taichi", lambda: None)
    monkeypatch.setattr(playing, "start_taichi", lambda arch, seed: None)
    monkeypatch.setattr("display.scene_bodies.load_bodies", lambda scene: None)
    monkeypatch.setattr(playing, "ThreadPoolExecutor", Immediately)
    monkeypatch.setattr("commands.opening.check_name", lambda name, playing: None)
    monkeypatch.setattr("commands.opening.is_asset", lambda name: True)
    return begin


def worlds_of(session) -> list:
    """The world of each frame."""
    return [session.world for _ in session.frames()]


def test_the_world_is_replaced_and_the_display_stays(session):
    play = session([Pause(True)], [OpenScene("two")], [SwapRoom("barn")], [], [])
    first = play.world
    frames = [(play.world.scene, [type(c) for c in frame.commands]) for frame in play.frames()]
    assert frames == [("one", [Pause]), ("one", []), ("two", []), ("two in barn", []), ("two in barn", [])]
    assert play.display.shown == ["two", "two in barn"] and first.closed and not play.world.closed
    assert play.keeper.scene == play.options.scene == "two" and play.options.stage == "barn"


@pytest.mark.parametrize(
    "name, said", [("broken", "broken: cannot be read"), ("fails", "it fails on the device"), ("slow", "Cancelled.")]
)
def test_where_a_scene_cannot_be_opened_the_present_one_plays_on(name, said, session):
    play = session([OpenScene(name)], [])
    first, *_, last = worlds_of(play)
    assert last.scene == "one" and last.told == [said] and play.options.scene == "one"
    if name != "broken":  # the first world was gone by then
        assert last is not first and last.adopted == "state of one"


def test_a_body_joins_and_a_large_one_in_a_larger_world_of_the_same_state(session):
    play = session([AddBody("/there/cat.h5"), AddBody("dog.h5")], [], [AddBody("large")], [], [])
    first, *_, last = worlds_of(play)
    assert first.added == [("/there/cat.h5", "cat"), ("dog.h5", "dog")]
    assert last.reserve == ("/there/cat.h5", "dog.h5", "large") and last.added == [("large", "large")]
    assert last.adopted == "state of one"


def test_a_length_sets_the_size_of_the_body_that_has_both_points(session, monkeypatch):
    """10 cm of it are 20 cm in truth; a smaller body beside the points, and a larger one around them, stay."""
    boxes = [((-1, 0, -1), (1, 2, 1)), ((0, 0, 0), (0.2, 0.2, 0.2)), ((0.15, 0, 0), (0.2, 0.05, 0.05))]
    bodies = [SimpleNamespace(low=np.array(low, float), high=np.array(high, float)) for low, high in boxes]
    applied = []
    monkeypatch.setattr(EmptyWorld, "bodies", lambda self: bodies, raising=False)
    monkeypatch.setattr(EmptyWorld, "apply", lambda self, commands: applied.extend(commands), raising=False)
    worlds_of(session([Measure((0.05, 0.1, 0.1), (0.15, 0.1, 0.1), 0.2)], []))
    (rescale,) = applied
    assert rescale.body == 1 and rescale.factor == pytest.approx(2.0)


def test_a_length_in_the_room_is_written_to_its_file_and_the_scene_begins_anew(session, monkeypatch, tmp_path):
    """Of no room of the user's it is refused in one line."""
    path, same = tmp_path / "room.h5", np.eye(4)
    leaning_room(np.eye(3)).save(path)
    before = Asset.load(path)
    own = Body(str(path))
    monkeypatch.setattr(EmptyWorld, "bodies", lambda self: [], raising=False)
    monkeypatch.setattr(EmptyWorld, "room", SimpleNamespace(own=own, pose=same, kept=same), raising=False)
    first, *_, last = worlds_of(session([Measure((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.6)], [], []))
    after = Asset.load(path)
    assert last is not first and last.scene == "one"
    sizes = [np.ptp(a.gaussians.means, axis=0) for a in (before, after)]
    np.testing.assert_allclose(sizes[1], 1.2 * sizes[0], rtol=1e-4)
    assert after.environment.clear_radius == pytest.approx(1.2 * before.environment.clear_radius)
    monkeypatch.setattr(EmptyWorld, "room", SimpleNamespace(own=None), raising=False)
    (world, *_) = worlds_of(session([Measure((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), 0.6)], []))
    assert world.told == ["Both points on one body set its size; a room must be your own (--stage) for that."]


@pytest.mark.parametrize("output", ["recording", "study"])
def test_what_belongs_to_one_scene_keeps_it(output, session):
    recording = SimpleNamespace(note=lambda frame: frame)
    play = session([OpenScene("two")], [AddBody("cat.h5")], [], **{output: recording})
    assert {world.scene for world in worlds_of(play)} == {"one"}
    assert play.world.told == [f"Nothing else can be opened during a {output}."] * 2 and not play.world.added


def test_a_scene_file_is_opened_only_if_the_command_line_named_it():
    options = PlayOptions(scene="mine.py")
    assert opened_options(OpenScene("mine.py"), options).scene == "mine.py"
    with pytest.raises(BadInput, match=r"no scene named 'evil\.py'"):
        opened_options(OpenScene("evil.py"), options)


@pytest.fixture
def preparing(monkeypatch, tmp_path):
    """An opening of a splat, which a function of this module prepares."""
    monkeypatch.setattr("commands.opening.is_prepared", lambda path, options, room: False)
    monkeypatch.setattr(opening, "running_arch", lambda: "cpu")

    def begin(function):
        monkeypatch.setattr(opening, "prepare_into_cache", function)
        splat = tmp_path / "cat.ply"
        splat.write_bytes(b"ply")
        return Opening(AddBody(str(splat)), PlayOptions())

    return begin


def hollow(path, room, arch, reports) -> None:
    reports.send(("step", "orient", 0.25))
    time.sleep(1.0)
    reports.send(("problem", "cat.ply: is hollow"))


def endless(path, room, arch, reports) -> None:
    time.sleep(600)


def broken(path, room, arch, reports) -> None:
    sys.exit(3)


def test_a_preparation_tells_its_progress_and_why_it_failed(preparing):
    request = preparing(hollow)
    assert not request.poll()
    until(lambda: request.poll() or "orient 25%" in request.text)
    assert request.text.startswith("Preparing cat.ply: orient 25%, ")
    with pytest.raises(BadInput, match=r"^cat\.ply: is hollow$"):
        until(request.poll)


def test_a_preparation_that_ends_without_a_word_has_failed(preparing):
    request = preparing(broken)
    with pytest.raises(BadInput, match="ended abnormally"):
        until(request.poll)


def test_a_preparation_that_is_cancelled_ends_at_once(preparing):
    request = preparing(endless)
    assert not request.poll()
    process = request._now._process
    request.close()
    assert process.exitcode is not None


def test_a_file_is_prepared_into_the_cache_by_a_process(tmp_path, monkeypatch):
    """The real one: a ball, with its progress; then it is found there."""
    monkeypatch.setenv("VRGS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(opening, "running_arch", lambda: "cpu")
    monkeypatch.setattr(opening, "is_prepared", lambda path, options, room: False)
    write_gaussians(tmp_path / "ball.ply", ball(800))
    request, said = Opening(AddBody(str(tmp_path / "ball.ply")), PlayOptions(arch="cpu")), set()
    until(lambda: request.poll() or said.add(request.text), 120.0)
    assert any("%, " in line for line in said) and list((tmp_path / "cache").rglob("*.h5"))


def test_cancelling_gives_up_what_waits(session):
    play = session([CancelOpening()], [])
    worlds_of(play)
    assert play.world.told == []


def test_nothing_is_compiled_after_the_first_picture_without_a_display(ti_cpu, monkeypatch):
    from display.world import World

    step, seen = World.step, []

    def watched(self, frame):
        with compiled() as names:
            step(self, frame)
        seen.append(names)

    monkeypatch.setattr(World, "step", watched)
    assert vrgs.main(["--headless", "--scene", "sandbox", "--frames", "3", "--size", "64x48", "--arch", "cpu"]) == 0
    assert seen == [[], [], []]
