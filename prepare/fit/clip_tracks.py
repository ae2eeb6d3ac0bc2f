"""Tracks of points on a body in a clip: where the body is in the first picture, and where its surface goes then."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from assets.asset import Asset
from core.camera import Camera, directions_around
from core.errors import BadInput
from prepare.fit.clip_masks import Clip, flow_between
from prepare.fit.marker_tracks import (
    OFF_THE_CAGE,
    MarkerTracks,
    Rig,
    posed,
    rigid_pose_seen,
    surface_weights,
)

# Draws the body at rest from a camera: colours (H, W, 3) 0..1 on black, opacity and depth [m] (H, W)
Draw = Callable[[Camera], tuple[np.ndarray, np.ndarray, np.ndarray]]

SEARCH_SIDE = 48  # [px] of a picture in which a pose is tried
ALIGNED_SIDE = 200  # [px] of one in which a pose is refined
DIRECTIONS, ROLLS = 72, 12  # poses that are tried: of the body's axis, and turns about it: 30 degrees apart
REFINED = 12  # best of them, which are refined
ROUNDS = 8  # of refining one by optical flow
STEEP = 6.0  # [px] in depth over two pixels, beyond which a picture of a surface shows two of them
POINTS, FEWEST_POINTS = 400, 20  # of the surface that a flow moves
SHAPED = 0.6  # least overlap (intersection over union) of the body and the mask
FLAT, FOOT = 12.0, 0.05  # [degrees] of a side to a plane on which it lies, and its least share of the body's hull
MARKERS = 150
CORNER = 0.003  # of the clearest corner's strength: fainter ones slide along edges
EDGE = 3  # [px] that markers keep from the mask's border
WINDOW = (17, 17)  # [px] of Lucas and Kanade
BACK_AND_FORTH = 0.7  # [px] by which a marker, tracked to the next picture and back, may be off
NEAREST = 7  # markers whose median motion is that of the surface there
LONE = 3.0  # [px] beyond that: what is tracked there is not the surface
FOLLOWED = 0.2  # least share of the markers, over all pictures, that is seen
MISSED = 2  # pictures in which a marker may be missed, one after the other


@dataclass(frozen=True)
class Shot:
    """A clip with the thing's masks (F, H, W) in it, its camera, and boxes (B, 4) [px] around what stands still in the
    first picture."""

    clip: Clip
    masks: np.ndarray
    camera: Camera
    held: np.ndarray


def crop_of(camera: Camera, mask: np.ndarray, side: int) -> tuple[Camera, np.ndarray]:
    """The camera of a square picture of `side` [px] about a mask (H, W) bool, and the affine map (2, 3) to it."""
    x, y, w, h = cv2.boundingRect(mask.astype(np.uint8))
    extent = 1.4 * max(w, h)
    s, left, top = side / extent, x + w / 2 - extent / 2, y + h / 2 - extent / 2
    near = Camera(
        side, side, camera.fx * s, camera.fy * s, (camera.cx - left) * s, (camera.cy - top) * s, camera.world_to_camera
    )
    return near, np.array([[s, 0, (0.5 - left) * s - 0.5], [0, s, (0.5 - top) * s - 0.5]])


def placed(camera: Camera, x: np.ndarray, turn: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The pose (4, 4) that turns points (V, 3), as the camera sees them, and moves them to fill the mask's box."""
    R = camera.world_to_camera[:3, :3].T @ turn
    local = (x - x.mean(0)) @ turn.T
    bx, by, w, h = cv2.boundingRect(mask.astype(np.uint8))
    extent = np.ptp(local[:, :2], axis=0)
    place = np.array([0.0, 0.0, np.sqrt(camera.fx * camera.fy * extent.prod() / (w * h)) + np.ptp(local[:, 2]) / 4])
    for _ in range(4):
        p = local + place
        u, v = camera.fx * p[:, 0] / p[:, 2] + camera.cx, camera.fy * p[:, 1] / p[:, 2] + camera.cy
        place[2] *= np.sqrt(np.ptp(u) * np.ptp(v) / (w * h))
        off = np.array([bx + w / 2 - (u.max() + u.min()) / 2, by + h / 2 - (v.max() + v.min()) / 2])
        place[:2] += off * place[2] / [camera.fx, camera.fy]
    pose = np.eye(4)
    pose[:3, :3] = R
    pose[:3, 3] = (place - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3] - R @ x.mean(0)
    return pose


