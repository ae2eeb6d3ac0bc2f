"""Photographs of a capture: decoding, masks, undistortion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from assets.file_access import file_size, open_input
from assets.images import decoded, read_image_header
from core.camera import Camera
from core.errors import BadInput
from prepare.train.capture import Capture, View

FILE_MAX = 512 << 20  # [bytes]
PIXELS_MAX = 1 << 28
OPAQUE = 127  # of 255; less opaque pixels do not count
VIEWS_COMPARED = 12  # photographs whose colours are compared with those of the points
POINTS_COMPARED = 30  # least number of them in a photograph
COLOURED = 5.0  # [of 255] least spread of the points' colours that tells anything
# Correlation of the points' colours with the photographs: 0.28 to 0.62 in four captures, with another photograph's pose
# -0.02 to 0.21. Poses are doubted where it is below the first number, and not by the second ahead of others' poses.
AGREEING, AHEAD = 0.25, 0.1
HEADER_BYTES = 1 << 20  # searched for the image size: the preview in a JPEG may come first


class Photograph(NamedTuple):
    """An undistorted image (H, W, 3) uint8 RGB, the pixels that count (H, W) bool, and its pinhole camera.

    objects  ids of what the pixels show, (H, W) uint8, 0 = background; None where that is not known
    alpha    opacity (H, W) uint8 of the pixels, which are then over black; None: opaque
    """

    pixels: np.ndarray
    mask: np.ndarray
    camera: Camera
    objects: np.ndarray | None = None
    alpha: np.ndarray | None = None


def load_photograph(view: View, reduce: int = 1, objects: np.ndarray | None = None) -> Photograph:
    """The view's photograph and its ids, with width and height divided by `reduce`. Raises BadInput."""
    if reduce > 1 and view.mask is None and objects is None:
        image, reduce = smaller_copy(view.image, reduce)
        view = replace(view, image=image)
    pixels, opacity = read_image(view.image)
    mask, alpha = opacity > OPAQUE, None
    if view.cut_out and not (opacity == 255).all() and mask.any():
        pixels, mask, alpha = over(pixels, opacity), np.ones_like(mask), opacity
    if view.mask is not None:
        mask &= read_mask(view.mask, mask.shape)
    if view.border:
        edge = np.ones_like(mask)
        edge[view.border : -view.border, view.border : -view.border] = False
        mask &= ~edge
    if not mask.any():
        raise BadInput(f"{view.image}: no pixel counts: it is all transparent, or masked")
    height, width = mask.shape
    lens = view.lens.resized(width, height, str(view.image))
    if alpha is not None:
        alpha = lens.undistort(alpha, mask)[0]
    pixels, mask = lens.undistort(pixels, mask)
    if not mask.any():
        raise BadInput(f"{view.image}: its lens, {lens.distortion}, distorts it so much that no pixel is left")
    if objects is not None:
        objects = lens.undistort_labels(objects)
    camera = View(view.image, lens, view.world_to_camera).camera()
    return reduced(Photograph(pixels, mask, camera, objects, alpha), reduce)


