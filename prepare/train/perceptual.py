"""LPIPS (Zhang 2018), the perceptual distance of two images, if its package is installed: it is an optional one."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

PACKAGES = ("lpips", "torch")
MISSING = "LPIPS needs the package lpips, which is not installed"


def lpips_distance() -> Callable[[np.ndarray, np.ndarray], float] | None:
    """A function of two images (H, W, 3) uint8, with the features of AlexNet as papers use it; None without lpips."""
    if any(find_spec(name) is None for name in PACKAGES):
        return None
    import lpips
    import torch

    network = lpips.LPIPS(net="alex", verbose=False)

    def tensor(image: np.ndarray):
        return torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32) / 127.5 - 1.0)

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        with torch.no_grad():
            return float(network(tensor(a), tensor(b)))

    return distance
