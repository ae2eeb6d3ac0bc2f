"""A captured room: what cameras need, what holds an object, where the player stands, stages that go on."""

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from assets.asset import Asset, Cage
from assets.environment import Environment
from assets.gaussians import Gaussians, concatenate
from assets.room_folder import RoomObject
from bench.physics import box
from core.camera import look_at, perspective
from core.distance_grid import DistanceGrid
from core.errors import BadInput
from core.material import MATERIALS
from prepare.inpaint.inpaint_pipeline import NoSurface
from prepare.progress import no_progress
from prepare.room_capture import room_pipeline
from prepare.room_capture import stages as stages_module
from prepare.room_capture.captured_background import RoomView, room_extent, view_of
from prepare.room_capture.contributions import Contributions, contributions, needed
from prepare.room_capture.objects import base_of, object_files, seated, support_of, without_solid
from prepare.room_capture.room_pipeline import MeasuredLength, PlacedRoom, held_objects, inpainted, without_objects
from prepare.room_capture.stages import Stages, source_digest
from prepare.standing import bent_by_weight, liftable, steady
from prepare.train.capture import Capture
from sim.contact.contact_samples import skin_depth, surface_points
from tests.support.samples import discs


def plane(axis: int, at: float) -> Gaussians:
    """A square plane of 2 m across an axis."""
    u = np.linspace(-1, 1, 41)
    points = np.insert(np.stack(np.meshgrid(u, u), -1).reshape(-1, 2), axis, at, axis=1)
    return discs(points)


def ball(centre, radius=0.15) -> Gaussians:
    x = np.random.default_rng(0).normal(size=(400, 3))
    return discs(centre + radius * x / np.linalg.norm(x, axis=1, keepdims=True))


def test_what_stands_what_hangs_and_what_nothing_holds():
    on_floor = support_of(ball((0.2, 0.15, 0.0)), plane(1, 0.0))
    assert on_floor.stands and on_floor.direction @ [0, 1, 0] == 1.0
    in_corner = support_of(ball((0.0, 0.15, 0.15)), concatenate([plane(1, 0.0), plane(2, 0.0)]))
    assert in_corner.stands
    on_wall = support_of(ball((0.0, 1.0, 0.15)), plane(2, 0.0))
    assert not on_wall.stands and on_wall.direction @ [0, 0, 1] > 0.98
    face = discs(np.random.default_rng(0).normal((0.145, 0.17, 0.0), 0.003, (900, 3)), 0.002)  # over no foot
    narrow = concatenate([ball((0.0, 0.15, 0.0)), face])
    assert support_of(narrow, plane(1, 0.0)).stands, "what stands on its middle stands, whatever its details"
    with pytest.raises(BadInput, match="touches nothing"):
        support_of(ball((0.0, 1.0, 0.0)), plane(1, 0.0))


def room_of(*things: Gaussians) -> PlacedRoom:
    """A floor with things on it."""
    rest = plane(1, 0.0)
    ids = np.repeat(np.arange(1 + len(things)), [len(rest), *map(len, things)]).astype(np.uint16)
    g = replace(concatenate([rest, *things]), object_id=ids, objects=("dot", "ball", "unseen")[: len(things)])
    return PlacedRoom(g, np.ones(len(g)), RoomView(ring_of_cameras(1.4), np.full(12, 1.8), True), None)


def test_an_object_of_too_few_gaussians_or_in_the_air_stays_in_the_background():
    dot, large, nothing = ball((0.5, 0.15, 0.0)).select(slice(5)), ball((0.0, 0.15, 0.0)), discs(np.zeros((0, 3)))
    said = []
    room, held = held_objects(room_of(dot, large, nothing), said.append)
    assert room.names == ["ball"] and len(held) == 1 and held[0].stands
    things, rest = room.parts()
    assert len(things[0]) == len(large) and len(rest) == len(plane(1, 0.0)) + len(dot)
    assert [line.split(":")[0] for line in said] == [f"{name} stays in the background" for name in ("dot", "unseen")]
    room = without_objects(room_of(dot, large), {"dot": "it has no cage"}, said.append)
    assert room.names == ["ball"] and said[-1] == "dot stays in the background: it has no cage"
    room, held = held_objects(room_of(ball((0.0, 1.0, 0.0)), large), said.append)
    assert room.names == ["ball"] and len(held) == 1 and "dot stays in the background: touches nothing" in said[-1]
    with pytest.raises(BadInput, match="dot: only 5 opaque"):
        held_objects(room_of(dot), said.append)


