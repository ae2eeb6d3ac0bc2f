"""Every writer of files, as a program that writes one version after another may use it.

`write(folder, k)` writes version k, and `version(folder)` reads back which one is there: it fails if that is not whole.
"""

import contextlib
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Writer:
    """A writer of the file `name`. `version`: None if there is no file."""

    name: str
    write: Callable[[Path, int], None]
    version: Callable[[Path], int | None]


def read_back(name: str, read: Callable[[Path], int]) -> Callable[[Path], int | None]:
    return lambda folder: read(folder / name) if (folder / name).exists() else None


def splat(k: int):
    from tests.support.samples import some_gaussians

    g = some_gaussians(400, 1)
    return replace(g, means=np.full_like(g.means, k))


def write_splat(name: str) -> Callable[[Path, int], None]:
    def write(folder: Path, k: int) -> None:
        from assets.splat_files import write_gaussians

        write_gaussians(folder / name, splat(k))

    return write


def splat_version(path: Path) -> int:
    from assets.splat_files import read_gaussians

    (k,) = np.unique(np.round(read_gaussians(path).means).astype(int))
    return int(k)


def write_asset(make: str, quantised: bool) -> Callable[[Path, int], None]:
    def write(folder: Path, k: int) -> None:
        from tests.fuzz import sample_assets

        asset = replace(getattr(sample_assets, make)(), provenance={"version": k})
        asset.save(folder / "asset.h5", quantised=quantised)

    return write


def asset_version(path: Path) -> int:
    from assets.asset import Asset

    return Asset.load(path).provenance["version"]


def write_film(folder: Path, k: int) -> None:
    from display.headless.video import Video

    video = Video(folder / "film.mp4", 64, 48)
    for i in range(k + 2):
        video.write(np.full((48, 64, 3), 5 * (i % 50), np.uint8))
    video.close()


def film_version(path: Path) -> int:
    import cv2

    video, count = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), 0
    while video.read()[0]:
        count += 1
    assert count == round(video.get(cv2.CAP_PROP_FRAME_COUNT))
    return count - 2


def write_play(folder: Path, k: int) -> None:
    from display.record.recording import Recording
    from tests.display.test_recording import Ball, some_frames

    world = Ball()
    path = folder / f"play{k}.h5"
    path.with_name(f"{path.name}.part").unlink(missing_ok=True)  # as the program asks for
    with Recording(path) as recording:
        recording.about = {"scene": "ring_toss"}
        for frame in some_frames(k + 1):
            world.step(recording.note(frame))
            recording.after(world)


def play_version(folder: Path) -> int | None:
    from display.record.replay import Replay

    last = None
    for k in range(len(list(folder.glob("play*.h5")))):
        assert len(Replay.load(folder / f"play{k}.h5")) == k + 1
        last = k
    return last


def write_trial(folder: Path, k: int) -> None:
    from display.study.study_file import add_to_study
    from display.study.trial import Trial

    add_to_study(folder / "study.h5", lambda study: study.trials.append(Trial(f"{len(study.trials)}", "task")))


def study_version(path: Path) -> int:
    from display.study.study_file import read_study

    names = [trial.participant for trial in read_study(path).trials]
    assert names == [str(k) for k in range(len(names))]
    return len(names) - 1


def write_preferences(folder: Path, k: int) -> None:
    from display.preferences import Preferences

    preferences = Preferences(folder / "preferences.json")
    preferences.set("window.size", [k, k])
    assert preferences.path is not None, "given up"


def preferences_version(path: Path) -> int:
    from display.preferences import Preferences

    preferences = Preferences(path)
    assert preferences.path is not None and not list(path.parent.glob("*broken*"))
    return int(preferences.get("window.size", tuple[float, float])[0])


def write_checkpoint(folder: Path, k: int) -> None:
    """A kept step; an earlier one is removed first, as the pipeline does not write over it."""
    from prepare.progress import Checkpoints

    checkpoints = Checkpoints()
    checkpoints.folder = folder
    made = checkpoints.step(f"step{k}", lambda: {"x": np.full(5000, k)})
    assert (made["x"] == k).all() and (folder / f"step{k}.npz").exists()


def checkpoint_version(folder: Path) -> int | None:
    from prepare.progress import Checkpoints

    checkpoints = Checkpoints()
    checkpoints.folder = folder
    last = None
    for k in range(len(list(folder.glob("step*.npz")))):
        assert (checkpoints._read(f"step{k}")["x"] == k).all()
        last = k
    return last


def write_training(folder: Path, k: int) -> None:
    from prepare.train.trainer import write_checkpoint

    write_checkpoint(folder / "training.h5", {"done": np.array([k]), "mean": np.full((500, 3), k)}, {})


def training_version(path: Path) -> int:
    from assets.hdf5 import open_hdf5

    with open_hdf5(path) as file:
        k = int(file.indices("done", (1,))[0])
        assert (file.array("mean", "iu", (500, 3)) == k).all()
    return k


def write_picture(folder: Path, k: int) -> None:
    from display.picture import save_picture

    save_picture(folder / "picture.png", np.random.default_rng(k).integers(0, 255, (k + 1, 300, 3), np.uint8))


def picture_version(path: Path) -> int:
    import cv2

    return cv2.imread(str(path)).shape[0] - 1


def write_numbers(folder: Path, k: int) -> None:
    from assets.file_access import write_json

    write_json(folder / "stats.json", {"version": k, "more": list(range(3000))})


def numbers_version(path: Path) -> int:
    import json

    return json.loads(path.read_text())["version"]


def write_camera(folder: Path, k: int) -> None:
    from assets.camera_file import write_cameras
    from core.camera import Camera

    write_cameras(folder / "camera.json", [Camera(k + 1, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))])


def camera_version(path: Path) -> int:
    from assets.camera_file import read_cameras

    return read_cameras(path)[0].width - 1


WRITERS = {
    "asset": Writer("asset.h5", write_asset("moving_body", False), read_back("asset.h5", asset_version)),
    "quantised": Writer("asset.h5", write_asset("moving_body", True), read_back("asset.h5", asset_version)),
    "room": Writer("asset.h5", write_asset("some_stage", True), read_back("asset.h5", asset_version)),
    "film": Writer("film.mp4", write_film, read_back("film.mp4", film_version)),
    "recording": Writer("play*.h5", write_play, play_version),
    "study": Writer("study.h5", write_trial, read_back("study.h5", study_version)),
    "preferences": Writer("preferences.json", write_preferences, read_back("preferences.json", preferences_version)),
    "checkpoint": Writer("step*.npz", write_checkpoint, checkpoint_version),
    "training": Writer("training.h5", write_training, read_back("training.h5", training_version)),
    "picture": Writer("picture.png", write_picture, read_back("picture.png", picture_version)),
    "numbers": Writer("stats.json", write_numbers, read_back("stats.json", numbers_version)),
    "camera": Writer("camera.json", write_camera, read_back("camera.json", camera_version)),
    **{
        name: Writer(f"out.{name}", write_splat(f"out.{name}"), read_back(f"out.{name}", splat_version))
        for name in ("ply", "compressed.ply", "spz", "splat")
    },
}


@contextlib.contextmanager
def child(act: Callable[[], None]) -> Iterator[int]:
    """A process that acts and ends, quietly; it shares all that is imported. Yields its id. Linux and macOS only."""
    process = os.fork()
    if process == 0:
        status = 1
        try:
            act()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    try:
        yield process
    finally:
        with contextlib.suppress(ChildProcessError):
            os.waitpid(process, 0)
