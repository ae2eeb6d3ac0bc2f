"""Corrections of each photograph that are learned with the Gaussians: its exposure and its pose."""

import numpy as np
import taichi as ti

from core.fields import FieldGroup
from prepare.train.train_options import BETA1, BETA2, EPSILON

IDENTITY = np.eye(3, 4, dtype=np.float32)
BLOCK = 64  # [px] of a row that one thread sums

vec3, vec4 = ti.math.vec3, ti.math.vec4
EXPOSURE_RATE = (1e-2, 1e-3)  # first and last, as in 3DGS's own exposure compensation
POSE_REACH = 0.003  # [rad], and of the extent, that a pose can move in a training: more is worse (bench/NOTES.md)
POSE_DECAY = 0.01  # of the rate from the first step to the last


@ti.data_oriented
class Exposure:
    """The map c' = A c + b of a picture of at most (height, width), and its gradient.

    affine    rows of [A b], vec4 (3,)
    rgb       Out: the mapped picture, (1, height, width) as a renderer's
    d_affine  Out: gradient with respect to the rows, vec4 (3,)
    """

    def __init__(self, height: int, width: int):
        self.fields = f = FieldGroup()
        self.rgb = f.vector(1, height, width)
        self.affine, self.d_affine = f.vector(3, n=4), f.vector(3, n=4)
        f.build()
        self.set(IDENTITY)

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    def set(self, affine: np.ndarray) -> None:
        """Use [A b], (3, 4)."""
        self.affine.from_numpy(np.ascontiguousarray(affine, np.float32))

    @ti.func
    def apply(self, rgb: ti.template(), height: ti.i32, width: ti.i32):
        """Map the picture `rgb`; outermost level of a kernel."""
        for y, x in ti.ndrange(height, width):
            c = rgb[0, y, x]
            color = vec4(c.r, c.g, c.b, 1.0)
            for k in ti.static(range(3)):
                self.rgb[0, y, x][k] = self.affine[k].dot(color)

    @ti.func
    def backward(self, rgb: ti.template(), d_rgb: ti.template(), height: ti.i32, width: ti.i32):
        """Turn d_rgb from the gradient of the mapped picture into that of `rgb`; outermost level of a kernel."""
        for k in range(3):
            self.d_affine[k] = vec4(0.0)
        blocks = (width + BLOCK - 1) // BLOCK
        for i in range(height * blocks):
            y, first = i // blocks, i % blocks * BLOCK
            sums = ti.Matrix.zero(ti.f32, 3, 4)
            for x in range(first, ti.min(first + BLOCK, width)):
                c, d = rgb[0, y, x], d_rgb[y, x]
                back = vec3(0.0)
                for k in ti.static(range(3)):
                    back += d[k] * self.affine[k].xyz
                    sums[k, 3] += d[k]
                    for j in ti.static(range(3)):
                        sums[k, j] += d[k] * c[j]
                d_rgb[y, x] = back
            for k in ti.static(range(3)):
                self.d_affine[k] += vec4(sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3])


