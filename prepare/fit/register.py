"""The camera of a clip, found from photographs of the same place whose poses are known.

A feature of the picture that photographs show from apart is a point in space, and the camera is the one in which most
of these points are where the picture has them: three of them and a focal length give a pose (RANSAC), all that agree
give pose and focal length (least squares), and one coefficient k1 of the lens where it is sure, else the lens is
straight. Its axis goes through the middle of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from assets.room_folder import RoomManifest, is_room_folder, read_room
from core.camera import Camera
from core.errors import BadInput
from prepare.fit.clip_masks import LONGEST_SIDE, Clip
from prepare.room_capture.stages import file_key
from prepare.segment.marks import Clicks
from prepare.train.capture import Capture
from prepare.train.capture_files import checked, read_capture, read_colmap, reader_of
from prepare.train.photographs import image_size, load_photograph
from prepare.train.structure_from_motion import FEATURES_MAX, VIDEOS

DISTINCT = 0.8  # of the distance to the second-best descriptor (Lowe 2004)
VIEWS = 12  # photographs that share most features with the picture; each pair of them takes time
APART = np.cos(np.radians(2.0))  # of rays that cross: half a pixel moves the crossing by 2% of its distance then
OFF = 3.0  # [px] from where a point is seen: several times the deviation of those that agree
FEWEST = 16  # points that agree: four always do; with photographs of other places there were at most twelve points
CLICKED, CLICKED_FOV = 6, 4  # points that a user has marked, without and with a given field of view
CLICKED_OFF = 8.0  # [px] for OFF of points that a user has marked: a pixel in a small photograph is several in the clip
SURE = 0.03  # most standard error of a field of view, relative to it: by the points alone, the truth is farther off
FOCALS = np.geomspace(0.4, 4.0, 22)  # longest sides of the picture (103 to 14 degrees); of many points, each third
UNSURE = 3.0  # standard errors of k1: a lens that may move no corner of the picture by OFF is taken for straight
ROUNDS = 5  # of least squares over the points that agree, which then are others


@dataclass(frozen=True)
class FoundCamera:
    """A camera; `agree` of `points` are where it sees them, to `residual` [px]; `error`: a standard deviation [degrees]
    of its vertical field of view. `k1`: of the lens's distortion, 0 where it is not sure."""

    camera: Camera
    agree: int
    points: int
    residual: float
    error: float
    k1: float = 0.0

    @property
    def fov(self) -> float:
        """Vertical field of view [degrees]."""
        return 2 * float(np.degrees(np.arctan(0.5 * self.camera.height / self.camera.fy)))

    def rank(self) -> tuple[float, float]:
        """The greater, the better it is."""
        return self.agree, -self.residual

    def described(self) -> str:
        """A line for the user."""
        fit = f"{self.agree} of {self.points} points agree, to {self.residual:.2f} px"
        lens = f", k1 {self.k1:.3f}" if self.k1 else ""
        return f"camera: vertical field of view {self.fov:.2f} ± {self.error:.2f} degrees{lens}; {fit}"


