"""Skeletal animation of a body: joints, their motion, and the cage vertices that follow. Linear blend skinning.

    x = sum_j w_j world_j inverse_bind_j X,      world_j = world_parent(j) T R S

The group `animation` of an asset file is described in docs/formats.md.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Annotated

import h5py
import numpy as np

from assets.gaussians import UNIT_TOLERANCE
from assets.hdf5 import Hdf5Reader, write_dataset, write_text
from core.errors import BadInput
from core.rotation import (
    conjugate_quaternions,
    matrices_from_quaternions,
    multiply_quaternions,
    quaternions_from_matrices,
)
from core.typed import Size

JOINTS_MAX, FRAMES_MAX, JOINT_FRAMES_MAX = 1024, 100_000, 2_000_000
JOINTS_PER_VERTEX = 4
START_RAMP = 1.0  # [s] from the shape at rest to the motion
SCALE_RANGE = (1e-4, 1e4)  # of a joint
POSE_KINDS = (("translations", 3), ("rotations", 4), ("scales", 3))

Pose = tuple[np.ndarray, np.ndarray, np.ndarray]  # local translation (..., J, 3), rotation wxyz (..., J, 4), scale


@dataclass(frozen=True)
class Animation:
    """A periodic motion: frame k is at k / fps, and after the last one comes the first.

    names         of the joints, [J]
    parents       (J,) int32, each before its children, -1 for none
    inverse_bind  from the asset's frame to each joint's at rest, (J, 4, 4) float64
    rest          local translation [m] (J, 3), rotation wxyz (J, 4), scale (J, 3) where all vertices are at rest
    frames        the same of each frame, (F, J, 3), (F, J, 4), (F, J, 3)
    fps           frame rate [1/s]
    vertices      cage vertices with weights: those of the surface and some inside bones, (S,) int32, ascending
    joints        that they follow, (S, 4) int32
    weights       (S, 4) float32, rows sum to 1
    driven        (S,) bool: True if prescribed by the motion, False if left to the simulation
    """

    names: list[str]
    parents: np.ndarray
    inverse_bind: np.ndarray
    rest: Pose
    frames: Pose
    fps: float
    vertices: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    driven: np.ndarray

    @property
    def duration(self) -> float:
        """Period [s]."""
        return len(self.frames[0]) / self.fps

    def local(self, time: float) -> Pose:
        """Local pose of the joints at `time` [s], interpolated between frames."""
        count = len(self.frames[0])
        at = (time * self.fps) % count
        k = min(int(at), count - 1)
        return interpolate_poses([x[k] for x in self.frames], [x[(k + 1) % count] for x in self.frames], at - k)

    def matrices(self, time: float) -> np.ndarray:
        """Skinning matrices (J, 4, 4), world_j inverse_bind_j, at `time` [s] after the start.

        The motion starts at rest and is blended in over START_RAMP [s].
        """
        local, u = self.local(time), min(max(time / START_RAMP, 0.0), 1.0)
        if u < 1.0:
            local = interpolate_poses(self.rest, local, u * u * (3.0 - 2.0 * u))
        return world_matrices(self.parents, local) @ self.inverse_bind

    def skinned(self, points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
        """Positions of `vertices` whose rest positions are `points` (S, 3) [m], float64; twin of `Skinning`."""
        return linear_blend_skinning(points, self.joints, self.weights, matrices)

    def check(self, cage_vertices: int, where: str) -> None:
        """Raise BadInput, naming `where`, unless the motion can be played on a cage with this many vertices."""
        J, F, S = len(self.names), len(self.frames[0]), len(self.vertices)
        if not (0 < J <= JOINTS_MAX and 0 < F <= FRAMES_MAX and J * F <= JOINT_FRAMES_MAX):
            raise BadInput(f"{where}: the animation has {J} joints and {F} frames, more than can be played, or none")
        arrays = {"parents": (self.parents, (J,)), "inverse_bind": (self.inverse_bind, (J, 4, 4))}
        for k, (kind, width) in enumerate(POSE_KINDS):
            arrays |= {f"rest {kind}": (self.rest[k], (J, width)), kind: (self.frames[k], (F, J, width))}
        arrays |= {"joints": (self.joints, (S, JOINTS_PER_VERTEX)), "weights": (self.weights, (S, JOINTS_PER_VERTEX))}
        arrays |= {"driven": (self.driven, (S,))}
        for name, (values, shape) in arrays.items():
            if np.shape(values) != shape:
                raise BadInput(f"{where}: the animation's {name} has shape {np.shape(values)}, expected {shape}")
            if not np.isfinite(values).all():
                raise BadInput(f"{where}: the animation's {name} are not finite")
        if (self.parents < -1).any() or (self.parents >= np.arange(J)).any():
            raise BadInput(f"{where}: a joint of the animation stands before its parent")
        if not (np.isfinite(self.fps) and 1e-3 <= self.fps <= 1e4):
            raise BadInput(f"{where}: the animation plays {self.fps:g} frames a second")
        for _, q, s in (self.rest, self.frames):
            if np.abs(np.linalg.norm(q, axis=-1) - 1).max() > UNIT_TOLERANCE:
                raise BadInput(f"{where}: a rotation of the animation is not normalised")
            if s.min() < SCALE_RANGE[0] or s.max() > SCALE_RANGE[1]:
                raise BadInput(f"{where}: a joint's scale is out of range ({SCALE_RANGE[0]:g} to {SCALE_RANGE[1]:g})")
        volumes = np.abs(np.linalg.det(self.inverse_bind[:, :3, :3]))
        if volumes.min() < 1e-18 or (self.inverse_bind[:, 3] != [0, 0, 0, 1]).any():
            raise BadInput(f"{where}: an inverse bind matrix cannot be inverted")
        v = self.vertices
        if S == 0 or v.min() < 0 or v.max() >= cage_vertices or (np.diff(v) <= 0).any():
            raise BadInput(f"{where}: the animation leads vertices outside 0..{cage_vertices - 1}, one twice, or none")
        if self.joints.min() < 0 or self.joints.max() >= J:
            raise BadInput(f"{where}: a vertex of the animation follows a joint outside 0..{J - 1}")
        if (self.weights < 0).any() or np.abs(self.weights.sum(1, dtype=np.float64) - 1).max() > UNIT_TOLERANCE:
            raise BadInput(f"{where}: skin weights are negative or do not sum to 1")


def linear_blend_skinning(
    points: np.ndarray, joints: np.ndarray, weights: np.ndarray, matrices: np.ndarray
) -> np.ndarray:
    """Blend of moved points (n, 3), float64; joints and weights (n, k), matrices (J, 4, 4)."""
    points, weights = np.asarray(points, np.float64), np.asarray(weights, np.float64)
    blended = np.einsum("nk,nkij->nij", weights, matrices[joints][:, :, :3])
    return np.einsum("nij,nj->ni", blended[:, :, :3], points) + blended[:, :, 3]


def slerp(a: np.ndarray, b: np.ndarray, u) -> np.ndarray:
    """Spherical interpolation from a to b by the shorter arc: unit quaternions (..., 4); u is a number or (..., 1)."""
    dot = (a * b).sum(-1, keepdims=True)
    b, dot = np.where(dot < 0, -b, b), np.abs(dot).clip(0, 1)
    angle = np.arccos(dot)
    near = angle < 1e-4
    sine = np.where(near, 1.0, np.sin(angle))
    left = np.where(near, 1 - u, np.sin((1 - u) * angle) / sine)
    right = np.where(near, u, np.sin(u * angle) / sine)
    q = left * a + right * b
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def interpolate_poses(a: Pose, b: Pose, u: float) -> Pose:
    """The pose a fraction u of the way from a to b."""
    return a[0] + u * (b[0] - a[0]), slerp(a[1], b[1], u), a[2] + u * (b[2] - a[2])


def local_matrices(local: Pose) -> np.ndarray:
    """T R S of translations, rotations and scales, (..., 4, 4)."""
    t, q, s = local
    m = np.zeros((*np.shape(t)[:-1], 4, 4))
    m[..., :3, :3] = matrices_from_quaternions(q) * np.asarray(s)[..., None, :]
    m[..., :3, 3], m[..., 3, 3] = t, 1.0
    return m


def world_matrices(parents: np.ndarray, local: Pose) -> np.ndarray:
    """Transforms from each joint's frame to the asset's, (..., J, 4, 4)."""
    m = local_matrices(local)
    for j, parent in enumerate(parents):
        if parent >= 0:
            m[..., j, :, :] = m[..., parent, :, :] @ m[..., j, :, :]
    return m


def decompose(m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation wxyz and scale of T R S (n, 4, 4), and the largest deviation from that form (n,)."""
    scale = np.linalg.norm(m[:, :3, :3], axis=1)
    R = m[:, :3, :3] / np.maximum(scale, 1e-12)[:, None]
    u, _, vt = np.linalg.svd(R)
    nearest = u @ vt
    mirrored = np.linalg.det(nearest) < 0
    deviation = np.abs(nearest - R).max((1, 2)) + 2.0 * mirrored
    proper = np.where(mirrored[:, None, None], np.eye(3), nearest)
    return m[:, :3, 3].copy(), quaternions_from_matrices(proper), scale, deviation


