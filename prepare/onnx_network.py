"""ONNX networks that the user brings, run by OpenCV: for the borders of objects, and for inpainting."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

import cv2
import numpy as np

from assets.file_access import file_size
from core.errors import BadInput

SIDE = 512  # [px] of the pictures that the networks take
MODEL_MAX = 4 << 30  # [bytes]
LEVELS = 255.0  # the published exports give 0..255, others 0..1


class OnnxNetwork:
    """A network with named inputs (1, C, SIDE, SIDE) float32 and one output (1, `channels`, SIDE, SIDE)."""

    def __init__(self, path: str | Path, channels: int):
        """Read the file. Raises BadInput."""
        self.path, self.channels, self._lock = Path(path), channels, Lock()
        if self.path.suffix.lower() != ".onnx":
            raise BadInput(f"{path}: a network is an .onnx file")
        if file_size(self.path) > MODEL_MAX:
            raise BadInput(f"{path}: larger than {MODEL_MAX >> 30} GiB")
        try:
            self._net = cv2.dnn.readNetFromONNX(str(self.path))
        except cv2.error as e:
            raise BadInput(f"{path}: OpenCV cannot read it as an ONNX network ({_reason(e)})") from e

    def run(self, **inputs: np.ndarray) -> np.ndarray:
        """The output (channels, SIDE, SIDE) for inputs (C, SIDE, SIDE) by name; from any thread. Raises BadInput."""
        shape = (1, self.channels, SIDE, SIDE)
        try:
            with self._lock:
                for name, values in inputs.items():
                    self._net.setInput(np.ascontiguousarray(values[None], np.float32), name)
                found = np.array(self._net.forward())
        except cv2.error as e:
            names = " and ".join(f"`{name}`" for name in inputs)
            raise BadInput(f"{self.path}: does not run on inputs {names} of {SIDE} px ({_reason(e)})") from e
        if found.shape != shape or not np.isfinite(found).all():
            raise BadInput(f"{self.path}: gives {found.shape}, expected finite {shape}")
        return found[0]


def _reason(error: Exception) -> str:
    return " ".join(str(getattr(error, "err", "") or error).split())[:120]


class MaskNetwork:
    """A network that refines the border of an object in place of GrabCut (mask_propagation.Cut).

    The network's inputs are `image` (1, 3, 512, 512) float32 RGB in 0..1, a crop around the object, and `hints`
    (1, 3, 512, 512) float32: how likely a pixel is inside by the geometry, 1 where it is surely inside, 1 where it is
    surely outside. Its only output is (1, 1, 512, 512), above 0 inside of the object (logits).
    """

    def __init__(self, path: str | Path):
        """Read the file. Raises BadInput."""
        self._net = OnnxNetwork(path, 1)

    def __call__(self, picture: np.ndarray, likely: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """The object (H, W) bool; sure pixels stay. Raises BadInput."""
        size = (SIDE, SIDE)
        image = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
        hints = [cv2.resize(likely.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)]
        hints += [cv2.resize(h.astype(np.float32), size, interpolation=cv2.INTER_NEAREST) for h in (inside, outside)]
        found = self._net.run(image=image.transpose(2, 0, 1), hints=np.stack(hints))
        mask = cv2.resize(found[0], likely.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0
        return (mask | inside) & ~outside


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