def test_what_an_object_hid_stays_open_where_no_surface_goes_on_behind_it(monkeypatch):
    """The dot is on a thing of which no plane was found; the ball's hole is closed all the same."""

    def find_hole(drawing, rest, thing, cameras, *, name, **options):
        if name == "dot":
            raise NoSurface(f"{name}: no surface was found")
        return SimpleNamespace(name=name, background=concatenate([rest, thing]), textures=[])

    pipeline = "prepare.inpaint.inpaint_pipeline"
    monkeypatch.setattr(f"{pipeline}.drawing_of", lambda *_: nullcontext())
    monkeypatch.setattr(f"{pipeline}.find_hole", find_hole)
    monkeypatch.setattr(f"{pipeline}.take_shadow", lambda drawing, holes, *_: holes)
    monkeypatch.setattr(f"{pipeline}.paint_hole", lambda hole, *_: hole)
    monkeypatch.setattr(f"{pipeline}.close_holes", lambda drawing, background, *_: background)
    things, said = [ball((x, 0.15, 0.0)) for x in (0.0, 0.6)], []
    rest = inpainted(room_of(*things), lambda *part: no_progress, said.append)
    assert len(rest) == len(plane(1, 0.0)) + len(things[1])
    assert said == ["what it hid stays open: dot: no surface was found"]


def test_what_no_photograph_needs_is_left_out(ti_cpu):
    """A plane, one Gaussian behind it, and one before each camera's lens."""
    camera = perspective(64, 48, 0.9, look_at((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)))
    hidden, floater = discs([[0.0, 0.0, -0.5]]), discs([[0.05, 0.0, 1.9]], 0.004)
    g = concatenate([plane(2, 0.0), hidden, floater])
    found = contributions(g, [camera, camera])
    assert found.depth == pytest.approx([2.0, 2.0], rel=0.05)
    keep = needed(g, [camera, camera], found)
    assert not keep[-2] and found.weight[-2] < 0.5 and not keep[-1] and found.weight[-1] > 1.0
    inside = (np.abs(g.means[:-2, :2]) < 0.6).all(1)
    assert keep[:-2][inside].all()


def test_sides_of_an_object_that_no_photograph_shows_stay_with_it(monkeypatch):
    g = concatenate([plane(1, 0.0), ball((0.0, 0.5, 0.0))])
    g = replace(g, object_id=(g.means[:, 1] > 0.2).astype(np.uint16), objects=("a",))
    monkeypatch.setattr(room_pipeline, "needed", lambda *_: np.zeros(len(g), bool))
    turned = SimpleNamespace(pose=lambda m: m, gaussians=lambda g: g, scale=1.0, floor_seen=True)
    monkeypatch.setattr(room_pipeline, "capture_orientation", lambda *_: turned)
    found = Contributions(np.arange(len(g)), np.ones(1))
    room = room_pipeline.placed_room(g, SimpleNamespace(cameras=list), found, None)
    own = np.flatnonzero(g.object_id)
    assert len(own) and np.array_equal(room.weight, own) and np.array_equal(room.gaussians.means, g.means[own])


def ring_of_cameras(height: float):
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    eyes = [(1.5 * np.sin(t), height + 0.1 * np.cos(5 * t), 1.5 * np.cos(t)) for t in turns]
    return [perspective(100, 80, 0.8, look_at(eye, (0.0, 0.3, 0.0))) for eye in eyes]


def test_the_player_stands_where_a_photographer_stood_on_the_front_side():
    cameras = ring_of_cameras(1.4)
    view = RoomView(cameras, np.full(12, 1.8), True)
    eye, target, fov = view_of(view)
    assert any(np.allclose(eye, c.position) for c in cameras) and eye[2] > 1.2 and fov == pytest.approx(0.8)
    assert np.linalg.norm(np.subtract(target, (0.0, 0.3, 0.0))) < 0.2 and view.floor == 0.0
    upright = [replace(c, width=c.height, height=c.width, cx=c.cy, cy=c.cx) for c in cameras]
    wide, high = (np.tan(0.5 * a) for a in (fov, 2 * np.arctan(0.5 * upright[0].height / upright[0].fy)))
    assert np.tan(0.5 * view_of(replace(view, cameras=upright))[2]) == pytest.approx(np.sqrt(wide * high))
    unseen = replace(view, floor_seen=False)
    assert unseen.floor == pytest.approx(min(0.0, np.median(view.places[:, 1]) - 1.5))