def over(pixels: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Pixels (H, W, 3) uint8 of opacity `alpha` (H, W) uint8 over black."""
    return (pixels * (alpha[..., None] / 255.0) + 0.5).astype(np.uint8)


def smaller_copy(image: Path, reduce: int) -> tuple[Path, int]:
    """The copy of images/NAME in images_N/, as datasets have them for N = `reduce`, and 1; or the image and `reduce`.

    Raises BadInput if the copy has another size.
    """
    copy = image.parent.with_name(f"{image.parent.name}_{reduce}") / image.name
    if not copy.is_file():
        return image, reduce
    found, whole = image_size(copy), image_size(image)
    if any(abs(a - b / reduce) > 1.0 for a, b in zip(found, whole, strict=True)):
        raise BadInput(f"{copy}: is {found[0]}x{found[1]}, and not {whole[0]}x{whole[1]} divided by {reduce}")
    return copy, 1


def reduced(photograph: Photograph, divisor: int) -> Photograph:
    """The photograph with width and height divided; a pixel counts if all pixels that it averages did."""
    if divisor == 1:
        return photograph
    pixels, mask, camera, objects, alpha = photograph
    size = (max(1, camera.width // divisor), max(1, camera.height // divisor))
    pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
    if alpha is not None:
        alpha = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
    if objects is not None:
        there = np.unique(objects)
        shares = [cv2.resize((objects == k).astype(np.float32), size, interpolation=cv2.INTER_AREA) for k in there]
        objects = there[np.argmax(shares, axis=0)]
    return Photograph(pixels, mask, camera.resized(*size), objects, alpha)


def load_photographs(
    views: list[View], reduce: int = 1, objects=None, *, progress: Callable[[int], None] | None = None
) -> list[Photograph]:
    """The photographs of all views, see `load_photograph`; `progress` is called with their number. Raises BadInput.

    objects: ids of each view's pixels, or None, for each view.
    """
    photographs = []
    for view, ids in zip(views, objects or [None] * len(views), strict=True):
        photographs.append(load_photograph(view, reduce, ids))
        if progress is not None:
            progress(len(photographs))
    return photographs


def learned_and_tested(
    capture: Capture, reduce: int, test_every: int, objects=None, *, progress: Callable[[int], None] | None = None
) -> tuple[list[Photograph], list[Photograph]]:
    """Photographs to learn from, and held-out ones: the capture's own if it has some, else every `test_every`th.

    objects and progress: of `load_photographs`. Raises BadInput.
    """
    every = 0 if capture.test and test_every > 1 else test_every
    kept_for_test(capture.views, every)  # refused before all photographs are loaded
    learned, tested = kept_for_test(load_photographs(capture.views, reduce, objects, progress=progress), every)
    return learned, load_photographs(capture.test, reduce) if capture.test and test_every else tested


def photographs_differ(capture: Capture) -> bool:
    """True if some photographs show the colours of the points no better by their own poses than by those of others."""
    if len(capture.points) == 0 or capture.colors.std(axis=0).max() < COLOURED:
        return False
    views = capture.views[:: -(-len(capture.views) // VIEWS_COMPARED)]
    photographs = [load_photograph(view) for view in views]
    own, other = (
        np.mean([_agreement(p, views[k - shift], capture) for k, p in enumerate(photographs)])
        for shift in (0, max(1, len(views) // 3))
    )
    return bool(own < AGREEING and own - other < AHEAD)  # NaN, of too few points, compares false


def _agreement(photograph: Photograph, view: View, capture: Capture) -> float:
    """Correlation of the points' colours with a photograph as if it were from a view; NaN: too few points."""
    camera = replace(photograph.camera, world_to_camera=view.world_to_camera)
    x, y, z = camera.projected(capture.points)
    seen = (z > 0.0) & (x >= 0.0) & (x < camera.width) & (y >= 0.0) & (y < camera.height)
    if seen.sum() < POINTS_COMPARED:
        return float("nan")
    shown = photograph.pixels[y[seen].astype(int), x[seen].astype(int)].astype(np.float64)
    a, b = shown - shown.mean(axis=0), capture.colors[seen] - capture.colors[seen].mean(axis=0)
    return float((a * b).sum() / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-9))


def kept_for_test(items: list, every: int) -> tuple[list, list]:
    """(training, held-out) items: every `every`th from the first on is held out, none for 0 or if there are fewer.

    Raises BadInput if none is left for training.
    """
    if every < 0:
        raise BadInput("--test-every is 0 or more")
    if every == 1:
        raise BadInput("--test-every 1 leaves no photograph to learn from")
    if every == 0 or len(items) < every:
        return items, []
    return [item for k, item in enumerate(items) if k % every], items[::every]


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image file, by its header if that is known. Raises BadInput."""
    with open_input(path) as file:
        header = read_image_header(file.read(HEADER_BYTES))
    return (header.width, header.height) if header else read_image(path)[1].shape[::-1]


def read_image(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (H, W, 3) and opacity (H, W) uint8, of 8 or 16 bits, grey or colour. Raises BadInput."""
    raw = _decode(path)
    if raw.ndim == 2:
        raw = raw[..., None]
    if raw.dtype == np.uint16:
        raw = (raw // 257).astype(np.uint8)
    opacity = raw[..., -1].copy() if raw.shape[2] in (2, 4) else np.full(raw.shape[:2], 255, np.uint8)
    grey = raw.shape[2] < 3
    return np.ascontiguousarray(raw[..., [0, 0, 0]] if grey else raw[..., [2, 1, 0]]), opacity


def read_mask(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """Pixels of a mask (H, W) bool that are not black. Raises BadInput unless it has the image's shape."""
    raw = _decode(path)
    mask = raw > 0 if raw.ndim == 2 else (raw[..., :3] > 0).any(axis=2)
    if mask.shape != shape:
        raise BadInput(f"{path}: the mask is {mask.shape[1]}x{mask.shape[0]}, its image {shape[1]}x{shape[0]}")
    return mask


def _decode(path: Path) -> np.ndarray:
    """Pixels as stored, BGR or BGRA or grey, uint8 or uint16."""
    if file_size(path) > FILE_MAX:
        raise BadInput(f"{path}: larger than {FILE_MAX >> 20} MiB")
    with open_input(path) as file:
        data = file.read()
    header = read_image_header(data[:HEADER_BYTES])
    if header is not None and header.width * header.height > PIXELS_MAX:
        raise BadInput(f"{path}: {header.width}x{header.height} pixels are too many")
    raw = decoded(data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    if raw is None or raw.dtype not in (np.uint8, np.uint16) or raw.ndim not in (2, 3) or not raw.size:
        raise BadInput(f"{path}: not an image that can be decoded")
    return raw