def close_loop(frames: Pose, seconds: float, fps: float) -> Pose:
    """Make frames 0..F periodic: F frames without a jump from the last to the first.

    The difference between frames F and 0 is blended in over the last `seconds`.
    """
    t, q, s = (np.array(x, np.float64) for x in frames)
    count = len(t) - 1
    n = min(round(seconds * fps), count)
    u = np.zeros(count + 1)
    u[count - n :] = np.linspace(0, 1, n + 1)
    u = (u * u * (3 - 2 * u))[:, None, None]
    gap = multiply_quaternions(q[:1], conjugate_quaternions(q[-1:]))
    t, s = t + u * (t[:1] - t[-1:]), s + u * (s[:1] - s[-1:])
    q = multiply_quaternions(slerp(np.broadcast_to([1.0, 0, 0, 0], q.shape), np.broadcast_to(gap, q.shape), u), q)
    return t[:-1], q[:-1], s[:-1]


def write_animation(file: h5py.File, a: Animation) -> None:
    """Write the group `animation`."""
    write_dataset(file, "animation/inverse_bind", a.inverse_bind, np.float64)
    root = np.arange(len(a.parents))  # its own parent: indices in files are not negative
    write_dataset(file, "animation/parents", np.where(a.parents < 0, root, a.parents), np.int32)
    for k, (kind, _) in enumerate(POSE_KINDS):
        write_dataset(file, f"animation/rest_{kind}", a.rest[k], np.float32)
        write_dataset(file, f"animation/{kind}", a.frames[k], np.float32)
    write_dataset(file, "animation/vertices", a.vertices, np.int32)
    write_dataset(file, "animation/joints", a.joints, np.int32)
    write_dataset(file, "animation/weights", a.weights, np.float32)
    write_dataset(file, "animation/driven", a.driven, np.uint8)
    file["animation"].attrs["fps"] = float(a.fps)
    write_text(file["animation"], "names", json.dumps(a.names))


