"""The Gaussians in training: learned parameters, moments of the optimizer, statistics, copying and moving of rows."""

import numpy as np
import taichi as ti

from assets.gaussians import Gaussians
from core.fields import FieldGroup
from core.quaternion import to_matrix
from prepare.train.object_labels import Labels
from prepare.train.train_options import BETA1, BETA2, EPSILON
from render.splats import Splats

vec3, vec4 = ti.math.vec3, ti.math.vec4
SPLIT = 0.5, 0.85, 0.6  # factors on the longest axis of a Gaussian that is split, on the others, and on its opacity
GEOMETRY = 11  # learned numbers of a Gaussian without its harmonics: mean 3, quat 4, log_scale 3, logit 1
geometry = ti.types.vector(GEOMETRY, ti.f32)


@ti.data_oriented
class Parameters:
    """Rotations, scales and opacities of `splats` in unconstrained form, of shape (capacity,).

    quat       wxyz of any length
    log_scale  vec3, natural logarithm [m]
    logit      of the opacity

    Means and harmonics need no activation and are learned in `splats`.
    """

    def __init__(self, splats: Splats):
        self.splats = splats
        self.fields = f = FieldGroup()
        self.quat, self.log_scale = f.vector(splats.capacity, n=4), f.vector(splats.capacity)
        self.logit = f.scalar(splats.capacity)
        f.build()

    def destroy(self) -> None:
        """Free the device memory."""
        self.fields.destroy()

    @ti.func
    def activate(self, begin: ti.i32, end: ti.i32):
        """Write covariances and opacities of Gaussians [begin, end) to the splats; outermost level of a kernel.

        Sigma = R S S R^T.                                                                        Kerbl 2023, eq. 6
        """
        for g in range(begin, end):
            axes = self.axes(g)
            s = axes @ axes.transpose()
            self.splats.cov[g] = ti.Vector([s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]])
            self.splats.opacity[g] = 1.0 / (1.0 + ti.exp(-self.logit[g]))

    @ti.func
    def axes(self, g: ti.i32):
        """R S: the columns are the axes of a Gaussian, one standard deviation long [m]."""
        axes = to_matrix(self.quat[g].normalized(1e-12))
        for k in ti.static(range(3)):
            scale = ti.exp(self.log_scale[g][k])
            for i in ti.static(range(3)):
                axes[i, k] *= scale
        return axes

    @ti.func
    def backward(self, g: ti.i32, gradients: ti.template()):
        """Gradients (quat, log_scale, logit) of a Gaussian from those of its covariance and opacity."""
        d = gradients.d_cov[g]
        d_cov = ti.Matrix(
            [[d[0], 0.5 * d[1], 0.5 * d[2]], [0.5 * d[1], d[3], 0.5 * d[4]], [0.5 * d[2], 0.5 * d[4], d[5]]]
        )
        length = ti.max(self.quat[g].norm(), 1e-12)
        q = self.quat[g] / length
        axes = self.axes(g)
        d_axes = 2.0 * d_cov @ axes
        d_log_scale, D = vec3(0.0), ti.Matrix.zero(ti.f32, 3, 3)  # D = dL/dR
        for k in ti.static(range(3)):
            scale = ti.exp(self.log_scale[g][k])
            for i in ti.static(range(3)):
                d_log_scale[k] += d_axes[i, k] * axes[i, k]
                D[i, k] = d_axes[i, k] * scale
        w, x, y, z = q[0], q[1], q[2], q[3]
        d_q = 2.0 * vec4(
            x * (D[2, 1] - D[1, 2]) + y * (D[0, 2] - D[2, 0]) + z * (D[1, 0] - D[0, 1]),
            w * (D[2, 1] - D[1, 2]) - 2 * x * (D[1, 1] + D[2, 2]) + y * (D[0, 1] + D[1, 0]) + z * (D[0, 2] + D[2, 0]),
            w * (D[0, 2] - D[2, 0]) + x * (D[0, 1] + D[1, 0]) - 2 * y * (D[0, 0] + D[2, 2]) + z * (D[1, 2] + D[2, 1]),
            w * (D[1, 0] - D[0, 1]) + x * (D[0, 2] + D[2, 0]) + y * (D[1, 2] + D[2, 1]) - 2 * z * (D[0, 0] + D[1, 1]),
        )
        d_quat = (d_q - q * q.dot(d_q)) / length
        opacity = self.splats.opacity[g]
        return d_quat, d_log_scale, gradients.d_opacity[g] * opacity * (1.0 - opacity)