@dataclass(frozen=True)
class CapturedPlace:
    """A capture, +y up, and the room that was made of it, or None."""

    capture: Capture
    room: RoomManifest | None

    @classmethod
    def of(cls, path: Path, asset: Path) -> CapturedPlace:
        """The capture of a path, and the room that holds the asset. Raises BadInput.

        Photographs without poses, and a video, have those that were found as the room was made.
        """
        folder = asset.resolve().parent.parent  # of ROOM/objects/NAME.h5
        room = read_room(folder) if is_room_folder(folder) else None
        poses, is_video = folder / "work" / "poses" / "sparse", path.suffix.lower() in VIDEOS
        if room and poses.is_dir() and (is_video or reader_of(path) is None):
            capture = checked(read_colmap(poses, folder / "work" / "frames" if is_video else path))
        else:
            capture = read_capture(path)
        place = cls(capture.upright(), room)
        if room:
            ours = [place.placed(camera).world_to_camera for camera in place.capture.cameras()]
            theirs = [camera.world_to_camera for camera in room.cameras]
            if len(ours) != len(theirs) or not np.allclose(ours, theirs, atol=1e-3):
                raise BadInput(f"{path}: is not the capture that {folder} was made of")
        return place

    @property
    def key(self) -> str:
        """A text that is another one after any change of what a camera is found by."""
        views = [(file_key(v.image), v.lens, v.world_to_camera.tolist()) for v in self.capture.views]
        return repr((views, self.room and self.room.room_from_capture.tolist()))

    def placed(self, camera: Camera) -> Camera:
        """A camera of the capture in the room [m]; the same where there is none."""
        if self.room is None:
            return camera
        m = self.room.room_from_capture
        scale = np.diag([*[np.cbrt(np.linalg.det(m[:3, :3]))] * 3, 1.0])
        return replace(camera, world_to_camera=scale @ camera.world_to_camera @ np.linalg.inv(m))

    def found_camera(self, picture: np.ndarray, where: str, fov: float | None = None, progress=lambda done: None):
        """The FoundCamera of a picture (H, W, 3) uint8 of the place, in the room, or else in the capture.

        where  names the picture in errors;   fov  vertical field of view [degrees], None: it is found. Raises BadInput.
        """
        places, seen, cameras = sightings(picture, self.capture, progress)
        points = triangulated(seen, cameras)
        known = np.isfinite(points).all(1)
        found, count = camera_by(points[known], places[known], picture.shape[1::-1], fov), int(known.sum())
        if found is None:
            raise BadInput(
                f"{where}: the clip shows too little of what {self.capture.folder} shows: {count} of {len(places)}"
                f" features are found there, and fewer than {FEWEST} agree on a camera; film more of the place, mark"
                " points of it (docs/your_own.md), or give --camera"
            )
        return self.sure(found, where)

    def clicked_camera(self, points: dict[str, Clicks], clip: Clip, full: tuple[int, int], fov: float | None = None):
        """The FoundCamera of a clip by numbered points in its first picture and in photographs, as `found_camera`.

        full  (width, height) [px] that the points in the clip's picture are in. Raises BadInput.
        """
        first, views = f"frame_{clip.first:04d}", {view.name: view for view in self.capture.views}
        if strange := set(points) - {first, *views}:
            raise BadInput(f"{clip.where}: points in {min(strange)}: they belong in {first} and in photographs")
        count, seen, cameras = max(map(len, points.values())), [], []
        ours = clip.size[0] / full[0] * numbered(points.get(first, []), count)
        for name in sorted(set(points) - {first}):
            width, height = image_size(views[name].image)
            scale = min(1.0, LONGEST_SIDE / max(width, height))
            lens = views[name].lens.resized(round(scale * width), round(scale * height), name)
            seen.append(lens.undistort_points(lens.width / width * numbered(points[name], count)))
            cameras.append(replace(views[name], lens=lens).camera())
        there = triangulated(np.array(seen), cameras, CLICKED_OFF) if len(seen) > 1 else np.full((count, 3), np.nan)
        known, fewest = np.isfinite(there).all(1) & np.isfinite(ours).all(1), CLICKED if fov is None else CLICKED_FOV
        found = camera_by(there[known], ours[known], clip.size, fov, fewest, CLICKED_OFF)
        if found is None:
            raise BadInput(
                f"{clip.where}: {known.sum()} points are marked in {first} and in two photographs from apart, and fewer"
                f" than {fewest} agree on a camera: mark more, all over the picture and near and far"
            )
        return self.sure(found, clip.where)

    def sure(self, found: FoundCamera, where: str) -> FoundCamera:
        """The camera in the room. Raises BadInput where its field of view is not sure."""
        if found.error > SURE * found.fov:
            raise BadInput(f"{where}: its field of view is not sure ({found.described()}): give --fov")
        return replace(found, camera=self.placed(found.camera))


def numbered(clicks: Clicks, count: int) -> np.ndarray:
    """Places (count, 2) of numbered points, NaN for what is not seen."""
    return np.array([p or (np.nan, np.nan) for p in [*clicks, *[None] * (count - len(clicks))]]).reshape(-1, 2)


