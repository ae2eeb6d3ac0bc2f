"""Every writer of files, as a program that writes one version after another may use it.

`write(folder, k)` writes version k, and `version(folder)` reads back which one is there: it fails if that is not whole.
"""

import contextlib
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from assets.asset import Asset
from assets.camera_file import read_cameras, write_cameras
from assets.file_access import write_json
from assets.hdf5 import open_hdf5
from assets.splat_files import read_gaussians, write_gaussians
from core.camera import Camera
from display.headless.video import Video
from display.picture import save_picture
from display.preferences import Preferences
from display.record.recording import Recording, Replay
from display.study.study_file import add_to_study, read_study
from display.study.trial import Trial
from prepare.progress import Checkpoints, read_arrays
from prepare.train.trainer import write_checkpoint
from tests.display.test_recording import Ball, some_frames
from tests.fuzz.sample_files import moving_body, some_stage
from tests.support.samples import some_gaussians


@dataclass(frozen=True)
class Writer:
    """A writer of the file `name`. `version`: None if there is no file."""

    name: str
    write: Callable[[Path, int], None]
    version: Callable[[Path], int | None]


def file_writer(name: str, write: Callable[[Path, int], object], read: Callable[[Path], int]) -> Writer:
    """A writer of one file, of which both functions take the path."""
    return Writer(
        name,
        lambda folder, k: write(folder / name, k),
        lambda folder: read(folder / name) if (folder / name).exists() else None,
    )


def write_splat(path: Path, k: int) -> None:
    """All centres at k."""
    g = some_gaussians(400, 1)
    write_gaussians(path, replace(g, means=np.full_like(g.means, k)))


def splat_version(path: Path) -> int:
    (k,) = np.unique(np.round(read_gaussians(path).means).astype(int))
    return int(k)


def asset_writer(make: Callable[[], Asset], quantised: bool) -> Writer:
    def write(path: Path, k: int) -> None:
        replace(make(), provenance={"version": k}).save(path, quantised=quantised)

    return file_writer("asset.h5", write, lambda path: Asset.load(path).provenance["version"])


def write_film(path: Path, k: int) -> None:
    """k + 2 pictures."""
    video = Video(path, 64, 48)
    for i in range(k + 2):
        video.write(np.full((48, 64, 3), 5 * (i % 50), np.uint8))
    video.close()


def film_version(path: Path) -> int:
    """By the number of pictures, all of which can be read."""
    video, count = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), 0
    while video.read()[0]:
        count += 1
    assert count == round(video.get(cv2.CAP_PROP_FRAME_COUNT))
    return count - 2


def write_play(folder: Path, k: int) -> None:
    """A recorded play of k + 1 frames."""
    world = Ball()
    path = folder / f"play{k}.h5"
    path.with_name(f"{path.name}.part").unlink(missing_ok=True)  # as the program asks for
    with Recording(path) as recording:
        recording.about = {"scene": "ring_toss"}
        for frame in some_frames(k + 1):
            world.step(recording.note(frame))
            recording.after(world)


def play_version(folder: Path) -> int | None:
    """The last of the plays, all of which are whole."""
    last = None
    for k in range(len(list(folder.glob("play*.h5")))):
        assert len(Replay.load(folder / f"play{k}.h5")) == k + 1
        last = k
    return last


def write_trial(path: Path, k: int) -> None:
    add_to_study(path, lambda study: study.trials.append(Trial(f"{len(study.trials)}", "task")))


def study_version(path: Path) -> int:
    """By the number of trials, each of which is there."""
    names = [trial.participant for trial in read_study(path).trials]
    assert names == [str(k) for k in range(len(names))]
    return len(names) - 1


def write_preferences(path: Path, k: int) -> None:
    preferences = Preferences(path)
    preferences.set("window.size", [k, k])
    assert preferences.path is not None, "given up"


def preferences_version(path: Path) -> int:
    preferences = Preferences(path)
    assert preferences.path is not None and not list(path.parent.glob("*broken*"))
    return int(preferences.get("window.size", tuple[float, float])[0])


def checkpoints_in(folder: Path) -> Checkpoints:
    checkpoints = Checkpoints()
    checkpoints.folder = folder
    return checkpoints


def write_step(folder: Path, k: int) -> None:
    made = checkpoints_in(folder).step(f"step{k}", lambda: {"x": np.full(5000, k)})
    assert (made["x"] == k).all() and (folder / f"step{k}.npz").exists()


def step_version(folder: Path) -> int | None:
    """The last step; all before it are kept too."""
    last = None
    for k in range(len(list(folder.glob("step*.npz")))):
        assert (read_arrays(folder / f"step{k}.npz")["x"] == k).all()
        last = k
    return last


def write_training(path: Path, k: int) -> None:
    write_checkpoint(path, {"done": np.array([k]), "mean": np.full((500, 3), k)}, {})


def training_version(path: Path) -> int:
    with open_hdf5(path) as file:
        k = int(file.indices("done", (1,))[0])
        assert (file.array("mean", "iu", (500, 3)) == k).all()
    return k


def write_picture(path: Path, k: int) -> None:
    """k + 1 rows."""
    save_picture(path, np.random.default_rng(k).integers(0, 255, (k + 1, 300, 3), np.uint8))


WRITERS = {
    "asset": asset_writer(moving_body, False),
    "quantised": asset_writer(moving_body, True),
    "room": asset_writer(some_stage, True),
    "film": file_writer("film.mp4", write_film, film_version),
    "recording": Writer("play*.h5", write_play, play_version),
    "study": file_writer("study.h5", write_trial, study_version),
    "preferences": file_writer("preferences.json", write_preferences, preferences_version),
    "checkpoint": Writer("step*.npz", write_step, step_version),
    "training": file_writer("training.h5", write_training, training_version),
    "picture": file_writer("picture.png", write_picture, lambda path: cv2.imread(str(path)).shape[0] - 1),
    "numbers": file_writer(
        "stats.json",
        lambda path, k: write_json(path, {"version": k, "more": list(range(3000))}),
        lambda path: json.loads(path.read_text())["version"],
    ),
    "camera": file_writer(
        "camera.json",
        lambda path, k: write_cameras(path, [Camera(k + 1, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))]),
        lambda path: read_cameras(path)[0].width - 1,
    ),
    **{
        name: file_writer(f"out.{name}", write_splat, splat_version)
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
