"""Checkpoints, from which an interrupted training resumes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from assets.file_access import atomic_write
from assets.gaussians import SH_COUNTS
from assets.hdf5 import new_hdf5, open_hdf5

FORMAT, VERSION = "vrgs-training", 1
COLUMNS = {"mean": (3,), "quat": (4,), "log_scale": (3,), "logit": (), "first": (11,), "second": (11,)}
COLUMNS |= {"pull": (), "pulls": ()}
OF_VIEWS = (("exposure", "exposure", 12), ("poses", "pose", 6))  # option, dataset, numbers a view
HARMONICS = ("sh", "first_sh", "second_sh")
LABELS = ("label", "first_label", "second_label")  # if objects are learned


def write_checkpoint(path: Path, state: dict[str, np.ndarray], options: dict) -> None:
    """Write the state of a trainer, atomically. Raises BadInput."""
    with atomic_write(path) as beside, new_hdf5(beside) as file:
        file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
        file.attrs["options"] = json.dumps(options, sort_keys=True)
        for name, values in state.items():
            file.create_dataset(name, data=values)


def read_checkpoint(path: Path, options: dict, views: int) -> dict[str, np.ndarray]:
    """The state of a trainer of `views` photographs with the same options. Raises BadInput."""
    with open_hdf5(path) as file:
        if file.text("", "format") != FORMAT or file.number("", "version") != VERSION:
            raise file.error("is no checkpoint of a training of this version")
        if file.json("", "options") != options:
            raise file.error("was made with other options; with --fresh the training starts anew")
        count = len(file.floats("mean", (None, 3)))
        state = {name: file.floats(name, (count, *shape)) for name, shape in COLUMNS.items()}
        coefficients = SH_COUNTS[options["degree"]]
        state |= {name: file.floats(name, (count, coefficients, 3)) for name in HARMONICS}
        if options.get("objects"):
            state |= {name: file.floats(name, (count, 3)) for name in LABELS}
        for option, name, numbers in OF_VIEWS:
            if options.get(option):
                state[name] = file.floats(name, (views, 3, numbers), np.float64)
        for name, values in state.items():
            if not np.isfinite(values).all():
                raise file.error(f"{name} is not finite")
        for option, name, _ in OF_VIEWS:
            if options.get(option):
                state[f"{name}_steps"] = file.indices(f"{name}_steps", (views,), np.int64)
        state["done"] = file.indices("done", (1,), np.int64)
        state["queue"] = file.indices("queue", (None,))
        state["rng"] = file.array("rng", "iu", (4,)).astype(np.uint64)
        if count == 0 or (state["queue"] >= views).any():
            raise file.error("does not belong to these photographs")
        return state