def features(pixels: np.ndarray, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) [px] of a picture's SIFT features, and unit descriptors (N, 128), roots of shares (RootSIFT)."""
    found, rows = cv2.SIFT_create(FEATURES_MAX).detectAndCompute(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY), mask)
    rows = np.zeros((0, 128), np.float32) if rows is None else rows
    return np.array([k.pt for k in found]).reshape(-1, 2) + 0.5, np.sqrt(rows / np.maximum(rows.sum(1)[:, None], 1e-9))


def matched(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Row of `other` that each descriptor of `one` is like, and no other is; -1 for none."""
    if len(one) == 0 or len(other) < 2:
        return np.full(len(one), -1)
    alike, rows = one @ other.T, np.arange(len(one))
    best = alike.argmax(1)
    first = alike[rows, best]
    alike[rows, best] = -1.0
    return np.where(1 - first < DISTINCT**2 * (1 - alike.max(1)), best, -1)  # |a - b|^2 = 2 - 2 a b


def sightings(picture: np.ndarray, capture: Capture, progress) -> tuple[np.ndarray, np.ndarray, list[Camera]]:
    """Places (N, 2) [px] of a picture's features, where photographs show them (K, N, 2), NaN, and their K cameras."""
    (places, ours), shown = features(picture), []
    for k, view in enumerate(capture.views):
        photograph = load_photograph(view, max(1, max(image_size(view.image)) // LONGEST_SIDE))
        there, theirs = features(photograph.pixels, photograph.mask.astype(np.uint8))
        to, at = matched(ours, theirs), np.full(places.shape, np.nan)
        at[to >= 0] = there[to[to >= 0]]
        shown = sorted([*shown, (at, photograph.camera)], key=lambda s: -np.isfinite(s[0]).sum())[:VIEWS]
        progress((k + 1) / len(capture.views))
    return places, np.array([at for at, _ in shown]), [camera for _, camera in shown]


def triangulated(seen: np.ndarray, cameras: list[Camera], off: float = OFF) -> np.ndarray:
    """Points (N, 3) that cameras see at `seen` (K, N, 2) [px], NaN where no two rays that are apart cross.

    Two rays give a point, and all that pass it as the most of them do give the point that is nearest to these.
    """
    points, most = np.full((seen.shape[1], 3), np.nan), np.zeros(seen.shape[1], int)
    rays = [np.stack([(s[:, 0] - c.cx) / c.fx, (s[:, 1] - c.cy) / c.fy, np.ones(len(s))], 1) @ c.world_to_camera[:3, :3]
            for s, c in zip(seen, cameras, strict=True)]  # fmt: skip
    rays = np.array(rays) / np.linalg.norm(rays, axis=2, keepdims=True)
    across = np.nan_to_num(np.eye(3) - rays[..., :, None] * rays[..., None, :])  # times x - o: how far x is off the ray
    aim = np.einsum("knij,kj->kni", across, [c.position for c in cameras])
    chosen = np.zeros(seen.shape[:2], bool)
    for a, b in combinations(range(len(cameras)), 2):
        rows = np.flatnonzero((rays[a] * rays[b]).sum(1) < APART)  # NaN compares false
        x = np.linalg.solve(across[a, rows] + across[b, rows], (aim[a, rows] + aim[b, rows])[..., None])[..., 0]
        near = np.array([offsets(c, x, s[rows]) < off for c, s in zip(cameras, seen, strict=True)])
        better = near[a] & near[b] & (near.sum(0) > most[rows])
        most[rows[better]], chosen[:, rows[better]] = near.sum(0)[better], near[:, better]
    rows = np.flatnonzero(most)
    matrix = np.einsum("kn,knij->nij", chosen[:, rows], across[:, rows])
    right = np.einsum("kn,kni->ni", chosen[:, rows], aim[:, rows])
    points[rows] = np.linalg.solve(matrix, right[..., None])[..., 0]
    return points


def bent(camera: Camera, points: np.ndarray, k1: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `camera.projected` of points (N, 3), through a lens with the distortion k1."""
    x, y, depth = camera.projected(points)
    away = k1 * (((x - camera.cx) / camera.fx) ** 2 + ((y - camera.cy) / camera.fy) ** 2)
    return x + away * (x - camera.cx), y + away * (y - camera.cy), depth


def offsets(camera: Camera, points: np.ndarray, places: np.ndarray, k1: float = 0.0) -> np.ndarray:
    """Distance (N,) [px] of points (N, 3) from their places (N, 2) in the picture; inf behind the camera."""
    x, y, depth = bent(camera, points, k1)
    return np.where(depth > 0, np.hypot(x - places[:, 0], y - places[:, 1]), np.inf)


def camera_by(
    points: np.ndarray, places: np.ndarray, size: tuple[int, int], fov: float | None, fewest=FEWEST, off=OFF
) -> FoundCamera | None:
    """The camera by which most points (N, 3) are at their places (N, 2) [px] in a picture of a size.

    fewest, off  points that agree, else None, and how far they are from their places then [px]. Where there are few,
    nearly all must agree at the first focal length, so more of these are tried.
    """
    (width, height), found = size, []
    tried = FOCALS[:: 3 if fewest == FEWEST else 1] * max(size)
    focals = tried if fov is None else [0.5 * height / np.tan(0.5 * np.radians(fov))]
    for focal in focals if len(points) >= fewest else ():
        lens = np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])
        how = {"iterationsCount": 1000, "reprojectionError": off, "flags": cv2.SOLVEPNP_AP3P}
        good, turn, shift, _ = cv2.solvePnPRansac(points, places, lens, None, **how)
        if good:
            start = Camera(width, height, focal, focal, 0.5 * width, 0.5 * height, np.eye(4))
            start = moved(start, np.r_[turn.ravel(), shift.ravel(), 0.0])
            found.append(refined(start, points, places, fov is None, fewest, off))
    best = max(filter(None, found), key=FoundCamera.rank, default=None)
    if best is None or best.agree < FEWEST:
        return best
    bends = refined(best.camera, points, places, fov is None, fewest, off, bends=True)
    return max(filter(None, (best, bends)), key=FoundCamera.rank)


def moved(camera: Camera, by: np.ndarray) -> Camera:
    """A camera whose frame is turned and shifted, by (7,), and its focal length times exp(by[6])."""
    step, focal = np.eye(4), camera.fx * np.exp(by[6])
    step[:3, :3], step[:3, 3] = Rotation.from_rotvec(by[:3]).as_matrix(), by[3:6]
    return replace(camera, fx=focal, fy=focal, world_to_camera=step @ camera.world_to_camera)


def refined(
    camera: Camera, points: np.ndarray, places: np.ndarray, zooms: bool, fewest: int, off: float, bends: bool = False
) -> FoundCamera | None:
    """The camera nearby that fits all points that agree with it; None if these are too few, or k1 is not sure.

    fewest, off  see `camera_by`;   zooms, bends  whether the focal length, and k1 of the lens, are found
    """
    free, k1 = np.r_[:6, [6] * zooms, [7] * bends].astype(int), 0.0

    def step(some: np.ndarray) -> np.ndarray:
        by = np.zeros(8)
        by[free] = some
        return by

    def residuals(some: np.ndarray, camera: Camera, k1: float, use: np.ndarray) -> np.ndarray:
        by = step(some)
        x, y, _ = bent(moved(camera, by), points[use], k1 + by[7])
        return np.r_[x - places[use, 0], y - places[use, 1]]

    for _ in range(ROUNDS):
        use = offsets(camera, points, places, k1) < off
        if use.sum() < fewest:
            return None
        fit = least_squares(residuals, np.zeros(len(free)), method="lm", x_scale="jac", args=(camera, k1, use))
        by = step(fit.x)
        camera, k1 = moved(camera, by), k1 + by[7]
    deviation = np.sqrt(2 * fit.cost / (len(fit.fun) - len(free)))  # of a coordinate [px]
    error = step(deviation * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac))))
    corner = 0.5 * np.hypot(camera.width, camera.height)  # from the middle [px]
    if bends and not (abs(k1) - UNSURE * error[7]) * corner**3 / camera.fx**2 > OFF:
        return None
    found = FoundCamera(camera, int(use.sum()), len(points), float(np.sqrt(2) * deviation), 0.0, float(k1))
    return replace(found, error=float(np.degrees(np.sin(np.radians(found.fov)) * error[6])))
