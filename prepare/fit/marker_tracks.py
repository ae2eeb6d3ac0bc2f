"""Tracks of markers on a body: POINTS.npz read and checked, the markers in the cage, and how the body sets off."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from core.camera import Camera
from core.errors import BadInput
from core.point_location import TetLocator
from core.rotation import best_fit_rotation

START_FRAMES = 5  # through whose places a parabola gives the start: a place and a speed less noisy than those of one
FEWEST_FRAMES = 12
OFF_THE_CAGE = 0.1  # of the body's extent: a marker further outside is on another body, or in other units
LARGEST_FILE = 1 << 30  # [bytes]
OUTLIER_PIXELS = 2.0  # [px] at which a point, seen in a picture, counts half for a pose
NEIGHBOURS = 6  # markers, whose mean motion is taken from a marker's where its noise is estimated
FINEST = 0.02  # [px] of noise at least: compressed pictures of what stands still differ by half of it


@dataclass(frozen=True)
class Rig:
    """Cameras that stand still, and the number of that which sees each of M points, (M,). As of a Camera:"""

    cameras: tuple[Camera, ...]
    of: np.ndarray

    def part(self, some: np.ndarray) -> Rig:
        """Of some of the points."""
        return Rig(self.cameras, self.of[some])

    def projected(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions x, y (..., M) [px] in their cameras' pictures, and depths, of points (..., M, 3)."""
        seen = np.empty((3, *points.shape[:-1]))
        for k, camera in enumerate(self.cameras):
            seen[..., self.of == k] = camera.projected(points[..., self.of == k, :])
        return tuple(seen)

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Derivatives (M, 2, 3) [px/m] of the positions of points (M, 3)."""
        found = np.empty((len(points), 2, 3))
        for k, camera in enumerate(self.cameras):
            found[self.of == k] = camera.slopes(points[self.of == k])
        return found


@dataclass(frozen=True)
class MarkerTracks:
    """Markers seen over time, in metres and seconds, in a world with y up; or in the pictures of cameras.

    times    (F,) ascending;   points  (F, M, 3) places, NaN where a marker is not seen
    rest     (M, 3) where the markers are on the asset, in its frame
    held     (2, 3) least and greatest corner of a box in the asset's frame: what lies in it does not move; or None
    release  time at which the held part is let go, inf if never
    pose     (4, 4) world_from_asset of the held part; None: of a free body, which is found
    planes   (P, 4) normal n and offset d of solid half spaces: the body stays in n x >= d
    gravity  (3,) [m/s^2]
    camera   None; or what the pictures are taken with: points (F, M, 2) are then positions in them times `metres`, the
             size of a pixel at the body's distance [m] (of several cameras the mean), and `held` (B, 5) boxes [px] in
             the first pictures, with their camera's number; `start`, places of the cage's vertices at the first time,
             (V, 3), is then known
    """

    times: np.ndarray
    points: np.ndarray
    rest: np.ndarray
    held: np.ndarray | None
    release: float
    pose: np.ndarray | None
    planes: np.ndarray
    gravity: np.ndarray
    camera: Rig | None = None
    metres: float = 1.0
    start: np.ndarray | None = None

    @property
    def seen(self) -> np.ndarray:
        """True where a marker is seen, (F, M)."""
        return np.isfinite(self.points).all(2)

    def by_camera(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each camera numbers of the times at which it sees markers, and which it sees, (M,) bool; all without one.

        Cameras need not take their pictures at the same times.
        """
        if self.camera is None:
            return [(np.arange(len(self.times)), np.ones(len(self.rest), bool))]
        groups = [self.camera.of == k for k in range(len(self.camera.cameras))]
        return [(np.flatnonzero(self.seen[:, group].any(1)), group) for group in groups]

    def observed(self, places: np.ndarray, some=np.s_[:]) -> np.ndarray:
        """The coordinates (..., D) of places (..., 3) [m] of (some of) the markers that are compared with `points`."""
        if self.camera is None:
            return places
        return self.metres * np.stack(self.camera.part(some).projected(places)[:2], -1)

    def slopes(self, places: np.ndarray, some=np.s_[:]) -> np.ndarray:
        """Derivatives (M, D, 3) of what is observed of places (M, 3) of (some of) the markers."""
        if self.camera is None:
            return np.tile(np.eye(3), (len(places), 1, 1))
        return self.metres * self.camera.part(some).slopes(places)

    def is_held(self, x: np.ndarray, start: np.ndarray | None, wider: float = 0.0) -> np.ndarray:
        """Mask (V,) of a cage's vertices that stand still: in boxes of each camera that has some, `wider` [px] to each
        side; x, and in pictures `start`: their places (V, 3) at rest and at the first time."""
        if self.held is None:
            return np.zeros(len(x), bool)
        if self.camera is None:
            return ((x >= self.held[0]) & (x <= self.held[1])).all(1)
        found = np.ones(len(x), bool)
        for k in np.unique(self.held[:, 4]).astype(int):
            u, v, _ = self.camera.cameras[k].projected(start)
            boxes = self.held[self.held[:, 4] == k, :4] + wider * np.array([-1, -1, 1, 1])
            found &= np.any([(u >= l) & (v >= t) & (u <= r) & (v <= b) for l, t, r, b in boxes], axis=0)
        return found


