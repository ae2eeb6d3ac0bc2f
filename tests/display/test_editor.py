"""Copies, sizes, turns and undo in a running world: bodies and picture stay one, the game does not notice; marks."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace as N

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from core.vocabulary import BodyState, Hand, Light
from display import user_commands as cmd
from display.edit import selection_marker as marking
from display.edit.body_registry import FULL_NOTICE as FULL
from display.edit.editor import COPY_GAP, Editor, Step, UndoStack, body_with, copy_offset
from display.edit.selection_marker import marked, strokes
from display.xr import avatar
from scenes.dining_table import RING_MATERIAL as RUBBER
from tests.support.edited_play import BLUE, DT, RED, Play, equal


@pytest.fixture(scope="module")
def shared(ti_cpu) -> Play:
    return Play()


@pytest.fixture
def play(shared) -> Play:
    world = shared.world
    shared.do(cmd.Reset(), cmd.SetInteraction("physics"), cmd.SetLight(world.scene.light))
    shared.do(cmd.SetGravity(world.scene.gravity), cmd.SetTimeScale(1.0))
    shared.world.editor.history.done.clear()
    shared.world.editor.history.undone.clear()
    shared.do(cmd.Select(None))
    shared.step()
    return shared


def test_a_world_at_rest_draws_nothing_and_undo_finds_it_asleep(play, monkeypatch):
    play.step(150)
    world, motion = play.world, play.motion()
    assert world.stats()["asleep"] == 2 and not world.moving and world.stats()["substeps"] == 0
    cost = world.simulation_cost
    for part, name in ((world.device, "deform"), (world.device, "cast_shadow"), (world.device, "render")):
        monkeypatch.setattr(part, name, None)
    play.step(10, Hand((0.0, 0.5, 0.0)))
    equal(motion, play.motion())
    assert cost == world.simulation_cost > 0.0  # it is what the next throw will cost
    monkeypatch.undo()
    play.step(1, Hand((0.15, 0.02, 0.08), grip=True))
    for k in range(10):
        play.step(1, Hand((0.15, 0.02 + 0.003 * k, 0.08), grip=True))
    assert world.moving and world.stats()["asleep"] == 1
    play.do(cmd.Undo())
    equal(motion, play.motion())
    play.step()
    assert world.stats()["asleep"] == 2
    equal(motion, play.motion())
    play.step(5, cmd.SetGravity((0.0, 1.0, 0.0)))  # wakes all
    assert world.stats()["asleep"] == 0 and min(b.velocity[1] for b in world.bodies()) > 0.0
    play.do(cmd.Undo())
    assert world.gravity == world.scene.gravity


def test_undo_of_a_move_brings_back_motion_picture_and_score_bit_for_bit(play):
    play.step(3)
    motion, picture, score, time = play.motion(), play.picture(), play.world.score, play.world.time
    play.step(1, Hand((0.15, 0.02, 0.08), grip=True))
    for k in range(6):
        play.step(1, Hand((0.15, 0.02 + 0.03 * k, 0.08), grip=True))
    assert play.world.bodies()[BLUE].held and play.world.selected == BLUE
    play.step(2)
    thrown = play.motion()
    assert (play.picture() != picture).any()
    play.do(cmd.Undo())
    equal(motion, play.motion())
    assert_array_equal(play.picture(), picture)
    assert (play.world.score, play.world.time) == (score, time)
    play.do(cmd.Redo())
    equal(thrown, play.motion())
    play.do(cmd.Undo())
    equal(motion, play.motion())
    play.do(cmd.Undo())
    equal(motion, play.motion())
    assert play.world.notice == "Nothing to undo."


def test_a_hand_that_takes_nothing_is_no_action(play):
    play.step(2, Hand((0.0, 1.0, 0.0), grip=True))
    assert play.world.editor.history.done == []


def test_a_copy_looks_like_its_original_and_stands_above_it(play):
    before, gaussians = play.picture(), play.world.device.splats.count
    own = play.world.device.gaussian_counts[BLUE]
    play.do(cmd.Duplicate(BLUE))
    world = play.world
    assert world.device.splats.count == gaussians + own and len(world.bodies()) == 3 and world.selected == 2
    original, copy = world.bodies()[BLUE], world.bodies()[2]
    aside = copy.centroid - original.centroid
    assert copy.name == original.name and copy.low[1] > original.high[1]
    assert_allclose(play.shown(2), play.shown(BLUE) + aside, atol=2e-6)
    a, b = world.device.embedding.spans[BLUE].gaussian, world.device.embedding.spans[2].gaussian
    for one, other in zip(world.device.splats.read(a, own), world.device.splats.read(b, own), strict=True):
        assert_array_equal(one, other)
    assert_allclose(
        world.device.splats.cov.to_numpy()[b : b + own], world.device.splats.cov.to_numpy()[a : a + own], atol=1e-9
    )
    blue = lambda p: ((p[..., 2].astype(int) - p[..., 0]) > 60).sum()  # noqa: E731
    assert blue(play.picture()) > 1.25 * blue(before)
    play.step(30)
    assert 0 < world.bodies()[2].low[1] < original.high[1] + 0.02  # it lies on the other one


def test_the_frame_of_an_edit_deforms_and_casts_once(play, monkeypatch):
    """Also when nothing moves in it: what is undone is seen at once."""
    device, calls = play.world.device, []

    def counted(name):
        part = getattr(device, name)
        monkeypatch.setattr(device, name, lambda *a: (calls.append(name), part(*a)))

    play.step(150)
    for name in ("deform", "cast_shadow", "render"):
        counted(name)
    before = play.picture()
    for command in (cmd.Duplicate(RED), cmd.Undo()):
        calls.clear()
        play.step(1, command)
        assert calls == ["deform", "cast_shadow", "render"]
        assert (play.picture() != before).any() == (command != cmd.Undo())


def test_a_cpu_casts_the_shadows_of_what_moves_in_every_second_frame_and_once_more_at_the_end(play, monkeypatch):
    device, casts = play.world.device, []
    cast, visibility = device.cast_shadow, device.splats.visibility
    play.step(150)
    monkeypatch.setattr(device, "cast_shadow", lambda: (casts.append(1), cast()))
    play.step(1, Hand((0.15, 0.02, 0.08), grip=True))
    casts.clear()
    for k in range(10):
        play.step(1, Hand((0.15, 0.02 + 0.003 * k, 0.08), grip=True))
    assert play.world.moving and len(casts) == (10 if device.shadow.on_gpu else 5)
    play.step(150)
    shown = visibility.to_numpy()
    cast()
    assert not play.world.moving
    assert_array_equal(visibility.to_numpy(), shown)


def test_the_game_sees_the_scenes_own_bodies_only(play):
    play.do(cmd.Duplicate(RED))
    play.do(cmd.Remove(RED))
    play.step()
    names, places = zip(*play.world.scene.game.seen, strict=True)
    assert names == ("ring_red", "ring_blue") and places[RED][0] > 100.0
    assert_allclose(places[BLUE], play.world.bodies()[0].centroid)
    assert len(play.world.bodies()) == 2


def test_what_is_taken_away_is_not_drawn_and_comes_back(play):
    before, motion = play.picture(), play.motion()
    play.do(cmd.Remove(BLUE))
    assert len(play.world.bodies()) == 1
    picture = play.picture()
    assert ((picture[..., 2].astype(int) - picture[..., 0]) > 60).sum() == 0
    play.do(cmd.Remove(0))
    assert play.world.bodies() == [] and (play.picture()[..., :3] == 0).all()
    play.step(2)
    play.do(cmd.Undo())
    play.do(cmd.Undo())
    equal(motion, play.motion())
    assert_array_equal(play.picture(), before)


def test_a_body_grows_with_its_gaussians_and_stays_on_the_floor(play):
    play.step(20)
    before, cov, foot = play.shown(BLUE), play.world.device.splats.cov.to_numpy(), play.world.bodies()[BLUE]
    first, count = play.world.device.embedding.spans[BLUE].gaussian, play.world.device.gaussian_counts[BLUE]
    about = np.array([foot.centroid[0], foot.low[1], foot.centroid[2]])
    for factor, size in ((1.5, 1.5), (1.4, 2.1)):
        play.do(cmd.Rescale(BLUE, factor))
        assert_allclose(play.shown(BLUE), about + size * (before - about), atol=2e-5)
        now = play.world.device.splats.cov.to_numpy()[first : first + count]
        assert_allclose(now, size**2 * cov[first : first + count], rtol=1e-3, atol=1e-8)
        assert_allclose(play.world.bodies()[BLUE].low[1], foot.low[1], atol=1e-5)
    play.do(cmd.Rescale(BLUE, 4.0))
    assert play.world.notice == FULL
    play.step()
    play.do(cmd.Undo())
    assert_allclose(play.shown(BLUE), before, atol=2e-6)
    play.do(cmd.Rescale(BLUE, 0.05))
    play.do(cmd.Rescale(BLUE, 0.05))
    assert_allclose(play.world.device.solver.body_models[BLUE].shape.factor, 0.2)
    assert play.world.notice == "It is as small as it can be."


def test_a_body_is_turned_and_stays_on_the_floor(play):
    play.step(20)
    before = play.world.bodies()[BLUE]
    play.do(cmd.Rotate(BLUE, (np.cos(0.5), np.sin(0.5), 0.0, 0.0)))
    after = play.world.bodies()[BLUE]
    assert_allclose(np.abs(before.axis @ after.axis), np.cos(1.0), atol=0.02)
    assert_allclose(after.low[1], before.low[1], atol=1e-5)
    assert after.high[1] > before.high[1] + 0.05


def test_a_drag_is_one_action_two_keys_are_two(play):
    for _ in range(4):
        play.do(cmd.Rescale(RED, 1.02))
    for _ in range(3):
        play.step()
    play.do(cmd.Rescale(RED, 1.1))
    light = play.world.light
    for k in range(5):
        play.do(cmd.SetLight(Light((0.1 * k, 2.0, 0.0))))
    assert [s.action for s in play.world.editor.history.done] == ["rescale", "rescale", "light"]
    motion = play.motion()
    play.do(cmd.Undo())
    assert play.world.light == light
    equal(motion, play.motion())  # the light alone went back
    play.do(cmd.Undo())
    assert_allclose(play.world.device.solver.body_models[RED].shape.factor, 1.02**4)


def test_a_drag_of_a_slider_is_one_action_however_long_it_rests(play):
    world, materials = play.world, [replace(RUBBER, young=1e5 + 1e4 * k) for k in range(3)]
    for k in range(3):
        play.do(cmd.SetMaterial(RED, materials[k], k > 0))
        play.step(3)
    for k in range(3):
        play.do(cmd.SetGravity((0.0, -1.0 - k, 0.0), k > 0))
        play.step(3)
    assert [s.action for s in world.editor.history.done] == ["material", "gravity"]
    play.do(cmd.Undo())
    assert world.gravity == world.scene.gravity and world.material(RED)[0] == materials[2]
    play.do(cmd.Undo())
    assert world.material(RED)[0] == RUBBER


def test_materials_are_named_and_what_is_changed_is_said(play):
    world = play.world
    assert world.material(RED) == (RUBBER, "silicone")
    play.do(cmd.SetMaterial(RED, replace(RUBBER, friction=0.1)))
    assert world.material(RED)[1] == "silicone, changed" and world.material(BLUE)[1] == "silicone"
    play.do(cmd.SetMaterial(RED, "jelly"))
    play.do(cmd.Duplicate(RED))
    assert world.material(RED)[1] == world.material(2)[1] == "jelly"
    play.do(cmd.SetMaterial(2, replace(world.material(2)[0], young=9e3)))
    assert world.material(2)[1] == "jelly, changed"
    play.do(cmd.Undo())
    assert world.material(2)[1] == "jelly"


def test_time_passes_more_slowly(play):
    world = play.world
    play.do(cmd.SetTimeScale(0.25))
    play.step(4)
    assert_allclose(world.time, 2 * DT)  # one frame of the fixture, and a quarter of four
    play.do(cmd.SetTimeScale(0.0))
    assert world.time_scale == cmd.MIN_TIME_SCALE
    play.do(cmd.Undo())
    assert world.time_scale == 0.25


@pytest.mark.parametrize("end", ["script", "grip", "reset", "key"])
def test_a_demonstration_ends_with_its_script_a_grip_or_a_reset(play, monkeypatch, end):
    world, grip = play.world, Hand((0.15, 0.02, 0.08), grip=True)
    monkeypatch.setattr(world.scene.game, "duration", 4.5 * DT)
    monkeypatch.setattr(world.scene.game, "interaction", lambda time: "transform", raising=False)
    play.do(cmd.PlayDemo(True))
    play.step(4)
    assert world.demo and world.interaction == "transform"
    play.step(2, *{"script": [], "grip": [grip], "reset": [cmd.Reset()], "key": [cmd.PlayDemo(False)]}[end])
    assert not world.demo and world.interaction == "physics"
    play.step(2, *([grip] if end == "grip" else []))
    assert world.bodies()[BLUE].held == (end == "grip")
    assert play.world.time < 9 * DT if end != "reset" else play.world.time < 5 * DT


def test_a_body_is_put_elsewhere_and_rests_there(play):
    play.step(2)
    before = play.world.bodies()[RED]
    half_turn = (0.0, 0.0, 0.0, 1.0)
    for k in range(4):
        play.do(cmd.Place(RED, (0.0, 0.1, 0.05), half_turn if k == 0 else (1.0, 0.0, 0.0, 0.0), k > 0))
    after = play.world.bodies()[RED]
    assert_allclose(after.centroid - before.centroid, (0.0, 0.4, 0.2), atol=1e-4)
    assert_allclose(after.axis, -before.axis, atol=1e-3)
    assert_allclose(after.velocity, 0.0, atol=1e-6)
    assert [s.action for s in play.world.editor.history.done] == ["place"]


def test_live_changes_are_replayed_bit_for_bit_from_their_recording(play):
    commands = {
        1: [cmd.SetMaterial(RED, replace(RUBBER, young=1e5))],
        2: [cmd.SetMaterial(RED, replace(RUBBER, young=2e5), continued=True), cmd.SetGravity((0.0, -1.6, 0.0))],
        4: [cmd.SetTimeScale(0.3), cmd.Place(BLUE, (0.0, 0.1, 0.02), (0.9, 0.1, 0.0, 0.0))],
        5: [cmd.SetTimeScale(0.4, continued=True), cmd.Place(BLUE, (0.0, 0.05, 0.0), continued=True)],
        8: [cmd.Undo()],
    }
    ends = []
    for read in (
        lambda k, given: given,
        lambda k, given: cmd.commands_from_text(cmd.commands_to_text(k, given), "x")[1],
    ):
        play.do(cmd.Reset(), cmd.SetGravity(play.world.scene.gravity), cmd.SetTimeScale(1.0))
        for k in range(10):
            play.step(1, *read(k, commands.get(k, [])))
        ends.append((play.motion(), play.world.time, play.world.gravity, play.world.material(RED)))
    equal(ends[0][0], ends[1][0])
    assert ends[0][1:] == ends[1][1:] and ends[0][3][1] == "silicone, changed"


def test_reset_gives_the_scene_and_can_be_taken_back(play):
    start = play.motion()
    play.do(cmd.Duplicate(RED))
    play.do(cmd.Rescale(BLUE, 1.5))
    play.do(cmd.SetMaterial(RED, "jelly"))
    play.do(cmd.Remove(RED))
    play.step(3)
    changed = play.motion()
    play.do(cmd.Reset())
    play.step()
    equal(start, play.motion())
    assert not play.world.registry.changed
    play.do(cmd.Undo())
    equal(changed, play.motion())
    assert [p.body.name for p in play.world.device.solver.body_models] == ["ring_blue", "ring_red"]
    assert play.world.device.solver.body_models[0].shape.factor == 1.5


def test_a_held_body_can_be_scaled_and_copied_in_transform_mode(play):
    hand = Hand((0.15, 0.02, 0.08), grip=True)
    play.do(cmd.Reset(), cmd.SetInteraction("transform"))
    play.step(1, hand)
    play.step(1, Hand((0.15, 0.3, 0.08), grip=True))
    high = play.world.bodies()[BLUE]
    assert high.held and high.low[1] > 0.25
    play.step(1, Hand((0.15, 0.3, 0.08), grip=True), cmd.Rescale(BLUE, 1.5))
    larger = play.world.bodies()[BLUE]
    assert larger.held
    assert_allclose(larger.centroid, high.centroid, atol=1e-5)
    play.step(1, Hand((0.25, 0.3, 0.08), grip=True), cmd.Duplicate(None))
    assert_allclose(play.world.bodies()[BLUE].centroid - larger.centroid, [0.1, 0.0, 0.0], atol=1e-5)
    copy = play.world.bodies()[2]
    assert not copy.held and copy.low[1] > larger.high[1] - 1e-4
    play.step(5)
    assert_allclose(play.world.bodies()[2].centroid, copy.centroid, atol=1e-6)  # time stands still


def test_a_held_body_follows_the_hand_through_changes_of_its_size(play):
    """A change in each frame of a drag: none of the hand's way is lost, and all of it is one action."""
    play.do(cmd.Reset(), cmd.SetInteraction("transform"))
    play.step(1, Hand((0.15, 0.02, 0.08), grip=True))
    motion, count = play.motion(), len(play.world.editor.history.done)
    start = play.world.bodies()[BLUE]
    for k in range(1, 6):
        play.step(1, Hand((0.15 + 0.02 * k, 0.02 + 0.05 * k, 0.08), grip=True), cmd.Rescale(BLUE, 1.1))
        body = play.world.bodies()[BLUE]
        assert body.held
        grown, before = body.high - body.low, start.high - start.low
        assert_allclose(grown, 1.1**k * before, rtol=1e-3)
        assert_allclose(body.centroid - start.centroid, [0.02 * k, 0.05 * k, 0.0], atol=1e-5)
    assert len(play.world.editor.history.done) == count + 1
    play.do(cmd.SetInteraction("physics"))
    play.step(75)  # it bounces thrice
    rest = play.world.bodies()[BLUE]
    assert_allclose((rest.high - rest.low)[[0, 2]], grown[[0, 2]], rtol=0.05)  # it is that large, and lies on the floor
    assert 0.0 < rest.low[1] + 5e-3 < 0.03 and np.abs(rest.velocity).max() < 0.2
    play.do(cmd.Undo())
    equal(motion, play.motion())


