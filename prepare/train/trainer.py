"""Training of Gaussians on photographs: one view per step, entirely on the device."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from assets.gaussians import SH_COUNTS, Gaussians
from prepare.train.densification import FAR, AdaptiveDensity, MonteCarlo
from prepare.train.free_space import free_radii, in_free_space, near_depth
from prepare.train.gradient_step import GradientStep
from prepare.train.object_labels import SEGMENTATION_WEIGHT, label_colors, nearest_label
from prepare.train.optimizer import BETA1, BETA2, LearningRates
from prepare.train.photographs import Photograph
from prepare.train.population import Population
from prepare.train.train_options import TrainOptions
from prepare.train.training_views import TrainingViews, packed
from prepare.train.view_corrections import Exposures, Poses

CLEARED = (0.5, 0.6, 0.7, 0.8, 0.9)  # fractions of a training at which free space is cleared: growth has ended
STRATEGIES = {"default": AdaptiveDensity, "mcmc": MonteCarlo}


@dataclass(frozen=True)
class Quality:
    """Quality of a drawn image: PSNR [dB], SSIM, mean absolute error, over the pixels that count."""

    psnr: float
    ssim: float
    l1: float


class Trainer:
    """Trains Gaussians on photographs; call `step` once for each of `options.steps`.

    photographs  undistorted; each stays on the device as 4 bytes a pixel
    extent       of the capture: the unit of positional learning rates and size limits
    objects      names of the objects in the masks; with them labels are learned, by L + lambda_seg L_seg
    """

    def __init__(
        self, photographs: list[Photograph], start: Gaussians, extent: float, options: TrainOptions, objects=()
    ):
        self.options, self.extent, self.objects = options, extent, tuple(objects)
        self.rng = np.random.default_rng(options.seed)
        capacity = max(options.cap, len(start))
        self.population = Population(start, capacity, options.frozen, labelled=bool(self.objects))
        self.strategy = STRATEGIES[options.strategy](self.population, extent, options.cap, self.rng)
        if isinstance(self.strategy, AdaptiveDensity):
            self.strategy.budgeted, self.strategy.resets = options.budgeted, options.resets
            self.strategy.start = len(start)
        self.views = TrainingViews(photographs, options.coarse, len(self.objects))
        cameras = self.views.cameras
        size = max(c.height for c in cameras), max(c.width for c in cameras)
        drawn = {"antialias": options.antialias, "sort": options.sort}
        drawn |= {"exposes": options.exposure, "of_camera": options.poses}
        self.gradients = GradientStep(self.population, *size, **drawn)
        self.exposures = Exposures(len(cameras)) if options.exposure else None
        self.poses = Poses([c.world_to_camera for c in cameras], extent, options.steps) if options.poses else None
        self.rates = LearningRates()
        self.done = 0  # steps
        self._queue: list[int] = []  # views that follow, in a random order without repetition

    def destroy(self) -> None:
        """Free the device memory."""
        self.gradients.destroy()
        self.population.destroy()

    def step(self) -> None:
        """One training step, on one view."""
        if not self._queue:
            self._queue = self.rng.permutation(len(self.views)).tolist()
        view = self._queue.pop()
        o, r = self.options, self.rates
        learning = max(1, self.population.count - self.population.frozen)
        progress = self.done / max(o.steps, 1)
        mean_rate = r.of_mean(self.done, o.steps, self.extent)
        degree = min(o.degree, self.done // o.degree_interval)
        if self.poses is not None:
            self.views.set_pose(view, self.poses.of(view))  # others' steps moved it, too
        self.done += 1
        biases = 1.0 - BETA1**self.done, 1.0 - BETA2**self.done
        target = self.views.at(view, progress)
        if self.exposures is not None:
            self.gradients.exposure.set(self.exposures.of(view))
        mask_scale = SEGMENTATION_WEIGHT / (3 * max(target.known, 1))
        self.gradients.compute(target.image, target.camera, 1.0 / (3 * target.counted), target.mask, mask_scale)
        if self.exposures is not None:
            self.exposures.step(view, self.gradients.exposure.d_affine.to_numpy(), progress)
        if self.poses is not None:
            self.poses.learn(view, self.gradients.camera_gradient(), progress)
        if target.mask is not None:
            self.gradients.update_labels(biases)
        self.gradients.update(
            target.camera,
            (mean_rate, r.quat, r.log_scale, r.logit, r.color, r.harmonics),
            biases,
            SH_COUNTS[degree] if self.done % o.harmonics_every == 0 else 1,
            FAR * self.extent,
            (self.strategy.opacity_cost / learning, self.strategy.scale_cost / (3 * learning)),
            o.sparse,
        )
        self.strategy.after(self.done, o.steps, mean_rate)
        if o.free_space and self.done in {round(part * o.steps) for part in CLEARED}:
            self.clear_free_space()

    def clear_free_space(self) -> None:
        """Remove the Gaussians in the free space around the cameras."""
        p, cameras = self.population, self.views.cameras
        radii = free_radii(cameras, np.array([near_depth(*self.gradients.depths(c)) for c in cameras]))
        p.remove(in_free_space(p.splats.mean.to_numpy()[: p.count], cameras, radii))

    def quality(self, photograph: Photograph) -> Quality:
        """Quality of the current rendering of a photograph."""
        sums = self.gradients.compare(packed(photograph), photograph.camera)
        values = 3.0 * max(float(sums[3]), 1.0)
        return Quality(-10.0 * np.log10(max(sums[1] / values, 1e-12)), sums[2] / values, sums[0] / values)

    def recent_loss(self) -> Quality:
        """Mean quality over the steps since the last call."""
        sums = self.gradients.take_sums()
        values = 3.0 * max(float(sums[3]), 1.0)
        return Quality(-10.0 * np.log10(max(sums[1] / values, 1e-12)), sums[2] / values, sums[0] / values)

    def gaussians(self) -> Gaussians:
        """The current Gaussians, with the sort they were trained for."""
        return replace(self.population.gaussians(), sort=self.options.sort)

    def picture(self, camera) -> np.ndarray:
        """Picture for a camera as of now, (H, W, 3) uint8."""
        return self.gradients.picture(camera)

    # objects

    def labels(self) -> np.ndarray:
        """Labels of the Gaussians, (N, 3)."""
        return self.population.labels.value.to_numpy()[: self.population.count]

    def evidence(self) -> np.ndarray:
        """Number of mask pixels in which each Gaussian was visible, by its blending weights, (N,) float64."""
        views = [self.views.at(view, 1.0) for view in range(len(self.views))]
        return sum(self.gradients.weights(v.camera, v.mask) for v in views if v.mask is not None)

    def seen_objects(self, camera, ids: np.ndarray | None = None) -> np.ndarray:
        """Id of the object that each pixel of a picture shows, (H, W) uint8; `ids`: those of the Gaussians, (N,).

        Without `ids` they follow from the learned labels.
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
        for name, learned in self._of_views().items():
            own |= learned.state(name)
        return {**self.population.read(), **own}

    def _of_views(self) -> dict:
        """Learned corrections of the views, by name."""
        known = {"exposure": self.exposures, "pose": self.poses}
        return {name: learned for name, learned in known.items() if learned is not None}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go back to what `state` gave."""
        self.population.write({name: state[name] for name in self.population.arrays()})
        self.done, self._queue = int(state["done"][0]), state["queue"].tolist()
        for name, learned in self._of_views().items():
            learned.restore(name, state)
        if self.poses is not None:
            for view in range(len(self.views)):
                self.views.set_pose(view, self.poses.of(view))
        low, high, inc_low, inc_high = (int(w) for w in state["rng"])
        rng = self.rng.bit_generator.state
        rng["state"] = {"state": low | high << 64, "inc": inc_low | inc_high << 64}
        self.rng.bit_generator.state = rng
