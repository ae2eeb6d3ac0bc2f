"""Inpainting: a ball is taken from a checked table, whose Gaussians under it no camera saw."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.ndimage import gaussian_filter

from assets.gaussians import ROWS, Gaussians, concatenate
from assets.splat_files import read_gaussians, write_gaussians
from core.camera import directions_around, look_at, perspective
from core.errors import BadInput
from core.spherical_harmonics import C0
from prepare.blending_weights import BlendingWeights
from prepare.inpaint.hole_patch import compare, uncovered_psnr
from prepare.inpaint.hole_views import HoleView, Surroundings, cut_out_camera, draw_views, drawing_of
from prepare.inpaint.inpaint_pipeline import close_holes, find_hole, inpaint, paint_hole, take_shadow, with_hole_first
from prepare.inpaint.picture_inpainting import paint_from_patches
from prepare.inpaint.support_surface import (
    SupportSurface,
    SurfaceTexture,
    part_of_surface,
    shows_colors,
    support_surfaces,
    texture_of,
)
from prepare.progress import no_progress
from prepare.room_capture.room_pipeline import without_supports
from prepare.train.photographs import Photograph
from tests.support.samples import discs
from vrgs import main

RADIUS, SPACING = 0.12, 0.02  # [m] of the ball, and between the table's Gaussians


def table() -> Gaussians:
    """A level square of 1 m in checks of 10 cm."""
    x, z = (a.ravel() for a in np.mgrid[-0.5:0.5:SPACING, -0.5:0.5:SPACING] + SPACING / 2)
    check = (np.floor(x / 0.1) + np.floor(z / 0.1)) % 2
    color = np.stack([0.45 + 0.25 * check, 0.5 + 0 * check, 0.4 - 0.1 * check], axis=1)
    scales = (0.6 * SPACING, 0.1 * SPACING, 0.6 * SPACING)
    return discs(np.stack([x, 0 * x, z], axis=1), scales, color)


def ball(height: float = RADIUS) -> Gaussians:
    return discs(directions_around(500) * RADIUS + [0.0, height, 0.0], 0.012, (0.9, 0.2, 0.2))


def cameras():
    eyes = [(0.9 * np.cos(a), 0.35 + 0.25 * (k % 2), 0.9 * np.sin(a)) for k, a in enumerate(np.arange(8) * np.pi / 4)]
    return [perspective(112, 84, 0.75, look_at(eye, (0, 0.08, 0))) for eye in eyes]


def shadowed_table() -> Gaussians:
    """The table in the shadow of the ball, 0.7 of its form factor R^2 h / d^3."""
    whole = table()
    distance = np.sqrt((whole.means[:, [0, 2]] ** 2).sum(axis=1) + RADIUS**2)
    left = (1.0 - 0.7 * (RADIUS / distance) ** 3)[:, None, None]
    return replace(whole, sh=(whole.sh * left + (left - 1.0) * 0.5 / C0).astype(np.float32))


@pytest.fixture(scope="module")
def drawing(ti_cpu):
    with drawing_of(table(), ball()) as drawing:
        yield drawing


@pytest.fixture(scope="module")
def shadowed(drawing):
    """The hole under the ball, with its shadow around."""
    return find_hole(drawing, shadowed_table(), ball(), cameras(), name="ball")


@pytest.fixture(scope="module")
def closed(shadowed, drawing):
    """The painted hole without the shadow, and the table with the patch."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("prepare.inpaint.object_shadow.DIRECTIONS", 24)
        (hole,) = take_shadow(drawing, [shadowed])
    hole = paint_hole(hole, [], paint_from_patches)
    return hole, close_holes(drawing, hole.background, [hole], 20, no_progress)


@pytest.fixture(scope="module")
def views(closed):
    """Pictures before and after, and of the whole table."""
    hole, after = closed
    return compare(hole.views, hole.textures, hole.background, after, truths(hole))


def truths(hole) -> list[Photograph]:
    drawing = BlendingWeights(table(), cameras())
    pictures = [(drawing.picture(c)[0].clip(0, 1) * 255).round().astype(np.uint8) for c in cameras()]
    drawing.destroy()
    return [Photograph(p, np.ones(p.shape[:2], bool), c) for p, c in zip(pictures, cameras(), strict=True)]