def test_when_the_room_is_used_up_it_is_said_and_nothing_changes(play):
    from taichi.lang import impl

    trees = None
    for _ in range(40):
        play.do(cmd.Duplicate(RED))
        if play.world.notice == FULL:
            break
        trees = trees or impl.get_runtime().prog.get_snode_tree_size()
    assert play.world.notice == FULL
    assert 6 <= len(play.world.bodies()) < 40
    assert impl.get_runtime().prog.get_snode_tree_size() == trees
    motion, picture, steps = play.motion(), play.picture(), len(play.world.editor.history.done)
    play.do(cmd.Duplicate(RED))
    equal(motion, play.motion())
    assert_array_equal(picture, play.picture())
    assert len(play.world.editor.history.done) == steps
    play.do(cmd.Remove(RED))
    play.do(cmd.Duplicate(0))
    assert len(play.world.bodies()) == len(motion[0]) // len(play.world.device.solver.body_models[0].shape.vertices)


@pytest.mark.parametrize(
    "command",
    [
        *(cmd.Duplicate(7), cmd.Duplicate(None), cmd.Remove(-1), cmd.Select(9), cmd.SetMaterial(0, "unobtainium")),
        *(cmd.Rescale(0, 0.0), cmd.Rescale(0, float("nan")), cmd.Rotate(0, (0.0, 0.0, 0.0, 0.0))),
        *(cmd.Place(0, (float("nan"), 0.0, 0.0)), cmd.Place(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))),
    ],
)
def test_what_cannot_be_is_said_in_one_line(play, command):
    motion, steps = play.motion(), len(play.world.editor.history.done)
    play.do(command)
    assert play.world.notice and "\n" not in play.world.notice
    equal(motion, play.motion())
    assert len(play.world.editor.history.done) == steps


