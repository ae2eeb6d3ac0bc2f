"""Borders of objects by the user's own network (a mask tracker, a SAM-like model): an ONNX file run by OpenCV."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prepare.onnx_network import SIDE, OnnxNetwork


class MaskNetwork:
    """A cut (picture_cut.Cut) by a network, in place of GrabCut.

    The network's inputs are `image` (1, 3, 512, 512) float32 RGB in 0..1, a crop around the object, and `hints`
    (1, 3, 512, 512) float32: how likely a pixel is inside by the geometry, 1 where it is surely inside, 1 where it is
    surely outside. Its only output is (1, 1, 512, 512), above 0 inside of the object (logits).
    """

    def __init__(self, path: str | Path):
        """Read the file. Raises BadInput."""
        self._net = OnnxNetwork(path, 1)

    def __call__(self, picture: np.ndarray, likely: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """The object (H, W) bool; sure pixels stay. Raises BadInput."""
        import cv2

        size = (SIDE, SIDE)
        image = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
        hints = [cv2.resize(likely.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)]
        hints += [cv2.resize(h.astype(np.float32), size, interpolation=cv2.INTER_NEAREST) for h in (inside, outside)]
        found = self._net.run(image=image.transpose(2, 0, 1), hints=np.stack(hints))
        mask = cv2.resize(found[0], likely.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0
        return (mask | inside) & ~outside
