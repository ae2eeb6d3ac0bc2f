"""Poses of photographs and videos without any: structure from motion by the optional package pycolmap."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from assets.file_access import check_space, reason_of
from core.errors import BadInput
from prepare.train.photographs import image_size

PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".webp")
VIDEOS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")
FRAMES = 120  # of a video
SIDE_MAX = 1600  # [px] of images in which features are searched
FEATURES_MAX = 4096  # in an image
FEATURE_BYTES = 450  # on the disk: three times a descriptor of 128 and a place of 24, for the matches and a log
EXHAUSTIVE_MAX = 120  # up to this many photographs every pair is matched; beyond, only neighbours in the sequence
Progress = Callable[[str], None]


def photographs_in(folder: Path) -> list[str]:
    """Names of the images in a folder, sorted."""
    there = folder.iterdir() if folder.is_dir() else ()
    return sorted(p.name for p in there if p.suffix.lower() in PHOTOGRAPHS and p.is_file())


def image_folder(folder: Path) -> Path:
    """The folder with the photographs of a capture: images/ in it, if it holds none itself."""
    return folder if photographs_in(folder) else folder / "images"


def load_pycolmap():
    """The optional package. Raises BadInput without it."""
    try:
        import pycolmap
    except ImportError as e:
        raise BadInput("photographs without poses need pycolmap (pip install -r requirements-poses.txt)") from e
    return pycolmap


def find_poses(images: Path, model: Path, *, names: list[str], in_order: bool, progress: Progress) -> None:
    """Write a COLMAP model of the images (one camera, unless they differ in size) to `model`, atomically.

    in_order: consecutive images overlap, as in a video. Raises BadInput if no poses can be found.
    """
    pycolmap = load_pycolmap()
    pycolmap.logging.minloglevel = 3  # it would print what is reported here
    check_space(model, len(names) * FEATURES_MAX * FEATURE_BYTES)  # else its library ends the program
    try:
        _find_poses(pycolmap, images, model, names, in_order, progress)
    except (OSError, RuntimeError) as e:  # its own, as where the disk is full
        raise BadInput(f"{model.parent}: poses cannot be found and written here ({reason_of(e)})") from e


def _find_poses(pycolmap, images: Path, model: Path, names: list[str], in_order: bool, progress: Progress) -> None:
    one_camera = len({image_size(images / name) for name in names}) == 1
    with tempfile.TemporaryDirectory(prefix="poses-", dir=model.parent) as work:
        database, cpu = Path(work) / "database.db", pycolmap.Device.cpu
        reading, search = pycolmap.ImageReaderOptions(), pycolmap.FeatureExtractionOptions()
        reading.camera_model, search.max_image_size = "OPENCV", SIDE_MAX
        search.sift.max_num_features = FEATURES_MAX
        mode = pycolmap.CameraMode.SINGLE if one_camera else pycolmap.CameraMode.PER_IMAGE
        progress(f"poses: searching features in {len(names)} photographs")
        pycolmap.extract_features(
            database, images, names, camera_mode=mode, reader_options=reading, extraction_options=search, device=cpu
        )
        progress("poses: comparing photographs")
        if in_order or len(names) > EXHAUSTIVE_MAX:
            pycolmap.match_sequential(database, device=cpu)
        else:
            pycolmap.match_exhaustive(database, device=cpu)
        progress("poses: placing cameras")
        found = pycolmap.incremental_mapping(database, images, work)
        best = max(found.values(), key=lambda m: m.num_reg_images(), default=None)
        if best is None or best.num_reg_images() < 3:
            raise BadInput(
                f"{images}: no poses were found; take sharp photographs that overlap by two thirds, from many places"
            )
        done = Path(work) / "best"
        done.mkdir()
        best.write_binary(done)
        model.parent.mkdir(parents=True, exist_ok=True)
        done.rename(model)
        progress(f"poses: {best.num_reg_images()} of {len(names)} photographs, {best.num_points3D()} points")


def sharpest_frames(video: Path, folder: Path, count: int = FRAMES) -> int:
    """Write the sharpest frame of each of `count` equal parts of a video to `folder`; returns how many there are.

    Sharpness is the variance of the Laplacian. Raises BadInput.
    """
    capture = cv2.VideoCapture(str(video))
    total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() else 0
    if total < 3:
        raise BadInput(f"{video}: not a video that can be decoded, or one of less than 3 frames")
    parts = min(count, total)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="frames-", dir=folder.parent) as work:
        chosen = Path(work) / "chosen"
        chosen.mkdir()
        best, sharpest, part, written = None, -1.0, 0, 0
        for k in range(total + 1):
            there, frame = capture.read() if k < total else (False, None)
            now = k * parts // total
            if (now != part or not there) and best is not None:
                if not cv2.imwrite(str(chosen / f"frame_{part:05}.png"), best):
                    raise BadInput(f"{folder}: frames cannot be written here")
                best, sharpest, part, written = None, -1.0, now, written + 1
            if not there:
                break
            grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
            sharpness = float(np.var(cv2.Laplacian(grey, cv2.CV_32F)))
            if sharpness > sharpest:
                best, sharpest = frame, sharpness
        capture.release()
        if written < 3:
            raise BadInput(f"{video}: only {written} frames can be decoded")
        shutil.rmtree(folder, ignore_errors=True)
        chosen.rename(folder)
    return written