def test_a_body_of_the_users_joins_over_the_play_and_can_be_taken_back(play):
    """It falls onto what lies there, looks as its asset does, compiles nothing, and no game sees it."""
    from tests.support.compiling import compiled

    play.do(cmd.Duplicate(RED))  # compiles what copies need
    play.do(cmd.Reset())
    world, before = play.world, play.motion()
    with compiled() as kernels:
        world.editor.begin_frame()
        world.editor.add(world.editor.prepared("ball", "my ball"))
        play.step(2)
    assert kernels == []
    new = world.bodies()[2]
    assert new.name == "my ball" and world.selected == 2 and len(world.scene.game.seen) == 2
    assert all(
        new.low[1] > b.high[1] or (new.low > b.high).any() or (new.high < b.low).any() for b in world.bodies()[:2]
    )
    means = play.shown(2)
    assert (means.min(0) > new.low - 0.01).all() and (means.max(0) < new.high + 0.01).all()
    play.do(cmd.Undo())
    assert len(world.bodies()) == 2 and world.device.splats.count == world.device.first + sum(
        world.device.gaussian_counts[:2]
    )
    equal(before, play.motion())
    play.do(cmd.Redo())
    assert [b.name for b in world.bodies()][2:] == ["my ball"]
    play.do(cmd.Reset())
    assert len(world.bodies()) == 2


