"""Marks carried to all views: exact depths of a modelled scene, sparse points alone, boxes, networks, and bad marks."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from core.camera import look_at, perspective
from core.errors import BadInput
from prepare.onnx_network import MaskNetwork
from prepare.segment.marks import Marks, ViewMarks
from prepare.segment.mask_files import Masks, contact_sheet, object_colors, overlap_of, overlay
from prepare.segment.mask_propagation import MarkPropagation, border_band, cut_objects, grab_cut, view_depths
from prepare.segment.surface_cloud import depths_of_points
from prepare.train.capture import Capture, Lens, View
from prepare.train.photographs import Photograph
from studio.stroke_marks import two_strokes
from tests.support.onnx_network import Network

WIDTH, HEIGHT, VIEWS, POINTS = 120, 90, 8, 8000
BALL, BOX = np.array([-0.16, 0.1, 0.0]), (np.array([0.05, 0.0, -0.1]), np.array([0.25, 0.16, 0.1]))


def traced(camera):
    """Pixels, ids and depths of a ball and a box of nearly the table's colour on a table, by exact rays."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    d, o = local @ camera.world_to_camera[:3, :3], camera.position
    z, ids = np.full(x.shape, np.inf), np.zeros(x.shape, np.uint8)
    t = -o[1] / d[..., 1]
    hit = o + t[..., None] * d
    z = np.where((t > 0) & (np.abs(hit[..., [0, 2]]) < 0.8).all(-1), t, z)
    b, a, c = (d * (o - BALL)).sum(-1), (d * d).sum(-1), ((o - BALL) ** 2).sum() - 0.1**2
    root = b * b - a * c
    t = (-b - np.sqrt(root.clip(0))) / a
    ids[(root > 0) & (t < z)] = 1
    z = np.where(ids == 1, t, z)
    low, high = ((corner - o) / d for corner in BOX)
    near, far = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
    front = (near < far) & (near < z)
    ids[front], z = 2, np.where(front, near, z)
    hit = o + np.where(np.isfinite(z), z, 0)[..., None] * d
    wood = 150 + 25 * np.sin(40 * hit[..., :1] + 3 * np.sin(9 * hit[..., 2:]))
    pixels = np.where(np.isfinite(z)[..., None], wood * (1.0, 0.8, 0.6), (90, 110, 130))
    pixels = np.where((ids == 1)[..., None], 140 + 60 * np.sin(30 * hit[..., 1:2]) * (1, 0, -1), pixels)
    face = 150 + 30 * np.abs(hit[..., 1:2] - 0.16) / 0.16
    pixels = np.where((ids == 2)[..., None], face * (0.9, 0.75, 0.6), pixels)
    noise = np.random.default_rng(int(1e3 * o[0]) % 97).normal(0, 3, pixels.shape)
    return (pixels + noise).clip(0, 255).astype(np.uint8), ids, np.where(np.isfinite(z), z, 0.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Capture, photographs, true masks and exact depths."""
    folder = tmp_path_factory.mktemp("scene")
    views, photographs, ids, depths, points = [], [], [], [], []
    rng = np.random.default_rng(0)
    for k in range(VIEWS):
        turn = np.radians(-70 + 140 * k / (VIEWS - 1))
        eye = (1.0 * np.sin(turn), 0.35 + 0.25 * (k % 3), 1.0 * np.cos(turn))
        camera = perspective(WIDTH, HEIGHT, 0.8, look_at(eye, (0.03, 0.05, 0.0)))
        pixels, mask, depth = traced(camera)
        image = folder / f"{k}.png"
        cv2.imwrite(str(image), pixels[..., ::-1])
        lens = Lens(WIDTH, HEIGHT, camera.fx, camera.fy, camera.cx, camera.cy)
        views.append(View(image, lens, camera.world_to_camera))
        photographs.append(Photograph(pixels, np.ones(mask.shape, bool), camera))
        ids.append(mask)
        depths.append(depth)
        row, column = np.nonzero(depth)
        some = rng.choice(len(row), 250, replace=False)
        points.append(camera.points_at(depth, column[some], row[some]))
    points = np.concatenate(points)
    capture = Capture(folder, views, points, np.zeros(points.shape, np.uint8))
    return capture, photographs, Masks(["ball", "box"], object_colors(2), ids), depths


def test_two_strokes_an_object_mark_all_views(scene):
    capture, photographs, truth, depths = scene
    propagation = MarkPropagation(capture, photographs, depths, points=POINTS)
    propagation.mark(two_strokes(truth, [v.name for v in capture.views]))
    told = []
    masks = propagation.masks(lambda step, done: told.append((step, done)))
    found = overlap_of(masks, truth)
    assert min(found.values()) > 0.93, found
    assert told[-1] == ("votes", 1.0)


def test_objects_are_compared_with_those_that_cover_them_whatever_their_names():
    true = np.array([[1, 1, 0, 2, 2, 2]], np.uint8)
    found = np.array([[2, 2, 1, 1, 1, 1]], np.uint8)
    truth, masks = (
        Masks(n, object_colors(len(n)), [i]) for n, i in ((["fox", "bear", "cow"], true), (["a", "fox"], found))
    )
    assert overlap_of(masks, truth) == {"fox": 1.0, "bear (found as a)": 0.75, "cow": 0.0}


def test_a_box_and_a_stroke_outside_do_as_well(scene):
    capture, photographs, truth, depths = scene
    y, x = np.nonzero(truth.ids[3] == 1)
    box = np.array([x.min() - 2, y.min() - 2, x.max() + 3, y.max() + 3], float)
    table = np.array([[8.0, 80.0], [110.0, 80.0]])
    marks = Marks({"ball": {"3.png": ViewMarks(boxes=[box], outside=[table])}})
    propagation = MarkPropagation(capture, photographs, depths, points=POINTS)
    propagation.mark(marks)
    only = Masks(["ball"], object_colors(1), [(i == 1).astype(np.uint8) for i in truth.ids])
    assert overlap_of(propagation.masks(), only)["ball"] > 0.88


def test_a_stroke_may_slip_off_the_object(scene):
    """Its pixels on what is seen far behind the ball do not make that a part of the ball."""
    capture, photographs, truth, depths = scene
    y, x = np.nonzero(truth.ids[3] == 1)
    middle, top = (x.mean(), y.mean()), (x.mean(), y.min() - 6.0)
    behind = depths[3][int(top[1]), int(top[0])]
    assert behind == 0 or behind > 1.1 * depths[3][int(middle[1]), int(middle[0])]
    marks = Marks({"ball": {"3.png": ViewMarks([np.array([middle, top])])}})
    propagation = MarkPropagation(capture, photographs, depths, points=POINTS)
    propagation.mark(marks)
    places = propagation._marked_points()["ball"]
    assert np.abs(np.linalg.norm(places - BALL, axis=1) - 0.1).max() < 0.02
    likely = propagation._likely(3)[..., 1] > 0.5
    assert (likely & (truth.ids[3] == 1)).sum() / (likely | (truth.ids[3] == 1)).sum() > 0.9


def test_sparse_points_do_where_there_is_no_splat(scene):
    capture, photographs, truth, _ = scene
    depths = view_depths(capture, [p.camera for p in photographs], None)
    propagation = MarkPropagation(capture, photographs, depths, coarse=True, points=POINTS)
    propagation.mark(two_strokes(truth, [v.name for v in capture.views]))
    assert min(overlap_of(propagation.masks(), truth).values()) > 0.75


def test_a_reduced_photograph_gives_masks_of_the_whole_one(tmp_path, scene):
    """Marks are in pixels of the photograph as it was taken, and so are the masks."""
    capture, photographs, truth, depths = scene
    views = []
    for view in capture.views:
        image = tmp_path / view.name
        cv2.imwrite(str(image), cv2.resize(cv2.imread(str(view.image)), (2 * WIDTH, 2 * HEIGHT)))
        views.append(View(image, view.lens.resized(2 * WIDTH, 2 * HEIGHT, ""), view.world_to_camera))
    large = Masks(truth.names, truth.colors, [i.repeat(2, 0).repeat(2, 1) for i in truth.ids])
    propagation = MarkPropagation(Capture(tmp_path, views), photographs, depths, points=POINTS)
    propagation.mark(two_strokes(large, [v.name for v in views]))
    masks = propagation.masks()
    assert masks.ids[0].shape == (2 * HEIGHT, 2 * WIDTH) and min(overlap_of(masks, large).values()) > 0.93


def test_hidden_points_have_no_depth(scene):
    """Of two points on one ray the nearer is seen."""
    camera = scene[1][0].camera
    x, y = np.meshgrid(np.arange(10, 110, 8), np.arange(10, 80, 8))
    x, y = x.ravel(), y.ravel()
    near, far = (camera.points_at(np.full((HEIGHT, WIDTH), z), x, y) for z in (1.0, 2.0))
    depth = depths_of_points(np.concatenate([far, near]), [camera])[0]
    assert depth[12:78, 12:100] == pytest.approx(1.0, rel=1e-5)
    assert camera.projected(near)[0] == pytest.approx(x + 0.5)


def test_bad_marks_are_named(scene):
    capture, photographs, _, depths = scene
    propagation = MarkPropagation(capture, photographs, [np.zeros_like(d) for d in depths])
    marks = Marks({"ball": {"3.png": ViewMarks([np.array([[60.0, 45.0]])])}})
    with pytest.raises(BadInput, match="'ball': its marks lie where"):
        propagation.mark(marks)
    bare = Capture(Path("bare"), capture.views)
    with pytest.raises(BadInput, match="has no points; train it first"):
        view_depths(bare, [], None)


def test_a_network_of_the_user_draws_the_borders(tmp_path, scene):
    """This one finds red pixels, whatever the geometry says, but for sure ones."""
    path = tmp_path / "red.onnx"
    network = Network(inputs={"image": (1, 3, 512, 512), "hints": (1, 3, 512, 512)})
    weights = np.zeros((1, 3, 1, 1), np.float32)
    weights[0, :, 0, 0] = (1.0, -1.0, 0.0)
    red = network.node("Conv", "image", network.constant("redness", weights))
    unused = network.node("Conv", "hints", network.constant("nothing", np.zeros((1, 3, 1, 1), np.float32)))
    offset = network.node("Add", red, network.constant("level", np.full((1, 1, 1, 1), -0.2, np.float32)))
    network.write(path, network.node("Add", offset, unused), (1, 1, 512, 512))
    picture = np.full((40, 60, 3), 100, np.uint8)
    picture[10:30, 10:30] = (220, 60, 60)
    inside, outside = np.zeros((40, 60), bool), np.zeros((40, 60), bool)
    inside[35:38, 50:55] = outside[10:12, 10:30] = True
    found = MaskNetwork(path)(picture, np.zeros((40, 60)), inside, outside)
    assert found[13:29, 11:29].all() and found[inside].all() and not found[outside].any()
    assert not found[:8].any() and not found[:30, 33:].any()


def test_a_cut_keeps_what_is_sure():
    picture = np.full((30, 40, 3), 90, np.uint8)
    picture[8:22, 8:28] = (200, 180, 40)
    likely = np.zeros((30, 40))
    likely[6:20, 6:26] = 0.8
    inside, outside = np.zeros((30, 40), bool), np.zeros((30, 40), bool)
    inside[12:16, 12:20], outside[:3] = True, True
    found = grab_cut(picture, likely, inside, outside)
    truth = np.zeros((30, 40), bool)
    truth[8:22, 8:28] = True
    assert (found & truth).sum() / (found | truth).sum() > 0.95


def test_a_sheet_shows_objects_in_their_colours():
    ids = np.zeros((20, 30), np.uint8)
    ids[5:15, 5:15] = 1
    grey = np.full((20, 30, 3), 100, np.uint8)
    shown = overlay(grey, ids, np.array([[255, 0, 0]], np.uint8))
    assert shown[10, 10, 0] > 150 > 70 > shown[10, 10, 1] and shown[1, 1].tolist() == [75, 75, 75]
    assert (overlay(grey, None, np.zeros((0, 3))) == grey).all()
    sheet = contact_sheet([shown] * 7)
    assert sheet.shape == (40, 150, 3) and not sheet[20:, 60:].any()


def test_colours_decide_wherever_an_object_is_disputed():
    """A foot, farther from what is surely the object than the cut reaches: of a colour of the object, so it is its."""
    picture = np.full((60, 80, 3), (90, 120, 90), np.uint8)
    picture[10:50, 20:40] = (200, 140, 60)
    picture[16:46, 23:37] = picture[36:50, 40:56] = (240, 230, 220)  # belly and foot
    picture = np.clip(picture + np.random.default_rng(0).normal(0, 4, picture.shape), 0, 255).astype(np.uint8)
    likely = np.zeros((60, 80, 2))
    likely[10:50, 20:40, 1], likely[36:50, 40:56, 1] = 0.95, 0.45
    likely[..., 0] = 1.0 - likely[..., 1]
    unsure = border_band(likely.argmax(axis=2).astype(np.uint8), 2) | (likely.min(axis=2) > 0.2)
    true = np.zeros((60, 80), bool)
    true[10:50, 20:40] = true[36:50, 40:56] = True
    found = cut_objects(picture, likely, unsure, 2, grab_cut) == 1
    assert (found & true).sum() > 0.97 * (found | true).sum()
