"""A clip of a block: read, cut out, found and followed; and what is refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.camera import look_at, perspective
from core.errors import BadInput
from display.drawn_body import DrawnBody
from display.headless.video import Video
from prepare.fit.clip_masks import Clip, backdrop_of, clip_masks, read_clip, read_clip_marks, straightened
from prepare.fit.clip_tracks import ALIGNED_SIDE, Shot, clip_tracks, found_pose, resting, tracked
from prepare.fit.fit_report import mask_pictures
from prepare.fit.marker_tracks import MarkerTracks, noise_of, posed, start_of, surface_weights
from prepare.progress import no_progress
from prepare.segment.marks import ViewMarks, write_marks
from prepare.train.capture import Lens
from tests.support.filmed_block import PIXELS, SIZE, TIMES, TRUE, camera_of, filmed, let_go, marks_of, speckled_block

NO_PLANES = np.zeros((0, 4))


@pytest.fixture(scope="module")
def block(ti_cpu):
    return speckled_block(TRUE)


@pytest.fixture(scope="module")
def moving(block):
    return let_go(block, TIMES)


@pytest.fixture(scope="module")
def clip(block, moving):
    return Clip(filmed(block, moving, camera_of()), TIMES, 0, "clip")


@pytest.fixture(scope="module")
def true_masks(block, moving):
    drawn, masks = DrawnBody(block, ALIGNED_SIDE, ALIGNED_SIDE), []
    for x in moving:
        drawn.move(x)
        masks.append(drawn.picture(camera_of())[1] > 0.5)
    drawn.destroy()
    return np.stack(masks)


@pytest.fixture(scope="module")
def masks(clip, moving):
    marks = marks_of(camera_of(), moving)
    return clip_masks(clip, {0: marks.objects["block"]["frame_0000"]})


def blank(**changes) -> MarkerTracks:
    gravity = np.array([0, -9.81, 0])
    return replace(MarkerTracks(TIMES, None, None, None, np.inf, None, NO_PLANES, gravity), **changes)


def test_a_drawn_body_is_where_its_cage_is(block):
    """Moved and turned as a whole it looks as through a camera that is moved and turned the other way."""
    camera, drawn = camera_of(), DrawnBody(block, ALIGNED_SIDE, ALIGNED_SIDE)
    x = block.cage.vertices.astype(float)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("y", 0.4).as_matrix(), [0.01, 0.02, -0.03]
    beside = drawn.picture(replace(camera, world_to_camera=camera.world_to_camera @ pose))
    drawn.move(posed(pose, x))
    for a, b in zip(drawn.picture(camera), beside, strict=True):
        assert np.percentile(np.abs(a - b), 99) < 0.01
    with pytest.raises(ValueError, match="larger than was said"):
        drawn.picture(camera.resized(800, 600))
    drawn.destroy()


def test_masks_follow_the_thing_from_marks_in_one_picture(masks, true_masks):
    overlap = (masks & true_masks).sum((1, 2)) / (masks | true_masks).sum((1, 2))
    assert overlap.min() > 0.88


def test_a_thing_that_leaves_the_picture_is_missed(clip, moving):
    """It goes on to the right, out of the picture, and only the wall is left."""
    empty = backdrop_of(
        clip.pictures, clip_masks(clip, {0: marks_of(camera_of(), moving).objects["block"]["frame_0000"]})
    )
    gone = [
        np.where(np.arange(PIXELS[0])[None, :, None] < 14 * k, empty, np.roll(clip.pictures[0], 14 * k, 1))
        for k in range(14)
    ]
    left = Clip(np.stack(gone), TIMES[:14], 0, "clip")
    with pytest.raises(BadInput, match=r"clip: frame_00\d\d: the thing leaves the picture, or its mask is lost"):
        clip_masks(left, {0: marks_of(camera_of(), moving).objects["block"]["frame_0000"]})


def test_the_pose_at_the_start_is_found_wherever_the_thing_is(block):
    """Turned far from how the asset stands, before another camera."""
    drawn, camera = (
        DrawnBody(block, ALIGNED_SIDE, ALIGNED_SIDE),
        perspective(*PIXELS, 0.5, look_at((0.1, 0.4, 0.6), (0, 0.1, 0))),
    )
    x = block.cage.vertices.astype(float)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("yxz", [2.4, 0.7, 0.4]).as_matrix()
    pose[:3, 3] = [0.08, 0.1, 0.02]
    drawn.move(posed(pose, x))
    mask = drawn.picture(camera)[1] > 0.5
    one = Clip(drawn.over(np.full((*PIXELS[::-1], 3), 120, np.uint8), camera)[None], TIMES[:1], 0, "clip")
    drawn.move(x)
    found = found_pose(drawn.picture, x, camera, one, mask, lambda done: None)
    off = np.linalg.norm(posed(found, x) - posed(pose, x), axis=1)
    assert np.degrees(Rotation.from_matrix(found[:3, :3].T @ pose[:3, :3]).magnitude()) < 3 and off.max() < 0.03
    with pytest.raises(BadInput, match="looks in no pose like the mask in frame_0000"):
        ring = np.zeros_like(mask)
        cv2.circle(ring.view(np.uint8), (80, 60), 50, 1, 3)
        found_pose(drawn.picture, x, camera, one, ring, lambda done: None)
    drawn.destroy()


def test_a_body_is_laid_on_a_plane_and_moved_along_the_line_of_sight(block):
    camera, x = camera_of(), block.cage.vertices.astype(float)
    plane, lifted = np.array([[0.0, 1.0, 0.0, 0.0]]), np.eye(4)
    lifted[1, 3] = 0.01
    leaning = lifted.copy()
    leaning[:3, :3] = Rotation.from_euler("zx", [0.06, -0.05]).as_matrix()
    flat = posed(resting(leaning, x, camera, plane), x)
    assert np.ptp(flat[x[:, 1] < 1e-6, 1]) < 1e-9
    leaning[:3, :3] = Rotation.from_euler("z", 0.5).as_matrix()
    np.testing.assert_allclose(resting(leaning, x, camera, plane)[:3, :3], leaning[:3, :3])
    at = posed(resting(lifted, x, camera, plane), x)
    assert abs(at[:, 1].min()) < 1e-9
    before, after = (np.stack(camera.projected(q.mean(0))[:2]) for q in (posed(lifted, x), at))
    assert np.abs(before - after).max() < 1e-6


def test_points_of_the_surface_are_followed(block, clip, masks, moving):
    drawn = DrawnBody(block, ALIGNED_SIDE, ALIGNED_SIDE)
    shot = Shot(clip, masks, camera_of(), np.array([[0, 0, 40, PIXELS[1]]]))
    tracks = clip_tracks(drawn.picture, block, [shot], blank(), no_progress)
    drawn.destroy()
    x = block.cage.vertices.astype(float)
    weights, away = surface_weights(x, block.cage.tets, tracks.rest)
    off = (tracks.observed(np.stack([weights @ q for q in moving])) - tracks.points) / tracks.metres
    assert len(tracks.rest) > 30 and tracks.seen.mean() > 0.8 and away.max() < 0.01
    assert np.sqrt(np.nanmean(off**2)) < 0.6 and np.sqrt(np.nanmean((off - np.nanmean(off, 0)) ** 2)) < 0.3  # [px]
    assert 0.005 < noise_of(tracks) / tracks.metres < 0.3
    assert np.linalg.norm(tracks.start - moving[0], axis=1).max() < 0.01
    assert 9 <= tracks.is_held(x, tracks.start).sum() < len(x)
    shown = mask_pictures(shot, tracks)
    assert len(shown) == 6 and all(p.shape == clip.pictures[0].shape for p in shown.values())


@pytest.mark.long
def test_a_second_camera_shows_the_depth_that_one_does_not(block, clip, moving, masks):
    """The second stands beside the block, at 90 degrees, and takes its pictures between those of the first."""
    middle, later = SIZE / 2 - [0, 0.02, 0], TIMES + 0.25 * TIMES[1]
    aside = perspective(*PIXELS, np.radians(32), look_at(middle + [0.36, 0.12, 0.06], middle))
    ways = let_go(block, later)
    other = Clip(filmed(block, ways, aside, 1), later - later[0] + 0.25 * TIMES[1], 0, "aside")
    cut = clip_masks(other, {0: marks_of(aside, ways).objects["block"]["frame_0000"]})
    front = Shot(clip, masks, camera_of(), np.array([[0, 0, 40, PIXELS[1]]]))
    shots = [front, Shot(other, cut, aside, np.zeros((0, 4)))]
    drawn = DrawnBody(block, ALIGNED_SIDE, ALIGNED_SIDE)
    one, both = (clip_tracks(drawn.picture, block, part, blank(), no_progress) for part in (shots[:1], shots))
    drawn.destroy()
    depth = camera_of().world_to_camera[2, :3]
    near, off = (abs((t.start - moving[0]).mean(0) @ depth) for t in (both, one))
    assert near < 0.7 * off
    assert len(both.times) == 2 * len(TIMES) and np.bincount(both.camera.of).min() > 10
    assert 0.005 < noise_of(both) / both.metres < 0.3 and start_of(both)[2].mean() > 0.9
    assert 9 <= both.is_held(block.cage.vertices.astype(float), both.start).sum() < len(moving[0])


def test_a_marker_that_is_covered_for_a_moment_is_found_again_and_one_that_strays_is_not():
    """A speckled picture slides by (4.1, 1.6) px; a bar covers a part of it in one of the pictures, and a patch that
    moves otherwise lies on another part from the fifth on."""
    rng = np.random.default_rng(0)
    wide = cv2.GaussianBlur(rng.normal(size=(200, 240)).astype(np.float32), (0, 0), 2.0)
    wide = np.repeat(((128 + 300 * wide).clip(0, 255).astype(np.uint8))[..., None], 3, 2)
    pictures = []
    for k in range(12):
        shift = np.array([[1, 0, 4.1 * k - 60], [0, 1, 1.6 * k - 30.0]])
        pictures.append(cv2.warpAffine(wide, shift, PIXELS, flags=cv2.INTER_CUBIC))
        if k == 3:
            pictures[k][:, 30:60] = 20
        if k >= 5:
            pictures[k][60:84, 90:114] = np.roll(pictures[k], -9 * (k - 4), 1)[60:84, 90:114]
    clip = Clip(np.stack(pictures), TIMES[:12], 0, "clip")
    inside = np.zeros((12, *PIXELS[::-1]), bool)
    inside[:, 4:116, 4:156] = True
    inside[3, :, 30:60] = False
    found = tracked(clip, inside)
    where, seen = found[0], np.isfinite(found).all(2)
    covered = (where[:, 0] > 26) & (where[:, 0] < 38)
    off = np.linalg.norm(found - where - np.arange(12)[:, None, None] * [4.1, 1.6], axis=2)
    assert covered.sum() > 3 and not seen[3, covered].any() and seen[8, covered].mean() > 0.6
    assert np.nanmedian(off[8, covered]) < 0.5
    under = (np.abs(where + 5 * np.array([4.1, 1.6]) - [102, 72]) < 9).all(1)
    assert under.sum() > 2 and np.nanmedian(off) < 0.1
    assert np.nanpercentile(off[:, ~under], 95) < 1 and not (off[7, under] > 3).any()


def test_a_thing_without_a_corner_cannot_be_followed(masks):
    plain = Clip(np.full((len(masks), *PIXELS[::-1], 3), 90, np.uint8), TIMES, 0, "clip")
    with pytest.raises(BadInput, match="clip: nothing on the thing can be followed"):
        tracked(plain, masks)


def test_what_stands_still_behind_is_seen_between_the_pictures(clip, true_masks, moving):
    behind = backdrop_of(clip.pictures, true_masks)
    outside = ~(cv2.dilate(true_masks.any(0).astype(np.uint8), np.ones((9, 9))) > 0)  # of what it softly covers, too
    usual = np.median(clip.pictures, axis=0)
    assert np.abs(behind[outside] - usual[outside]).max() < 4 and behind.min() > 70 and behind.max() < 160


def test_pictures_and_masks_are_straightened_by_the_lens(clip, true_masks):
    """The lens's picture is made by where the pinhole camera has each of its pixels."""
    camera = camera_of()
    lens = Lens(*PIXELS, camera.fx, camera.fy, camera.cx, camera.cy, (-0.8,))
    places = lens.undistort_points(np.mgrid[: PIXELS[0], : PIXELS[1]].reshape(2, -1).T + 0.5) - 0.5
    at = places.astype(np.float32).reshape(*PIXELS, 2).swapaxes(0, 1).copy()
    bent = [cv2.remap(p, at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE) for p in clip.pictures[:3]]
    cut = np.stack([lens.distort_labels(m.astype(np.uint8)) > 0 for m in true_masks[:3]])
    straight, masks = straightened(replace(clip, pictures=np.stack(bent)), cut, lens)
    true, block = clip.pictures[:3].astype(int), true_masks[:3]
    assert np.abs(straight.pictures - true)[block].mean() < 0.4 * np.abs(np.stack(bent) - true)[block].mean()
    assert (masks ^ block).sum() < 0.02 * block.sum() < (cut ^ block).sum()
    with pytest.raises(BadInput, match=r"clip: its lens, .* distorts it so much that no pixel is left"):
        straightened(clip, true_masks, replace(lens, cx=-9e5))