def test_a_body_that_was_read_on_a_thread_joins_without_being_measured(play, monkeypatch):
    """Nothing that takes longer than a frame is left to do then."""

    def late(*_, **__):
        raise AssertionError("too late")

    play.do(cmd.SetMaterial(RED, "rubber"))  # so stiff that the other integrator takes over, and knows the rings
    editor = play.world.editor
    with ThreadPoolExecutor(1) as thread:
        joining = thread.submit(editor.prepared, "ball", "my ball").result()
    for name in (
        "sim.embedding.pack", "assets.asset.Asset.load", "sim.contact.contact_samples.surface_points",
        "sim.contact.contact_samples.skin_depth", "sim.elastic.modal_correction.lattice_motions",
        "sim.elastic.vbd.color_vertices",
    ):  # fmt: skip
        monkeypatch.setattr(name, late)
    editor.begin_frame()
    editor.add(joining)
    play.step(2)
    play.do(cmd.SetMaterial(2, "rubber"))
    assert not play.world.notice and [b.name for b in play.world.bodies()][2:] == ["my ball"]
    play.do(cmd.Reset())


def test_the_oldest_steps_are_forgotten_and_a_new_action_ends_what_could_be_done_again():
    history = UndoStack(steps=5)
    for k in range(20):
        history.add(Step("set", k))
    assert [step.state for step in history.done] == [15, 16, 17, 18, 19]
    assert history.back(lambda action: Step(action, 20)).state == 19 and len(history.undone) == 1
    history.add(Step("set", 7))
    assert history.undone == [] and history.forth(Step) is None