OPTIONAL = {"held": (2, 3), "release": (), "pose": (4, 4), "planes": (None, 4), "gravity": (3,)}


def read_tracks(path: Path) -> MarkerTracks:
    """The tracks of a .npz file, checked. Raises BadInput that says what is wrong."""
    shapes = {"times": (None,), "points": (None, None, 3), "rest": (None, 3), **OPTIONAL}
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise BadInput(f"{path}: is larger than 1 GB")
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name], np.float64) for name in shapes if name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError, KeyError) as e:
        raise BadInput(f"{path}: cannot be read as a .npz file of numbers: {e}") from e
    for name, shape in shapes.items():
        if name not in arrays:
            if name in OPTIONAL:
                continue
            raise BadInput(f"{path}: has no {name}; a file of tracks has times, points and rest (docs/formats.md)")
        found = arrays[name].shape
        if len(found) != len(shape) or any(n not in (None, m) for n, m in zip(shape, found, strict=True)):
            raise BadInput(f"{path}: {name} has shape {found}, expected {shape}".replace("None", "n"))
        if name not in ("points", "release") and not np.isfinite(arrays[name]).all():
            raise BadInput(f"{path}: {name} is not finite")
    times, points, rest = (arrays[name] for name in ("times", "points", "rest"))
    if points.shape[:2] != (len(times), len(rest)):
        raise BadInput(f"{path}: points has {points.shape[:2]}, for {len(times)} times and {len(rest)} markers")
    if len(times) < FEWEST_FRAMES:
        raise BadInput(f"{path}: {len(times)} frames; at least {FEWEST_FRAMES} are needed")
    if (np.diff(times) <= 0).any():
        raise BadInput(f"{path}: times must ascend")
    turn = arrays.get("pose", np.eye(4))[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-4:
        raise BadInput(f"{path}: pose is not a rigid motion")
    planes = arrays.get("planes", np.zeros((0, 4)))
    lengths = np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    if (lengths < 1e-9).any():
        raise BadInput(f"{path}: the normal of a plane is zero")
    tracks = MarkerTracks(
        times,
        points,
        rest,
        arrays.get("held"),
        float(arrays.get("release", np.inf)),
        arrays.get("pose"),
        planes / np.where(lengths > 0, lengths, 1.0),
        arrays.get("gravity", np.array([0.0, -9.81, 0.0])),
    )
    seen = tracks.seen
    if seen.sum() < 0.2 * seen.size:
        raise BadInput(
            f"{path}: markers are seen in {seen.mean():.0%} of the frames only: the thing leaves the picture"
        )
    if (seen[:START_FRAMES].sum(0) >= 3).sum() < 3:
        raise BadInput(f"{path}: fewer than three markers are seen in the first {START_FRAMES} frames")
    return tracks


def marker_weights(vertices: np.ndarray, tets: np.ndarray, rest: np.ndarray, where: str) -> sp.csr_matrix:
    """Weights (M, V) of the cage's vertices that give each marker; BadInput for one that is far from the cage."""
    weights, away = surface_weights(vertices, tets, rest)
    if away.max() > OFF_THE_CAGE * np.ptp(vertices, axis=0).max():
        worst = int(away.argmax())
        raise BadInput(f"{where}: marker {worst} is {100 * away.max():.1f} cm outside the asset: rest is in its frame")
    return weights


def surface_weights(vertices: np.ndarray, tets: np.ndarray, points: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """Weights (M, V) of the cage's vertices that give points (M, 3), and how far these are outside the cage [m]."""
    locator = TetLocator(vertices, tets)
    host, away = locator.find(points), np.zeros(len(points))
    out = host < 0
    if out.any():
        host[out], sample = locator.nearest(points[out])
        away[out] = np.linalg.norm(sample - points[out], axis=1)
    weights = locator.weights(host, points)
    rows = np.repeat(np.arange(len(points)), 4)
    shape = (len(points), len(vertices))
    return sp.csr_matrix((weights.ravel(), (rows, locator.tets[host].ravel())), shape), away


def noise_of(tracks: MarkerTracks) -> float:
    """Standard deviation [m] of a coordinate's noise, from third differences, which a smooth motion hardly has."""
    parts = []
    for rows, group in tracks.by_camera():
        points, rest = tracks.points[rows][:, group], tracks.rest[group]
        if tracks.camera is not None:  # pictures are few in a period: what neighbours do as well is no noise
            away = np.linalg.norm(rest[:, None] - rest[None], axis=2)
            near = np.argsort(away, axis=1)[:, 1 : NEIGHBOURS + 1]
            points = points - points[:, near].mean(2)
        parts.append(np.diff(points, 3, axis=0).ravel())
    third = np.concatenate(parts)
    third = third[np.isfinite(third)]
    spread = 1.4826 * np.median(np.abs(third)) / np.sqrt(20) if third.size else 0.0  # 1 + 9 + 9 + 1
    least = 1e-5 * np.nanmax(np.ptp(tracks.rest, axis=0))
    return float(max(spread, least if tracks.camera is None else FINEST * tracks.metres))


def start_of(tracks: MarkerTracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places [m] and velocities [m/s] of the markers at the first time, (M, D) each; and which are known, (M,)."""
    place, velocity = np.zeros_like(tracks.points[0]), np.zeros_like(tracks.points[0])
    known = np.zeros(len(tracks.rest), bool)
    for rows, group in tracks.by_camera():
        t, points = tracks.times[rows[:START_FRAMES]] - tracks.times[0], tracks.points[rows[:START_FRAMES]]
        seen = np.isfinite(points).all(2)
        known |= group & (seen.sum(0) >= 3)
        for m in np.flatnonzero(known & group):
            degree = 2 if seen[:, m].sum() > 3 else 1
            fitted = np.polynomial.polynomial.polyfit(t[seen[:, m]], points[seen[:, m], m], degree)
            place[m], velocity[m] = fitted[0], fitted[1]
    return place, velocity, known


def rigid_pose(rest: np.ndarray, place: np.ndarray) -> np.ndarray:
    """world_from_asset (4, 4) of the rigid motion nearest to markers at rest (M, 3) and at their places (M, 3)."""
    a, b = rest.mean(0), place.mean(0)
    pose = np.eye(4)
    pose[:3, :3] = best_fit_rotation((place - b).T @ (rest - a))
    pose[:3, 3] = b - pose[:3, :3] @ a
    return pose


def posed(pose: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Points (..., 3) after a pose (4, 4)."""
    return x @ pose[:3, :3].T + pose[:3, 3]


def rigid_pose_seen(
    camera: Camera | Rig, body: np.ndarray, seen: np.ndarray, pose: np.ndarray, rounds: int = 6
) -> np.ndarray:
    """The pose (4, 4) that takes points of the body (N, 3) to where they are seen (N, 2) [px]: Gauss-Newton from a
    first pose, with weights of Cauchy."""
    for _ in range(rounds):
        at = posed(pose, body)
        J, uv = camera.slopes(at), np.stack(camera.projected(at)[:2], -1)
        r = seen - uv
        w = 1 / (1 + (r**2).sum(1) / OUTLIER_PIXELS**2)
        middle = at.mean(0)
        arm = at - middle
        cross = np.zeros((len(at), 3, 3))  # of a small turn: omega x arm
        cross[:, [0, 1, 2], [1, 2, 0]], cross[:, [0, 1, 2], [2, 0, 1]] = arm[:, [2, 0, 1]], -arm[:, [1, 2, 0]]
        A = np.concatenate([J, J @ cross], 2)
        H = np.einsum("n,nri,nrj->ij", w, A, A)
        step = np.linalg.solve(H + 1e-9 * np.diag(np.diag(H)), np.einsum("n,nri,nr->i", w, A, r))
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        new = np.eye(4)
        new[:3, :3] = turn @ pose[:3, :3]
        new[:3, 3] = turn @ (pose[:3, 3] - middle) + middle + step[:3]
        pose = new
    return pose