def likeness(drawn: tuple, picture: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Likeness of a drawn body and a picture (H, W, 3) 0..1 with its mask (H, W) bool: with colours, and in outline.

    Colours are compared after each channel's mean and spread are made equal: the clip's light is not the asset's.
    """
    rgb, alpha, _ = drawn
    own = alpha > 0.5
    both = own & mask
    overlap = both.sum() / max((own | mask).sum(), 1)
    if both.sum() < 20:
        return 0.0, 0.0
    a, b = rgb[both] / alpha[both][:, None], picture[both]
    off = (a - a.mean(0)) - (b - b.mean(0))
    spread = np.sqrt((a.var(0) + b.var(0)).sum()) + 0.02
    return float(overlap - 0.5 * np.sqrt((off**2).sum(1).mean()) / spread), float(overlap)


def crop(clip: Clip, mask: np.ndarray, camera: Camera, side: int) -> tuple[Camera, np.ndarray, np.ndarray]:
    """Camera, picture (side, side, 3) 0..1 and mask of a square about the mask (H, W) in the clip's first picture."""
    near, matrix = crop_of(camera, mask, side)
    how = {"flags": cv2.INTER_AREA if matrix[0, 0] < 1 else cv2.INTER_LINEAR}
    picture = cv2.warpAffine(clip.pictures[0].astype(np.float32) / 255, matrix, (side, side), **how)
    return near, picture, cv2.warpAffine(mask.astype(np.float32), matrix, (side, side), **how) > 0.5


def from_body(camera: Camera, pose: np.ndarray) -> Camera:
    """The camera in the frame of a body that has a pose (4, 4): so a body is turned without moving its Gaussians."""
    return replace(camera, world_to_camera=camera.world_to_camera @ pose)


def found_pose(draw: Draw, x: np.ndarray, camera: Camera, clip: Clip, mask: np.ndarray, progress) -> np.ndarray:
    """world_from_asset (4, 4) of the rigid body, of vertices x (V, 3) at rest, in the clip's first picture.

    Raises BadInput where it looks like the mask in no pose.
    """
    near, picture, small = crop(clip, mask, camera, SEARCH_SIDE)
    turns = []
    for direction in directions_around(DIRECTIONS):
        tip = Rotation.align_vectors([direction], [[0.0, 1.0, 0.0]])[0]
        turns += [(tip * Rotation.from_euler("y", a)).as_matrix() for a in 2 * np.pi * np.arange(ROLLS) / ROLLS]
    poses = [placed(near, x, turn, small) for turn in turns]
    scores = []
    for k, pose in enumerate(poses):
        scores.append(likeness(draw(from_body(near, pose)), picture, small)[0])
        progress(0.7 * k / len(poses))
    near, picture, fine = crop(clip, mask, camera, ALIGNED_SIDE)
    best = ((-np.inf, 0.0), poses[0])
    for k, i in enumerate(np.argsort(scores)[::-1][:REFINED]):
        pose = poses[i]
        for _ in range(ROUNDS):
            made = draw(from_body(near, pose))
            best = max(best, (likeness(made, picture, fine), pose), key=lambda b: b[0])
            points, seen = followed(made, from_body(near, pose), picture, fine)
            if len(points) < FEWEST_POINTS:
                break
            pose = rigid_pose_seen(near, points, seen, pose)
        progress(0.7 + 0.3 * (k + 1) / REFINED)
    (_, overlap), pose = best
    if overlap < SHAPED:
        raise BadInput(
            f"{clip.where}: the asset looks in no pose like the mask in frame_{clip.first:04d} (they overlap by"
            f" {overlap:.0%}): is it the same thing, in its own shape, and is this the clip's camera?"
        )
    return pose


def followed(made: tuple, camera: Camera, picture: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of the surface of a drawn body, in the camera's world, and where the picture shows them (N, 2)."""
    flow = flow_between(*alike(made, picture, mask))
    y, x = np.nonzero(surface(made, camera))
    step = max(1, len(y) // POINTS)
    y, x = y[::step], x[::step]
    return camera.points_at(made[2], x, y), np.column_stack([x + 0.5, y + 0.5]) + flow[y, x]


def surface(made: tuple, camera: Camera) -> np.ndarray:
    """Mask (H, W) of the pixels that show a drawn body's surface: opaque, and not between a near part and a far one."""
    _, alpha, depth = made
    steps = cv2.dilate(depth, np.ones((3, 3))) - cv2.erode(depth, np.ones((3, 3)))
    return (alpha > 0.9) & (steps < STEEP * depth / camera.fx)


def alike(made: tuple, picture: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A drawn body and the picture within its mask, as grey pictures (H, W) uint8 of equal mean and spread."""
    rgb, alpha, _ = made
    grey = []
    for colours, weight in ((rgb / np.maximum(alpha, 1e-3)[..., None], alpha), (picture, mask.astype(np.float32))):
        level = np.asarray(colours, np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
        inside = level[weight > 0.5]
        mean, spread = (inside.mean(), inside.std()) if inside.size else (0.0, 1.0)
        shown = (128 + 40 * (level - mean) / max(spread, 1e-3)).clip(40, 255)
        grey.append((weight * shown).astype(np.uint8))
    return grey[0], grey[1]


def tracked(clip: Clip, masks: np.ndarray, progress=lambda done: None) -> np.ndarray:
    """Pixels (F, M, 2) of markers on the thing, NaN once one is lost: corners of the first picture, which optical flow
    carries from each picture to the next. Lucas and Kanade's method makes a place more exact; where it does not come
    back to where it began, as on plain surfaces, that of the dense flow is taken, if this does."""
    grey = [cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in clip.pictures]
    inner = cv2.erode(np.pad(masks[0].astype(np.uint8), 1), np.ones((2 * EDGE + 1,) * 2, np.uint8))[1:-1, 1:-1]
    apart = max(3.0, 0.7 * np.sqrt(inner.sum() / MARKERS))
    corners = cv2.goodFeaturesToTrack(grey[0], MARKERS, CORNER, apart, mask=inner, blockSize=5)
    if corners is None or len(corners) < 8:
        raise BadInput(f"{clip.where}: nothing on the thing can be followed: it is too small or plain in this clip")
    now = corners.reshape(-1, 2)
    found = np.full((len(grey), len(now), 2), np.nan)
    found[0] = now + 0.5
    alive, missed = np.ones(len(now), bool), np.zeros(len(now), int)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    how = {"winSize": WINDOW, "maxLevel": 1, "criteria": stop, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    for k in range(1, len(grey)):
        there = now + sampled(flow_between(grey[k - 1], grey[k]), now)
        back = there + sampled(flow_between(grey[k], grey[k - 1]), there)
        good = np.linalg.norm(back - now, axis=1) < BACK_AND_FORTH
        then = cv2.calcOpticalFlowPyrLK(grey[k - 1], grey[k], now, there.copy(), **how)[0]
        back = cv2.calcOpticalFlowPyrLK(grey[k], grey[k - 1], then, now + then - there, **how)[0]
        exact = (np.linalg.norm(back - now, axis=1) < BACK_AND_FORTH) & (np.abs(then - there).max(1) < LONE)
        then = np.where(exact[:, None], then, there)
        good = alive & (good | exact) & (sampled(masks[k].astype(np.float32), then) > 0.5)
        usual = usual_motion(now, then - now, good)
        good &= np.linalg.norm(then - now - usual, axis=1) < LONE
        now = np.where(good[:, None], then, now + usual)  # one that is not seen goes as those beside it
        missed = np.where(good, 0, missed + 1)
        alive &= missed <= MISSED
        found[k, good] = now[good] + 0.5
        progress(k / len(grey))
    return found


def sampled(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values (M, ...) of a picture (H, W, ...) float32 at places (M, 2) [px] from the middle of its first pixel."""
    return cv2.remap(picture, places.astype(np.float32)[:, None], None, cv2.INTER_LINEAR, borderValue=0)[:, 0]


def usual_motion(places: np.ndarray, moved: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Motion (M, 2) [px] of the surface at places (M, 2): the median of that of the nearest good markers."""
    if not good.any():
        return np.zeros_like(moved)
    away = np.linalg.norm(places[:, None] - places[good][None], axis=2)
    return np.median(moved[good][np.argsort(away, axis=1)[:, :NEAREST]], axis=1)


def common_pose(draw: Draw, x: np.ndarray, shots: Sequence[Shot], progress) -> np.ndarray:
    """world_from_asset (4, 4) of the rigid body in the first pictures of all shots, which show one moment.

    It is searched in each; that which looks most like all is refined by the points of all. Raises BadInput.
    """
    poses, lost = [], []
    for k, s in enumerate(shots):
        try:
            one = found_pose(draw, x, s.camera, s.clip, s.masks[0], lambda done, k=k: progress((k + done) / len(shots)))
            poses.append(one)
        except BadInput as e:
            lost.append(e)
    if not poses:
        raise lost[0]
    if len(shots) == 1:
        return poses[0]
    near, pictures, masks = zip(*(crop(s.clip, s.masks[0], s.camera, ALIGNED_SIDE) for s in shots), strict=True)

    def tried(pose: np.ndarray) -> tuple[float, list[tuple[float, float]], list[tuple]]:
        made = [draw(from_body(camera, pose)) for camera in near]
        like = [likeness(*m) for m in zip(made, pictures, masks, strict=True)]
        return sum(score for score, _ in like), like, made

    best = max(((*tried(pose), pose) for pose in poses), key=lambda b: b[0])
    pose = best[3]
    for _ in range(ROUNDS):
        made = tried(pose)[2]
        found = [followed(m, from_body(c, pose), *p) for m, c, *p in zip(made, near, pictures, masks, strict=True)]
        of = np.repeat(np.arange(len(near)), [len(points) for points, _ in found])
        if len(of) < FEWEST_POINTS:
            break
        points, seen = (np.concatenate(part) for part in zip(*found, strict=True))
        pose = rigid_pose_seen(Rig(near, of), points, seen, pose)
        best = max(best, (*tried(pose), pose), key=lambda b: b[0])
    for s, (_, overlap) in zip(shots, best[1], strict=True):
        if overlap < SHAPED:
            raise BadInput(
                f"{s.clip.where}: the asset is elsewhere in frame_{s.clip.first:04d} than the other clips show it (it"
                f" overlaps its mask by {overlap:.0%}): do they begin at the same moment, and is this its camera?"
            )
    return best[3]


def clip_tracks(draw: Draw, asset: Asset, shots: Sequence[Shot], blank: MarkerTracks, progress) -> MarkerTracks:
    """The tracks of clips of the asset, which show the same motion: `blank` with all that the pictures show.

    Raises BadInput where the thing is not found, or not followed.
    """
    x = np.asarray(asset.cage.vertices, np.float64)
    pose = common_pose(draw, x, shots, lambda done: progress("pose", 0.8 * done))
    if len(blank.planes):
        pose = resting(pose, x, shots[0].camera if len(shots) == 1 else None, blank.planes)
    progress("pose", 1.0)
    found = []
    for k, s in enumerate(shots):
        found.append(attached(draw, asset, s, pose, lambda d, k=k: progress("tracks", (k + d) / len(shots))))
    progress("tracks", 1.0)
    times = np.unique(np.concatenate([moments(s.clip) for s in shots]))
    of, metres = np.repeat(np.arange(len(shots)), [len(rest) for rest, *_ in found]), np.mean([m for *_, m in found])
    points = np.full((len(times), len(of), 2), np.nan)
    for k, (s, (_, pixels, _)) in enumerate(zip(shots, found, strict=True)):
        points[np.ix_(np.searchsorted(times, moments(s.clip)), of == k)] = metres * pixels
    held = np.concatenate([np.column_stack([s.held, np.full(len(s.held), k)]) for k, s in enumerate(shots)])
    return replace(
        blank,
        times=times,
        points=points,
        rest=np.concatenate([rest for rest, *_ in found]),
        held=held if len(held) else None,
        pose=pose,
        camera=Rig(tuple(s.camera for s in shots), of),
        metres=float(metres),
        start=posed(pose, x),
    )


def moments(clip: Clip) -> np.ndarray:
    """The times (F,) of a clip's pictures [s], so rounded that those of two cameras that run alike are equal."""
    return np.round(clip.times, 4)


def attached(draw: Draw, asset: Asset, shot: Shot, pose: np.ndarray, progress) -> tuple[np.ndarray, np.ndarray, float]:
    """Markers of a shot: where they are on the asset (M, 3), their pixels (F, M, 2), and the size of a pixel [m] there.

    Raises BadInput where the surface is not followed.
    """
    clip, masks, camera = shot.clip, shot.masks, shot.camera
    x = np.asarray(asset.cage.vertices, np.float64)
    pixels = tracked(clip, masks, progress)
    made = draw(from_body(camera, pose))
    ours, theirs = alike(made, clip.pictures[0].astype(np.float32) / 255, masks[0])
    flow = flow_between(theirs, ours)  # from the clip to the drawn body
    column, row = np.floor(pixels[0]).astype(int).T
    column, row = np.floor(pixels[0] + flow[row, column]).astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < camera.height) & (column < camera.width)
    inside[inside] = surface(made, camera)[row[inside], column[inside]]
    column, row, pixels = column[inside], row[inside], pixels[:, inside]
    seen = np.isfinite(pixels).all(2)
    share = seen.sum() / max(seen.size, 1)
    if share < FOLLOWED:
        raise BadInput(
            f"{clip.where}: its surface is followed in {share:.0%} of the pictures only: the thing leaves the picture,"
            " turns away or is blurred"
        )
    W, away = surface_weights(x, asset.cage.tets, from_body(camera, pose).points_at(made[2], column, row))
    near = away < OFF_THE_CAGE * np.ptp(x, axis=0).max()
    return (W @ x)[near], pixels[:, near], float(np.median(made[2][row, column])) / np.sqrt(camera.fx * camera.fy)


def resting(pose: np.ndarray, x: np.ndarray, camera: Camera | None, planes: np.ndarray) -> np.ndarray:
    """The pose after a body of vertices x (V, 3) is laid flat on the plane that it is nearest to, if it has a side that
    is almost so, and moved along the camera's line of sight, or without one along the normal, until it touches it."""
    at = posed(pose, x)
    gaps = (at @ planes[:, :3].T).min(0) - planes[:, 3]
    k = int(np.abs(gaps).argmin())
    n = planes[k, :3]
    hull = ConvexHull(at)
    sides, corners = hull.equations[:, :3], at[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    below = sides @ n < -np.cos(np.radians(FLAT))
    new = np.eye(4)
    if area[below].sum() > FOOT * area.sum():
        new[:3, :3] = Rotation.align_vectors([-n], [area[below] @ sides[below]])[0].as_matrix()
        new[:3, 3] = at.mean(0) - new[:3, :3] @ at.mean(0)
    at = posed(new, at)
    along = n
    if camera is not None:
        sight = at.mean(0) - camera.position
        sight = sight / np.linalg.norm(sight)
        along = sight if abs(n @ sight) > 0.2 else n
    new[:3, 3] -= ((at @ n).min() - planes[k, 3]) / (n @ along) * along
    return new @ pose
