"""Options of a training, and the constants of its optimizer."""

from __future__ import annotations

from dataclasses import dataclass, replace

CAPS = {"cuda": 2_000_000, "cpu": 100_000}  # most Gaussians, by device
STEPS = {"cuda": 30_000, "cpu": 3_000}
FAST_STEPS = {"cuda": 10_000, "cpu": 1_000}
FAST = {"coarse": 0.3, "sparse": True, "harmonics_every": 2, "degree_interval": 400}
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15


@dataclass(frozen=True)
class TrainOptions:
    """Options of a training.

    strategy   of densification: "default" adds Gaussians where detail is missing, "mcmc" uses the whole budget `cap`
    cap        upper limit of Gaussians, frozen ones included; their memory is allocated at the start
    sort       order of blending in training, one of render.SORTS
    frozen     number of first Gaussians that are drawn but stay as they are, bit for bit
    exposure   also learn the exposure of each photograph (prepare/train/view_corrections.py)
    poses      also learn corrections of the poses
    free_space Gaussians beside the cameras are removed as they come (prepare/train/densification.py)

    Options that trade quality for time, see `fast`:
    coarse           fraction of the steps that use pictures of a quarter, then half, of the size
    sparse           Adam skips Gaussians outside the picture
    harmonics_every  harmonics above degree 0 are updated only every so many steps
    degree_interval  steps after which one more degree of the harmonics is learned
    """

    steps: int = 30_000
    strategy: str = "default"
    cap: int = 1_000_000
    degree: int = 3
    antialias: bool = False
    sort: str = "radial"
    seed: int = 0
    frozen: int = 0
    exposure: bool = False
    poses: bool = False
    free_space: bool = True
    coarse: float = 0.0
    sparse: bool = False
    harmonics_every: int = 1
    degree_interval: int = 1000


def fast(options: TrainOptions) -> TrainOptions:
    """The same options with those that trade quality for time set to the best measured values (bench/NOTES.md)."""
    return replace(options, **FAST)


@dataclass(frozen=True)
class LearningRates:
    """Learning rates of Adam (Kerbl 2023; half of that for opacities): that of the means is in units of the capture's
    extent and decays; once no Gaussians are added any more, the others halve each `halving` steps."""

    mean: float = 1.6e-4
    mean_end: float = 1.6e-6
    quat: float = 1e-3
    log_scale: float = 5e-3
    logit: float = 2.5e-2
    color: float = 2.5e-3
    harmonics: float = 2.5e-3 / 20
    halving: float = 3500.0

    def of_mean(self, step: int, steps: int, extent: float) -> float:
        """Rate of the means [capture's units] at a step of all."""
        return extent * self.mean * (self.mean_end / self.mean) ** (step / max(steps, 1))
