"""Trimming: Gaussians that straddle the border of an object are cut in two, one part on each side.

A Gaussian cut by a plane is, on each side, a truncated normal distribution; the Gaussian with its moments takes its
place. With t the distance of the plane from the mean in standard deviations across it, u the unit normal to the own
side, s^2 = u^T Sigma u and l = phi(t) / Phi(t):

    mu' = mu + l Sigma u / s,   Sigma' = Sigma - (1 - v) Sigma u u^T Sigma / s^2,   v = 1 - t l - l^2
                                                                after GaussianTrimmer (arXiv 2601.12683)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import log_ndtr, logit

from assets.gaussians import Gaussians, concatenate
from core.rotation import quaternions_from_matrices
from prepare.segment.gaussian_graph import mahalanobis

REACH = 2.0  # standard deviations: a Gaussian covers neighbours within this distance
COVERED_MAX = 48  # covered neighbours that are used to locate the border
OTHERS_MIN = 0.3  # share of covered neighbours on the other side; with fewer it only touches the border
FLATNESS = 0.1  # relative thickness at least assumed, so that a flat Gaussian covers its neighbours in the surface
OPACITY_MAX = 0.999  # as in the renderer


def trimmed(gaussians: Gaussians, selected: np.ndarray) -> tuple[Gaussians, np.ndarray, int]:
    """The Gaussians with those cut in two that straddle the border of a selection (N,) bool; the selection of these,
    and how many were cut. What is cut off is appended."""
    which, normal, distance = straddlers(gaussians, selected)
    if not len(which):
        return gaussians, selected, 0
    g = gaussians.select(which)
    own, rest = halves(g, normal, distance)
    arrays = {name: getattr(gaussians, name).copy() for name in ("means", "quats", "log_scales", "logit_opacities")}
    for name, array in arrays.items():
        array[which] = getattr(own, name)
    whole = concatenate([replace(gaussians, **arrays), rest])
    return whole, np.concatenate([selected, ~selected[which]]), len(which)


def straddlers(gaussians: Gaussians, selected: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index (K,) of the Gaussians that straddle, unit normals (K, 3) of the border to their own side, and the distance
    (K,) of the border from their means in standard deviations."""
    nothing = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0)
    if not selected.any() or selected.all():
        return nothing
    points = gaussians.means.astype(np.float64)
    radius = REACH * np.exp(gaussians.log_scales.astype(np.float64)).max(1)
    near = np.zeros(len(points), bool)
    for side in (selected, ~selected):
        low, high = points[~side].min(0), points[~side].max(0)
        candidates = np.flatnonzero(
            side & ((points > low - radius[:, None]) & (points < high + radius[:, None])).all(1)
        )
        gap = cKDTree(points[~side]).query(points[candidates], workers=-1)[0]
        near[candidates[gap < radius[candidates]]] = True
    which = np.flatnonzero(near)
    if not len(which):
        return nothing
    count = min(COVERED_MAX + 1, len(points))
    index = cKDTree(points).query(points[which], count, workers=-1)[1][:, 1:]
    offset = points[index] - points[which][:, None]
    sigma = gaussians.covariances[which]
    slab = (FLATNESS * np.exp(np.median(gaussians.log_scales[which].astype(np.float64), axis=1))) ** 2
    k = index.shape[1]
    gap = mahalanobis(offset.reshape(-1, 3), np.repeat(sigma, k, axis=0), np.repeat(slab, k)).reshape(-1, k)
    weight = np.where(gap < REACH**2, np.exp(-0.5 * gap), 0.0)
    side = np.where(selected[index] == selected[which][:, None], 1.0, -1.0)
    total = weight.sum(1)
    others = (weight * (side < 0)).sum(1)
    normal, shift = fitted_planes(offset, side, weight)
    full = full_matrices(sigma)
    across = np.sqrt(np.einsum("ki,kij,kj->k", normal, full, normal).clip(1e-30))
    distance = (shift / across).clip(0.0, None)
    # One whose covered neighbours are all on the other side lies under the thing, or is wider than they reach.
    keep = (others > OTHERS_MIN * total) & (others < (1.0 - OTHERS_MIN) * total)
    return which[keep], normal[keep], distance[keep]


def fitted_planes(offset: np.ndarray, side: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes between points (K, M, 3) of two sides (K, M), 1 and -1, by weighted least squares: unit normals (K, 3)
    towards side 1, and the distance (K,) of the origin from the plane, positive on that side."""
    scale = np.sqrt((weight[..., None] * offset**2).sum((1, 2)) / np.maximum(weight.sum(1), 1e-30)).clip(1e-12)
    x = np.concatenate([offset / scale[:, None, None], np.ones((*side.shape, 1))], axis=2)
    normal_matrix = np.einsum("km,kmi,kmj->kij", weight, x, x)
    ridge = 1e-2 * np.trace(normal_matrix, axis1=1, axis2=2).clip(1e-12)
    normal_matrix += ridge[:, None, None] * np.diag([1.0, 1.0, 1.0, 1e-3])
    plane = np.linalg.solve(normal_matrix, np.einsum("km,km,kmi->ki", weight, side, x)[..., None])[..., 0]
    length = np.linalg.norm(plane[:, :3], axis=1).clip(1e-12)
    return plane[:, :3] / length[:, None], plane[:, 3] / length * scale


def halves(g: Gaussians, normal: np.ndarray, distance: np.ndarray) -> tuple[Gaussians, Gaussians]:
    """The parts of Gaussians on their own side of a plane each and beyond it: `normal` (K, 3) points to the own side,
    the plane lies `distance` (K,) standard deviations from the mean. Their mass is kept."""
    return _part(g, normal, distance), _part(g, -normal, -distance)


def _part(g: Gaussians, normal: np.ndarray, t: np.ndarray) -> Gaussians:
    sigma = full_matrices(g.covariances)
    across = np.einsum("kij,kj->ki", sigma, normal)
    s = np.sqrt(np.einsum("ki,ki->k", normal, across).clip(1e-30))
    log_mass = log_ndtr(t)
    ratio = np.exp(-0.5 * t * t - 0.5 * np.log(2 * np.pi) - log_mass)  # phi / Phi
    variance = (1.0 - t * ratio - ratio**2).clip(1e-3, 1.0)
    means = g.means + (ratio / s)[:, None] * across
    sigma = sigma - ((1.0 - variance) / s**2)[:, None, None] * across[:, :, None] * across[:, None, :]
    values, axes = np.linalg.eigh(sigma)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    opacity = (g.opacities * np.exp(log_mass) / np.sqrt(variance)).clip(1e-6, OPACITY_MAX)
    log_scales = 0.5 * np.log(values.clip(1e-16, None))
    shape = {"means": means, "quats": quaternions_from_matrices(axes), "log_scales": log_scales}
    shape["logit_opacities"] = logit(opacity)
    return replace(g, **{name: values.astype(np.float32) for name, values in shape.items()})


def full_matrices(sigma: np.ndarray) -> np.ndarray:
    """Symmetric matrices (K, 3, 3) of (xx, xy, xz, yy, yz, zz), (K, 6)."""
    return sigma[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