def test_a_texture_is_sampled_at_any_number_of_places():
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    texture = SurfaceTexture(None, np.zeros(2), 0.5, None, values > 0, values > 0)
    at = np.array([[0.25, 0.25], [1.75, 1.25], [0.5, 0.25], [9.0, 0.0]])
    many = np.tile(at, (10_000, 1))  # cv2.remap takes rows of less than 32,768
    assert_array_equal(texture.sample(values, many)[-4:], [0.0, 11.0, 0.5, 0.0])
    assert texture.sample(np.dstack([values] * 3), at[None]).shape == (1, 4, 3)


def test_where_two_holes_overlap_the_second_shows_what_was_painted_in_the_first():
    """Of the same surface; a parallel one keeps its hole."""
    color, hole = np.zeros((4, 8, 3), np.float32), np.zeros((4, 8), bool)
    color[:, :4], hole[:, :4] = (0.9, 0.2, 0.2), True

    def texture(x: float, z: float, color: np.ndarray) -> SurfaceTexture:
        surface = SupportSurface(np.array([0.0, 0.0, z]), np.eye(3), 0.01)
        return SurfaceTexture(surface, np.array([x, 0.0]), 0.5, color, ~hole, hole)

    first, second, above = texture(0.0, 0.0, color), texture(1.0, 0.0, 0 * color), texture(1.0, 3.0, 0 * color)
    both = second.beside(first)
    assert_array_equal(both.hole[:, :4], [[False, False, True, True]] * 4)
    assert both.known[:, :2].all() and not both.known[:, 2:4].any()
    assert_array_equal(both.color[:, :2], color[:, :2])
    assert_array_equal(above.beside(first).hole, hole)


def test_what_an_object_stands_on_has_the_hole():
    """Known around it, and with many of the points around: not a plane through a neck, or the fur of its own side."""

    def texture(hole: bool, rim: float = 1.0, share: float = 0.5) -> SurfaceTexture:
        surface = SupportSurface(np.zeros(3), np.eye(3), 0.01, share)
        return SurfaceTexture(surface, np.zeros(2), 0.5, None, np.full((3, 4), not hole), np.full((3, 4), hole), rim)

    side, table, fur = texture(False), texture(True, 0.8), texture(True, 0.3)
    wall, neck = texture(True, 0.47, 0.2), texture(True, 0.55, 0.09)
    assert [id(t) for t in with_hole_first([neck, fur, side, table, wall])] == list(
        map(id, (table, fur, wall, neck, side))
    )


def test_only_what_no_camera_saw_is_a_hole(closed):
    hole, _ = closed
    (texture,) = hole.textures
    assert abs(texture.surface.axes[2] @ [0, 1, 0]) > 0.999
    places = texture.surface.points(texture.places())
    away = np.linalg.norm(places[..., [0, 2]], axis=-1)
    assert texture.hole[away < 0.4 * RADIUS].all() and not texture.hole[away > 1.3 * RADIUS].any()
    assert 0 < hole.dropped < len(table()) // 5


def test_the_hole_is_closed_as_the_table_was_from_all_sides(views):
    psnr = uncovered_psnr(views)
    assert psnr["hole"]["before"] < 15.0 and psnr["hole"]["after"] > 22.0 and psnr["object"]["after"] > 25.0
    assert min(uncovered_psnr([view])["object"]["after"] for view in views) > 23.0


def test_the_shadow_goes_with_the_object(shadowed, closed):
    """The surroundings get their own colours back, and nothing but colours changes."""
    lit, whole = closed[0].background, table()
    away = np.linalg.norm(whole.means[:, [0, 2]], axis=1)
    near = np.flatnonzero((away > 1.2 * RADIUS) & (away < 2.0 * RADIUS))
    row = {tuple(mean): k for k, mean in enumerate(lit.means.tolist())}
    own = np.array([row[tuple(mean)] for mean in whole.means[near].tolist()])
    off = [np.abs(C0 * (g.sh[own] - whole.sh[near])).mean() for g in (shadowed.background, lit)]
    assert off[0] > 0.05 and off[1] < 0.4 * off[0]
    for name in ROWS:
        if name != "sh":
            assert_array_equal(getattr(lit, name), getattr(shadowed.background, name))


