"""ONNX networks that the user brings, run by OpenCV: for the borders of objects, and for inpainting."""

from __future__ import annotations

import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock

import cv2
import numpy as np

from assets.file_access import file_size
from assets.images import without_stderr
from core.errors import BadInput
from prepare.child_process import ChildProcess

SIDE = 512  # [px] of the pictures that the networks take
MODEL_MAX = 4 << 30  # [bytes]
PATIENCE = 600  # [s] for an answer: a large network on a slow machine takes a few
LEVELS = 255.0  # the published exports give 0..255, others 0..1


class OnnxNetwork:
    """A network with named inputs (1, C, SIDE, SIDE) float32 and one output (1, `channels`, SIDE, SIDE).

    It is read and run in a process of its own: a damaged file can crash OpenCV.
    """

    def __init__(self, path: str | Path, channels: int):
        """Read the file. Raises BadInput."""
        self.path, self._shape, self._lock = Path(path), (channels, SIDE, SIDE), Lock()
        if self.path.suffix.lower() != ".onnx":
            raise BadInput(f"{path}: a network is an .onnx file")
        if file_size(self.path) > MODEL_MAX:
            raise BadInput(f"{path}: larger than {MODEL_MAX >> 30} GiB")
        self._child = ChildProcess(serve, str(path), (1, *self._shape), patience=PATIENCE, library="OpenCV")
        self._fault = self._child.answer().decode()  # with which the process has ended
        if self._fault:
            raise BadInput(f"{path}: OpenCV cannot read it as an ONNX network ({self._fault})")

    def run(self, **inputs: np.ndarray) -> np.ndarray:
        """The output (channels, SIDE, SIDE) for inputs (C, SIDE, SIDE) by name; from any thread. Raises BadInput."""
        with self._lock:
            if not self._fault:
                self._child.send({name: np.ascontiguousarray(v[None], np.float32) for name, v in inputs.items()})
                self._fault = self._child.answer().decode()
            found = b"" if self._fault else self._child.answer()
        if self._fault:
            names = " and ".join(f"`{name}`" for name in inputs)
            raise BadInput(f"{self.path}: does not run on inputs {names} of {SIDE} px ({self._fault})")
        return np.frombuffer(found, np.float32).reshape(self._shape)


def serve(pipe: Connection, path: str, shape: tuple[int, ...]) -> None:
    """Read and run a network, in its own process: inputs by name come through the pipe.

    The answer to the file is an empty text, that to inputs an empty text and the output, of this shape; a fault is
    answered by a text of its own, and ends the process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the program ends this process
    with without_stderr(), suppress(EOFError, OSError):  # the program has ended
        try:
            network = cv2.dnn.readNetFromONNX(path)
            pipe.send_bytes(b"")
            while True:
                for name, values in pipe.recv().items():
                    network.setInput(values, name)
                found = np.array(network.forward())
                if found.shape != shape or not np.isfinite(found).all():
                    raise ValueError(f"gives {found.shape}, expected finite {shape}")
                pipe.send_bytes(b"")
                pipe.send_bytes(found.astype(np.float32).tobytes())
        except (cv2.error, MemoryError, ValueError) as e:
            pipe.send_bytes(" ".join(str(getattr(e, "err", "") or e).split())[:120].encode())


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