def film(folder, pictures, fps=30.0, name="c.mp4"):
    video = Video(folder / name, pictures[0].shape[1], pictures[0].shape[0], fps=fps)
    for picture in pictures:
        video.write(picture)
    video.close()
    return folder / name


def test_a_video_is_read_with_its_times_and_in_part(tmp_path):
    steps = [np.full((90, 160, 3), 5 * k, np.uint8) for k in range(40)]
    path = film(tmp_path, steps)
    clip = read_clip(path)
    np.testing.assert_allclose(clip.times, np.arange(40) / 30, atol=1e-3)
    assert clip.size == (160, 90) and clip.first == 0
    part = read_clip(path, (0.5, 1.0))
    assert part.first == 15 and len(part.times) == 16 and part.times[0] == 0
    assert abs(int(part.pictures[0].mean()) - 75) < 4
    np.testing.assert_allclose(read_clip(path, fps=240).times, np.arange(40) / 240, atol=1e-6)
    wide = read_clip(film(tmp_path, [np.zeros((400, 1280, 3), np.uint8)] * 12, name="w.mp4"))
    assert wide.size == (640, 200)


@pytest.mark.parametrize(
    ("part", "said"), [((0.0, 0.2), "7 pictures; at least 12 are needed"), ((9.0, 10.0), "has no picture in --part")]
)
def test_a_part_that_is_too_short_is_refused(tmp_path, part, said):
    path = film(tmp_path, [np.zeros((32, 32, 3), np.uint8)] * 40)
    with pytest.raises(BadInput, match=said):
        read_clip(path, part)


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "c.mp4").write_bytes(b"no video")
    with pytest.raises(BadInput, match="cannot be read as a video"):
        read_clip(tmp_path / "c.mp4")
    with pytest.raises(BadInput, match="no such file"):
        read_clip(tmp_path / "none.mp4")


