"""Captures: transforms.json and COLMAP models, lenses, masks, and what is said of bad ones."""

import json
import shutil
import struct
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from commands.train import read_posed
from core.camera import look_at
from core.errors import BadInput
from prepare.train.capture import Capture, Lens, View
from prepare.train.capture_files import OPENGL_TO_OPENCV, read_capture, read_colmap
from prepare.train.photographs import learned_and_tested, load_photograph, photographs_differ, read_image
from prepare.train.structure_from_motion import find_poses, photographs_in, sharpest_frames
from tests.support.painted_capture import write_capture
from tests.support.splat_encoders import ply_bytes

WIDTH, HEIGHT = 48, 32
EYES = [(2.0, 0.5, 0.0), (0.0, 0.6, 2.0), (-2.0, 0.4, 0.1), (0.3, 0.5, -2.0)]
POSES = [look_at(eye, (0, 0, 0)) for eye in EYES]
LENSES = (
    Lens(320, 240, 220.0, 225.0, 165.0, 118.0, (-0.2, 0.05, 0.002, -0.001)),
    Lens(320, 240, 150.0, 150.0, 160.0, 120.0, (0.05, -0.01, 0.0, 0.0), fisheye=True),
)
POINTS = np.random.default_rng(0).uniform(-1, 1, (20, 3))


def write_images(folder, count=len(POSES), size=(WIDTH, HEIGHT)):
    (folder / "images").mkdir()
    rng = np.random.default_rng(1)
    for k in range(count):
        pixels = rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
        cv2.imwrite(str(folder / "images" / f"{k}.png"), pixels)


def transforms(**changes) -> dict:
    frames = []
    for k, pose in enumerate(POSES):
        matrix = np.linalg.inv(pose) @ OPENGL_TO_OPENCV
        frames.append({"file_path": f"images/{k}.png", "transform_matrix": matrix.tolist()})
    return {"w": WIDTH, "h": HEIGHT, "fl_x": 40.0, "fl_y": 41.0, "cx": 24.5, "cy": 15.5, "frames": frames, **changes}


@pytest.fixture
def folder(tmp_path):
    write_images(tmp_path)
    return tmp_path


def look_away(data: dict) -> None:
    """Turn all cameras round, as if +z were ahead in the file."""
    for frame in data["frames"]:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ OPENGL_TO_OPENCV).tolist()


def write(folder, data) -> None:
    (folder / "transforms.json").write_text(json.dumps(data))


def test_transforms_json_gives_cameras_with_z_ahead(folder):
    write(folder, transforms())
    capture = read_capture(folder)
    assert [v.name for v in capture.views] == [f"{k}.png" for k in range(4)] and len(capture.points) == 0
    for view, pose in zip(capture.views, POSES, strict=True):
        assert_allclose(view.world_to_camera, pose, atol=1e-12)
    camera = load_photograph(capture.views[0]).camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (48, 32, 40.0, 41.0, 24.5, 15.5)
    assert capture.up[1] > 0.95 and 2.0 < capture.extent < 2.6


