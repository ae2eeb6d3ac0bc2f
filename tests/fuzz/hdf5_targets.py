"""Readers of HDF5 files, and of the kept steps of a preparation, with sound samples."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from assets.asset import Asset
from assets.environment import Environment
from assets.library import animated_height, asset_material, cage_vertices, default_material
from commands.play import PlayOptions, take_options
from core.errors import BadInput
from display.keep.scene_state import game_values
from display.keep.state_file import read_state, write_state
from display.record.replay import Replay
from display.study.comparison import compare_study, overview, table
from display.study.study_file import Study, read_study, write_study
from prepare.progress import Checkpoints, arrays_of, gaussians_of
from prepare.train.trainer import read_checkpoint, write_checkpoint
from tests.display.test_recording import as_version_3, record, some_frames
from tests.display.test_study import some_study
from tests.fuzz.mutations import Files, saved
from tests.fuzz.sample_assets import moving_body, some_stage
from tests.fuzz.sample_plays import SomeGame, record_some, some_state
from tests.support.samples import some_gaussians


def samples(name: str, *save: Callable[[Path], object]) -> Callable[[Path], list[Files]]:
    """A sample from each of the functions, which write a file."""
    return lambda folder: [saved(folder, name, write) for write in save]


def with_variable_texts(path: Path) -> None:
    """An asset whose texts are of variable length, as in files before 2026."""
    moving_body().save(path)
    with h5py.File(path, "r+") as file:
        for node in (file, *(file[name] for name in file)):
            for key, value in node.attrs.items():
                if isinstance(value, bytes):
                    node.attrs[key] = value.decode()


asset_samples = samples(
    "asset.h5", *(lambda path, m=m, q=q: m().save(path, quantised=q) for m in (moving_body, some_stage) for q in (0, 1))
)
old_asset_samples = samples("asset.h5", with_variable_texts)


def read_asset(path: Path) -> None:
    """Load an asset in each of the ways of the program."""
    for look in (asset_material, animated_height, cage_vertices, default_material, Environment.load):
        try:
            look(str(path))
        except BadInput as e:
            assert "\n" not in str(e)
    asset = Asset.load(path)
    if asset.animation is not None:
        asset.animation.matrices(0.3)


def interrupted(path: Path) -> None:
    """The journal of a recording, as an interrupted session leaves it."""
    recording = record(path.with_name("other.h5"), some_frames(24), close=False)
    recording.flush()
    path.write_bytes(recording.part.read_bytes())
    recording.close()
    recording.path.unlink()


recording_samples = samples("play.h5", record_some)
old_recording_samples = samples("play.h5", lambda path: (record_some(path), as_version_3(path)))
journal_samples = samples("play.h5.part", interrupted)


def read_recording(path: Path) -> None:
    """Load a recording, and take over its options."""
    replay = Replay.load(path)
    take_options(PlayOptions(scene=str(replay.about.get("scene"))), replay.about, path, "recording was made")
    replay.world_options({})


study_samples = samples(
    "study.h5", lambda path: write_study(path, some_study()), lambda path: write_study(path, Study())
)


def read_and_compare_study(path: Path) -> None:
    study = read_study(path)
    overview(study)
    list(table(compare_study(study)))


state_samples = samples("scene.state.h5", lambda path: write_state(path, some_state()))


def read_saved_state(path: Path) -> None:
    """Read a state, and what its game was."""
    state = read_state(path)
    with contextlib.suppress(BadInput):
        if state.settings.game is not None:
            game_values(SomeGame(), state.settings.game)


def training_state() -> dict[str, np.ndarray]:
    """The state of a training with poses."""
    shapes = {"mean": (5, 3), "logit": (5,), "first": (5, 11), "sh": (5, 4, 3)}
    state = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    state |= {"pose": np.zeros((4, 3, 6)), "pose_steps": np.zeros(4, np.int64), "done": np.array([7])}
    return state | {"queue": np.arange(3, dtype=np.int32), "rng": np.arange(4, dtype=np.uint64)}


training_samples = samples("training.h5", lambda path: write_checkpoint(path, training_state(), {"degree": 1}))


def read_training(path: Path) -> None:
    read_checkpoint(path, {"degree": 1}, training_state(), 4)


def write_step(path: Path) -> None:
    """A kept step of a preparation."""
    with open(path, "wb") as file:
        np.savez(file, **arrays_of(some_gaussians(20, 1), up="+y", counts={"read": 20}))


step_samples = samples("step.npz", write_step)


def read_step(path: Path) -> None:
    """Take up a kept step: its arrays, or it is made again; the pipeline bears these errors of what they hold."""
    checkpoints = Checkpoints()
    checkpoints.folder = path.parent
    arrays = checkpoints.step(path.stem, lambda: {})
    with contextlib.suppress(LookupError, TypeError, ValueError):  # then the pipeline begins anew
        gaussians_of(arrays)[0].check(str(path))
