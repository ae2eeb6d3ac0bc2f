"""Readers of files from users, with sound samples of what they read and mutations of these.

A case is a target, a seed and a number: `mutated(target, seed, number, folder)` is always the same file.
"""

import functools
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets.camera_file import read_cameras
from display.study.questionnaire import read_answers_file
from prepare.rig.landmarks import read_landmarks
from tests.fuzz import hdf5_targets as hdf5
from tests.fuzz import splat_targets as splats
from tests.fuzz import text_targets as texts
from tests.fuzz.hdf5_mutations import claim_text, inside_hdf5
from tests.fuzz.mutations import BYTES, JSON, TEXT, Files, Mutation, inside_zip, several


@dataclass(frozen=True)
class Target:
    """A reader.

    samples  sound files, made in a folder; the first name of each is what is read
    read     read a file and use it as the program would; raises BadInput, and nothing else
    inside   mutations of what the file holds, tried as often as those of its bytes; made in a folder
    """

    name: str
    samples: Callable[[Path], list[Files]]
    read: Callable[[Path], object]
    inside: Callable[[Path], list[Mutation]] = lambda folder: []


def mutated(target: Target, seed: int, number: int, folder: Path) -> Files:
    """The files of a case."""
    rng = np.random.default_rng([seed, zlib.crc32(target.name.encode()), number])
    samples = sound_samples(target.name, folder)
    files = dict(samples[rng.integers(len(samples))])
    inside = target.inside(folder)
    outside = BYTES + (TEXT if rng.random() < 0.5 else []) + ([claim_text] if target.inside is HDF5 else [])
    return several(inside if inside and rng.random() < 0.6 else outside)(rng, files)


@functools.cache
def sound_samples(name: str, folder: Path) -> list[Files]:
    """The samples of a target, made once a process; all of them are read without an error."""
    target, found = TARGETS[name], []
    for files in target.samples(folder):
        write(folder, files)
        target.read(folder / next(iter(files)))
        found.append(files)
        for entry in files:
            (folder / entry).unlink()
    return found


def write(folder: Path, files: Files) -> None:
    """Write the files, with the folders that they name."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def read_answers(path: Path) -> None:
    read_answers_file(path, "now")


HDF5: Callable[[Path], list[Mutation]] = lambda folder: [inside_hdf5(folder)]  # noqa: E731
TARGETS = {
    target.name: target
    for target in (
        Target("ply", splats.splat_samples(".ply"), splats.read_splat),
        Target("splat", splats.splat_samples(".splat"), splats.read_splat),
        Target("ksplat", splats.splat_samples(".ksplat"), splats.read_splat),
        Target("spz", splats.splat_samples(".spz"), splats.read_splat, lambda folder: [splats.inside_gzip_only]),
        Target("sog", splats.splat_samples(".sog"), splats.read_splat, lambda folder: [inside_zip(splats.inside_sog)]),
        Target("meta.json", splats.unzipped_sog, splats.read_splat, lambda folder: [splats.inside_sog]),
        Target("asset", hdf5.asset_samples, hdf5.read_asset, HDF5),
        Target("old asset", hdf5.old_asset_samples, hdf5.read_asset, HDF5),
        Target("recording", hdf5.recording_samples, hdf5.read_recording, HDF5),
        Target("old recording", hdf5.old_recording_samples, hdf5.read_recording, HDF5),
        Target("journal", hdf5.journal_samples, hdf5.read_recording, lambda folder: BYTES + TEXT),
        Target("study", hdf5.study_samples, hdf5.read_and_compare_study, HDF5),
        Target(
            "camera",
            texts.json_samples("cam.json", texts.CAMERA, [texts.CAMERA, texts.CAMERA]),
            read_cameras,
            lambda folder: JSON,
        ),
        Target(
            "answers",
            texts.json_samples("answers.json", texts.ANSWERS),
            read_answers,
            lambda folder: JSON,
        ),
        Target("landmarks", texts.json_samples("l.json", texts.LANDMARKS), read_landmarks, lambda folder: JSON),
        Target("state", hdf5.state_samples, hdf5.read_saved_state, HDF5),
        Target(
            "preferences",
            texts.json_samples("p.json", texts.PREFERENCES, {}),
            texts.read_preferences,
            lambda folder: JSON,
        ),
        Target("message", texts.json_samples("m.json", *texts.MESSAGES), texts.read_page_message, lambda folder: JSON),
        Target("glb", splats.glb_samples, splats.read_skinned_glb, lambda folder: [splats.inside_glb]),
        Target("mesh", splats.mesh_samples, splats.read_mesh_file, lambda folder: BYTES + TEXT),
        Target("capture", texts.capture_samples, texts.read_whole_capture, lambda folder: [texts.inside_capture]),
        Target("training", hdf5.training_samples, hdf5.read_training, HDF5),
        Target("image", splats.image_samples, splats.read_image),
        Target("checkpoint", hdf5.step_samples, hdf5.read_step, lambda folder: [inside_zip(several(BYTES))]),
    )
}
