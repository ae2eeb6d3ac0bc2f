"""From covered and lit points to Gaussians: colour, tone, sharpness, numbers that compress."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from assets.gaussians import Gaussians
from core.spherical_harmonics import C0
from studio.shapes import Part
from studio.surface_sampling import Cover

FOOTPRINT = 6  # texture samples under each Gaussian
EXPOSURE, WHITE = 1.5, 3.2  # radiance times exposure that shows as 1
WARMTH = np.array([1.0, 1.0, 1.02])
CONTRAST, SATURATION = 0.22, 1.0
SHARPEN = 4  # rounds that undo the blur of overlapping Gaussians
OPACITY = 0.97
THIN = 0.12  # thickness over the smaller width
THICKEST = 0.002  # [m]
MANTISSA = 11  # bits kept of the floats in a file: errors of 1/4096, which nobody sees


def tone(radiance: np.ndarray) -> np.ndarray:
    """Display colour 0..1 of linear radiance: a soft shoulder towards white (Reinhard 2002, eq. 4), then sRGB."""
    x = EXPOSURE * np.maximum(radiance, 0) * WARMTH
    x = np.clip(x * (1 + x / WHITE**2) / (1 + x), 0, 1)
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    x = x + CONTRAST * x * (1 - x) * (2 * x - 0.9)
    grey = x.mean(-1, keepdims=True)
    return np.clip(grey + SATURATION * (x - grey), 0, 1)


def albedo(cover: Cover, parts: list[Part], rng: np.random.Generator) -> np.ndarray:
    """Albedo (N, 3), averaged over the inner part of each footprint so that textures do not alias."""
    total = np.zeros((len(cover), 3))
    across = np.cross(cover.normals, cover.tangents)
    for _ in range(FOOTPRINT):
        offset = 0.55 * cover.sigma * rng.normal(size=(len(cover), 2)).clip(-1.5, 1.5)
        points = cover.points + offset[:, :1] * cover.tangents + offset[:, 1:] * across
        for k in np.unique(cover.part):
            own = cover.part == k
            total[own] += parts[k].albedo(points[own], cover.normals[own])
    return np.clip(total / FOOTPRINT, 0, 1)


def smoothed(cover: Cover, values: np.ndarray, width: float = 1.0, neighbours: int = 12) -> np.ndarray:
    """Values (N, C) averaged over neighbours of the same surface, against the noise of the rays."""
    weight, near = _weights(cover, neighbours, width)
    return (weight[..., None] * values[near]).sum(1) / weight.sum(1)[:, None]


def sharpened(cover: Cover, colours: np.ndarray, neighbours: int = 12) -> np.ndarray:
    """Colours (N, 3) whose blend over overlapping Gaussians gives `colours` back (van Cittert's iteration)."""
    weight, near = _weights(cover, neighbours, 1.0)
    weight = weight / weight.sum(1, keepdims=True)
    result = colours
    for _ in range(SHARPEN):
        result = result + 0.8 * (colours - (weight[..., None] * result[near]).sum(1))
    return np.clip(result, colours - 0.2, colours + 0.2).clip(0, 1)


def gaussians(cover: Cover, sh: np.ndarray, object_id: np.ndarray) -> Gaussians:
    """Flat Gaussians (N) with spherical harmonics `sh` (N, K, 3), all numbers rounded for the file."""
    across = np.cross(cover.normals, cover.tangents)
    rotation = np.stack([cover.tangents, across, cover.normals], 2)
    thin = np.minimum(THIN * cover.sigma.min(1), THICKEST).clip(3e-4)
    scales = np.concatenate([cover.sigma, thin[:, None]], 1)
    logit = np.full(len(cover), np.log(OPACITY / (1 - OPACITY)))
    rounded = [rounded_to(a, MANTISSA) for a in (quats(rotation), np.log(scales), logit, sh)]
    return Gaussians(rounded_to(cover.points, MANTISSA + 3), *rounded, object_id.astype(np.uint16))


def flat_sh(colours: np.ndarray) -> np.ndarray:
    """Spherical harmonics (N, 1, 3) of colours (N, 3) that look alike from all sides."""
    return ((colours - 0.5) / C0)[:, None]


def rounded_to(values: np.ndarray, bits: int) -> np.ndarray:
    """float32 with the given number of mantissa bits."""
    mantissa, exponent = np.frexp(np.asarray(values, np.float64))
    return np.ldexp(np.round(mantissa * 2.0**bits) / 2.0**bits, exponent).astype(np.float32)


def quats(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions wxyz (N, 4) of rotation matrices (N, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(canonical=True)[:, [3, 0, 1, 2]]


def _weights(cover: Cover, neighbours: int, width: float) -> tuple[np.ndarray, np.ndarray]:
    """How much each neighbour's Gaussian covers each point, (N, k), and the neighbours' indices."""
    _, near = cKDTree(cover.points).query(cover.points, k=min(neighbours, len(cover)), workers=2)
    offset = cover.points[:, None] - cover.points[near]
    across = np.cross(cover.normals, cover.tangents)
    u = (offset * cover.tangents[near]).sum(2) / (width * cover.sigma[near, 0])
    v = (offset * across[near]).sum(2) / (width * cover.sigma[near, 1])
    alike = (cover.part[near] == cover.part[:, None]) & ((cover.normals[near] * cover.normals[:, None]).sum(2) > 0.5)
    return np.exp(-0.5 * (u * u + v * v)) * alike, near
