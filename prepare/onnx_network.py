"""Networks of the user's: ONNX files, run by OpenCV."""

from __future__ import annotations

from pathlib import Path
from threading import Lock

import numpy as np

from assets.file_access import file_size
from core.errors import BadInput

SIDE = 512  # [px] of the pictures that the networks take
MODEL_MAX = 4 << 30  # [bytes]


class OnnxNetwork:
    """A network with named inputs (1, C, SIDE, SIDE) float32 and one output (1, `channels`, SIDE, SIDE)."""

    def __init__(self, path: str | Path, channels: int):
        """Read the file. Raises BadInput."""
        import cv2

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
        import cv2

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