class ViewAdam:
    """Adam on the host for a few numbers per view: `values` (views, numbers), with a step count for each view."""

    def __init__(self, start: np.ndarray, views: int, rates: tuple[float, float]):
        self.values = np.tile(np.asarray(start, np.float64).ravel(), (views, 1))
        self.first, self.second = np.zeros_like(self.values), np.zeros_like(self.values)
        self.steps, self.rates = np.zeros(views, np.int64), rates

    def step(self, view: int, gradient: np.ndarray, progress: float) -> np.ndarray:
        """Step a view's numbers; `progress` is the fraction of the training done. Returns the change."""
        self.steps[view] += 1
        t, d = self.steps[view], np.asarray(gradient, np.float64).ravel()
        self.first[view] += (1.0 - BETA1) * (d - self.first[view])
        self.second[view] += (1.0 - BETA2) * (d * d - self.second[view])
        rate = self.rates[0] * (self.rates[1] / self.rates[0]) ** progress
        mean, spread = self.first[view] / (1.0 - BETA1**t), self.second[view] / (1.0 - BETA2**t)
        move = -rate * mean / (np.sqrt(spread) + EPSILON)
        self.values[view] += move
        return move

    def state(self, name: str) -> dict[str, np.ndarray]:
        """All that later steps depend on, by names that begin with `name`."""
        rows = np.stack([self.values, self.first, self.second], axis=1)
        return {name: rows, f"{name}_steps": self.steps.copy()}

    def restore(self, name: str, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` gave."""
        self.values, self.first, self.second = (np.array(a, np.float64) for a in state[name].transpose(1, 0, 2))
        self.steps = np.array(state[f"{name}_steps"], np.int64)


class Exposures(ViewAdam):
    """[A b] of each view. Their mean is kept at the identity, which stands for photographs without one."""

    def __init__(self, views: int):
        super().__init__(IDENTITY, views, EXPOSURE_RATE)

    def of(self, view: int) -> np.ndarray:
        """[A b] of a view, (3, 4)."""
        return self.values[view].reshape(3, 4)

    def step(self, view: int, gradient: np.ndarray, progress: float) -> np.ndarray:
        """Step a view's numbers, then shift all so that their mean stays."""
        move = super().step(view, gradient, progress)
        self.values -= move / len(self.values)
        return move


class Poses(ViewAdam):
    """A twist (rotation [rad], translation [extents]) that multiplies each view's world_to_camera from the left.

    steps  of the training, in which all views take turns: with more views each takes longer steps

    Together they neither move, turn nor scale the capture: the Gaussians would only follow.
    """

    def __init__(self, given: list[np.ndarray], extent: float, steps: int):
        mean = (1.0 - POSE_DECAY) / -np.log(POSE_DECAY)  # of the decaying rate over all steps
        rate = POSE_REACH * len(given) / (mean * max(steps, len(given)))
        super().__init__(np.zeros(6), len(given), (rate, POSE_DECAY * rate))
        self.given, self.extent = given, extent
        self._common = common_twists(np.array(given), extent)

    def of(self, view: int) -> np.ndarray:
        """world_to_camera (4, 4) of a view, corrected."""
        return twisted(self.values[view, :3], self.extent * self.values[view, 3:]) @ self.given[view]

    def learn(self, view: int, d_camera: np.ndarray, progress: float) -> None:
        """Step a view's pose; d_camera (3, 4): the gradient with respect to the rows of world_to_camera.

        The twist w, v of a small further motion changes column c of the matrix by w x c (and the last by v as well),
        so dL/dw = sum c x dL/dc. For a small twist this is also the gradient with respect to the whole twist.
        """
        columns = self.of(view)[:3].T
        d_rotation = np.cross(columns, d_camera.T).sum(axis=0)
        self.step(view, np.concatenate([d_rotation, self.extent * d_camera[:, 3]]), progress)
        twists = self.values.ravel()
        self.values = (twists - self._common @ (self._common.T @ twists)).reshape(self.values.shape)


def common_twists(world_to_camera: np.ndarray, extent: float) -> np.ndarray:
    """Twists of all cameras (N, 4, 4) when the world turns, moves or scales, (6 N, 7), orthonormal columns.

    A point w x x + v + s x of the world, in a camera at R x + t, is one of the twist (R w, R v - R w x t - s t).
    """
    R, t = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3] / extent
    turned = R.transpose(0, 2, 1)  # row k: R e_k
    turns = np.concatenate([turned, -np.cross(turned, t[:, None])], axis=-1)
    moves = np.concatenate([np.zeros_like(turned), turned], axis=-1)
    scales = np.concatenate([np.zeros_like(t), -t], axis=-1)[:, None]
    basis = np.concatenate([turns, moves, scales], axis=1)  # (N, 7, 6)
    return np.linalg.qr(basis.transpose(0, 2, 1).reshape(-1, 7))[0]


def twisted(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """The rigid transform (4, 4) of a rotation vector [rad] and a translation."""
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(rotation).as_matrix(), translation
    return out