def test_all_that_was_seen_stays_bit_for_bit(shadowed, closed):
    hole, after = closed
    rows = {mean.tobytes(): sh.tobytes() for mean, sh in zip(shadowed_table().means, shadowed_table().sh, strict=True)}
    assert all(
        rows[m.tobytes()] == s.tobytes() for m, s in zip(shadowed.background.means, shadowed.background.sh, strict=True)
    )
    kept = after.select(slice(len(hole.background)))
    for name in ROWS:
        assert_array_equal(getattr(kept, name), getattr(hole.background, name))
    new = after.select(slice(len(hole.background), None))
    assert len(new) > 50 and np.linalg.norm(new.means[:, [0, 2]], axis=1).max() < 1.2 * RADIUS
    assert np.abs(new.means[:, 1]).max() < 0.02  # on the table


def test_holes_of_all_objects_are_closed_by_one_training(closed, drawing, monkeypatch):
    """Of the Gaussians over the holes alone, by as many pictures and steps as of each by itself."""
    (hole, _), told = closed, []

    def train_patch(background, patch, targets, extent, progress, steps):
        told.append((len(patch), len(targets), steps))
        return patch

    monkeypatch.setattr("prepare.inpaint.inpaint_pipeline.train_patch", train_patch)
    for holes in ([hole], [hole, hole]):
        close_holes(drawing, hole.background, holes, 20, no_progress)
    assert told[1] == tuple(2 * number for number in told[0]) and told[0][0] == len(hole.patch) > 0


def test_the_shadow_of_a_later_object_goes_from_earlier_holes_too(closed, drawing, monkeypatch):
    hole, _ = closed
    half = SimpleNamespace(left=lambda points, normals: np.full(len(points), 0.5))
    monkeypatch.setattr("prepare.inpaint.inpaint_pipeline.find_shadow", lambda *_: half)
    was, known = hole.textures[0].color, hole.textures[0].known
    for lit in take_shadow(drawing, [hole, hole]):
        assert_array_equal(lit.textures[0].color[known], (2.0 * was[known]).clip(0.0, 1.0))


@pytest.mark.long
def test_without_photographs_what_is_drawn_there_stays(ti_cpu):
    """The table is whole under the ball: nothing is empty, so nothing is made up. Where it is empty, it is."""
    whole, stages = table(), []
    tell = lambda stage, done: stages.append((stage, done))  # noqa: E731
    after, _ = inpaint(whole, {"ball": ball()}, None, steps=5, progress=lambda *_: tell)
    assert len(after) == len(whole) and stages[-1] == ("patch", 1.0)
    torn = whole.select(np.linalg.norm(whole.means[:, [0, 2]], axis=1) > 0.5 * RADIUS)
    after, _ = inpaint(torn, {"ball": ball()}, None, steps=5)
    new = after.means[len(torn) :]
    assert len(new) > 20 and np.linalg.norm(new[:, [0, 2]], axis=1).max() < 0.8 * RADIUS


def test_an_object_in_the_air_has_no_surface():
    views = noisy_views(cameras(), 0.0)
    sphere = Surroundings(np.array([0.0, 1.6 * RADIUS, 0.0]), RADIUS)
    assert support_surfaces(views, ball(height=1.6 * RADIUS).means, sphere, np.random.default_rng(0)) == []


def test_an_unseen_object_is_refused(drawing):
    with pytest.raises(BadInput, match="ball: no camera sees it"):
        find_hole(drawing, table(), ball(height=-9.0), cameras(), name="ball")
    with pytest.raises(BadInput, match="only 5 Gaussians"):
        find_hole(drawing, table(), ball().select(slice(5)), cameras(), name="ball")


