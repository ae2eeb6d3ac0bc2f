"""Training of Gaussians on photographs: one view per step, entirely on the device; checkpoints of it."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import taichi as ti

from assets.file_access import atomic_write
from assets.gaussians import SH_COUNTS, Gaussians
from assets.hdf5 import new_hdf5, open_hdf5, write_text
from core.camera import Camera
from prepare.train import densification as density
from prepare.train.gradient_step import GradientStep
from prepare.train.image_loss import packed
from prepare.train.object_labels import SEGMENTATION_WEIGHT, label_colors, nearest_label, packed_labels
from prepare.train.photographs import Photograph, reduced
from prepare.train.population import AdamStep, Population
from prepare.train.train_options import BETA1, BETA2, LearningRates, TrainOptions
from prepare.train.view_corrections import Exposures, Poses

COARSE = (4, 2)  # divisors of width and height in the coarse stage, each for an equal part of it
SIDE_MIN = 32  # [px] smaller pictures are not reduced: SSIM's window is 11
CLEARED = (0.5, 0.6, 0.7, 0.8, 0.9)  # fractions of a training at which free space is cleared: growth has ended
FORMAT, VERSION = "vrgs-training", 2


class Target(NamedTuple):
    """A training view: an image, its camera, the number of pixels that count, and object labels if known.

    mask   `packed_labels`, or None; known: the number of pixels that it counts
    """

    image: ti.Ndarray
    camera: Camera
    counted: int
    mask: ti.Ndarray | None
    known: int


class TrainingViews:
    """Training photographs by view, at the size for the current stage of the training.

    coarse   fraction of the steps that use reduced pictures; 0: none, and no reduced copies are kept
    objects  number of objects in their masks
    """

    def __init__(self, photographs: list[Photograph], coarse: float, objects: int):
        self.cameras, self.coarse = [p.camera for p in photographs], coarse
        side = min(min(c.width, c.height) for c in self.cameras)
        divisors = [d for d in COARSE if side >= d * SIDE_MIN] if coarse > 0.0 else []
        self.levels = [[target(reduced(p, d), objects) for p in photographs] for d in (*divisors, 1)]

    def __len__(self) -> int:
        return len(self.cameras)

    def at(self, view: int, progress: float) -> Target:
        """The target for a view after a fraction `progress` of the steps."""
        stages = len(self.levels) - 1
        k = min(stages, math.floor(stages * progress / self.coarse)) if stages else 0
        found = self.levels[k][view]
        return found._replace(camera=replace(found.camera, world_to_camera=self.cameras[view].world_to_camera))

    def set_pose(self, view: int, world_to_camera: np.ndarray) -> None:
        """Render a view from another pose from now on."""
        self.cameras[view] = replace(self.cameras[view], world_to_camera=world_to_camera)


def target(photograph: Photograph, objects: int) -> Target:
    """A photograph on the device, with labels if it knows its `objects`."""
    ids, mask, known = photograph.objects, None, 0
    if ids is not None and objects > 0:
        counts = photograph.mask & (ids <= objects)
        known = int(counts.sum())
        mask = packed_labels(ids, counts, objects) if known else None
    image = packed(photograph.pixels, photograph.mask, photograph.alpha)
    return Target(image, photograph.camera, max(1, int(photograph.mask.sum())), mask, known)


@dataclass(frozen=True)
class Quality:
    """Quality of a drawn image: PSNR [dB], SSIM, mean absolute error, over the pixels that count."""

    psnr: float
    ssim: float
    l1: float


def quality_of(sums: np.ndarray) -> Quality:
    """Mean quality by the sums (4,) of an ImageLoss."""
    values = 3.0 * max(float(sums[3]), 1.0)
    return Quality(-10.0 * np.log10(max(sums[1] / values, 1e-12)), sums[2] / values, sums[0] / values)


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
        self.cut_out = any(p.alpha is not None for p in photographs)
        capacity = max(options.cap, len(start))
        self.population = Population(start, capacity, options.frozen, labelled=bool(self.objects))
        if options.strategy == "mcmc":
            stop, self.rates = min(density.MCMC_STOP, options.steps), LearningRates(logit=density.MCMC_LOGIT_RATE)
            self.strategy = density.MonteCarlo(self.population, options.cap, self.rng, stop=stop)
        else:
            stop, self.rates = min(density.STOP, options.steps // 2), LearningRates()
            self.strategy = density.AdaptiveDensity(self.population, options.cap, stop=stop)
        self.views = TrainingViews(photographs, options.coarse, len(self.objects))
        cameras = self.views.cameras
        size = max(c.height for c in cameras), max(c.width for c in cameras)
        self.gradients = GradientStep(
            self.population,
            *size,
            antialias=options.antialias,
            sort=options.sort,
            exposes=options.exposure,
            of_camera=options.poses,
            cut_out=self.cut_out,
        )
        self.exposures = Exposures(len(cameras)) if options.exposure else None
        self.poses = Poses([c.world_to_camera for c in cameras], extent, options.steps) if options.poses else None
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
        o = self.options
        progress = self.done / max(o.steps, 1)
        degree = min(o.degree, self.done // o.degree_interval)
        if self.poses is not None:
            self.views.set_pose(view, self.poses.of(view))  # others' steps moved it, too
        self.done += 1
        target = self.views.at(view, progress)
        if self.exposures is not None:
            self.gradients.exposure.set(self.exposures.of(view))
        if self.cut_out:  # another one each time: what is not opaque shows on some
            self.gradients.loss.background.from_numpy(self.rng.uniform(size=(1, 3)).astype(np.float32))
        mask_scale = SEGMENTATION_WEIGHT / (3 * max(target.known, 1))
        self.gradients.compute(target.image, target.camera, 1.0 / (3 * target.counted), target.mask, mask_scale)
        if self.exposures is not None:
            self.exposures.step(view, self.gradients.exposure.d_affine.to_numpy(), progress)
        if self.poses is not None:
            self.poses.learn(view, self.gradients.camera_gradient(), progress)
        if target.mask is not None:
            self.gradients.update_labels(self.done)
        step = self.adam_step(target.camera, SH_COUNTS[degree] if self.done % o.harmonics_every == 0 else 1)
        self.gradients.update(step)
        self.strategy.after(self.done, step.mean)
        if o.free_space and self.done in {round(part * o.steps) for part in CLEARED}:
            self.clear_free_space()

    def adam_step(self, camera: Camera, active: int) -> AdamStep:
        """Numbers of step `done` of Adam, counted from 1; `active` coefficients of the harmonics are learned."""
        o, r = self.options, self.rates
        learning = max(1, self.population.count - self.population.frozen)
        late = 0.5 ** (max(0, self.done - self.strategy.stop) / r.halving)
        return AdamStep(
            mean=r.of_mean(self.done - 1, o.steps, self.extent),
            quat=late * r.quat,
            log_scale=late * r.log_scale,
            logit=late * r.logit,
            color=late * r.color,
            harmonics=late * r.harmonics,
            bias1=1.0 - BETA1**self.done,
            bias2=1.0 - BETA2**self.done,
            active=active,
            half_width=0.5 * camera.width,
            half_height=0.5 * camera.height,
            far=density.FAR * self.extent,
            opacity_cost=self.strategy.opacity_cost / learning,
            scale_cost=self.strategy.scale_cost / (3 * learning),
            fading=self.strategy.fading if self.done < self.strategy.stop else 0.0,
            sparse=int(o.sparse),
        )

    def clear_free_space(self) -> None:
        """Remove the Gaussians in the free space around the cameras."""
        p, cameras = self.population, self.views.cameras
        depths = np.array([density.near_depth(*self.gradients.depths(c)) for c in cameras])
        means, radii = p.splats.mean.to_numpy()[: p.count], density.free_radii(cameras, depths)
        p.remove(density.in_free_space(means, cameras, radii))

    def quality(self, photograph: Photograph) -> Quality:
        """Quality of the current rendering of a photograph, over white where that is cut out."""
        self.gradients.loss.background.fill(1.0)
        image = packed(photograph.pixels, photograph.mask, photograph.alpha)
        return quality_of(self.gradients.compare(image, photograph.camera))

    def recent_loss(self) -> Quality:
        """Mean quality over the steps since the last call."""
        return quality_of(self.gradients.take_sums())

    def gaussians(self) -> Gaussians:
        """The current Gaussians, which tell how they were trained."""
        return replace(self.population.gaussians(), sort=self.options.sort, antialias=self.options.antialias)

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

    def seen_objects(self, camera: Camera, ids: np.ndarray) -> np.ndarray:
        """Id of the object that each pixel of a picture shows, (H, W) uint8, for ids (N,) of the Gaussians."""
        count, value = len(self.objects), self.population.labels.value
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
        self.population.write({name: state[name] for name in self.population.arrays})
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


def write_checkpoint(path: Path, state: dict[str, np.ndarray], options: dict) -> None:
    """Write the state of a trainer, atomically. Raises BadInput."""
    with atomic_write(path) as beside, new_hdf5(beside) as file:
        write_text(file, "format", FORMAT)
        write_text(file, "options", json.dumps(options, sort_keys=True))
        file.attrs["version"] = VERSION
        for name, values in state.items():
            file.create_dataset(name, data=values)


def read_checkpoint(path: Path, options: dict, like: dict[str, np.ndarray], views: int) -> dict[str, np.ndarray]:
    """The state of a trainer of `views` photographs with the same options; `like` is any of its states. Raises
    BadInput."""
    with open_hdf5(path) as file:
        if file.text("", "format") != FORMAT or file.number("", "version") != VERSION:
            raise file.error("is no checkpoint of a training of this version")
        if file.json("", "options", dict[str, Any]) != options:
            raise file.error("was made with other options; with --fresh the training starts anew")
        state, count = {}, len(file.floats("mean", (None, 3)))
        for name, values in like.items():
            shape = (None,) if name == "queue" else values.shape
            if name == "rng":
                state[name] = file.array(name, "iu", shape).astype(np.uint64)
            elif values.dtype.kind == "i":
                state[name] = file.indices(name, shape, values.dtype)
            else:  # float32: a row a Gaussian; float64: a row a view
                rows = count if values.dtype == np.float32 else len(values)
                state[name] = file.floats(name, (rows, *shape[1:]), values.dtype)
                if not np.isfinite(state[name]).all():
                    raise file.error(f"{name} is not finite")
        if count == 0 or (state["queue"] >= views).any():
            raise file.error("does not belong to these photographs")
        return state
