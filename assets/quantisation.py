"""Version 2 of the asset file: Gaussians, embeddings and distance grids as integers, in a fifth of the bytes.

The datasets and what is lost in each: docs/formats.md. An array of integers has an attribute `step`, and stands for
step times the integers. Means lie on a lattice of each block's own step, from the block's lowest corner: half a step is
1/32 of the smallest width in the block (the middle standard deviation of a Gaussian: what is seen of a flat or thin
one), or the precision of float32 where that is coarser.
"""

from __future__ import annotations

import h5py
import numpy as np

from assets.formats.packing import join_largest, split_largest
from assets.gaussians import SH_COUNTS, Gaussians
from assets.hdf5 import Hdf5Reader, write_dataset
from core.distance_grid import DistanceGrid
from core.morton import morton_order
from core.point_location import POINTS_AT_ONCE, TetLocator
from core.program import batches
from core.rotation import matrices_from_quaternions

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


BLOCK = 256  # Gaussians that share a step and a corner
STEPS_A_WIDTH = 16  # of a block's lattice in the smallest width
FLOAT_BITS = 24  # of a float32's mantissa: a finer lattice would hold nothing more
LOG_STEP, LOGIT_STEP, SH_STEP = 1 / 64, 1 / 32, 1 / 128
QUAT_BITS = 10
WEIGHT_TOLERANCE = 0.01  # weights that would come out farther from the asset's are stored as they are
CORNERS = np.sqrt(3.0) * np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # around the unit sphere


def write_quantised_gaussians(file: h5py.File, g: Gaussians) -> None:
    """Write the group `gaussians`."""
    write_steps(file, "gaussians/log_scales", g.log_scales, LOG_STEP)
    write_steps(file, "gaussians/logit_opacities", g.logit_opacities, LOGIT_STEP)
    write_steps(file, "gaussians/sh", g.sh, SH_STEP)
    write_integers(file, "gaussians/quats", packed_quaternions(g.quats), shuffle=False)
    write_integers(file, "gaussians/object_id", g.object_id)
    starts = np.arange(0, len(g), BLOCK)
    width = np.sort(np.exp(g.log_scales.astype(np.float64)), axis=1)[:, 1]
    smallest = np.minimum.reduceat(width, starts) / STEPS_A_WIDTH
    farthest = np.maximum.reduceat(np.abs(g.means).max(1).astype(np.float64), starts) / 2**FLOAT_BITS
    step = 2.0 ** np.ceil(np.log2(np.maximum(np.maximum(0.5 * smallest, farthest), 1e-30)))
    means = np.rint(g.means / np.repeat(step, BLOCK)[: len(g), None]).astype(np.int64)
    low = np.minimum.reduceat(means, starts)
    write_integers(file, "gaussians/means", means - np.repeat(low, BLOCK, axis=0)[: len(g)], columns=True)
    write_integers(file, "gaussians/block_low", low)
    file.create_dataset("gaussians/block_step", data=step.astype(np.float32))