@ti.dataclass
class AdamStep:
    """Numbers of one step of Adam.

    mean to harmonics        learning rates
    bias1, bias2             1 - beta^t of this step
    active                   number of coefficients of the harmonics that are learned by now
    half_width, half_height  of the picture [px]
    far                      depth from which on a positional gradient counts in full
    opacity_cost, scale_cost derivatives of the loss by each opacity and scale, over the number of Gaussians
    fading                   by which the logits of opacities in the picture fall, past Adam
    sparse                   1: Gaussians outside the picture are not updated, nor their moments
    """

    mean: ti.f32
    quat: ti.f32
    log_scale: ti.f32
    logit: ti.f32
    color: ti.f32
    harmonics: ti.f32
    bias1: ti.f32
    bias2: ti.f32
    active: ti.i32
    half_width: ti.f32
    half_height: ti.f32
    far: ti.f32
    opacity_cost: ti.f32
    scale_cost: ti.f32
    fading: ti.f32
    sparse: ti.i32


@ti.data_oriented
class Population:
    """Up to `capacity` Gaussians with all data that training needs.

    parameters  learned form of rotation, scale and opacity; means and harmonics are learned in `splats`
    first, second        moments of Adam of mean, quat, log_scale, logit, in this order
    first_sh, second_sh  those of the harmonics
    gradient_sum    sum over steps since the last clearing of the norm of the gradient with respect to the position in
                    the picture [1/half picture], less near the camera (Pixel-GS, Zhang et al. 2024): else what hangs
                    in the air before one camera multiplies
    gradient_count  number of those steps, in which the Gaussian was visible
    labels          of their objects, if there are masks
    arrays          all fields with a row a Gaussian, by name
    frozen          number of first rows that are drawn but never change, move or disappear

    Rows beyond `count` are unused. The host decides which rows are copied and dropped (prepare/train/densification.py);
    no kernel depends on `count`.
    """

    def __init__(self, gaussians: Gaussians, capacity: int, frozen: int = 0, *, labelled: bool = False):
        self.frozen = frozen
        self.splats = Splats(gaussians, capacity=capacity)
        self.splats.sh_range = (0, self.splats.capacity)  # all harmonics are evaluated: they will not stay zero
        self.parameters = Parameters(self.splats)
        self.capacity, coefficients = self.splats.capacity, self.splats.coefficients
        self.labels = Labels(self.capacity) if labelled else None
        self.fields = f = FieldGroup()
        self.first, self.second = (f.vector(self.capacity, n=GEOMETRY) for _ in range(2))
        self.first_sh, self.second_sh = (f.vector(self.capacity, coefficients) for _ in range(2))
        self.gradient_sum, self.gradient_count = f.scalar(self.capacity), f.scalar(self.capacity)
        f.build()
        p, s = self.parameters, self.splats
        learned = {"mean": s.mean, "quat": p.quat, "log_scale": p.log_scale, "logit": p.logit}
        kept = {"first": self.first, "second": self.second}
        kept |= {"gradient_sum": self.gradient_sum, "gradient_count": self.gradient_count}
        if labelled:
            learned["label"] = self.labels.value
            kept |= {"first_label": self.labels.first, "second_label": self.labels.second}
        self._learned, self._kept = list(learned.values()), list(kept.values())
        self.arrays = learned | kept | {"sh": s.sh, "first_sh": self.first_sh, "second_sh": self.second_sh}
        p.quat.from_numpy(s.padded(gaussians.quats))
        p.log_scale.from_numpy(s.padded(gaussians.log_scales))
        p.logit.from_numpy(s.padded(gaussians.logit_opacities))
        self.activate()

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return self.splats.count

    def destroy(self) -> None:
        """Free the device memory."""
        self.parameters.destroy()
        self.splats.destroy()
        self.fields.destroy()
        if self.labels is not None:
            self.labels.destroy()

    def read(self) -> dict[str, np.ndarray]:
        """Copies of all rows in use, on the host."""
        return {name: field.to_numpy()[: self.count] for name, field in self.arrays.items()}

    def write(self, arrays: dict[str, np.ndarray]) -> None:
        """Put rows back as `read` gave them; the first `count` are in use then."""
        self.splats.count = len(arrays["mean"])
        for name, field in self.arrays.items():
            field.from_numpy(self.splats.padded(arrays[name]))
        self.activate()

    def gaussians(self) -> Gaussians:
        """The Gaussians as they are now, on the host."""
        p, n = self.parameters, self.count
        rows = (self.splats.mean, p.quat, p.log_scale, p.logit, self.splats.sh)
        gaussians = Gaussians.of(*(field.to_numpy()[:n] for field in rows))
        gaussians.quats[: self.frozen] = p.quat.to_numpy()[: self.frozen]  # normalised again they differ in a bit
        return gaussians

    def activate(self) -> None:
        """Write covariances and opacities of all Gaussians to the splats."""
        self._activate(self.count)

    @ti.kernel
    def _activate(self, count: ti.i32):
        self.parameters.activate(0, count)

    @ti.func
    def update(self, gradients: ti.template(), begin: ti.i32, end: ti.i32, step: ti.template()):
        """A step of Adam for Gaussians [begin, end) with the gradients of this step, an `AdamStep`; outermost level of
        a kernel."""
        for g in range(begin, end):
            seen = gradients.seen(g)
            if seen or step.sparse == 0:
                d = geometry(0.0)
                if seen:
                    d_position = gradients.blend.d_mean2d(g)
                    share = ti.min(gradients.projection.mean2d[0, g][3] / step.far, 1.0) ** 2
                    self.gradient_sum[g] += (
                        share * ti.math.vec2(d_position.x * step.half_width, d_position.y * step.half_height).norm()
                    )
                    self.gradient_count[g] += 1.0
                    d_mean = gradients.d_mean[g]
                    d_quat, d_log_scale, d_logit = self.parameters.backward(g, gradients)
                    for k in ti.static(range(3)):
                        d[k], d[7 + k] = d_mean[k], d_log_scale[k]
                    for k in ti.static(range(4)):
                        d[3 + k] = d_quat[k]
                    d[10] = d_logit
                opacity = self.splats.opacity[g]
                d[10] += step.opacity_cost * opacity * (1.0 - opacity)
                for k in ti.static(range(3)):
                    d[7 + k] += step.scale_cost * ti.exp(self.parameters.log_scale[g][k])
                first = BETA1 * self.first[g] + (1.0 - BETA1) * d
                second = BETA2 * self.second[g] + (1.0 - BETA2) * d * d
                self.first[g], self.second[g] = first, second
                move = (first / step.bias1) / (ti.sqrt(second / step.bias2) + EPSILON)
                for k in ti.static(range(3)):
                    self.splats.mean[g][k] -= step.mean * move[k]
                    self.parameters.log_scale[g][k] -= step.log_scale * move[7 + k]
                for k in ti.static(range(4)):
                    self.parameters.quat[g][k] -= step.quat * move[3 + k]
                self.parameters.logit[g] -= step.logit * move[10] + ti.select(seen, step.fading, 0.0)
        for g, k in ti.ndrange((begin, end), step.active):
            seen = gradients.seen(g)
            if seen or step.sparse == 0:
                d_sh = vec3(0.0)
                if seen:
                    d_sh = gradients.d_sh[g, k]
                first_sh = BETA1 * self.first_sh[g, k] + (1.0 - BETA1) * d_sh
                second_sh = BETA2 * self.second_sh[g, k] + (1.0 - BETA2) * d_sh * d_sh
                self.first_sh[g, k], self.second_sh[g, k] = first_sh, second_sh
                rate = step.color if k == 0 else step.harmonics
                self.splats.sh[g, k] -= rate * (first_sh / step.bias1) / (ti.sqrt(second_sh / step.bias2) + EPSILON)

    # births and deaths

    def copy(self, sources, targets, *, moments: bool) -> None:
        """Overwrite rows `targets` with rows `sources`; no row is both.

        Without `moments` the copies' are zero, and so are their statistics.
        """
        if len(targets):
            self._copy(np.asarray(sources, np.int32), np.asarray(targets, np.int32), int(moments))

    @ti.kernel
    def _copy(self, sources: ti.types.ndarray(ti.i32, 1), targets: ti.types.ndarray(ti.i32, 1), moments: ti.i32):
        for i in range(targets.shape[0]):
            a, b = sources[i], targets[i]
            for field in ti.static(self._learned):
                field[b] = field[a]
            for k in range(self.splats.coefficients):
                self.splats.sh[b, k] = self.splats.sh[a, k]
            self._set_moments(a, b, ti.cast(moments, ti.f32))

    @ti.func
    def _set_moments(self, a: ti.i32, b: ti.i32, keep: ti.f32):
        """Moments and statistics of row b: `keep` times those of row a."""
        for field in ti.static(self._kept):
            field[b] = keep * field[a]
        for k in range(self.splats.coefficients):
            self.first_sh[b, k], self.second_sh[b, k] = keep * self.first_sh[a, k], keep * self.second_sh[a, k]

    def remove(self, dead: np.ndarray) -> None:
        """Remove the Gaussians of a mask (count,) that are not frozen, all but one; the last rows take their places."""
        dead = dead & (np.arange(self.count) >= self.frozen)
        alive = max(1, self.count - int(dead.sum()))
        holes = np.flatnonzero(dead[:alive])
        self.copy(alive + np.flatnonzero(~dead[alive:])[: len(holes)], holes, moments=True)
        self.splats.count = alive
        self.activate()

    @ti.kernel
    def split(self, rows: ti.types.ndarray(ti.i32, 1), copies: ti.i32):
        """Make `rows` and their copies, the rows from `copies` on, halves along the longest axes; variances stay."""
        length, width, share = ti.static(SPLIT)
        for i in range(rows.shape[0]):
            a, b = rows[i], copies + i
            axes, logs = self.parameters.axes(a), self.parameters.log_scale[a]
            longest = 0
            for k in ti.static(range(1, 3)):
                if logs[k] > logs[longest]:
                    longest = k
            way = ti.sqrt(1.0 - length * length) * vec3(axes[0, longest], axes[1, longest], axes[2, longest])
            opacity = share / (1.0 + ti.exp(-self.parameters.logit[a]))
            for g, sign in ti.static(((a, 1.0), (b, -1.0))):
                self.splats.mean[g] += sign * way
                for k in ti.static(range(3)):
                    self.parameters.log_scale[g][k] = logs[k] + ti.log(ti.select(k == longest, length, width))
                self.parameters.logit[g] = ti.log(opacity / (1.0 - opacity))
                self._set_moments(g, g, 0.0)

    def clear_statistics(self) -> None:
        """Forget the sums and counts of the gradients."""
        self.gradient_sum.fill(0.0)
        self.gradient_count.fill(0.0)

    @ti.kernel
    def set_opacity_and_scale(
        self, rows: ti.types.ndarray(ti.i32, 1), logits: ti.types.ndarray(ti.f32, 1),
        log_scales: ti.types.ndarray(ti.f32, 2),
    ):  # fmt: skip
        """Give rows these logits (n,) and log scales (n, 3), without moments."""
        for i in range(rows.shape[0]):
            g = rows[i]
            self.parameters.logit[g] = logits[i]
            self.parameters.log_scale[g] = vec3(log_scales[i, 0], log_scales[i, 1], log_scales[i, 2])
            self._set_moments(g, g, 0.0)

    @ti.kernel
    def add_noise(self, begin: ti.i32, end: ti.i32, amount: ti.f32, seed: ti.u32):
        """Move Gaussians [begin, end) at random along their axes, more the fainter they are (Kheradmand 2024, eq. 8).

        Sigma n times `amount`, n standard normal, times a logistic function that vanishes for opacities above 0.005.
        """
        for g in range(begin, end):
            faint = 1.0 / (1.0 + ti.exp(-100.0 * (0.005 - self.splats.opacity[g])))
            s = self.splats.cov[g]
            n = vec3(normal(seed, g, 0), normal(seed, g, 1), normal(seed, g, 2)) * faint * amount
            self.splats.mean[g] += vec3(
                s[0] * n.x + s[1] * n.y + s[2] * n.z,
                s[1] * n.x + s[3] * n.y + s[4] * n.z,
                s[2] * n.x + s[4] * n.y + s[5] * n.z,
            )


@ti.func
def hashed(x: ti.u32) -> ti.u32:
    """A hash of 32 bits (the finaliser of MurmurHash3)."""
    x ^= x >> ti.u32(16)
    x *= ti.u32(2246822507)
    x ^= x >> ti.u32(13)
    x *= ti.u32(3266489909)
    return x ^ (x >> ti.u32(16))


@ti.func
def normal(seed: ti.u32, g: ti.i32, k: ti.i32) -> ti.f32:
    """A standard normal number for a seed, a row and a component (Box and Muller)."""
    base = hashed(seed ^ hashed(ti.cast(g * 3 + k, ti.u32)))
    u = (ti.cast(hashed(base ^ ti.u32(1640531527)), ti.f32) + 1.0) / 4294967808.0
    v = ti.cast(hashed(base ^ ti.u32(3266489917)), ti.f32) / 4294967296.0
    return ti.sqrt(-2.0 * ti.log(u)) * ti.cos(6.2831853 * v)
