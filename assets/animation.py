"""How a body moves by itself: a skeleton, its motion, and which cage vertices follow it. Linear blend skinning.

x = sum_j w_j  world_j  inverse_bind_j  X,      world_j = world_parent(j)  T R S
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.errors import BadInput
from core.rotation import matrices_from_quaternions, multiply_quaternions

JOINTS_MAX, FRAMES_MAX, NUMBERS_MAX = 1024, 100_000, 20_000_000
JOINTS_PER_VERTEX = 4  # joints that a vertex follows
START_RAMP = 1.0  # [s] from the shape at rest to the motion
SUM_TOLERANCE = 1e-3  # of a vertex's weights, as float32 rounds them
SCALES = (1e-4, 1e4)  # of a joint

Pose = tuple[
    np.ndarray, np.ndarray, np.ndarray
]  # translation (..., J, 3), rotation wxyz (..., J, 4), scale (..., J, 3)


@dataclass(frozen=True)
class Animation:
    """A motion that comes round: frame k is at k / fps, and after the last one the first is next.

    names         of the joints, [J];  parents (J,) int32, each before its children, -1 for none
    inverse_bind  from the asset's frame to each joint's at rest, (J, 4, 4) float64
    rest          local translation [m] (J, 3), rotation wxyz (J, 4), scale (J, 3) where all vertices are at rest
    frames        the same of each frame, (F, J, 3), (F, J, 4), (F, J, 3)
    fps           [1/s]
    vertices      cage vertices that have weights, those of the surface and some in bones, (S,) int32, rising
    joints        what they follow, (S, 4) int32;  weights  (S, 4) float32, rows sum to 1
    driven        (S,) bool: led by the motion, or left to the simulation
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
        """[s] until it comes round."""
        return len(self.frames[0]) / self.fps

    def local(self, time: float) -> Pose:
        """Translation, rotation and scale of each joint at `time` [s], blended between frames, (J, 3 or 4) each."""
        count = len(self.frames[0])
        at = (time * self.fps) % count
        k = min(int(at), count - 1)
        return interpolate_poses([x[k] for x in self.frames], [x[(k + 1) % count] for x in self.frames], at - k)

    def matrices(self, time: float, ramp: float = START_RAMP) -> np.ndarray:
        """What carries a vertex at rest to where each joint has it at `time` [s] after the start, (J, 4, 4).

        It starts at rest, and over `ramp` [s] goes over into the motion.
        """
        local, share = self.local(time), 1.0 if ramp <= 0 else min(max(time / ramp, 0.0), 1.0)
        if share < 1.0:
            local = interpolate_poses(self.rest, local, share * share * (3.0 - 2.0 * share))
        return world_matrices(self.parents, local) @ self.inverse_bind

    def skinned(self, points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
        """Where `vertices` are that at rest are at `points` (S, 3) [m], float64; the twin of sim/skinning.py."""
        return linear_blend_skinning(points, self.joints, self.weights, matrices)


def linear_blend_skinning(points: np.ndarray, joints: np.ndarray, weights: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Linear blend skinning: points (n, 3), joints and weights (n, k), matrices (J, 4, 4); (n, 3) float64."""
    points, weights = np.asarray(points, np.float64), np.asarray(weights, np.float64)
    blended = np.einsum("nk,nkij->nij", weights, matrices[joints][:, :, :3])
    return np.einsum("nij,nj->ni", blended[:, :, :3], points) + blended[:, :, 3]


def slerp(a: np.ndarray, b: np.ndarray, u) -> np.ndarray:
    """Unit quaternions the share u of the shorter way from a to b, (..., 4); u is a number or (..., 1)."""
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
    """The share u of the way from one pose to another."""
    return a[0] + u * (b[0] - a[0]), slerp(a[1], b[1], u), a[2] + u * (b[2] - a[2])


def local_matrices(local: Pose) -> np.ndarray:
    """T R S of translations, rotations and scales, (..., 4, 4)."""
    t, q, s = local
    m = np.zeros((*np.shape(t)[:-1], 4, 4))
    m[..., :3, :3] = matrices_from_quaternions(q) * np.asarray(s)[..., None, :]
    m[..., :3, 3], m[..., 3, 3] = t, 1.0
    return m


def world_matrices(parents: np.ndarray, local: Pose) -> np.ndarray:
    """From each joint's frame to the asset's, (..., J, 4, 4)."""
    m = local_matrices(local)
    for j, parent in enumerate(parents):
        if parent >= 0:
            m[..., j, :, :] = m[..., parent, :, :] @ m[..., j, :, :]
    return m


def decompose(m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation wxyz, scale of T R S (n, 4, 4), and how far each is from being one (n,): 0 if it is."""
    from scipy.spatial.transform import Rotation

    scale = np.linalg.norm(m[:, :3, :3], axis=1)
    R = m[:, :3, :3] / np.maximum(scale, 1e-12)[:, None]
    u, _, vt = np.linalg.svd(R)
    nearest = u @ vt
    off = np.abs(nearest - R).max((1, 2)) + 2.0 * (np.linalg.det(nearest) < 0)
    proper = np.where((np.linalg.det(nearest) < 0)[:, None, None], np.eye(3), nearest)
    return m[:, :3, 3].copy(), Rotation.from_matrix(proper).as_quat()[:, [3, 0, 1, 2]], scale, off


def turned_back(q: np.ndarray) -> np.ndarray:
    """The inverse of unit quaternions wxyz (..., 4)."""
    return np.asarray(q) * [1.0, -1.0, -1.0, -1.0]


def close_loop(frames: Pose, seconds: float, fps: float) -> Pose:
    """Frames 0..F of a motion whose last one should be the first again: F frames that come round without a jump.

    Over the last `seconds` what is missing at the end is made up for, bit by bit.
    """
    t, q, s = (np.array(x, np.float64) for x in frames)
    count = len(t) - 1
    n = min(round(seconds * fps), count)
    u = np.zeros(count + 1)
    u[count - n :] = np.linspace(0, 1, n + 1)
    u = (u * u * (3 - 2 * u))[:, None, None]
    gap = multiply_quaternions(q[:1], turned_back(q[-1:]))
    t, s = t + u * (t[:1] - t[-1:]), s + u * (s[:1] - s[-1:])
    q = multiply_quaternions(slerp(np.broadcast_to([1.0, 0, 0, 0], q.shape), np.broadcast_to(gap, q.shape), u), q)
    return t[:-1], q[:-1], s[:-1]


def check_animation(a: Animation, cage_vertices: int, where: str) -> None:
    """Raise BadInput, naming `where`, unless the motion can be played on a cage of so many vertices."""
    J, F, S = len(a.names), len(a.frames[0]), len(a.vertices)
    if not (0 < J <= JOINTS_MAX and 0 < F <= FRAMES_MAX and J * F <= NUMBERS_MAX // 10):
        raise BadInput(f"{where}: the animation has {J} joints and {F} frames, more than can be played, or none")
    shapes = {"parents": (a.parents, (J,)), "inverse_bind": (a.inverse_bind, (J, 4, 4))}
    for kind, width, k in (("translations", 3, 0), ("rotations", 4, 1), ("scales", 3, 2)):
        shapes |= {f"rest {kind}": (a.rest[k], (J, width)), kind: (a.frames[k], (F, J, width))}
    shapes |= {"joints": (a.joints, (S, JOINTS_PER_VERTEX)), "weights": (a.weights, (S, JOINTS_PER_VERTEX)), "driven": (a.driven, (S,))}
    for name, (values, shape) in shapes.items():
        if np.shape(values) != shape:
            raise BadInput(f"{where}: the animation's {name} has shape {np.shape(values)}, expected {shape}")
        if not np.isfinite(values).all():
            raise BadInput(f"{where}: the animation's {name} are not finite")
    if (a.parents < -1).any() or (a.parents >= np.arange(J)).any():
        raise BadInput(f"{where}: a joint of the animation stands before its parent")
    if not (np.isfinite(a.fps) and 1e-3 <= a.fps <= 1e4):
        raise BadInput(f"{where}: the animation plays {a.fps:g} frames a second")
    for q in (a.rest[1], a.frames[1]):
        if np.abs(np.linalg.norm(q, axis=-1) - 1).max() > SUM_TOLERANCE:
            raise BadInput(f"{where}: a rotation of the animation is not normalised")
    for s in (a.rest[2], a.frames[2]):
        if s.min() < SCALES[0] or s.max() > SCALES[1]:
            raise BadInput(f"{where}: a joint's scale is out of range ({SCALES[0]:g} to {SCALES[1]:g})")
    if np.abs(np.linalg.det(a.inverse_bind[:, :3, :3])).min() < 1e-18 or (a.inverse_bind[:, 3] != [0, 0, 0, 1]).any():
        raise BadInput(f"{where}: an inverse bind matrix cannot be inverted")
    if S == 0 or a.vertices.min() < 0 or a.vertices.max() >= cage_vertices or (np.diff(a.vertices) <= 0).any():
        raise BadInput(f"{where}: the animation leads vertices outside 0..{cage_vertices - 1}, one twice, or none")
    if a.joints.min() < 0 or a.joints.max() >= J:
        raise BadInput(f"{where}: a vertex of the animation follows a joint outside 0..{J - 1}")
    if (a.weights < 0).any() or np.abs(a.weights.sum(1, dtype=np.float64) - 1).max() > SUM_TOLERANCE:
        raise BadInput(f"{where}: skin weights are negative or do not sum to 1")