def read_quantised_gaussians(file: Hdf5Reader) -> Gaussians:
    """Read the group `gaussians`; the caller checks it. Raises BadInput."""
    offsets = file.array("gaussians/means", "iu", (None, 3))
    n = len(offsets)
    blocks = -(-n // BLOCK)
    low = file.array("gaussians/block_low", "iu", (blocks, 3))
    step = file.floats("gaussians/block_step", (blocks,), np.float64)
    if not (np.isfinite(step) & (step > 0)).all():
        raise file.error("a step of gaussians/block_step is not positive")
    lattice = np.repeat(low.astype(np.float64), BLOCK, axis=0)[:n] + offsets
    sh = read_steps(file, "gaussians/sh", (n, None, 3))
    if sh.shape[1] not in SH_COUNTS:
        raise file.error(f"sh has shape {sh.shape}, expected (N, K, 3) with K one of {SH_COUNTS}")
    with np.errstate(over="ignore"):  # an overflow becomes infinite
        return Gaussians(
            (lattice * np.repeat(step, BLOCK)[:n, None]).astype(np.float32),
            unpacked_quaternions(file.indices("gaussians/quats", (n,), np.uint32)),
            read_steps(file, "gaussians/log_scales", (n, 3)),
            read_steps(file, "gaussians/logit_opacities", (n,)),
            sh,
            file.indices("gaussians/object_id", (n,), np.uint16),
        )


def packed_quaternions(quats: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) as uint32 (N,): 2 bits name the largest component, 10 bits hold each of the others."""
    largest, others = split_largest(np.asarray(quats, np.float64))
    rest = others * np.sqrt(2)  # at most 1
    half = 2 ** (QUAT_BITS - 1) - 1
    codes = (np.rint(rest.clip(-1, 1) * half).astype(np.int64) + half).astype(np.uint32)
    packed = largest.astype(np.uint32)
    for k in range(3):
        packed |= codes[:, k] << np.uint32(2 + QUAT_BITS * k)
    return packed


def unpacked_quaternions(packed: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4) float32 of packed ones."""
    half, mask = 2 ** (QUAT_BITS - 1) - 1, np.uint32(2**QUAT_BITS - 1)
    rest = np.stack([packed >> np.uint32(2 + QUAT_BITS * k) & mask for k in range(3)], 1)
    rest = (rest.astype(np.float64) - half) / (half * np.sqrt(2))
    q = join_largest(packed & np.uint32(3), rest)
    return (q / np.linalg.norm(q, axis=1, keepdims=True)).astype(np.float32)


def write_quantised_embedding(file: h5py.File, host: np.ndarray, weights: np.ndarray, g: Gaussians, cage) -> None:
    """Write the group `embedding` of Gaussians in a cage, with `host` (N, 4) and `weights` (N, 4, 4).

    The corners of a local tetrahedron are mu + R diag(half axes) R^T CORNERS. Others keep their weights.
    """
    order = morton_order(_centroids(cage))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    locator = TetLocator(cage.vertices, cage.tets)
    codes, exact = np.zeros((len(g), 3), np.int64), np.zeros(len(g), bool)
    for s in batches(len(g), POINTS_AT_ONCE):
        x = locator.vertices[locator.tets[host[s]]]
        corners = np.einsum("nkj,nkjc->nkc", weights[s].astype(np.float64), x)
        axes = matrices_from_quaternions(g.quats[s])
        local = np.einsum("nkc,nci->nki", corners - g.means[s, None], axes)
        half = np.einsum("nki,nkj,nji->ni", local, np.broadcast_to(CORNERS, local.shape), axes) / 12
        codes[s] = np.rint(np.log(half.clip(1e-30)) / LOG_STEP)
        again = _weights(locator, host[s], g.means[s], axes, codes[s])
        exact[s] = np.abs(again - weights[s]).max((1, 2)) > WEIGHT_TOLERANCE
    codes[exact] = 0
    write_integers(file, "embedding/host", place[host])
    write_integers(file, "embedding/half_axes", codes)
    file["embedding/half_axes"].attrs["step"] = LOG_STEP
    write_integers(file, "embedding/exact", np.flatnonzero(exact))
    file.create_dataset("embedding/exact_weights", data=weights[exact])


def read_quantised_embedding(file: Hdf5Reader, g: Gaussians, cage) -> tuple[np.ndarray, np.ndarray]:
    """Host (N, 4) int32 and weights (N, 4, 4) float32 of sound Gaussians in a sound cage. Raises BadInput."""
    n, tets = len(g), len(cage.tets)
    place = file.indices("embedding/host", (n, 4))
    if n and place.max() >= tets:
        raise file.error(f"the embedding names a tet outside 0..{tets - 1}")
    host = morton_order(_centroids(cage))[place]
    codes = file.array("embedding/half_axes", "iu", (n, 3))
    step = step_of(file, "embedding/half_axes")
    exact = file.indices("embedding/exact", (None,))
    if len(exact) and (exact.max() >= n or (np.diff(exact) <= 0).any()):
        raise file.error("embedding/exact does not name Gaussians in order")
    weights = np.empty((n, 4, 4), np.float32)
    with np.errstate(all="ignore"):  # tets of a volume that float64 barely holds: the caller refuses such weights
        locator = TetLocator(cage.vertices, cage.tets)
    for s in batches(n, POINTS_AT_ONCE):
        with np.errstate(over="ignore", invalid="ignore"):  # the caller refuses weights that are not finite
            axes = matrices_from_quaternions(g.quats[s])
            weights[s] = _weights(locator, host[s], g.means[s], axes, codes[s] * (step / LOG_STEP))
    weights[exact] = file.floats("embedding/exact_weights", (len(exact), 4, 4))
    return host.astype(np.int32), weights


def _weights(locator: TetLocator, host, means, axes, codes) -> np.ndarray:
    """Weights (N, 4, 4) of local tetrahedra about `means`, half axes exp(LOG_STEP codes) [m] along `axes` (N, 3, 3)."""
    half = np.exp(LOG_STEP * codes)
    off = np.einsum("nci,ni,nji,kj->nkc", axes, half, axes, CORNERS, optimize=True)
    corners = means[:, None].astype(np.float64) + off
    return locator.weights(host.ravel(), corners.reshape(-1, 3)).reshape(-1, 4, 4)


def _centroids(cage) -> np.ndarray:
    """Centroids (T, 3) of the tets [m], float64: in their Morton order hosts of neighbours have near numbers."""
    return cage.vertices.astype(np.float64)[cage.tets].mean(1)
