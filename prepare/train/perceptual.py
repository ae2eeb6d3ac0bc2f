"""LPIPS (Zhang 2018), the perceptual distance of two images; needs the optional package `lpips`."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

PACKAGES = ("lpips", "torch")


def lpips_distance() -> tuple[Callable[[np.ndarray, np.ndarray], float] | None, str]:
    """A function of two images (H, W, 3) uint8, with the features of AlexNet as papers use it, or None and why not."""
    if any(find_spec(name) is None for name in PACKAGES):
        return None, "LPIPS needs the package lpips, which is not installed"
    import lpips
    import torch

    try:
        network = lpips.LPIPS(net="alex", verbose=False)
    except OSError as e:  # its weights are downloaded when they are used first
        return None, f"the weights of LPIPS cannot be loaded ({e})"

    def tensor(image: np.ndarray):
        return torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32) / 127.5 - 1.0)

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        with torch.no_grad():
            return float(network(tensor(a), tensor(b)))

    return distance, ""
