"""Training of Gaussians to photographs: one view a step, all of it on the device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import taichi as ti

from assets.gaussians import SH_COUNTS, Gaussians
from prepare.train.densification import AdaptiveDensity, MonteCarlo
from prepare.train.gradient_step import GradientStep
from prepare.train.object_labels import SEGMENTATION_WEIGHT, label_colors, nearest_label, packed_labels
from prepare.train.optimizer import BETA1, BETA2, SH_DEGREE_INTERVAL, LearningRates
from prepare.train.photographs import Photograph
from prepare.train.population import Population

STRATEGIES = {"default": AdaptiveDensity, "mcmc": MonteCarlo}


@dataclass(frozen=True)
class TrainOptions:
    """Options of a training.

    strategy   of births and deaths: "default" grows where detail is missing, "mcmc" fills the budget `cap`
    cap        most Gaussians, frozen ones included; memory for them is taken at the start
    sort       order of blending that is trained for, one of render.SORTS but "pixel"
    frozen     the first Gaussians, as many as this, are drawn but stay as they are, bit for bit
    """

    steps: int = 30_000
    strategy: str = "default"
    cap: int = 1_000_000
    degree: int = 3
    antialias: bool = False
    sort: str = "radial"
    seed: int = 0
    frozen: int = 0


@dataclass(frozen=True)
class Quality:
    """Quality of a drawn image: PSNR [dB], SSIM, mean absolute error, over the pixels that count."""

    psnr: float
    ssim: float
    l1: float


class Trainer:
    """Trains Gaussians to photographs; `step` once for each of `options.steps`.

    photographs  undistorted; each stays on the device as 4 bytes a pixel
    extent       of the capture: the unit of the learning rate of positions, and of what is large
    objects      names of the objects in the photographs' masks: those teach labels, by L + lambda_seg L_seg
    """

    def __init__(
        self, photographs: list[Photograph], start: Gaussians, extent: float, options: TrainOptions, objects=()
    ):
        self.options, self.extent, self.objects = options, extent, tuple(objects)
        self.rng = np.random.default_rng(options.seed)
        capacity = max(options.cap, len(start))
        self.population = Population(start, capacity, options.frozen, labelled=bool(self.objects))
        self.strategy = STRATEGIES[options.strategy](self.population, extent, options.cap, self.rng)
        self.cameras = [p.camera for p in photographs]
        self.counted = [int(p.mask.sum()) for p in photographs]
        self.images = [_packed(p) for p in photographs]
        self.masks = [_packed_mask(p, len(self.objects)) for p in photographs]  # (labels, counted pixels)
        size = max(c.height for c in self.cameras), max(c.width for c in self.cameras)
        self.gradients = GradientStep(self.population, *size, antialias=options.antialias, sort=options.sort)
        self.rates = LearningRates()
        self.done = 0  # steps
        self._queue: list[int] = []  # views that follow, in a random order without repetition

    def destroy(self) -> None:
        """Free the device memory."""
        self.gradients.destroy()
        self.population.destroy()

    def step(self) -> None:
        """Learn from one view."""
        if not self._queue:
            self._queue = self.rng.permutation(len(self.images)).tolist()
        view = self._queue.pop()
        o, r = self.options, self.rates
        learning = max(1, self.population.count - self.population.frozen)
        self.done += 1
        degree = min(o.degree, (self.done - 1) // SH_DEGREE_INTERVAL)
        mean_rate = r.of_mean(self.done - 1, o.steps, self.extent)
        mask, known = self.masks[view]
        biases = 1.0 - BETA1**self.done, 1.0 - BETA2**self.done
        scales = 1.0 / (3 * self.counted[view]), mask, SEGMENTATION_WEIGHT / (3 * max(known, 1))
        self.gradients.compute(self.images[view], self.cameras[view], *scales)
        if mask is not None:
            self.gradients.update_labels(biases)
        self.gradients.update(
            self.cameras[view],
            (mean_rate, r.quat, r.log_scale, r.logit, r.color, r.harmonics),
            biases,
            SH_COUNTS[degree],
            (self.strategy.opacity_cost / learning, self.strategy.scale_cost / (3 * learning)),
        )
        self.strategy.after(self.done, o.steps, mean_rate)

    def quality(self, photograph: Photograph) -> Quality:
        """Quality of what is drawn now of a photograph."""
        sums = self.gradients.compare(_packed(photograph), photograph.camera)
        values = 3.0 * max(float(sums[3]), 1.0)
        return Quality(-10.0 * np.log10(max(sums[1] / values, 1e-12)), sums[2] / values, sums[0] / values)

    def recent_loss(self) -> Quality:
        """Mean quality over the steps since the last call."""
        sums = self.gradients.take_sums()
        values = 3.0 * max(float(sums[3]), 1.0)
        return Quality(-10.0 * np.log10(max(sums[1] / values, 1e-12)), sums[2] / values, sums[0] / values)

    def picture(self, camera) -> np.ndarray:
        """Picture for a camera as of now, (H, W, 3) uint8."""
        return self.gradients.picture(camera)

    # objects

    def labels(self) -> np.ndarray:
        """Labels of the Gaussians, (N, 3)."""
        return self.population.labels.value.to_numpy()[: self.population.count]

    def seen_objects(self, camera, ids: np.ndarray | None = None) -> np.ndarray:
        """Id of the object that each pixel of a picture shows, (H, W) uint8; `ids`: those of the Gaussians, (N,).

        Without `ids` they are as the learned labels say.
        """
        count, value = len(self.objects), self.population.labels.value
        if ids is None:
            return nearest_label(self.gradients.labels(camera), count)
        kept = value.to_numpy()
        value.from_numpy(self.population.splats.padded(label_colors(count)[ids]))
        seen = nearest_label(self.gradients.labels(camera), count)
        value.from_numpy(kept)
        return seen

    # a cut training goes on

    def state(self) -> dict[str, np.ndarray]:
        """All that the following steps depend on."""
        rng = self.rng.bit_generator.state["state"]
        words = [rng[k] >> shift & 0xFFFFFFFFFFFFFFFF for k in ("state", "inc") for shift in (0, 64)]
        own = {
            "done": np.array([self.done]),
            "queue": np.array(self._queue, np.int32),
            "rng": np.array(words, np.uint64),
        }
        return {**self.population.read(), **own}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` gave."""
        self.population.write({name: state[name] for name in self.population.arrays()})
        self.done, self._queue = int(state["done"][0]), state["queue"].tolist()
        low, high, inc_low, inc_high = (int(w) for w in state["rng"])
        rng = self.rng.bit_generator.state
        rng["state"] = {"state": low | high << 64, "inc": inc_low | inc_high << 64}
        self.rng.bit_generator.state = rng


def _packed(photograph: Photograph) -> ti.Ndarray:
    """A photograph on the device: u32 R | G<<8 | B<<16 | A<<24, A = 255 where a pixel counts."""
    rgba = np.dstack([photograph.pixels, np.where(photograph.mask, 255, 0).astype(np.uint8)])
    image = ti.ndarray(ti.u32, rgba.shape[:2])
    image.from_numpy(np.ascontiguousarray(rgba).view("<u4")[..., 0])
    return image


def _packed_mask(photograph: Photograph, count: int) -> tuple[ti.Ndarray | None, int]:
    """The mask of a photograph as labels of `count` objects, None without one, and the number of pixels it counts."""
    ids = photograph.objects
    if ids is None or count == 0:
        return None, 0
    known = photograph.mask & (ids <= count)
    return (packed_labels(ids, known, count), int(known.sum())) if known.any() else (None, 0)