def test_steps_that_take_too_much_are_forgotten_but_what_is_shared_counts_once():
    history, shared = UndoStack(steps=100, size=1000), object()
    for _ in range(20):
        own = object()
        history.add(Step("move", own, {id(own): 100, id(shared): 300}))
        assert history.bytes <= 1000
    assert len(history.done) == 7
    huge = object()
    history.add(Step("move", huge, {id(huge): 5000}))
    assert history.done == [] and history.bytes == 0


# The marker of the selected body


def body(held=False, high=(0.2, 0.1, 0.3)):
    return N(low=np.zeros(3), high=np.array(high), held=held)


def world(selected=0, chosen=False, **how):
    return N(selected=selected, recently_selected=chosen, bodies=lambda: [body(**how)])


def test_it_is_marked_when_it_was_chosen_or_an_edit_is_near():
    assert marked(world(), near=False) is None
    assert marked(world(chosen=True), near=False) is not None
    assert marked(world(), near=True) is not None
    for other in (world(selected=None), world(selected=3), world(held=True), world(high=(np.nan, 1, 1))):
        assert marked(other, near=True) is None


def test_strokes_go_along_the_edges_of_a_box_around_the_body():
    found = strokes(body())
    assert found.shape == (24, 2, 3)
    low, high = -marking.CORNER_GAP, np.array([0.2, 0.1, 0.3]) + marking.CORNER_GAP
    assert (found >= low - 1e-9).all() and (found <= high + 1e-9).all()
    along = np.abs(found[:, 1] - found[:, 0])
    assert (np.count_nonzero(along > 1e-9, axis=1) == 1).all()
    assert_allclose(along.max(1), marking.MAX_STROKE)
    assert len(np.unique(found[:, 0].round(6), axis=0)) == 8


