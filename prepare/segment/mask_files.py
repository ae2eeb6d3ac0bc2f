"""Masks of objects in photographs: a folder of PNGs, one colour per object, objects.json with their names; overlays."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from assets.file_access import make_folder, part_beside, read_json, reason_of
from core.errors import BadInput
from core.typed import Range, Size, from_plain
from prepare.train.capture import View
from prepare.train.photographs import image_size, read_image

NAMES_FILE = "objects.json"
OBJECTS_MAX = 255  # ids fit a byte, 0 is the background
JSON_MAX = 1 << 20  # [bytes]
Byte = Annotated[int, Range(0, 255)]
Colors = Annotated[dict[str, tuple[Byte, Byte, Byte]], Size(OBJECTS_MAX, least=1)]  # of the file of names
VIEWS_MIN = 2  # views that must show an object: one view gives no depth
NAME = re.compile(r"[^\x00-\x1f\x7f/\\:*?\"<>|.\s](?:[^\x00-\x1f\x7f/\\:*?\"<>|]{0,62}[^\x00-\x1f\x7f/\\:*?\"<>|.\s])?")
# Colours far apart, of Kelly's list of maximum contrast, the strongest first.
COLORS = (
    (230, 60, 50), (60, 130, 230), (250, 200, 40), (50, 180, 90), (170, 80, 200), (240, 130, 40), (80, 210, 220),
    (240, 120, 180), (140, 90, 50), (160, 210, 60), (110, 110, 240), (200, 200, 200),
)  # fmt: skip
TILE = 320  # [px] width of a photograph on the sheet
COLUMNS = 5
TINT = 0.45  # opacity of a mask's colour over the photograph


@dataclass(frozen=True)
class Masks:
    """Objects in photographs.

    names   of the objects; the object with id k is names[k - 1]
    colors  of the objects in files and overlays, (K, 3) uint8 RGB
    ids     of each view (H, W) uint8, 0 the background, in the size of the photograph as it was taken;
            None: nothing is known of that view
    """

    names: list[str]
    colors: np.ndarray
    ids: list[np.ndarray | None]

    def pixels(self, name: str) -> int:
        """Number of pixels of an object in all views."""
        return int(sum((i == self.names.index(name) + 1).sum() for i in self.ids if i is not None))


def overlap_of(found: Masks, truth: Masks) -> dict[str, float]:
    """Intersection over union of each true object with the found one that covers it best, over all true masks.

    No two have the same one. The key is the true object's name, with that of the found one where it is another.
    """
    both = np.zeros((len(truth.names) + 1, len(found.names) + 1))  # pixels of each true and each found object
    for f, t in zip(found.ids, truth.ids, strict=True):
        if f is not None and t is not None:
            np.add.at(both, (t, f), 1)
    either = both.sum(1, keepdims=True) + both.sum(0, keepdims=True) - both
    overlap = (both / np.maximum(either, 1))[1:, 1:]
    pairs = dict(zip(*linear_sum_assignment(-overlap), strict=True))
    result = {}
    for k, name in enumerate(truth.names):
        j = pairs.get(k)
        met = j is not None and overlap[k, j] > 0
        other = f" (found as {found.names[j]})" if met and found.names[j] != name else ""
        result[name + other] = float(overlap[k, j]) if met else 0.0
    return result


def object_colors(count: int) -> np.ndarray:
    """Colours of `count` objects, (count, 3) uint8 RGB: distinct, none of them black."""
    lattice = np.stack(np.meshgrid(*[np.arange(70, 251, 30)] * 3), axis=-1).reshape(-1, 3)  # has none of COLORS
    rest = np.random.default_rng(0).permutation(lattice)
    return np.concatenate([np.array(COLORS), rest])[:count].astype(np.uint8)


def check_name(name: str, where: str) -> None:
    """Raise BadInput, naming `where`, unless an object's name is a valid file name on every system."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise BadInput(
            f"{where}: {name!r:.80} cannot be an object's name: 1 to 64 characters without / \\ : * ? \" < > |"
        )