def noisy_view(
    index: int, camera, noise: float, dent: float = 0.0, plinth: tuple | None = None, torn: float = 0.0
) -> HoleView:
    """A table without end, its depth off by `noise` [m], with a dent around the foot of a ball; or with a round
    `plinth`, radius and height [m], under it, whose top is at y = 0 and lacks the part within `torn` [m]."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    rays = rays @ camera.world_to_camera[:3, :3]
    eye, down = camera.position, rays[..., 1] < -1e-3
    depth = np.where(down, -eye[1] / np.minimum(rays[..., 1], -1e-3), 9.0)
    if plinth is not None:
        beside = np.linalg.norm((eye + depth[..., None] * rays)[..., [0, 2]], axis=-1) > plinth[0]
        beside |= np.linalg.norm((eye + depth[..., None] * rays)[..., [0, 2]], axis=-1) < torn
        depth = np.where(beside & down, depth * (1.0 + plinth[1] / eye[1]), depth)
    away = np.linalg.norm((eye + depth[..., None] * rays)[..., [0, 2]], axis=-1)
    rough = gaussian_filter(np.random.default_rng(index).normal(size=depth.shape), 4)
    depth = depth + noise * rough / rough.std()
    depth += np.where(np.abs(away - 0.6 * RADIUS) < dent, 0.2, 0.0)
    a, b = (rays**2).sum(-1), rays @ (eye - [0.0, RADIUS, 0.0])
    root = b**2 - a * (((eye - [0.0, RADIUS, 0.0]) ** 2).sum() - RADIUS**2)
    alpha, front = (root > 0).astype(np.float32), (-b - np.sqrt(root.clip(0))) / a
    pictures = (np.full((*x.shape, 3), 0.5), down, depth, alpha, front)
    return HoleView(index, camera, *(p.astype(np.float32) for p in pictures))


SPHERE = Surroundings(np.array([0.0, RADIUS, 0.0]), RADIUS)


def noisy_views(cameras: list, noise: float, **options) -> list[HoleView]:
    return [noisy_view(k, camera, noise, **options) for k, camera in enumerate(cameras)]


def surfaces_under(views: list[HoleView], means: np.ndarray | None = None) -> list[SupportSurface]:
    """Support surfaces of the ball, or of points of it."""
    return support_surfaces(views, ball().means if means is None else means, SPHERE, np.random.default_rng(0))


def test_a_small_object_on_a_noisy_surface_has_one_hole():
    """Noise of the depth makes no further planes, and a narrow dent around the foot is no end of the surface."""
    views = noisy_views(cameras(), 0.012, dent=0.006)
    surfaces = surfaces_under(views)
    assert len(surfaces) == 1 and surfaces[0].axes[2][1] > 0.995
    texture = texture_of(surfaces[0], [], views, SPHERE, photographed=True)
    places = texture.surface.points(texture.places())
    away = np.linalg.norm(places[..., [0, 2]], axis=-1)
    assert texture.hole[away < 0.3 * RADIUS].all()
    assert texture.hole[np.abs(away - 0.55 * RADIUS) < 0.05 * RADIUS].mean() > 0.9  # the dent's inner half


def test_known_texels_have_the_colour_of_the_surface():
    """None is dark, not those at a picture's edge either."""
    views = noisy_views([cut_out_camera(c, SPHERE) for c in cameras()], 0.004)
    surface, *_ = surfaces_under(views)
    texture = texture_of(surface, [], views, SPHERE, photographed=True)
    assert texture.known.any() and np.abs(texture.color[texture.known] - 0.5).max() < 1e-3


def test_what_stands_on_a_narrow_plinth_leaves_no_hole_beside_it():
    """Most views of the air there show the ball before it; the few that look past it tell."""
    views = noisy_views(cameras()[:5], 0.002, plinth=(0.4 * RADIUS, RADIUS))
    top = SupportSurface(np.zeros(3), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), 0.002)
    texture = texture_of(top, [], views, SPHERE, photographed=True)
    away = np.linalg.norm(texture.surface.points(texture.places())[..., [0, 2]], axis=-1)
    assert texture.hole[away < 0.25 * RADIUS].all() and not texture.hole[away > 0.5 * RADIUS].any()


