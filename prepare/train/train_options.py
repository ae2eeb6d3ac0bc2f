"""Options of a training, and what they are by default."""

from __future__ import annotations

from dataclasses import dataclass, replace

from prepare.train.optimizer import SH_DEGREE_INTERVAL

CAPS = {"cuda": 2_000_000, "cpu": 100_000}  # most Gaussians, by device
STEPS = {"cuda": 30_000, "cpu": 3_000}
FAST_STEPS = {"cuda": 10_000, "cpu": 1_000}
FAST = {"coarse": 0.3, "sparse": True, "harmonics_every": 2, "degree_interval": 400, "resets": False}


@dataclass(frozen=True)
class TrainOptions:
    """Options of a training.

    strategy   of births and deaths: "default" grows where detail is missing, "mcmc" fills the budget `cap`
    cap        most Gaussians, frozen ones included; memory for them is taken at the start
    sort       order of blending that is trained for, one of render.SORTS
    frozen     the first Gaussians, as many as this, are drawn but stay as they are, bit for bit
    exposure   each photograph's exposure is learned, too (prepare/train/exposure.py)
    poses      and corrections of its pose

    What trades quality for time, see `fast`:
    coarse           part of the steps in which pictures are drawn in a quarter, then in half of their size
    sparse           Gaussians out of the picture rest: Adam does not move them
    harmonics_every  steps from one in which harmonics above degree 0 learn to the next
    degree_interval  steps after which one more degree of the harmonics is learned
    budgeted         Gaussians grow towards `cap` by a schedule (`AdaptiveDensity`) and not as many as are pulled
    resets           opacities are lowered from time to time, and what does not rise again dies
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
    coarse: float = 0.0
    sparse: bool = False
    harmonics_every: int = 1
    degree_interval: int = SH_DEGREE_INTERVAL
    budgeted: bool = False
    resets: bool = True


def fast(options: TrainOptions) -> TrainOptions:
    """The same options with all that trades quality for time as it was measured best (bench/NOTES.md)."""
    return replace(options, **FAST)
