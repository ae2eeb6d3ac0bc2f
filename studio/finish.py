"""From lit surfels to Gaussians: albedo, tone mapping, sharpening and view-dependent colour."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from assets.gaussians import SH_COUNTS, Gaussians
from core.program import batches, in_threads
from core.spherical_harmonics import C0, sh_basis
from studio.shapes import Surface
from studio.surface_sampling import Surfels, Viewer

TEXTURE_SAMPLES = 6  # under each Gaussian
EXPOSURE, WHITE_POINT = 1.5, 3.2  # radiance times exposure that maps to 1
WARMTH = np.array([1.0, 1.0, 1.02])
CONTRAST = 0.22
SHARPENING_ROUNDS = 4  # to undo the blur of overlapping Gaussians
OPACITY = 0.97
THICKNESS_RATIO = 0.12  # over the smaller width
MAX_THICKNESS = 0.002  # [m]
SPHERE_VIEWS, PLAYER_VIEWS = 96, 64  # directions that colours are fitted to: all around, and from the player's space
SOLVE_BATCH = 4096  # Gaussians at a time
BATCH = 16384  # Gaussians at a time in each thread


def tone_map(radiance: np.ndarray, exposure: float = EXPOSURE) -> np.ndarray:
    """Display colour in 0..1 of linear radiance: a soft shoulder towards white (Reinhard 2002, eq. 4), then sRGB."""
    x = exposure * np.maximum(radiance, 0) * WARMTH
    x = np.clip(x * (1 + x / WHITE_POINT**2) / (1 + x), 0, 1)
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.clip(x + CONTRAST * x * (1 - x) * (2 * x - 0.9), 0, 1)


def sample_albedo(surfels: Surfels, surfaces: list[Surface], rng: np.random.Generator) -> np.ndarray:
    """Linear albedo (N, 3), averaged over the core of each footprint so that textures do not alias."""
    result = np.zeros((len(surfels), 3))
    order = np.argsort(surfels.surface, kind="stable")
    ends = np.cumsum(np.bincount(surfels.surface, minlength=len(surfaces)))
    parts = [order[a:b][s] for a, b in zip([0, *ends], ends, strict=False) for s in batches(b - a, BATCH)]

    def sample(part: np.ndarray, own_rng: np.random.Generator) -> None:
        own, surface = surfels.select(part), surfaces[surfels.surface[part[0]]]
        across = np.cross(own.normals, own.tangents)
        for _ in range(TEXTURE_SAMPLES):
            offset = 0.55 * own.sigma * own_rng.normal(size=(len(own), 2)).clip(-1.5, 1.5)
            points = own.points + offset[:, :1] * own.tangents + offset[:, 1:] * across
            result[part] += surface.albedo(points, own.normals)

    in_threads(lambda job: sample(*job), zip(parts, rng.spawn(len(parts)), strict=True))
    return np.clip(result / TEXTURE_SAMPLES, 0, 1)


def smoothed(
    surfels: Surfels,
    values: np.ndarray,
    width: float = 1.0,
    neighbours: int = 12,
    *,
    rounds: int = 1,
    which: np.ndarray | None = None,
) -> np.ndarray:
    """Values (N, C) averaged over neighbours on the same surface, `rounds` times: removes the noise of the rays.

    which  mask (N,) of the surfels whose values change (default: all)
    """
    if not rounds:
        return np.array(values)
    changing = np.arange(len(surfels)) if which is None else np.flatnonzero(which)
    averages, result = _averages(surfels, neighbours, width, changing), np.array(values)
    for _ in range(rounds):
        result[changing] = averages @ result
    return result


def sharpened(surfels: Surfels, colours: np.ndarray, neighbours: int = 12) -> np.ndarray:
    """Colours (N, 3) whose blend over overlapping Gaussians reproduces `colours` (van Cittert's iteration)."""
    averages = _averages(surfels, neighbours, 1.0, np.arange(len(surfels)))
    result = colours
    for _ in range(SHARPENING_ROUNDS):
        result = result + 0.8 * (colours - averages @ result)
    return np.clip(result, colours - 0.2, colours + 0.2).clip(0, 1)


def to_gaussians(surfels: Surfels, sh: np.ndarray, object_id: np.ndarray) -> Gaussians:
    """Flat Gaussians with spherical harmonics `sh` (N, K, 3)."""
    across = np.cross(surfels.normals, surfels.tangents)
    rotation = np.stack([surfels.tangents, across, surfels.normals], 2)
    quaternions = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    thin = np.minimum(THICKNESS_RATIO * surfels.sigma.min(1), MAX_THICKNESS).clip(3e-4)
    scales = np.concatenate([surfels.sigma, thin[:, None]], 1)
    logit = np.full(len(surfels), np.log(OPACITY / (1 - OPACITY)))
    return Gaussians.of(surfels.points, quaternions, np.log(scales), logit, sh, object_id)


def flat_sh(colours: np.ndarray) -> np.ndarray:
    """Spherical harmonics (N, 1, 3) of colours (N, 3) that do not depend on the view."""
    return ((colours - 0.5) / C0)[:, None]


def all_directions() -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (M, 3) all around, and equal weights (M,): for things that turn, of which no view counts more."""
    i = np.arange(SPHERE_VIEWS) + 0.5  # Fibonacci sphere
    z, a = 1 - 2 * i / SPHERE_VIEWS, np.pi * (1 + 5**0.5) * i
    return np.stack([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z], 1), np.ones(SPHERE_VIEWS)


def view_directions(at, viewer: Viewer) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (M, 3) from cameras to the point `at`, and their weights (M,): all around, and the viewer's."""
    sphere, _ = all_directions()
    low, high = np.min(viewer.corners, axis=0), np.max(viewer.corners, axis=0)
    fraction = (np.arange(1, PLAYER_VIEWS + 1)[:, None] * [0.8191725, 0.6710436, 0.5497005]) % 1  # R3 sequence
    from_player = np.asarray(at) - (low + fraction * (high - low))
    from_player /= np.linalg.norm(from_player, axis=1, keepdims=True)
    weights = np.repeat([0.25, 1.0], [SPHERE_VIEWS, PLAYER_VIEWS])
    return np.concatenate([sphere, from_player]), weights


def fit_view_dependence(normals: np.ndarray, colour: Callable, degree: int, views: tuple) -> np.ndarray:
    """Spherical harmonics (N, K, 3) fitted to view-dependent colours by weighted, ridge-regularised least squares.

    `colour(cosine)` returns colours (N, M, 3) for cosines (N, M) between the normal and the direction to the camera;
    `views` holds directions and weights. Only views in front of the surface count, so a low degree suffices.
    """
    k = SH_COUNTS[degree]
    d, view_weight = views
    basis = sh_basis(d, k)
    cosine = -(normals @ d.T)
    weight = view_weight * np.clip(cosine, 0, 1) ** 0.5
    target = colour(np.clip(cosine, 0, 1)) - 0.5
    result = np.empty((len(normals), k, 3))
    ridge = np.diag([0.0] + [1.0] * (k - 1)) * 1e-3 * view_weight.sum()
    for s in range(0, len(normals), SOLVE_BATCH):
        w = weight[s : s + SOLVE_BATCH]
        left = np.einsum("nm,mi,mj->nij", w, basis, basis, optimize=True) + ridge
        right = np.einsum("nm,mi,nmc->nic", w, basis, target[s : s + SOLVE_BATCH], optimize=True)
        result[s : s + SOLVE_BATCH] = np.linalg.solve(left, right)
    return result


def _averages(surfels: Surfels, neighbours: int, width: float, which: np.ndarray) -> csr_matrix:
    """Matrix (M, N) that averages over the neighbours' Gaussians on the same surface at the surfels `which` (M,)."""
    tree, k = cKDTree(surfels.points), min(neighbours, len(surfels))
    across = np.cross(surfels.normals, surfels.tangents)

    def weights(s: slice) -> tuple[np.ndarray, np.ndarray]:
        i = which[s]
        near = tree.query(surfels.points[i], k=k)[1].reshape(len(i), k)
        offset = surfels.points[i, None] - surfels.points[near]
        u = np.einsum("nkc,nkc->nk", offset, surfels.tangents[near]) / (width * surfels.sigma[near, 0])
        v = np.einsum("nkc,nkc->nk", offset, across[near]) / (width * surfels.sigma[near, 1])
        alike = np.einsum("nkc,nc->nk", surfels.normals[near], surfels.normals[i]) > 0.5
        alike &= surfels.surface[near] == surfels.surface[i, None]
        weight = np.exp(-0.5 * (u * u + v * v)) * alike
        return weight / weight.sum(1, keepdims=True), near.astype(np.int32)

    parts = in_threads(weights, batches(len(which), BATCH))
    weight, near = (np.concatenate([part[i] for part in parts]) if parts else np.zeros((0, k)) for i in range(2))
    return csr_matrix((weight.ravel(), near.ravel(), np.arange(len(which) + 1) * k), (len(which), len(surfels)))