def test_a_room_reaches_as_far_as_cameras_and_what_they_show_but_no_backdrop():
    view = RoomView(ring_of_cameras(1.4), np.full(12, 1.8), True)
    g = concatenate([plane(1, 0.0), discs(np.full((50, 3), 60.0))])
    low, high = room_extent(g, np.ones(len(g)), view)
    assert (low < -2.0).sum() == 2 and (high[[0, 2]] < 2.5).all() and high[1] < 2.5


def test_a_body_leaves_its_place_free():
    solid = DistanceGrid(np.full((21, 21, 21), -0.2, np.float32), np.full(3, -0.5), 0.05)
    x = np.moveaxis(np.indices((17, 17, 17)), 0, -1) * 0.025 - 0.2
    body = DistanceGrid((np.linalg.norm(x, axis=-1) - 0.15).astype(np.float32), np.full(3, -0.2), 0.025)
    thing = RoomObject("ball", "objects/ball.h5", (0.1, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    free = without_solid(solid, body, thing)
    assert free.sample(np.array([[0.1, 0.0, 0.0]]))[0] == pytest.approx(0.15, abs=0.03)
    assert free.sample(np.array([[-0.3, 0.0, 0.0]]))[0] == pytest.approx(-0.2, abs=1e-3)


LEGS = {(-0.12, -0.12): 0.0, (0.12, -0.12): 0.001, (0.12, 0.12): 0.002, (-0.12, 0.12): 0.005}  # [m] their soles


def stool() -> Asset:
    """A board of 0.3 m on four legs that end at different heights, in a coarse cage that is 4 cm wider."""
    origin, h = np.array([-0.2, -0.05, -0.2]), 0.01
    x = origin + h * np.moveaxis(np.indices((41, 41, 41)), 0, -1)

    def block(low, high) -> np.ndarray:
        return np.maximum(np.array(low) - x, x - np.array(high)).max(-1)

    legs = [block((u - 0.03, y, w - 0.03), (u + 0.03, 0.3, w + 0.03)) for (u, w), y in LEGS.items()]
    values = np.minimum.reduce([block((-0.15, 0.2, -0.15), (0.15, 0.3, 0.15)), *legs])
    vertices, tets, surface = box((0.38, 0.38, 0.38), (4, 4, 4))
    cage = Cage((vertices - [0.19, 0.04, 0.19]).astype(np.float32), tets, surface)
    return Asset(discs(np.zeros((1, 3))), cage, sdf=DistanceGrid(values, origin, h), material=MATERIALS["plush"])


def test_what_stands_is_borne_where_it_was_photographed():
    """Under it the room has a hollow of 6 cm, and at one leg a bump that reaches into it."""
    body, at = stool(), np.array([0.3, 0.1, -0.2])
    thing = RoomObject("stool", "objects/stool.h5", tuple(at), (1.0, 0.0, 0.0, 0.0))
    x = np.moveaxis(np.indices((61, 41, 61)), 0, -1) * 0.0125 + (at - [0.375, 0.3, 0.375])
    bump = np.linalg.norm(x - (at + [0.12, -0.04, 0.12]), axis=-1) - 0.05
    grid = DistanceGrid(np.minimum(x[..., 1] - at[1] + 0.06, bump), at - [0.375, 0.3, 0.375], 0.0125)
    empty = Environment(0.0, (0, 0, 0), (0, 1, 1), 0.5, (("floor", 0.0, -1.0, -1.0, 1.0, 1.0),))
    coarse = DistanceGrid(np.ones((3, 3, 3), np.float32), at - 1, 1.0)
    room = seated(Asset(body.gaussians, sdf=coarse, environment=replace(empty, fine_grids=(grid,))), [(body, thing)])
    points = surface_points(body.cage.vertices, body.cage.surface, 0.02)
    own = (body.cage.vertices[points.ids] * points.weights[..., None]).sum(1)
    skin = skin_depth(points, body.cage.vertices, body.sdf)
    gaps = [g.sample(own + at) + skin for g in (grid, room.environment.fine_grids[0])]
    under = [(np.abs(own[:, [0, 2]] - leg) < 0.03).all(1) & (own[:, 1] < 0.0) for leg in LEGS]
    assert gaps[0].min() < -0.01 and sum(bool((np.abs(gaps[0][u]) < 2e-3).any()) for u in under) < 3
    assert gaps[1].min() > -2e-3, "nothing pushes it"
    assert all((np.abs(gaps[1][u]) < 2e-3).any() for u in under), "all its legs are borne"
    assert (room.sdf.values == coarse.values).all(), "only the finest grid is filled"
    assert np.abs(base_of(body).normal @ [1, 0, 0]) < 0.02


def test_an_object_stays_as_it_was_photographed_under_its_weight():
    """A bar of 1 m that is held at one end."""
    vertices, tets, surface = box((1.0, 0.1, 0.1), (8, 2, 2))
    bar, down = Cage(vertices, tets, surface), np.array([-1.0, 0.0, 0.0])
    upright = Cage(vertices[:, [1, 0, 2]], tets[:, [0, 2, 1, 3]], surface[:, ::-1])
    for cage, way in ((upright, down), (upright, np.array([0.0, -1.0, 0.0]))):
        held, light = cage.vertices[:, 1] < 0.1, MATERIALS["plush"]
        firm = steady(light, cage.vertices, cage.tets, way, held)
        moved = np.linalg.norm(bent_by_weight(cage.vertices, cage.tets, firm, way, held), axis=1).max()
        assert moved < 0.0031 and (firm.young > light.young or moved < 0.0029)
    assert steady(MATERIALS["wood"], bar.vertices, bar.tets, down, bar.vertices[:, 1] < 0.05) == MATERIALS["wood"]


def test_a_hand_can_lift_an_object_of_any_size():
    plush = MATERIALS["plush"]
    assert liftable(plush, 0.01) == plush
    big = liftable(replace(plush, young=1e6), 1.0)
    assert big.density == pytest.approx(3.0) and big.young == pytest.approx(3e4)


def test_files_of_objects_have_safe_and_different_names():
    assert object_files(["bear", "der Bär", "熊", "der B?r"]) == [
        "objects/bear.h5", "objects/der_B_r.h5", "objects/object_3.h5", "objects/der_B_r_4.h5",
    ]  # fmt: skip


def test_a_cut_run_goes_on_and_changed_inputs_are_made_anew(tmp_path):
    made = []

    def run(second: int, *, cut: bool = False):
        stages = Stages(tmp_path / "work", ("first", "second"))

        def make(folder):
            made.append(folder.name)
            (folder / "result").write_text("done")
            if cut:
                raise KeyboardInterrupt

        stages.run("first", {"n": 1}, lambda folder: made.append("first"))
        return stages.run("second", {"n": second}, make)

    with pytest.raises(KeyboardInterrupt):
        run(1, cut=True)
    assert not (tmp_path / "work" / "second").exists() and (tmp_path / "work" / "second.part" / "result").exists()
    assert (run(1) / "result").read_text() == "done" and made == ["first", "second.part", "second.part"]
    run(1)
    assert len(made) == 3
    run(2)
    assert len(made) == 4 and json.loads((tmp_path / "work/second/stage.json").read_text())["seconds"] >= 0
    (tmp_path / "work/first/stage.json").write_text("[")
    run(2)
    assert made[-1] == "first"
    for damage in (lambda p: p.write_text("don"), lambda p: p.unlink()):
        damage(tmp_path / "work/second/result")
        assert (run(2) / "result").read_text() == "done" and made.pop() == "second.part" and made[-1] == "first"


def test_a_full_disk_is_told_in_one_line_and_what_the_stage_has_made_is_kept(tmp_path):
    """A limit of the size of files stands for the full disk; stage.json does not fit either."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    seen = []

    def make(folder, limit=limits[0]):
        seen.append((folder / "checkpoint").exists())
        (folder / "checkpoint").write_text("1")
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))
        (folder / "result").write_text("done")

    try:
        with pytest.raises(BadInput, match=r"first\.part: cannot be written \(File too large\)$"):
            Stages(tmp_path / "work", ("first",)).run("first", {}, lambda folder: make(folder, 2))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [p.name for p in (tmp_path / "work").iterdir()] == ["first.part"]
    done = Stages(tmp_path / "work", ("first",)).run("first", {}, make)
    assert (done / "result").read_text() == "done" and seen == [False, True]


def test_a_stage_is_made_again_once_the_source_that_makes_it_has_changed(tmp_path):
    """By a module that is imported at any depth, in a function too; not by one that only shows results."""
    files = {
        "commands/make.py": "def run():\n    from prepare import cut\n    import display.window\n",
        "prepare/cut.py": "import numpy as np\nfrom core.size import SIZE\n",
        "core/size.py": "SIZE = 1\n",
        "display/window.py": "TITLE = 'a'\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    made = []

    def run() -> int:
        source = source_digest("commands.make", tmp_path)
        Stages(tmp_path / "work", ("first",)).run("first", {}, lambda folder: made.append(folder), source)
        return len(made)

    assert (run(), run()) == (1, 1)
    (tmp_path / "display/window.py").write_text("TITLE = 'b'\n")
    assert run() == 1
    (tmp_path / "core/size.py").write_text("SIZE = 2\n")
    assert run() == 2
    (tmp_path / "prepare/cut.py").write_text("import numpy as np\nSIZE = 3\n")
    assert run() == 3


def test_a_module_without_source_is_an_error():
    """Else a result would be taken for fresh for ever."""
    with pytest.raises(FileNotFoundError, match=r"commands\.nothing"):
        source_digest("commands.nothing")


def test_time_left_is_that_of_the_step_and_is_not_said_where_it_is_not_known(tmp_path, monkeypatch, capsys):
    """Views pass in 4 s; a paint step of unknown length begins, and tells nothing until it is done."""
    clock = [100.0]
    monkeypatch.setattr(stages_module.time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(stages_module, "LINE_SECONDS", 0.0)
    stages = Stages(tmp_path / "work", ("first",))

    def said() -> str:
        return capsys.readouterr().err.strip()

    def make(folder):
        first, second = (stages.part(name, k, 2) for k, name in enumerate(("cup", "duck")))
        for k in range(5):
            clock[0] = 100.0 + k
            first("views", k / 4)
            assert said() == f"[1/1] first: {k} s; cup, 1 of 2: views {k / 4:.0%}" + (
                f", {4 - k} s left" if 2 <= k < 4 else ""
            )
        clock[0] = 104.5
        first("paint", 0.0)
        assert said().endswith("paint 0%")
        clock[0] = 130.0
        second = stages.part("duck", 1, 2)
        clock[0] = 140.0
        second("views", 0.5)
        assert said() == "[1/1] first: 40 s; duck, 2 of 2, all in 20 s: views 50%", "as long as the cup took"
        clock[0] = 142.0
        stages.part("duck", 0, 1)("patch", 0.0)
        assert said() == "[1/1] first: 42 s; duck: patch 0%"

    stages.run("first", {}, make)


def test_a_scale_is_measured_between_points_in_photographs_or_in_the_capture():
    found = MeasuredLength.of(("a:b.jpg:12,3.5", "1,2,3", "46cm"))
    assert found.points == (("a:b.jpg", [12.0, 3.5]), ("", [1, 2, 3])) and found.length == pytest.approx(0.46)
    for text in ("1,2", "a.jpg:1", "a.jpg:1,x", "nan,1,2"):
        with pytest.raises(BadInput, match=r"--scale-points: .* is neither"):
            MeasuredLength.of(("1,2,3", text, "1"))
    for text in ("0", "-1", "inf", "nan", "a"):
        with pytest.raises(BadInput, match=r"--scale-points: .*length"):
            MeasuredLength.of(("1,2,3", "1,2,4", text))
    found.check({"a:b.jpg": (160, 120)})
    for size, why in (({"b.jpg": (160, 120)}, "no photograph a:b.jpg"), ({"a:b.jpg": (12, 9)}, "has 12x9 pixels")):
        with pytest.raises(BadInput, match=why):
            found.check(size)
    scale = MeasuredLength((("", [0, 0, 0]), ("", [0, 2, 0])), 0.5).scale(plane(1, 0.0), Capture(Path(), []), np.eye(3))
    assert scale == pytest.approx(0.25)
