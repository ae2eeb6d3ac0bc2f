"""Borders of objects by a network of the user's, an ONNX file run by OpenCV: a mask tracker, a model like SAM."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

import numpy as np

from assets.file_access import file_size
from core.errors import BadInput

SIDE = 512  # [px] of the pictures that the network takes
MODEL_MAX = 4 << 30  # [bytes]


class MaskNetwork:
    """A cut (picture_cut.Cut) by a network, in place of GrabCut.

    The network's inputs are `image` (1, 3, 512, 512) float32 RGB in 0..1, a crop around the object, and `hints`
    (1, 3, 512, 512) float32: how likely a pixel is inside by the geometry, 1 where it is surely inside, 1 where it is
    surely outside. Its only output is (1, 1, 512, 512), above 0 inside of the object (logits).
    """

    def __init__(self, path: str | Path):
        """Read the file. Raises BadInput."""
        import cv2

        self.path, self._lock = Path(path), Lock()  # views are cut on several threads
        if self.path.suffix.lower() != ".onnx":
            raise BadInput(f"{path}: a network is an .onnx file")
        if file_size(self.path) > MODEL_MAX:
            raise BadInput(f"{path}: larger than {MODEL_MAX >> 30} GiB")
        try:
            self._net = cv2.dnn.readNetFromONNX(str(self.path))
        except cv2.error as e:
            raise BadInput(f"{path}: OpenCV cannot read it as an ONNX network ({_reason(e)})") from e

    def __call__(self, picture: np.ndarray, likely: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
        """The object (H, W) bool; sure pixels stay. Raises BadInput."""
        import cv2

        size = (SIDE, SIDE)
        image = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255.0
        hints = [cv2.resize(likely.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)]
        hints += [cv2.resize(h.astype(np.float32), size, interpolation=cv2.INTER_NEAREST) for h in (inside, outside)]
        try:
            with self._lock:
                self._net.setInput(np.ascontiguousarray(image.transpose(2, 0, 1)[None]), "image")
                self._net.setInput(np.stack(hints)[None], "hints")
                found = np.array(self._net.forward())
        except cv2.error as e:
            raise BadInput(
                f"{self.path}: does not run on inputs `image` and `hints` of {SIDE} px ({_reason(e)})"
            ) from e
        if found.shape != (1, 1, SIDE, SIDE) or not np.isfinite(found).all():
            raise BadInput(f"{self.path}: gives {found.shape}, expected finite (1, 1, {SIDE}, {SIDE})")
        mask = cv2.resize(found[0, 0], likely.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0
        return (mask | inside) & ~outside


def _reason(error) -> str:
    return " ".join(str(getattr(error, "err", "") or error).split())[:120]
