"""Readers of files from users, with sound samples of what they read and mutations of these.

A case is a target, a seed and a number: `mutated(target, seed, number, folder)` is always the same file.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.hdf5_mutations import claim_text, inside_hdf5
from tests.fuzz.hdf5_targets import (
    asset_samples,
    checkpoint_samples,
    journal_samples,
    old_asset_samples,
    old_recording_samples,
    read_and_compare_study,
    read_asset,
    read_checkpoint,
    read_recording,
    read_saved_state,
    read_training,
    recording_samples,
    state_samples,
    study_samples,
    training_samples,
)
from tests.fuzz.mutations import (
    BYTES,
    JSON,
    TEXT,
    Files,
    Mutation,
    inside_zip,
    several,
)
from tests.fuzz.splat_targets import (
    glb_samples,
    image_samples,
    inside_glb,
    inside_gzip_only,
    inside_sog,
    mesh_samples,
    read_image,
    read_mesh_file,
    read_skinned_glb,
    read_splat,
    splat_samples,
    unzipped_sog,
)
from tests.fuzz.text_targets import (
    ANSWERS,
    CAMERA,
    LANDMARKS,
    MESSAGES,
    PREFERENCES,
    capture_samples,
    inside_capture,
    json_samples,
    read_camera_file,
    read_landmark_file,
    read_page_message,
    read_preferences,
    read_questionnaire,
    read_whole_capture,
)


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


HDF5: Callable[[Path], list[Mutation]] = lambda folder: [inside_hdf5(folder)]  # noqa: E731
TARGETS = {
    target.name: target
    for target in (
        Target("ply", splat_samples(".ply"), read_splat),
        Target("splat", splat_samples(".splat"), read_splat),
        Target("ksplat", splat_samples(".ksplat"), read_splat),
        Target("spz", splat_samples(".spz"), read_splat, lambda folder: [inside_gzip_only]),
        Target("sog", splat_samples(".sog"), read_splat, lambda folder: [inside_zip(inside_sog)]),
        Target("meta.json", unzipped_sog, read_splat, lambda folder: [inside_sog]),
        Target("asset", asset_samples, read_asset, HDF5),
        Target("old asset", old_asset_samples, read_asset, HDF5),
        Target("recording", recording_samples, read_recording, HDF5),
        Target("old recording", old_recording_samples, read_recording, HDF5),
        Target("journal", journal_samples, read_recording, lambda folder: BYTES + TEXT),
        Target("study", study_samples, read_and_compare_study, HDF5),
        Target("camera", json_samples("cam.json", CAMERA, [CAMERA, CAMERA]), read_camera_file, lambda folder: JSON),
        Target("answers", json_samples("answers.json", ANSWERS), read_questionnaire, lambda folder: JSON),
        Target("landmarks", json_samples("l.json", LANDMARKS), read_landmark_file, lambda folder: JSON),
        Target("state", state_samples, read_saved_state, HDF5),
        Target("preferences", json_samples("p.json", PREFERENCES, {}), read_preferences, lambda folder: JSON),
        Target("message", json_samples("m.json", *MESSAGES), read_page_message, lambda folder: JSON),
        Target("glb", glb_samples, read_skinned_glb, lambda folder: [inside_glb]),
        Target("mesh", mesh_samples, read_mesh_file, lambda folder: BYTES + TEXT),
        Target("capture", capture_samples, read_whole_capture, lambda folder: [inside_capture]),
        Target("training", training_samples, read_training, HDF5),
        Target("image", image_samples, read_image),
        Target("checkpoint", checkpoint_samples, read_checkpoint, lambda folder: [inside_zip(several(BYTES))]),
    )
}
