"""Arrays in asset files as integers: multiples of a step, each in the smallest type that holds them."""

from __future__ import annotations

import h5py
import numpy as np

from assets.hdf5 import Hdf5Reader, write_dataset
from core.distance_grid import DistanceGrid

DISTANCE_STEPS = 64  # in a grid's spacing
CHUNK = 1 << 20  # numbers that are compressed together
INTEGER_TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.uint32, np.int32, np.int64)


def write_steps(file: h5py.File, name: str, values: np.ndarray, step: float) -> None:
    """Write an array as multiples of `step`, which becomes an attribute."""
    write_integers(file, name, np.rint(np.asarray(values, np.float64) / step).astype(np.int64))
    file[name].attrs["step"] = step


def read_steps(file: Hdf5Reader, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """An array of multiples of the dataset's step, float32, not checked to be finite. Raises BadInput."""
    values = file.array(name, "iu", shape)
    with np.errstate(over="ignore"):  # an overflow becomes infinite
        return (values * step_of(file, name)).astype(np.float32)


def step_of(file: Hdf5Reader, name: str) -> float:
    """The step of a dataset. Raises BadInput."""
    step = file.number(name, "step")
    if not (np.isfinite(step) and step > 0):
        raise file.error(f"the step of {name} is not positive")
    return step


def write_integers(
    file: h5py.File, name: str, values: np.ndarray, *, shuffle: bool = True, columns: bool = False
) -> None:
    """Write integers in the smallest type that holds them; `columns` compresses each column by itself."""
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    fits = [t for t in INTEGER_TYPES if np.iinfo(t).min <= low and high <= np.iinfo(t).max]
    rows = max(1, min(len(values), CHUNK // max(1, values[:1].size)))
    chunks = (rows, 1) if columns else (rows, *values.shape[1:])
    packing = {"compression": "gzip", "compression_opts": 9, "shuffle": shuffle, "chunks": chunks}
    file.create_dataset(name, data=values.astype(fits[0]), **(packing if values.size else {}))


def write_grid(file: h5py.File, name: str, grid: DistanceGrid, *, quantised: bool) -> None:
    """Write a distance grid as float16 or, quantised, in steps of 1/64 spacing, differenced along all three axes."""
    if quantised:
        values = np.asarray(grid.values, np.float64)
        step = max(float(grid.spacing) / DISTANCE_STEPS, np.abs(values).max() / 2**40)  # sums of eight fit int64
        values = np.rint(values / step).astype(np.int64)
        for axis in range(3):
            values = np.diff(values, axis=axis, prepend=0)
        write_integers(file, name, values)
        file[name].attrs["step"] = step
    else:
        write_dataset(file, name, grid.values, np.float16)
    attributes = file[name].attrs
    attributes["origin"], attributes["spacing"] = np.asarray(grid.origin, np.float64), float(grid.spacing)


def read_grid(file: Hdf5Reader, name: str) -> DistanceGrid:
    """Read a distance grid of either kind; the caller checks it. Raises BadInput."""
    if file.has_attribute(name, "step"):
        values = file.array(name, "iu", (None, None, None)).astype(np.int64)
        for axis in range(3):
            values = values.cumsum(axis)
        with np.errstate(over="ignore"):
            values = (values * step_of(file, name)).astype(np.float16)
    else:
        values = file.array(name, "f", (None, None, None))
        if values.dtype != np.float16:
            with np.errstate(over="ignore"):
                values = values.astype(np.float32)
    return DistanceGrid(values, file.vector(name, "origin"), file.number(name, "spacing"))
