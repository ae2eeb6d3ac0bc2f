"""Splat files that are looked at: turned, cropped, written, one after the other; lines over the picture."""

from dataclasses import replace
from types import SimpleNamespace as N

import numpy as np
import pytest

from assets.formats.ply import write_ply
from assets.gaussians import Gaussians
from assets.splat_files import read_gaussians, write_gaussians
from core.camera import look_at, perspective
from core.errors import BadInput
from display import user_commands
from display.panel import Slider, crop_section
from display.protocol import Frame, Line
from display.viewed_file import UP_AXES, ViewedFile, camera_around, film_yaws, scene_around
from display.viewer import BACKGROUNDS, Viewer
from display.window.overlay import visible_part

CAMERA = perspective(96, 64, 0.9, look_at((0, 0, 4), (0, 0, 0)))


def cloud(seed: int, count: int = 500, degree: int = 0) -> Gaussians:
    """A box of red Gaussians, 1 x 2 x 3 m."""
    rng = np.random.default_rng(seed)
    means = rng.uniform(-1, 1, (count, 3)) * [0.5, 1.0, 1.5]
    sh = np.zeros((count, (degree + 1) ** 2, 3))
    sh[:, 0] = [1.0, -1.0, -1.0]
    return Gaussians.of(means, np.tile([1.0, 0, 0, 0], (count, 1)), np.full((count, 3), -3.0), np.full(count, 3.0), sh)


@pytest.fixture
def file(tmp_path) -> ViewedFile:
    write_ply(tmp_path / "box.ply", cloud(0))
    return ViewedFile.read(tmp_path / "box.ply", "+y")


def test_turning_goes_through_all_axes_about_the_middle(file):
    moved = replace(file, gaussians=file.gaussians.transformed(np.eye(3), (5.0, 0.0, 0.0)))
    extents, turned = [], ViewedFile(moved.path, moved.gaussians, "+y", "")
    first = turned.gaussians.means
    for k in range(6):
        assert turned.up == UP_AXES[k]
        middle = 0.5 * (turned.bounds.low + turned.bounds.high)
        extents.append(float((turned.bounds.high - turned.bounds.low)[1]))
        turned = turned.turned()
        assert np.allclose(0.5 * (turned.bounds.low + turned.bounds.high), middle, atol=1e-4)
    assert np.allclose(extents, [2, 2, 3, 3, 1, 1], rtol=0.05)
    assert turned.up == "+y" and np.allclose(turned.gaussians.means, first, atol=1e-4)


def test_a_crop_leaves_what_lies_in_it_and_is_written(file, tmp_path):
    cropped = file.cropped(np.array([-9.0, 0.0, -9.0]), np.array([9.0, 9.0, 9.0]))
    count = int((file.gaussians.means[:, 1] >= 0).sum())
    assert 0 < count == cropped.shown.sum() < len(file.gaussians)
    assert cropped.write(tmp_path / "half.ply") == count
    half = read_gaussians(tmp_path / "half.ply")
    assert len(half) == count and half.means[:, 1].min() >= 0
    assert ("within the crop", f"{count:,}") in cropped.facts and len(cropped.crop.edges()) == 12
    assert cropped.cropped(file.bounds.low, file.bounds.high).crop is None
    with pytest.raises(BadInput, match="holds no Gaussians"):
        file.cropped(np.full(3, 8.0), np.full(3, 9.0)).write(tmp_path / "none.ply")
    assert not (tmp_path / "none.ply").exists()
    with pytest.raises(BadInput):
        file.write(tmp_path / "x.txt")


def test_sliders_move_one_side_each(file):
    world = N(file=file)
    made = {row.name: row for row in crop_section(world).rows if isinstance(row, Slider)}
    assert list(made) == ["x from", "x to", "y from", "y to", "z from", "z to"]
    crop = made["y from"].command(0.25, False)
    assert crop.low[1] == 0.25 and np.allclose(crop.high, file.bounds.high)
    assert made["z to"].usual == pytest.approx(file.bounds.high[2])


def test_lines_are_cut_at_the_eye():
    ahead, behind = np.array([0.0, 0.0, 0.0]), np.array([0.0, 1.0, 9.0])
    u, v = visible_part(Line(ahead, ahead + [0.1, 0, 0], (1, 1, 1)), CAMERA)
    assert u == pytest.approx((48, 32)) and v[0] > u[0]
    assert visible_part(Line(behind, behind + 1, (1, 1, 1)), CAMERA) is None
    a, b = visible_part(Line(ahead, behind, (1, 1, 1)), CAMERA)
    assert np.isfinite([*a, *b]).all()