def read_animation(file: Hdf5Reader) -> Animation:
    """The group `animation` of an open asset file, not checked against the cage. Raises BadInput."""
    names = file.json("animation", "names", Annotated[list[str], Size(JOINTS_MAX)])
    J = len(names)

    def pose(prefix: str, *frames: int) -> Pose:
        t, q, s = (file.floats(f"animation/{prefix}{kind}", (*frames, J, n), np.float64) for kind, n in POSE_KINDS)
        norm = np.linalg.norm(q, axis=-1, keepdims=True)
        rounded = np.abs(norm - 1) < 1e-5  # by float32; other quaternions stay, and are refused by the check
        return t, np.where(rounded, q / np.where(rounded, norm, 1.0), q), s

    frames = len(file.floats("animation/translations", (None, J, 3)))
    parents = file.indices("animation/parents", (J,))
    vertices = file.indices("animation/vertices", (None,))
    S = len(vertices)
    return Animation(
        names,
        np.where(parents == np.arange(J), -1, parents).astype(np.int32),
        file.floats("animation/inverse_bind", (J, 4, 4), np.float64),
        pose("rest_"),
        pose("", frames),
        file.number("animation", "fps"),
        vertices,
        file.indices("animation/joints", (S, JOINTS_PER_VERTEX)),
        file.floats("animation/weights", (S, JOINTS_PER_VERTEX)),
        file.indices("animation/driven", (S,)) != 0,
    )