def mask_file(folder: Path, view: View) -> Path:
    """The mask of a view in a folder of masks."""
    return folder / f"{view.image.stem}.png"


def read_masks(folder: str | Path, views: Sequence[View]) -> Masks:
    """The masks of these views in a folder.

    Raises BadInput for a mask that differs in size from its photograph or belongs to none, for a colour missing from
    objects.json, if there is no object, and for an object in fewer than VIEWS_MIN views.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such folder of masks")
    _check_stems(folder, views)
    named = _read_names(folder / NAMES_FILE)
    pictures = [_read_colors(mask_file(folder, v), v) for v in views]
    missing = [v.image.name for v, p in zip(views, pictures, strict=True) if p is None]
    stray = sorted({f.stem for f in folder.glob("*.png")} - {v.image.stem for v in views})
    if missing and stray:
        raise BadInput(f"{folder}: {stray[0]}.png is of no photograph, and {missing[0]} has no mask")
    if len(missing) == len(views):
        raise BadInput(f"{folder}: no mask in it; a mask is called as its photograph, with the ending .png")
    codes = np.unique(np.concatenate([np.unique(p) for p in pictures if p is not None]))
    codes = codes[codes != 0]
    if not len(codes):
        raise BadInput(f"{folder}: no object in any mask: all are black")
    if named is None:
        if len(codes) > OBJECTS_MAX:
            text = "a mask has one plain colour an object, without soft edges"
            raise BadInput(f"{folder}: {len(codes)} colours, at most {OBJECTS_MAX} can be objects; {text}")
        named = {f"object_{k + 1}": int(code) for k, code in enumerate(codes)}
    order = np.array(list(named.values()))
    if len(strange := np.setdiff1d(codes, order)):
        raise BadInput(f"{folder}: the colour {_rgb(strange[0])} is not in {NAMES_FILE}")
    ids = [None if p is None else _ids(p, order) for p in pictures]
    masks = Masks(list(named), np.array([_rgb(c) for c in order], np.uint8), ids)
    seen = np.array([np.bincount(np.unique(i), minlength=len(order) + 1)[1:] for i in ids if i is not None]).sum(0)
    for name, count in zip(masks.names, seen, strict=True):
        if count < VIEWS_MIN:
            raise BadInput(
                f"{folder}: {name!r} is seen in {count} of the masks; its shape shows only from {VIEWS_MIN} or more"
            )
    return masks


def write_masks(folder: str | Path, views: Sequence[View], masks: Masks) -> None:
    """Write a folder of masks, completely or not at all, replacing earlier masks. Raises BadInput."""
    folder = Path(folder)
    _check_stems(folder, views)
    check_masks_folder(folder)
    colors = np.concatenate([np.zeros((1, 3), np.uint8), masks.colors])
    make_folder(folder.parent)
    beside = part_beside(folder)
    try:
        beside.mkdir()
        for view, ids in zip(views, masks.ids, strict=True):
            if ids is not None:
                png = cv2.imencode(".png", np.ascontiguousarray(colors[ids][..., ::-1]))[1]
                mask_file(beside, view).write_bytes(png.tobytes())
        text = json.dumps(dict(zip(masks.names, masks.colors.tolist(), strict=True)), indent=1, ensure_ascii=False)
        (beside / NAMES_FILE).write_text(text + "\n", encoding="utf-8")
        if folder.exists():
            old = part_beside(folder)
            folder.rename(old)
            beside.rename(folder)
            shutil.rmtree(old)
        else:
            beside.rename(folder)
    except OSError as e:
        raise BadInput(f"{folder}: cannot be written ({reason_of(e)})") from e
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def check_masks_folder(folder: Path) -> None:
    """Raise BadInput unless the folder is missing or holds nothing but masks, since it will be replaced."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise BadInput(f"{folder}: is a file, not a folder")
    for found in folder.iterdir():
        if found.name != NAMES_FILE and (found.suffix != ".png" or not found.is_file()):
            raise BadInput(f"{folder}: holds {found.name}, which is no mask; choose an empty or another folder")