def test_marks_are_those_of_segment_in_the_pictures_own_size(tmp_path):
    clip = Clip(np.zeros((20, 60, 80, 3), np.uint8), TIMES[:20], 5, "clip")
    marks = marks_of(camera_of(), let_go(speckled_block(TRUE), TIMES[:20]), (5, 9))
    marks.objects["held"]["frame_0005"] = marks.objects["held"].pop("frame_0000")
    write_marks(tmp_path / "m.json", marks)
    thing, held = read_clip_marks(tmp_path / "m.json", clip, PIXELS)
    assert sorted(thing) == [0, 4]
    np.testing.assert_allclose(held, marks.objects["held"]["frame_0005"].boxes[0][None] / 2, atol=0.1)
    np.testing.assert_allclose(thing[4].inside[0], marks.objects["block"]["frame_0009"].inside[0] / 2, atol=0.1)
    marks.objects["other"] = {"frame_0005": ViewMarks([np.array([[3.0, 3.0]])])}
    write_marks(tmp_path / "m.json", marks)
    with pytest.raises(BadInput, match="marks 2 things, not one"):
        read_clip_marks(tmp_path / "m.json", clip, PIXELS)
    del marks.objects["other"]
    marks.objects["held"]["frame_0005"] = ViewMarks([SIZE[None, :2] + 20])
    write_marks(tmp_path / "m.json", marks)
    with pytest.raises(BadInput, match="'held' needs a box in frame_0005"):
        read_clip_marks(tmp_path / "m.json", clip, PIXELS)
