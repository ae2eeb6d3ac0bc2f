"""Constants and learning rates of Adam (Kingma and Ba 2015); prepare/train/population.py takes its steps."""

from __future__ import annotations

from dataclasses import dataclass

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15


@dataclass(frozen=True)
class LearningRates:
    """Learning rates of Adam (Kerbl 2023): that of the means is in units of the capture's extent and decays."""

    mean: float = 1.6e-4
    mean_end: float = 1.6e-6
    quat: float = 1e-3
    log_scale: float = 5e-3
    logit: float = 5e-2
    color: float = 2.5e-3
    harmonics: float = 2.5e-3 / 20

    def of_mean(self, step: int, steps: int, extent: float) -> float:
        """Rate of the means [capture's units] at a step of all."""
        return extent * self.mean * (self.mean_end / self.mean) ** (step / max(steps, 1))
