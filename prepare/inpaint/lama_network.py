"""Inpainting by a LaMa network (Suvorov 2022) that the user has as an ONNX file, run by OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from prepare.onnx_network import SIDE, OnnxNetwork

LEVELS = 255.0  # the published exports give 0..255, others 0..1


class LamaNetwork:
    """A painter: fills the unknown part of a picture by a network.

    The network's inputs are `image` (1, 3, 512, 512) float32 RGB in 0..1, black where it is unknown, and `mask`
    (1, 1, 512, 512) float32, 1 where it is unknown. Its only output is (1, 3, 512, 512), in 0..1 or 0..255.
    """

    def __init__(self, path: str | Path):
        """Read the file. Raises BadInput."""
        self._net = OnnxNetwork(path, 3)

    def __call__(self, picture: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        """The picture (H, W, 3) float32, 0..1, with its unknown part (H, W) bool filled. Raises BadInput."""
        size = unknown.shape[::-1]
        share = cv2.resize(unknown.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
        mask = (share > 0).astype(np.float32)  # all that the interpolation mixes with what is unknown
        image = cv2.resize(picture.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_LINEAR)
        image *= 1.0 - mask[..., None]
        found = self._net.run(image=image.transpose(2, 0, 1), mask=mask[None]).transpose(1, 2, 0)
        known = mask == 0
        if known.any() and np.abs(found - image)[known].mean() > np.abs(found / LEVELS - image)[known].mean():
            found = found / LEVELS
        filled = cv2.resize(found.clip(0.0, 1.0), size, interpolation=cv2.INTER_AREA)
        return np.where(unknown[..., None], filled, picture).astype(np.float32)