def test_the_headset_shows_the_same_strokes():
    parts = avatar.hidden()
    avatar.show_corners(parts, body())
    ends = np.einsum("kij,sj->ksi", parts[avatar.CORNERS :], np.column_stack([np.eye(3), np.ones(3)])).reshape(-1, 3)
    assert_allclose(ends, strokes(body())[:, 1], atol=1e-12)
    assert np.isnan(parts[: avatar.CORNERS]).all()


def test_commands_choose_for_a_moment(monkeypatch):
    now = [10.0]
    monkeypatch.setattr("display.edit.editor.monotonic", lambda: now[0])
    editor = Editor(None, N(members=(None, None)))
    editor.apply([cmd.Undo()])
    assert not editor.recently_selected
    editor.apply([cmd.Select(1)])
    assert editor.recently_selected
    now[0] += marking.MARKED_SECONDS + 0.1
    assert not editor.recently_selected


@pytest.mark.parametrize("driven", [False, True])
def test_a_copy_is_put_in_the_nearest_free_place_above_or_beside_an_animated_body(driven):
    def state(x, y, z, **more) -> BodyState:
        low = np.array([x, y, z], float)
        return BodyState("box", low + 0.05, np.zeros(3), low, low + 0.1, np.array([0.0, 1, 0]), False, **more)

    def free(offset, bodies) -> bool:
        low, high = bodies[0].low + offset, bodies[0].high + offset
        return not any((low < b.high).all() and (high > b.low).all() for b in bodies)

    ways = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]] if driven else [[0, 1, 0]])
    for seed in range(20):
        rng = np.random.default_rng(seed)
        others = 0.11 * rng.integers(-2, 3, (6, 3)) + rng.uniform(0, 0.01, (6, 3))
        bodies = [state(0, 0, 0, driven=driven), *(state(*at) for at in others)]
        offset = copy_offset(0, bodies)
        steps = np.abs(offset).max() / (0.1 + COPY_GAP)
        assert free(offset, bodies) and steps == pytest.approx(round(steps))
        nearer = [s * (0.1 + COPY_GAP) * way for s in range(1, round(steps)) for way in ways]
        assert not any(free(at, bodies) for at in nearer), "there was a nearer place"


def test_of_bodies_within_one_another_the_smallest_that_holds_all_points_is_meant():
    def state(size) -> BodyState:
        half = np.full(3, size / 2)
        return BodyState("box", np.zeros(3), np.zeros(3), -half, half, np.array([0.0, 1, 0]), False)

    for order in ((0.3, 0.1, 0.2), (0.1, 0.2, 0.3), (0.3, 0.2, 0.1)):
        bodies, rng = [state(size) for size in order], np.random.default_rng(0)
        for size in order:
            points = [0.45 * size * np.sign(rng.normal(size=3)), np.zeros(3)]
            assert order[body_with(points, bodies)] == size
        assert body_with([np.zeros(3), np.full(3, 0.3)], bodies) is None
