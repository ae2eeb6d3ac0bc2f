"""Readers of HDF5 files, and of the kept steps of a preparation, with sound samples."""

import contextlib
from pathlib import Path

import h5py
import numpy as np

from tests.fuzz.mutations import Files, saved


def asset_samples(folder: Path) -> list[Files]:
    """Assets of both versions of the format: bodies with all that they may have, and a stage."""
    from tests.fuzz.sample_assets import moving_body, some_stage

    made = [(moving_body(), False), (moving_body(), True), (some_stage(), False), (some_stage(), True)]
    return [saved(folder, "asset.h5", lambda path, a=a, q=q: a.save(path, quantised=q)) for a, q in made]


def old_asset_samples(folder: Path) -> list[Files]:
    """An asset whose texts are of variable length, as in files before 2026."""
    from tests.fuzz.sample_assets import moving_body

    def save(path: Path) -> None:
        moving_body().save(path)
        with_variable_texts(path)

    return [saved(folder, "asset.h5", save)]


def with_variable_texts(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        for node in (file, *(file[name] for name in file)):
            for key, value in node.attrs.items():
                if isinstance(value, bytes):
                    node.attrs[key] = value.decode()


def read_asset(path: Path) -> None:
    from assets.asset import Asset
    from assets.environment import Environment
    from assets.library import animated_height, asset_material, cage_vertices, default_material
    from core.errors import BadInput

    for look in (asset_material, animated_height, cage_vertices, default_material, Environment.load):
        try:
            look(str(path))
        except BadInput as e:
            assert "\n" not in str(e)
    asset = Asset.load(path)
    if asset.animation is not None:
        asset.animation.matrices(0.3)


def recording_samples(folder: Path) -> list[Files]:
    from tests.fuzz.sample_plays import record_some

    return [saved(folder, "play.h5", record_some)]


def old_recording_samples(folder: Path) -> list[Files]:
    from tests.display.test_recording import as_version_3
    from tests.fuzz.sample_plays import record_some

    def save(path: Path) -> None:
        record_some(path)
        as_version_3(path)

    return [saved(folder, "play.h5", save)]


def journal_samples(folder: Path) -> list[Files]:
    """The journal of a recording, as an interrupted session leaves it."""
    from tests.display.test_recording import record, some_frames

    def save(path: Path) -> None:
        recording = record(path.with_name("other.h5"), some_frames(24), close=False)
        recording.flush()
        path.write_bytes(recording.part.read_bytes())
        recording.close()
        recording.path.unlink()

    return [saved(folder, "play.h5.part", save)]


def read_recording(path: Path) -> None:
    from commands.play import take_options
    from commands.play_options import PlayOptions
    from display.record.replay import Replay

    replay = Replay.load(path)
    take_options(PlayOptions(scene=str(replay.about.get("scene"))), replay.about, path, "recording was made")
    replay.world_options({})


def study_samples(folder: Path) -> list[Files]:
    from display.study.study_file import Study, write_study
    from tests.fuzz.sample_plays import some_study

    return [saved(folder, "study.h5", lambda path, s=s: write_study(path, s)) for s in (some_study(), Study())]


def read_and_compare_study(path: Path) -> None:
    from display.study.comparison import compare_study, overview, table
    from display.study.study_file import read_study

    study = read_study(path)
    overview(study)
    list(table(compare_study(study)))


def state_samples(folder: Path) -> list[Files]:
    from display.keep.state_file import write_state
    from tests.fuzz.sample_plays import some_state

    return [saved(folder, "scene.state.h5", lambda path: write_state(path, some_state()))]


def read_saved_state(path: Path) -> None:
    from core.errors import BadInput
    from display.keep.scene_state import game_values
    from display.keep.state_file import read_state
    from tests.fuzz.sample_plays import SomeGame

    state = read_state(path)
    with contextlib.suppress(BadInput):
        if state.settings.game is not None:
            game_values(SomeGame(), state.settings.game)


def training_state() -> dict[str, np.ndarray]:
    shapes = {"mean": (5, 3), "logit": (5,), "first": (5, 11), "sh": (5, 4, 3)}
    state = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    state |= {"pose": np.zeros((4, 3, 6)), "pose_steps": np.zeros(4, np.int64), "done": np.array([7])}
    return state | {"queue": np.arange(3, dtype=np.int32), "rng": np.arange(4, dtype=np.uint64)}


def training_samples(folder: Path) -> list[Files]:
    from prepare.train.trainer import write_checkpoint

    return [saved(folder, "training.h5", lambda path: write_checkpoint(path, training_state(), {"degree": 1}))]


def read_training(path: Path) -> None:
    from prepare.train.trainer import read_checkpoint

    read_checkpoint(path, {"degree": 1}, training_state(), 4)


def checkpoint_samples(folder: Path) -> list[Files]:
    from prepare.progress import arrays_of
    from tests.support.samples import some_gaussians

    arrays = arrays_of(some_gaussians(20, 1), up="+y", counts={"read": 20})

    def save(path: Path) -> None:
        with open(path, "wb") as file:
            np.savez(file, **arrays)

    return [saved(folder, "step.npz", save)]


def read_checkpoint(path: Path) -> None:
    """Take up a kept step: its arrays, or it is made again; the pipeline bears these errors of what they hold."""
    from prepare.progress import Checkpoints, gaussians_of

    checkpoints = Checkpoints()
    checkpoints.folder = path.parent
    arrays = checkpoints.step(path.stem, lambda: {})
    with contextlib.suppress(LookupError, TypeError, ValueError):  # then the pipeline begins anew
        gaussians_of(arrays)[0].check(str(path))