def test_photographs_reduced_on_disk_and_on_demand_have_the_same_view(tmp_path):
    """The file's camera is that of larger images; `reduce` divides once more."""
    write_images(tmp_path, size=(WIDTH // 2, HEIGHT // 2))
    write(tmp_path, transforms())
    view = read_capture(tmp_path).views[0]
    for reduce in (1, 2):
        p = load_photograph(view, reduce)
        assert p.pixels.shape == (HEIGHT // 2 // reduce, WIDTH // 2 // reduce, 3)
        assert_allclose([p.camera.fx, p.camera.cx], [20.0 / reduce, 12.25 / reduce])


def text_model(folder) -> None:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(f"# cameras\n7 OPENCV {WIDTH} {HEIGHT} 40 41 24.5 15.5 0.01 -0.02 0.001 0.002\n")
    lines = []
    for k, (q, t) in enumerate(quaternions()):
        lines += [f"{k + 1} {' '.join(map(repr, q))} {' '.join(map(repr, t))} 7 {k}.png", "1.0 2.0 -1" if k else ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{k} {x} {y} {z} {k} 5 6 0.5 1 2 3 4" for k, (x, y, z) in enumerate(POINTS.tolist())]
    (model / "points3D.txt").write_text("\n".join(rows) + "\n")


def quaternions():
    from core.rotation import quaternions_from_matrices

    for pose in POSES:
        yield quaternions_from_matrices(pose[:3, :3]).tolist(), pose[:3, 3].tolist()


def binary_model(folder) -> None:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    distortion = (0.01, -0.02, 0.001, 0.002)
    camera = struct.pack("<QIiQQ8d", 1, 7, 4, WIDTH, HEIGHT, 40, 41, 24.5, 15.5, *distortion)
    (model / "cameras.bin").write_bytes(camera)
    images = [struct.pack("<Q", len(POSES))]
    for k, (q, t) in enumerate(quaternions()):
        images.append(struct.pack("<I7dI", k + 1, *q, *t, 7) + f"{k}.png".encode() + b"\0" + struct.pack("<Q", 2))
        images.append(struct.pack("<ddqddq", 1, 2, -1, 3, 4, 5))
    (model / "images.bin").write_bytes(b"".join(images))
    points = [struct.pack("<Q", len(POINTS))]
    for k, point in enumerate(POINTS):
        points.append(struct.pack("<Q3d3BdQii", k, *point, k, 5, 6, 0.5, 1, 3, 4))
    (model / "points3D.bin").write_bytes(b"".join(points))


@pytest.mark.parametrize("make", [text_model, binary_model])
def test_colmap_models_give_cameras_and_points(folder, make):
    make(folder)
    capture = read_capture(folder)
    assert_allclose(capture.points, POINTS, atol=1e-12)
    assert capture.colors[:, 0].tolist() == list(range(20)) and (capture.colors[:, 1:] == (5, 6)).all()
    for view, pose in zip(capture.views, POSES, strict=True):
        assert_allclose(view.world_to_camera, pose, atol=1e-9)
        assert view.lens.distortion[:4] == (0.01, -0.02, 0.001, 0.002)


@pytest.mark.parametrize("make", [text_model, binary_model])
def test_a_cut_colmap_model_is_refused(folder, make):
    make(folder)
    for path in (folder / "sparse" / "0").iterdir():
        whole = path.read_bytes()
        for size in range(0, len(whole), max(1, len(whole) // 40)):
            path.write_bytes(whole[:size])
            try:
                read_capture(folder)
            except BadInput as e:
                assert "\n" not in str(e)
        path.write_bytes(whole)


@pytest.mark.parametrize("lens", LENSES)
def test_an_undistorted_picture_is_that_of_a_pinhole(lens):
    """A pattern over directions, photographed through the lens: undistorted, each pixel shows its own direction."""

    def pattern(x, y):
        return 128 + 60 * np.sin(9.0 * x) + 60 * np.cos(7.0 * y)

    u, v = np.meshgrid(np.arange(320, dtype=np.float64), np.arange(240, dtype=np.float64))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    undistort = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    count = 4 if lens.fisheye else 8
    k = np.array([*lens.distortion, *[0.0] * 8][:count])
    rays = undistort(pixels, lens.matrix(), k).reshape(240, 320, 2)
    seen = np.repeat(pattern(rays[..., 0], rays[..., 1])[..., None], 3, axis=2).round().clip(0, 255).astype(np.uint8)
    straight, mask = lens.undistort(seen, np.ones((240, 320), bool))
    fx, fy, cx, cy = lens.pinhole()
    truth = pattern((u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy)
    assert 0.5 < mask.mean() <= 1.0
    assert np.abs(straight[..., 0] - truth)[mask].max() < 6.0  # of 120; half a pixel off would be 8 to 15


@pytest.mark.parametrize("lens", LENSES)
def test_labels_of_the_pinhole_come_back_through_the_lens(lens):
    """A disc away from the middle: bent straight and back it is the same but for its rim."""
    down, along = np.mgrid[: lens.height, : lens.width]
    disc = (np.hypot(along - 220, down - 80) < 40).astype(np.uint8)
    straight = lens.undistort_labels(disc)
    back = lens.distort_labels(straight)
    assert (back & disc).sum() / (back | disc).sum() > 0.96
    dot = lens.undistort_labels((np.hypot(along - 220, down - 80) < 6).astype(np.uint8))
    centre = lens.undistort_points(np.array([[220.5, 80.5]]))[0]
    assert np.hypot(*(centre - np.argwhere(dot).mean(axis=0)[::-1] - 0.5)) < 1.0 < np.hypot(*(centre - (220.5, 80.5)))


def test_a_blender_dataset_brings_its_own_test_photographs_and_opacity(folder):
    """No sizes, no suffixes; colours lie over black, and every pixel counts."""
    rgba = np.full((HEIGHT, WIDTH, 4), 200, np.uint8)
    rgba[:10, :, 3], rgba[10:12, :, 3], rgba[12:, :, 3] = 0, 102, 255
    for k in range(4):
        cv2.imwrite(str(folder / "images" / f"{k}.png"), rgba)
    frames = [{**f, "file_path": f"./images/{k}"} for k, f in enumerate(transforms()["frames"])]
    for name, part in (("train", frames[:3]), ("test", frames[3:]), ("val", frames[:0])):
        (folder / f"transforms_{name}.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": part}))
    for given in (folder, folder / "transforms_train.json"):
        capture = read_capture(given)
        assert [v.name for v in capture.views] == ["0.png", "1.png", "2.png"]
        assert [v.name for v in capture.test] == ["3.png"] and len(capture.upright().test) == 1
    p = load_photograph(capture.views[0])
    assert p.mask.all() and (p.alpha[:10] == 0).all() and (p.alpha[10:12] == 102).all() and (p.alpha[12:] == 255).all()
    assert (p.pixels[:10] == 0).all() and (p.pixels[10:12] == 80).all() and (p.pixels[12:] == 200).all()
    assert [len(part) for part in learned_and_tested(capture, 1, 2)] == [3, 1], "its own test, not every second one"
    assert [len(part) for part in learned_and_tested(capture, 1, 0)] == [3, 0]
    small = load_photograph(capture.views[0], 4)
    assert small.alpha.shape == small.mask.shape == (8, 12) and small.alpha[2, 0] == 51 and small.pixels[2, 0, 0] == 40
    (folder / "images" / "3.png").unlink()
    with pytest.raises(BadInput, match=r"3\.png: no such image \(1 of 4 are missing\)"):
        read_capture(folder)


def test_polycam_raw_data_is_read_the_corrected_part_first(tmp_path):
    """Poses in rows of t_00 ...; the border of corrected photographs does not count."""
    frames = transforms()["frames"]
    for kind in ("", "corrected_"):
        (tmp_path / "keyframes" / f"{kind}cameras").mkdir(parents=True)
        (tmp_path / "keyframes" / f"{kind}images").mkdir()
        for k, frame in enumerate(frames):
            pose = {f"t_{i}{j}": frame["transform_matrix"][i][j] for i in range(3) for j in range(4)}
            lens = {"fx": 40.0, "fy": 41.0, "cx": 24.5, "cy": 15.5, "width": WIDTH, "height": HEIGHT}
            file = tmp_path / "keyframes" / f"{kind}cameras" / f"{100 + k}.json"
            file.write_text(json.dumps({**pose, **lens, "blur_score": 90.0, "neighbors": [1]}))
            image = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
            cv2.imwrite(str(tmp_path / "keyframes" / f"{kind}images" / f"{100 + k}.jpg"), image)
    for given in (tmp_path, tmp_path / "keyframes"):
        views = read_capture(given).views
        assert [v.image.parts[-2:] for v in views] == [("corrected_images", f"{100 + k}.jpg") for k in range(4)]
        for view, pose in zip(views, POSES, strict=True):
            assert_allclose(view.world_to_camera, pose, atol=1e-9)
    p = load_photograph(views[0])
    assert p.mask.sum() == (WIDTH - 30) * (HEIGHT - 30) and p.mask[16, 24] and p.camera.fy == 41.0
    shutil.rmtree(tmp_path / "keyframes" / "corrected_cameras")
    assert load_photograph(read_capture(tmp_path).views[0]).mask.all()
    (tmp_path / "keyframes" / "cameras" / "100.json").write_text("{}")
    with pytest.raises(BadInput, match=r"keyframes/cameras: images/100: the pose is not a finite 4x4 matrix"):
        read_capture(tmp_path)


@pytest.mark.parametrize(("metadata", "images"), [("metadata.json", "rgb"), ("metadata", "rgbd")])
def test_a_record3d_recording_is_read(tmp_path, monkeypatch, metadata, images):
    """Quaternions with w last, K by columns; of a long recording every so manieth photograph."""
    from core.rotation import quaternions_from_matrices

    (tmp_path / images).mkdir()
    poses = []
    for k, pose in enumerate(POSES):
        matrix = np.linalg.inv(pose) @ OPENGL_TO_OPENCV
        poses.append([*np.roll(quaternions_from_matrices(matrix[:3, :3]), -1), *matrix[:3, 3]])
        cv2.imwrite(str(tmp_path / images / f"{k}.jpg"), np.full((HEIGHT, WIDTH, 3), 200, np.uint8))
    data = {"w": WIDTH, "h": HEIGHT, "K": [40, 0, 0, 0, 41, 0, 24.5, 15.5, 1], "poses": poses}
    (tmp_path / metadata).write_text(json.dumps(data))
    views = read_capture(tmp_path).views
    assert (views[0].lens.fx, views[0].lens.fy, views[0].lens.cx, views[0].lens.cy) == (40, 41, 24.5, 15.5)
    for view, pose in zip(views, POSES, strict=True):
        assert_allclose(view.world_to_camera, pose, atol=1e-9)
    data = {**data, "poses": 2 * poses, "perFrameIntrinsicCoeffs": [[50 + k, 51, 24, 16] for k in range(8)]}
    (tmp_path / metadata).write_text(json.dumps(data))
    with pytest.raises(BadInput, match=r"4\.png: no such image \(4 of 8 are missing\)"):
        read_capture(tmp_path)
    monkeypatch.setattr("prepare.train.capture_files.RECORD3D_VIEWS", 2)
    shutil.copyfile(tmp_path / images / "0.jpg", tmp_path / images / "4.jpg")
    with pytest.raises(BadInput, match="2 views; take at least 3"):
        read_capture(tmp_path)
    (tmp_path / metadata).write_text(json.dumps({**data, "poses": [[1, 2]]}))
    with pytest.raises(BadInput, match=f"{metadata}: poses"):
        read_capture(tmp_path)


def test_instant_ngp_names_without_suffix_and_two_angles_of_view(folder):
    """Keys of its scripts that say nothing here are passed over; a suffix is found, fy follows from its own angle."""
    data = transforms(camera_angle_x=0.9, camera_angle_y=0.7, aabb_scale=16, scale=0.33, offset=[0.5, 0.5, 0.5])
    for name in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        data.pop(name)
    for frame in data["frames"]:
        frame |= {"file_path": "./" + frame["file_path"].removesuffix(".png"), "sharpness": 30.0}
    cv2.imwrite(str(folder / "images" / "0.jpg"), cv2.imread(str(folder / "images" / "0.png")))
    (folder / "images" / "0.png").unlink()
    write(folder, data)
    capture = read_capture(folder)
    assert [v.name for v in capture.views] == ["0.jpg", "1.png", "2.png", "3.png"]
    lens = capture.views[0].lens
    assert_allclose([2 * np.arctan(0.5 * WIDTH / lens.fx), 2 * np.arctan(0.5 * HEIGHT / lens.fy)], [0.9, 0.7])
    assert (lens.cx, lens.cy) == (WIDTH / 2, HEIGHT / 2)


def test_reduced_photographs_are_taken_from_their_folder(folder):
    """images_2/ beside images/, if its sizes are what it says."""
    write(folder, transforms())
    (folder / "images_2").mkdir()
    copy = str(folder / "images_2" / "0.png")
    cv2.imwrite(copy, np.full((HEIGHT // 2, WIDTH // 2, 3), 77, np.uint8))
    views = read_capture(folder).views
    p = load_photograph(views[0], 2)
    assert (p.pixels == 77).all() and p.camera.fx == 20.0 and load_photograph(views[1], 2).pixels.std() > 10
    assert load_photograph(views[0], 4).pixels.std() > 10 and load_photograph(views[0]).camera.width == WIDTH
    cv2.imwrite(copy, np.zeros((HEIGHT // 4, WIDTH // 4, 3), np.uint8))
    with pytest.raises(BadInput, match=r"images_2.0\.png: is 12x8, and not 48x32 divided by 2"):
        load_photograph(views[0], 2)


def test_transparent_and_masked_pixels_do_not_count(folder):
    (folder / "sparse_pc.ply").write_bytes(ply_bytes(dict.fromkeys("xyz", np.zeros(9))))
    rgba = np.full((HEIGHT, WIDTH, 4), 200, np.uint8)
    rgba[:10, :, 3] = 0
    cv2.imwrite(str(folder / "images" / "0.png"), rgba)
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, :8] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    write(folder, transforms(mask_path="mask.png"))
    p = load_photograph(read_capture(folder).views[0])
    assert not p.mask[:10].any() and not p.mask[:, :8].any() and p.mask[10:, 8:].all()


@pytest.mark.parametrize("kind", ["grey", "grey16", "colour16"])
def test_grey_and_16_bit_images_are_read(tmp_path, kind):
    values = np.arange(256, dtype=np.uint16).reshape(16, 16) * (257 if "16" in kind else 1)
    image = values if "16" in kind else values.astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), np.dstack([image] * 3) if kind == "colour16" else image)
    pixels, opaque = read_image(tmp_path / "a.png")
    assert (pixels == np.arange(256).reshape(16, 16)[..., None]).all() and opaque.all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t["frames"][2].update(file_path="images/9.png"), "9.png: no such image (1 of 4"),
        (lambda t: t["frames"][2].update(file_path="9" * 300), "9.png: no such image (1 of 4"),
        (lambda t: t["frames"][2].update(file_path="9" * 100_000), "99 ... 99"),
        (lambda t: t.update(cx=1e300, fl_y=None), "(1e+300, 15.5) is too far from the picture"),
        (lambda t: t["frames"][1].update(file_path="../9.png"), "not inside of the capture"),
        (lambda t: t["frames"][1].update(transform_matrix=[[1, 0], [0, 1]]), "not a finite 4x4 matrix"),
        (lambda t: t["frames"][1].update(transform_matrix=(2 * np.eye(4)).tolist()), "scales by 2 to 2"),
        (lambda t: t["frames"].__delitem__(slice(1, None)), "1 views; take at least 3"),
        (lambda t: [f.update(transform_matrix=np.eye(4).tolist()) for f in t["frames"]], "stand in one place"),
        (lambda t: t.update(fl_x="wide"), "fl_x is not a number"),
        (lambda t: t.pop("fl_x"), "neither a focal length"),
        (lambda t: t.update(fl_x=float("nan")), "no finite positive numbers"),
        (lambda t: t.update(camera_model="MIRROR"), "'MIRROR' is not known"),
        (lambda t: t.update(ply_file_path="points.ply"), "points.ply: no such file"),
        (lambda t: t.update(frames=5), "no list of frames"),
    ],
)
def test_a_bad_capture_is_named(folder, change, says):
    data = transforms()
    change(data)
    write(folder, data)
    with pytest.raises(BadInput) as error:
        read_capture(folder)
    assert says in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (
            lambda f, d: cv2.imwrite(str(f / "images" / "2.png"), np.zeros((30, 30))),
            "2.png: the image is 30x30, its cam",
        ),
        (lambda f, d: [(f / "images" / f"{k}.png").unlink() for k in (1, 3)], "1.png: no such image (2 of 4 are miss"),
        (lambda f, d: cv2.imwrite(str(f / "m.png"), np.ones((5, 48))), "m.png: the mask is 48x5, its image 48x32"),
        (lambda f, d: (f / "m.png").unlink(), "m.png: no such file"),
        (lambda f, d: d.update(frames=d["frames"][:1] * 4), "all cameras stand in one place"),
        (lambda f, d: look_away(d), "4 of 4 cameras see none of the points: the poses are of another set"),
    ],
)
def test_what_is_wrong_with_a_capture_is_said_before_its_photographs_are_loaded(folder, spoil, says):
    cv2.imwrite(str(folder / "m.png"), np.ones((HEIGHT, WIDTH)))
    data = transforms(mask_path="m.png", ply_file_path="sparse_pc.ply")
    (folder / "sparse_pc.ply").write_bytes(ply_bytes(dict(zip("xyz", 0.1 * POINTS.T, strict=True))))
    write(folder, data)
    assert len(read_capture(folder).views) == 4
    spoil(folder, data)
    write(folder, data)
    with pytest.raises(BadInput) as error:
        read_capture(folder)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_a_splat_is_first_seen_from_amid_its_cameras():
    """All around a thing; on one side of it, one far away; and in a room, looking out."""

    def view(turns, away=2.0, target=(0.0, 0.5, 0.0)):
        eyes = [
            (r * np.sin(t), 0.5, r * np.cos(t)) for t, r in zip(turns, np.broadcast_to(away, len(turns)), strict=True)
        ]
        poses = [look_at(eye, target if target else 2.0 * np.array(eye) - (0.0, 0.5, 0.0)) for eye in eyes]
        return Capture(Path(), [View(Path(), LENSES[0], pose) for pose in poses]).photographer()

    turns = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    assert view(turns)[6] == np.pi
    found = view(np.pi + np.linspace(-0.7, 0.7, 9), [2.0] * 4 + [9.0] + [2.0] * 4)
    assert_allclose(found[3:], (0.0, 0.5, 0.0, 0.7), atol=1e-6)
    assert abs(np.arctan2(found[0], -found[2])) == pytest.approx(0.175) and np.hypot(*found[:3:2]) == pytest.approx(2.0)
    out = view(turns, target=None)
    assert out[6] < 0.6 and np.dot(out[3:6], out[:3]) > np.dot(out[:3], out[:3])


def test_photographs_that_were_renamed_are_noticed(tmp_path):
    """By the colours of the points; not if these are grey, nor with their own poses."""
    write_capture(tmp_path)
    capture, said = read_capture(tmp_path), []
    assert not photographs_differ(capture)
    read_posed(tmp_path, said.append)
    assert not said
    for k, view in enumerate(capture.views):
        view.image.rename(tmp_path / f"{(k + 3) % len(capture.views):02}.png")
    for path in tmp_path.glob("*.png"):
        path.rename(tmp_path / "images" / path.name)
    mixed = read_posed(tmp_path, said.append)
    assert len(said) == 1 and "poses of another set" in said[0]
    assert not photographs_differ(replace(mixed, colors=np.full_like(mixed.colors, 128)))


def test_a_damaged_image_is_named(folder):
    write(folder, transforms())
    views = read_capture(folder).views
    (folder / "images" / "1.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    with pytest.raises(BadInput, match=r"1\.png: not an image"):
        load_photograph(views[1])


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_a_lens_that_leaves_no_pixel_is_named(folder, model):
    """With nothing to learn from, each training would be perfect."""
    write(folder, transforms(camera_model=model, k1=1e300))
    with pytest.raises(BadInput, match=r"0\.png: its lens, \(1e\+300, .*\), distorts it so much that no pixel is left"):
        load_photograph(read_capture(folder).views[0])


def test_a_name_in_a_colmap_model_may_be_too_long_for_a_file(folder):
    text_model(folder)
    images = folder / "sparse" / "0" / "images.txt"
    images.write_text(images.read_text().replace("0.png", "0" * 300))
    with pytest.raises(BadInput, match="000: no such image"):
        read_capture(folder)


def test_what_is_no_capture_is_said(tmp_path):
    with pytest.raises(BadInput, match="no such folder"):
        read_capture(tmp_path / "none")
    with pytest.raises(BadInput, match=r"no photographs, .* and no transforms\.json or COLMAP model"):
        read_capture(tmp_path)
    (tmp_path / "transforms.json").write_text("{")
    with pytest.raises(BadInput, match="not a JSON file"):
        read_capture(tmp_path)


def test_the_sharpest_frame_of_each_part_of_a_video_is_taken(tmp_path):
    """Every fifth frame is sharp, the others are blurred."""
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48))
    for k in range(20):
        frame = noise if k % 5 == 3 else cv2.GaussianBlur(noise, (9, 9), 3)
        cv2.putText(frame := frame.copy(), str(k), (4, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1)
        writer.write(frame)
    writer.release()
    assert sharpest_frames(tmp_path / "a.avi", tmp_path / "frames", 4) == 4
    sharpness = []
    for name in photographs_in(tmp_path / "frames"):
        sharpness.append(np.var(cv2.Laplacian(cv2.imread(str(tmp_path / "frames" / name)), cv2.CV_32F)))
    assert len(sharpness) == 4 and min(sharpness) > 1000.0
    (tmp_path / "b.mp4").write_bytes(b"nothing")
    with pytest.raises(BadInput, match="not a video"):
        sharpest_frames(tmp_path / "b.mp4", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_photographs_without_poses_need_pycolmap(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    names = photographs_in(folder / "images")
    with pytest.raises(BadInput, match=r"requirements-poses\.txt"):
        find_poses(folder / "images", folder / "poses", names=names, in_order=False, progress=print)


def test_a_failure_of_pycolmap_is_told_in_one_line(folder, monkeypatch):
    """Its database says no more than a RuntimeError when the disk is full."""
    module = MagicMock(**{"extract_features.side_effect": RuntimeError("No database.\nAt all.")})
    monkeypatch.setitem(sys.modules, "pycolmap", module)
    names = photographs_in(folder / "images")
    with pytest.raises(BadInput, match=r"poses cannot be found and written here \(No database\. At all\.\)$"):
        find_poses(folder / "images", folder / "poses", names=names, in_order=False, progress=print)
    assert not any(p.name.startswith("poses") for p in folder.iterdir())
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=3e6))
    with pytest.raises(BadInput, match=r"the disk has 3 MB left, about \d+ MB are needed"):  # it may abort there
        find_poses(folder / "images", folder / "poses", names=names, in_order=False, progress=print)


@pytest.mark.long
@pytest.mark.shared
def test_poses_are_found_as_they_were(tmp_path, shared):
    """A third of a capture's photographs: cameras stand where its file says, within 1 % of its extent."""
    pytest.importorskip("pycolmap")
    given = read_capture(shared / "data" / "captures" / "fox")
    images = tmp_path / "images"
    images.mkdir()
    for view in given.views[::3]:
        shutil.copy(view.image, images)
    find_poses(images, tmp_path / "sparse", names=photographs_in(images), in_order=False, progress=print)
    found = read_colmap(tmp_path / "sparse", images)
    places = {v.name: v.position for v in given.views}
    a = np.array([places[v.name] for v in found.views])
    b = np.array([v.position for v in found.views])
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, s, vt = np.linalg.svd(a.T @ b)
    rotation = u @ vt  # a right-handed one, or the distances below are large
    assert len(found.views) == len(given.views[::3]) and np.linalg.det(rotation) > 0
    scale = s.sum() / (b**2).sum()
    assert np.linalg.norm(a - scale * b @ rotation.T, axis=1).max() < 0.01 * given.extent