def test_a_part_of_the_surface_that_went_with_the_object_is_told_from_it():
    """A ball whose masks took along the middle of the plinth's top: its rim alone is less than the ground beside it."""
    views = noisy_views(cameras(), 0.002, plinth=(RADIUS, 0.2 * RADIUS), torn=0.8 * RADIUS)
    x, z = (a.ravel() for a in np.mgrid[-1:1:25j, -1:1:25j] * 0.8 * RADIUS)
    slab = np.stack([x, 0.0 * x, z], axis=1)[np.hypot(x, z) < 0.8 * RADIUS]
    means = np.concatenate([ball().means[ball().means[:, 1] > 0.1 * RADIUS], slab])
    top, *_ = surfaces_under(views, means)
    assert top.axes[2][1] > 0.999 and abs(top.local(np.zeros(3))[2]) < 0.02 * RADIUS
    part = part_of_surface(means, top, SPHERE)
    assert part[-len(slab) :].mean() > 0.9 and part[: -len(slab)].mean() < 0.05
    assert not part_of_surface(ball().means, top, SPHERE).any()  # nor is a round underside
    assert not part_of_surface(slab, top, SPHERE).any()  # a flat object is no part of what it lies on


def test_a_surface_shows_its_colours_in_any_shade():
    """Of a table in checks on which an orange thing was left."""
    surface = SupportSurface(np.zeros(3), np.eye(3), 0.0)
    checks, orange = np.array([[0.45, 0.5, 0.4], [0.7, 0.5, 0.3]]), np.array([[0.7, 0.35, 0.05]])
    color = checks[np.add.outer(np.arange(48) // 6, np.arange(48) // 6) % 2]
    color[10:16, 10:16] = orange  # 2% of it
    known = np.ones((48, 48), bool)
    texture = SurfaceTexture(surface, np.zeros(2), 0.01, color.astype(np.float32), known, ~known)
    noise = np.random.default_rng(0).normal(scale=0.05, size=(200, 3))
    for shade in (1.0, 0.5, 0.0):
        assert shows_colors(texture, np.repeat(shade * checks, 100, axis=0) + noise).mean() > 0.9
    assert shows_colors(texture, np.repeat(orange, 200, axis=0) + noise).mean() < 0.1


@pytest.mark.parametrize("feet", [False, True])
def test_a_body_does_not_carry_away_what_its_masks_took_of_the_table(ti_cpu, feet):
    """But flat feet of its own, as wide, of another colour."""
    whole, thing = table(), ball()
    taken = np.linalg.norm(whole.means[:, [0, 2]], axis=1) < RADIUS
    if feet:
        whole.sh[taken, 0] = (np.array([0.7, 0.35, 0.05]) - 0.5) / C0
    ids = np.concatenate([taken, np.ones(len(thing))]).astype(np.uint16)
    capture = SimpleNamespace(cameras=cameras)
    g = without_supports(replace(concatenate([whole, thing]), object_id=ids, objects=("ball",)), capture)
    kept, own = ({tuple(mean) for mean in g.means[g.object_id == k].tolist()} for k in (0, 1))
    share = np.mean([tuple(mean) in own for mean in whole.means[taken].tolist()])
    assert (share > 0.9 if feet else share < 0.3) and len(g) == len(whole) + len(thing) and not kept & own
    assert np.mean([tuple(mean) in own for mean in thing.means.tolist()]) > 0.9


def test_a_far_background_seen_through_the_table_does_not_spoil_its_depth(drawing):
    thin, far = table(), ball(height=0.0)
    thin = replace(thin, logit_opacities=np.full_like(thin.logit_opacities, 1.0))
    far = replace(far, means=150.0 * far.means, log_scales=np.full_like(far.log_scales, np.log(2.0)))
    views = draw_views(drawing, concatenate([thin, far]), ball(), cameras(), SPHERE)
    for view in views:
        y, x = np.nonzero(view.object_alpha < 0.01)
        at, eye = view.camera.points_at(view.depth, x, y), view.camera.position
        exact = eye + (at - eye) * (eye[1] / (eye[1] - at[:, 1]))[:, None]  # of the same ray, on the table
        near = np.linalg.norm(exact - SPHERE.centre, axis=1) < 2.0 * RADIUS
        assert near.sum() > 300 and np.abs(at[near, 1]).max() < 0.1 * RADIUS


def test_an_object_whose_underside_no_camera_saw_stands_level():
    means = ball().means
    surface, *_ = surfaces_under(noisy_views(cameras(), 0.004), means[means[:, 1] > 0.45 * RADIUS])
    assert surface.axes[2][1] > 0.998 and abs(surface.local(np.zeros(3))[2]) < 0.03 * RADIUS


def test_cut_out_cameras_show_the_same_rays():
    small = Surroundings(np.array([0.0, 0.1, 0.0]), 0.05)
    for camera in cameras():
        cut = cut_out_camera(camera, small)
        assert cut.width < camera.width
        for point in small.centre + 0.05 * np.random.default_rng(1).normal(size=(5, 3)):
            x, _, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
            shift = [(c.cx + c.fx * x / z) % 1 for c in (camera, cut)]
            assert shift[0] == pytest.approx(shift[1], abs=1e-6)
            assert 0 < cut.cx + cut.fx * x / z < cut.width
    behind = perspective(112, 84, 0.75, look_at((0.0, 0.1, 3.0), (0.0, 0.1, 9.0)))
    assert cut_out_camera(behind, small) is None


def write_scene(folder):
    torn = table()
    torn = torn.select(np.linalg.norm(torn.means[:, [0, 2]], axis=1) > 0.5 * RADIUS)
    scene = concatenate([torn, ball()])
    scene.object_id[len(torn) :] = 1
    write_gaussians(folder / "scene.ply", replace(scene, objects=("ball",)))
    write_gaussians(folder / "torn.ply", torn)
    return ["inpaint", str(folder / "scene.ply"), "--out", str(folder / "empty.ply"), "--arch", "cpu"], len(torn)


def test_the_command_refuses_what_is_not_there(tmp_path, capsys):
    line, _ = write_scene(tmp_path)
    for words, says in (
        (["--remove", "cup"], "holds no object cup, only ball"),
        (["--objects", str(tmp_path / "none.ply")], "no such file"),
        (["--remove", "ball", "--truth", str(tmp_path)], "belongs to --capture and --report"),
        (["--remove", "ball", "--lama", str(tmp_path / "x.onnx")], "no such file"),
        ([], "--remove --objects is required"),
    ):
        assert main([*line, *words]) == 2
        assert says in capsys.readouterr().err
    assert main(["inpaint", str(tmp_path / "torn.ply"), "--remove", "1", *line[2:]]) == 2
    assert "holds no objects" in capsys.readouterr().err and not (tmp_path / "empty.ply").exists()


def test_the_command_writes_the_scene_and_a_report(closed, views, tmp_path, capsys, monkeypatch):
    """With the hole that was found and closed above."""
    hole, after = closed
    (line, _), report = write_scene(tmp_path), tmp_path / "report.json"
    monkeypatch.setattr("prepare.inpaint.inpaint_pipeline.without_supports", lambda *parts: parts[:2])
    monkeypatch.setattr("prepare.inpaint.inpaint_pipeline.inpaint", lambda *_, **__: (after, [hole]))
    monkeypatch.setattr("prepare.inpaint.hole_patch.compare", lambda *_, **__: views)
    assert main([*line, "--remove", "ball", "--report", str(report)]) == 0
    check_written(tmp_path, report, capsys, len(hole.background))


def check_written(folder, report, capsys, kept: int):
    assert "ball: 500 Gaussians removed" in capsys.readouterr().out
    numbers = json.loads(report.read_text())["objects"][0]
    assert len(read_gaussians(folder / "empty.ply")) == kept + numbers["new"] and numbers["new"] > 20
    assert report.with_suffix(".png").is_file() and "before, after" in report.with_suffix(".html").read_text()


@pytest.mark.long
def test_the_command_takes_an_object_out(ti_cpu, tmp_path, capsys):
    (line, kept), report = write_scene(tmp_path), tmp_path / "report.json"
    assert main([*line, "--remove", "ball", "--steps", "3", "--report", str(report)]) == 0
    check_written(tmp_path, report, capsys, kept)