def _check_stems(folder: Path, views: Sequence[View]) -> None:
    """Raise BadInput if two photographs would share a mask."""
    first: dict[str, Path] = {}
    for view in views:
        other = first.setdefault(view.image.stem, view.image)
        if other != view.image:
            raise BadInput(f"{folder}: {other} and {view.image} would have the same mask; rename one of them")


def _read_names(path: Path) -> dict[str, int] | None:
    """Colour code of each object's name; None if there is no such file."""
    if not path.is_file():
        return None
    named: dict[str, int] = {}
    for name, color in from_plain(Colors, read_json(path, JSON_MAX), str(path)).items():
        check_name(name, str(path))
        if not any(color):
            raise BadInput(f"{path}: the colour of {name!r} is black, which means no object")
        code = int(_codes(np.array(color, np.uint8)))
        if code in named.values():
            raise BadInput(f"{path}: two objects have the colour {color}")
        named[name] = code
    return named


def _read_colors(path: Path, view: View) -> np.ndarray | None:
    """Colour codes (H, W) uint32 of a mask; None if there is none."""
    if not path.is_file():
        return None
    pixels, _ = read_image(path)
    width, height = image_size(view.image)
    if pixels.shape[:2] != (height, width):
        raise BadInput(f"{path}: the mask is {pixels.shape[1]}x{pixels.shape[0]}, its photograph {width}x{height}")
    return _codes(pixels)


def _codes(colors: np.ndarray) -> np.ndarray:
    """Colours (..., 3) uint8 as numbers (...) uint32: 0xRRGGBB."""
    c = colors.astype(np.uint32)
    return c[..., 0] << 16 | c[..., 1] << 8 | c[..., 2]


def _rgb(code) -> tuple[int, int, int]:
    return int(code) >> 16, int(code) >> 8 & 255, int(code) & 255


def _ids(codes: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Ids (H, W) uint8 of colour codes, all of which are 0 or in `order`."""
    sorted_ = np.argsort(order)
    place = np.searchsorted(order[sorted_], codes).clip(0, len(order) - 1)
    return np.where(codes == 0, 0, sorted_[place] + 1).astype(np.uint8)


def overlay(pixels: np.ndarray, ids: np.ndarray | None, colors: np.ndarray) -> np.ndarray:
    """A photograph (H, W, 3) uint8 with its objects tinted and outlined in their colours (K, 3), the rest darker."""
    if ids is None or not ids.any():
        return pixels
    paint = np.concatenate([np.zeros((1, 3), np.uint8), colors])
    out = np.where((ids > 0)[..., None], (1 - TINT) * pixels + TINT * paint[ids], 0.75 * pixels).astype(np.uint8)
    width = max(1, round(max(ids.shape) / 400))
    for k in range(1, len(paint)):
        own = (ids == k).astype(np.uint8)
        lines, _ = cv2.findContours(own, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(out, lines, -1, tuple(map(int, paint[k])), width)
    return out


def overlays(views: Sequence[View], masks: Masks) -> dict[str, np.ndarray]:
    """The overlay of each view, TILE pixels wide, by the photograph's name. Raises BadInput."""
    tiles = {}
    for view, ids in zip(views, masks.ids, strict=True):
        picture = overlay(read_image(view.image)[0], ids, masks.colors)
        size = (TILE, max(1, round(TILE * picture.shape[0] / picture.shape[1])))
        tiles[view.name] = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return tiles


def contact_sheet(tiles: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures (h, TILE, 3) side by side in rows of COLUMNS, (H, W, 3) uint8."""
    height = max(t.shape[0] for t in tiles)
    tiles = [np.pad(t, ((0, height - t.shape[0]), (0, 0), (0, 0))) for t in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % COLUMNS)
    return np.vstack([np.hstack(tiles[k : k + COLUMNS]) for k in range(0, len(tiles), COLUMNS)])
