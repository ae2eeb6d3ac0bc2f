"""Splats as .splat (antimatter15): 32 bytes a Gaussian, no header, SH degree 0, the axes of the .ply."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from assets.file_access import atomic_write, open_input
from assets.formats.quantization import bytes_from_logits, logits_from_bytes, to_bytes
from assets.gaussians import Gaussians, Report, drawable_gaussians
from core.errors import BadInput
from core.spherical_harmonics import C0

ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 3), ("alpha", "u1"), ("quat", "u1", 4)])

SCALE_MIN = float(np.finfo(np.float32).tiny)  # [m] a smaller one could become 0, which readers drop


def read_splat(path: str | Path, report: Report = print) -> Gaussians:
    """Gaussians of a .splat; those that are not finite are dropped and reported. Raises BadInput."""
    path = Path(path)
    with open_input(path) as file:
        size = file.seek(0, 2)
        if size % ROW.itemsize:
            raise BadInput(f"{path}: truncated, or no .splat: {size} bytes are not a multiple of {ROW.itemsize}")
        file.seek(0)
        rows = np.fromfile(file, ROW)
    with np.errstate(divide="ignore", invalid="ignore"):  # a scale of 0 or less has no logarithm and is dropped
        log_scales = np.log(rows["scale"])
    quats = (rows["quat"].astype(np.float32) - 128) / 128  # wxyz
    sh = ((rows["color"] / 255.0 - 0.5) / C0).astype(np.float32)[:, None, :]
    return drawable_gaussians(path, rows["mean"], quats, log_scales, logits_from_bytes(rows["alpha"]), sh, report)


def write_splat(path: str | Path, g: Gaussians) -> None:
    """Write a .splat: positions and scales as float32, all else in 8 bits. Raises BadInput.

    SH beyond degree 0 and `object_id` are not stored, colours outside 0..1 are clamped.
    """
    rows = np.zeros(len(g), ROW)
    rows["mean"] = g.means
    rows["scale"] = np.maximum(np.exp(g.log_scales.astype(np.float64)), SCALE_MIN)
    rows["color"] = to_bytes((g.sh[:, 0].astype(np.float64) * C0 + 0.5) * 255)
    rows["alpha"] = bytes_from_logits(g.logit_opacities)
    rows["quat"] = to_bytes(g.quats.astype(np.float64) * 128 + 128)
    with atomic_write(path) as beside, open(beside, "wb") as file:
        file.write(rows.tobytes())