def test_the_viewer_shows_one_file_after_the_other(file, tmp_path, ti_cpu):
    """Tab, crop, background, turn, a dropped file, all through commands."""
    write_ply(tmp_path / "other.ply", cloud(1, 300))
    other = ViewedFile.read(tmp_path / "other.ply", "+y")
    out = tmp_path / "out.ply"
    world = Viewer([file, other], scene_around(file.gaussians, 1.5), (96, 64), out=out)

    def step(*commands):
        world.step(Frame(1 / 60, 0.0, [CAMERA], commands=list(commands)))
        return world.picture.to_numpy().view(np.uint8).reshape(64, 96, 4)[..., :3].astype(int)

    first = step()
    assert first[32, 48, 0] > 150 and first[2, 2].tolist() == [round(255 * c) for c in BACKGROUNDS[0]]
    assert step(user_commands.NextBackground())[2, 2].tolist() == [0, 0, 0]
    cropped = step(user_commands.Crop((-9, 0, -9), (9, 9, 9)))
    assert cropped[20, 48, 0] > 150 and cropped[52, 48].tolist() == [0, 0, 0] and len(world.lines()) == 12
    step(user_commands.WriteSplats())
    assert "Written" in world.notice and len(read_gaussians(out)) == world.file.shown.sum()
    step(user_commands.NextFile())
    assert world.file is other and world.file_number == (2, 2) and world.stats() == {"gaussians": 300}
    assert step(user_commands.ShowAxes(True))[52, 48, 0] > 150 and [line.text for line in world.lines()][1] == "y 1 m"
    step(user_commands.TurnUp())
    assert world.file.up == "-y" and "-y is up" in world.file.note
    write_ply(tmp_path / "more.ply", cloud(2, 400))
    assert step(user_commands.ViewFiles((str(tmp_path / "more.ply"),)))[32, 48, 0] > 150
    assert world.file_number == (3, 3) and world.stats() == {"gaussians": 400}
    step(user_commands.ViewFiles((str(tmp_path / "none.ply"),)))
    assert "no such file" in world.notice and world.file_number == (3, 3)
    step(user_commands.NextFile())
    assert world.file.crop is not None and step()[52, 48].tolist() == [0, 0, 0]


def test_what_was_trained_is_first_seen_from_where_it_was_photographed(tmp_path):
    """A far background does not count; moved and scaled, the view comes along. A view that is none is ignored."""
    rng, turn = np.random.default_rng(0), np.tile([1.0, 0.0, 0.0, 0.0], (80, 1))
    means = np.concatenate([rng.uniform(-0.5, 0.5, (40, 3)), rng.normal(size=(40, 3)) * 100])
    g = Gaussians.of(means, turn, np.full((80, 3), -3.0), np.full(80, 2.0), np.zeros((80, 1, 3)))
    eye, target = (3.0, 1.0, 0.0), (0.0, 0.0, 0.5)
    seen = replace(g, view=(*eye, *target, 0.5))
    for name in ("a.compressed.ply", "a.ply"):
        write_gaussians(tmp_path / name, seen)
        file = ViewedFile.read(tmp_path / name, None)
        scene = scene_around(file.gaussians, 1.5)
        assert np.allclose((scene.eye, scene.target), (eye, target), atol=1e-6) and file.note == "+y is up"
    assert np.allclose(camera_around(file.gaussians, 60, 40, np.pi).position, (-3.0, 1.0, 1.0), atol=1e-5)
    level = camera_around(file.gaussians, 60, 40, 0.0, elevation=0.0).position - target
    assert abs(level[1]) < 1e-9 and np.isclose(np.linalg.norm(level), np.linalg.norm(np.subtract(eye, target)))
    assert np.allclose(film_yaws(file.gaussians, 8)[[0, 2, 4, 6]], (0, 0.5, 0, -0.5))
    moved = seen.transformed(np.eye(3), (1.0, 2.0, 3.0), 2.0).view
    assert moved == (7.0, 4.0, 3.0, 1.0, 2.0, 4.0, 0.5) and g.transformed(np.eye(3)).view == ()
    whole = (tmp_path / "a.ply").read_bytes()
    for words in (b"view 1 2 3 nan 5 6", b"view 1 2 3 1 2 3", b"view 1 2 a", b"view 1", b"view 1 2 3 4 5 6 7"):
        (tmp_path / "b.ply").write_bytes(whole.replace(b"view 3 1 0 0 0 0.5 0.5", words))
        assert ViewedFile.read(tmp_path / "b.ply", None).gaussians.view == ()
    (tmp_path / "b.ply").write_bytes(whole.replace(b" 0.5 0.5\n", b" 0.5\n"))
    round_it = ViewedFile.read(tmp_path / "b.ply", None).gaussians
    assert round_it.view[6] == np.pi and np.allclose(film_yaws(round_it, 4), np.pi * np.array([0, 0.5, 1, 1.5]))
