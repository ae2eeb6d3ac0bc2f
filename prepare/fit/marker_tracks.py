"""Tracks of markers on a body: POINTS.npz read and checked, the markers in the cage, and how the body sets off."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from core.errors import BadInput
from core.point_location import TetLocator
from core.rotation import best_fit_rotation

START_FRAMES = 5  # through whose places a parabola gives the start: a place and a speed less noisy than those of one
FEWEST_FRAMES = 12
OFF_THE_CAGE = 0.1  # of the body's extent: a marker further outside is on another body, or in other units
LARGEST_FILE = 1 << 30  # [bytes]


@dataclass(frozen=True)
class MarkerTracks:
    """Markers seen over time, in metres and seconds, in a world with y up.

    times    (F,) ascending;   points  (F, M, 3) places, NaN where a marker is not seen
    rest     (M, 3) where the markers are on the asset, in its frame
    held     (2, 3) least and greatest corner of a box in the asset's frame: what lies in it does not move; or None
    release  time at which the held part is let go, inf if never
    pose     (4, 4) world_from_asset of the held part; None: of a free body, which is found
    planes   (P, 4) normal n and offset d of solid half spaces: the body stays in n x >= d
    gravity  (3,) [m/s^2]
    """

    times: np.ndarray
    points: np.ndarray
    rest: np.ndarray
    held: np.ndarray | None
    release: float
    pose: np.ndarray | None
    planes: np.ndarray
    gravity: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """Whether a marker is seen, (F, M)."""
        return np.isfinite(self.points).all(2)


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
    locator = TetLocator(vertices, tets)
    host = locator.find(rest)
    out = host < 0
    if out.any():
        tet, sample = locator.nearest(rest[out])
        host[out] = tet
        away = np.linalg.norm(sample - rest[out], axis=1)
        if away.max() > OFF_THE_CAGE * np.ptp(vertices, axis=0).max():
            worst = int(np.flatnonzero(out)[away.argmax()])
            raise BadInput(
                f"{where}: marker {worst} is {100 * away.max():.1f} cm outside the asset: rest is in its frame"
            )
    weights = locator.weights(host, rest)
    rows = np.repeat(np.arange(len(rest)), 4)
    return sp.csr_matrix((weights.ravel(), (rows, locator.tets[host].ravel())), (len(rest), len(vertices)))


def noise_of(tracks: MarkerTracks) -> float:
    """Standard deviation [m] of a coordinate's noise, from third differences, which a smooth motion hardly has."""
    third = np.diff(tracks.points, 3, axis=0)
    third = third[np.isfinite(third)]
    spread = 1.4826 * np.median(np.abs(third)) / np.sqrt(20) if third.size else 0.0  # 1 + 9 + 9 + 1
    extent = np.nanmax(np.ptp(tracks.rest, axis=0))
    return float(max(spread, 1e-5 * extent))


def start_of(tracks: MarkerTracks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places [m] and velocities [m/s] of the markers at the first time, (M, 3) each; and which are known, (M,)."""
    t = tracks.times[:START_FRAMES] - tracks.times[0]
    place, velocity = np.zeros_like(tracks.rest), np.zeros_like(tracks.rest)
    seen = tracks.seen[:START_FRAMES]
    known = seen.sum(0) >= 3
    for m in np.flatnonzero(known):
        degree = 2 if seen[:, m].sum() > 3 else 1
        fitted = np.polynomial.polynomial.polyfit(t[seen[:, m]], tracks.points[:START_FRAMES][seen[:, m], m], degree)
        place[m], velocity[m] = fitted[0], fitted[1]
    return place, velocity, known


def rigid_pose(rest: np.ndarray, place: np.ndarray) -> np.ndarray:
    """world_from_asset (4, 4) of the rigid motion nearest to markers at rest (M, 3) and at their places (M, 3)."""
    a, b = rest.mean(0), place.mean(0)
    pose = np.eye(4)
    pose[:3, :3] = best_fit_rotation((place - b).T @ (rest - a))
    pose[:3, 3] = b - pose[:3, :3] @ a
    return pose
