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
    APART,
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
SPACING = 1 / 24  # of the body's size, between markers
OPAQUE = 0.0  # least logit of a Gaussian's opacity that is a marker
ON_SURFACE = 3.0  # [px] in depth: a marker that is farther from what is drawn there is hidden
BACK_AND_FORTH = 0.7  # [px] by which optical flow to a picture and back may be off
TURNED = 3  # rounds of finding the pose in a picture from that in the one before
FOLLOWED = 0.2  # least share of the pictures in which a marker is seen, and of the body's markers that are seen


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
    """world_from_asset (4, 4) of the rigid body, of points x (V, 3) at rest, in the clip's first picture.

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
            points = surface_points(made, from_body(near, pose))
            if len(points) < FEWEST_POINTS:
                break
            seen = followed(made, from_body(near, pose), picture, fine, points)[0]
            pose = rigid_pose_seen(near, points, seen, pose)
        progress(0.7 + 0.3 * (k + 1) / REFINED)
    (_, overlap), pose = best
    if overlap < SHAPED:
        raise BadInput(
            f"{clip.where}: the asset looks in no pose like the mask in frame_{clip.first:04d} (they overlap by"
            f" {overlap:.0%}): is it the same thing, in its own shape, and is this the clip's camera?"
        )
    return pose


def surface_points(made: tuple, camera: Camera) -> np.ndarray:
    """Some points (N, 3) of the surface of a drawn body, in the camera's world."""
    y, x = np.nonzero(surface(made, camera))
    step = max(1, len(y) // POINTS)
    return camera.points_at(made[2], x[::step], y[::step])


def followed(
    made: tuple, camera: Camera, picture: np.ndarray, mask: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) [px] in a picture with a mask of points (N, 3) of a drawn body, by the optical flow from the drawn
    picture; and a mask (N,) of those seen: on the drawn surface, from which the flow leads into the mask, and back."""
    ours, theirs = alike(made, picture, mask)
    u, v, depth = camera.projected(points)
    drawn = np.column_stack([u, v])
    there = drawn + sampled(flow_between(ours, theirs), drawn)
    off = np.linalg.norm(there + sampled(flow_between(theirs, ours), there) - drawn, axis=1)
    on = sampled(surface(made, camera).astype(np.float32), drawn) > 0.5
    on &= sampled(mask.astype(np.float32), there) > 0.5
    near = np.abs(sampled(made[2].astype(np.float32), drawn) - depth) < ON_SURFACE * depth / camera.fx
    return there, on & near & (off < BACK_AND_FORTH)


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


def points_of(asset: Asset) -> np.ndarray:
    """Points (N, 3) all over the body at rest: an opaque Gaussian in each cell of a grid that has one."""
    points = np.asarray(asset.gaussians.means, np.float64)[np.ravel(asset.gaussians.logit_opacities) > OPAQUE]
    size = np.ptp(points, axis=0).max()
    return points[np.unique(np.floor(points / (SPACING * size)), axis=0, return_index=True)[1]]


def tracked(draw: Draw, shot: Shot, pose: np.ndarray, rest: np.ndarray, progress=lambda done: None) -> np.ndarray:
    """Pixels (F, M, 2) of markers, at `rest` (M, 3) on the asset, in a clip that begins with the body in a pose; NaN
    where one is not seen.

    In each picture the rigid body is drawn in the nearest pose, begun with that of the picture before, moved as the
    mask is. Optical flow from there shows how the body deforms, and no error grows over time.
    """
    clip, camera = shot.clip, shot.camera
    found = np.full((len(clip.pictures), len(rest), 2), np.nan)
    for k, (pixels, mask) in enumerate(zip(clip.pictures, shot.masks, strict=True)):
        picture, place = pixels.astype(np.float32) / 255, posed(pose, rest).mean(0)
        way = [np.mean(np.nonzero(m), axis=1)[::-1] for m in (shot.masks[max(k - 1, 0)], mask)]
        depth = camera.projected(place[None])[2]
        step = np.append((way[1] - way[0]) / [camera.fx, camera.fy] * depth, 0.0) @ camera.world_to_camera[:3, :3]
        pose = pose.copy()
        pose[:3, 3] += step
        for turn in range(TURNED + 1):
            near = from_body(camera, pose)
            there, seen = followed(draw(near), near, picture, mask, rest)
            if turn == TURNED or seen.sum() < FEWEST_POINTS:
                break
            pose = rigid_pose_seen(camera, rest[seen], there[seen], pose)
        found[k, seen] = there[seen]
        progress((k + 1) / len(found))
    return found


def sampled(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Values (N, ...) of a picture (H, W, ...) float32 at places (N, 2) [px]."""
    return cv2.remap(picture, places.astype(np.float32)[:, None] - 0.5, None, cv2.INTER_LINEAR, borderValue=0)[:, 0]


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
        views = [from_body(c, pose) for c in near]
        found = [surface_points(m, c) for m, c in zip(made, views, strict=True)]
        found = [(p, followed(*q, p)[0]) for p, *q in zip(found, made, views, pictures, masks, strict=True)]
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
    pose = common_pose(draw, points_of(asset), shots, lambda done: progress("pose", 0.8 * done))
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
    x, rest = np.asarray(asset.cage.vertices, np.float64), points_of(asset)
    rest = rest[surface_weights(x, asset.cage.tets, rest)[1] < OFF_THE_CAGE * np.ptp(x, axis=0).max()]
    pixels = tracked(draw, shot, pose, rest, progress)
    seen = np.isfinite(pixels).all(2)
    often = seen.mean(0) >= FOLLOWED
    if often.sum() < FEWEST_POINTS:
        raise BadInput(
            f"{shot.clip.where}: its surface is not followed: {often.sum()} points of it are seen in"
            f" {FOLLOWED:.0%} of the pictures; the thing leaves the picture, turns away, is too small or is blurred"
        )
    depth = shot.camera.projected(posed(pose, rest[often]))[2]
    return rest[often], pixels[:, often], float(np.median(depth)) / np.sqrt(shot.camera.fx * shot.camera.fy)


def resting(pose: np.ndarray, x: np.ndarray, camera: Camera | None, planes: np.ndarray) -> np.ndarray:
    """The pose after a body of vertices x (V, 3) is laid flat on the plane that it is nearest to, if it has a side that
    is almost so, and moved along the camera's line of sight, or without one along the normal, until it touches it."""
    at = posed(pose, x)
    gaps = (at @ planes[:, :3].T).min(0) - planes[:, 3]
    k = int(np.abs(gaps).argmin())
    if abs(gaps[k]) > APART * np.ptp(x, axis=0).max():
        return pose
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
