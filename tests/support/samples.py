"""Small made-up inputs that several test files use, and what is asked of readers."""

import struct

import numpy as np
import pytest

from assets.gaussians import SH_COUNTS, Gaussians
from assets.splat_files import read_gaussians
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from core.spherical_harmonics import C0, sh_basis
from core.tetmesh import box_mesh

FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")


def some_gaussians(n: int = 30, degree: int = 3, seed: int = 0) -> Gaussians:
    """Random Gaussians with centres within some metres and sizes of some centimetres."""
    rng = np.random.default_rng(seed)
    return Gaussians.of(
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 4)),
        rng.normal(-3, 1, size=(n, 3)),
        rng.normal(size=n),
        rng.normal(0, 0.3, size=(n, SH_COUNTS[degree], 3)),
    )


def random_gaussians(rng, count, *, low=(0, 0, 0), high=(1, 0.2, 0.2), sigma=0.01, spread=0.5) -> Gaussians:
    """Gaussians uniform in a box [m] with standard deviations of median `sigma` [m] and log-normal `spread`."""
    scales = sigma * np.exp(spread * rng.normal(size=(count, 3)))
    quats, means = rng.normal(size=(count, 4)), rng.uniform(low, high, (count, 3))
    return Gaussians.of(means, quats, np.log(scales), np.zeros(count), np.zeros((count, 1, 3)))


def tet_bar(cells, size) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] (V, 3) float32 and tets (T, 4) of the box [0, size], as an asset's cage holds them."""
    x, tets, _ = box_mesh(size, cells, mirror=False)
    return x.astype(np.float32), tets


def discs(points, scales=0.02, colors=0.5) -> Gaussians:
    """Opaque Gaussians at points (N, 3) along the axes; scales [m] and colours 0..1 as they broadcast to (N, 3)."""
    n = len(points)
    quats, log_scales = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.log(np.broadcast_to(scales, (n, 3)))
    sh = (np.broadcast_to(colors, (n, 3))[:, None] - 0.5) / C0
    return Gaussians.of(points, quats, log_scales, np.full(n, 4.0), sh)


def assert_is_image(read: Gaussians, g: Gaussians, A: np.ndarray, turn: np.ndarray, shift=(0.0, 0.0, 0.0)) -> None:
    """The Gaussians g after x -> A x + shift: means, covariances, and colours along directions that `turn` turns."""
    np.testing.assert_allclose(read.means, g.means @ A.T + shift, rtol=1e-4, atol=1e-5)
    axes = A @ matrices_from_quaternions(g.quats) * np.exp(g.log_scales.astype(np.float64))[:, None]
    sigma = (axes @ axes.transpose(0, 2, 1))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(read.covariances, sigma, rtol=1e-3, atol=1e-5 * sigma.max())
    directions = np.random.default_rng(1).normal(size=(7, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    seen = np.einsum("dk,nkc->ndc", sh_basis(directions @ turn.T), read.sh)
    np.testing.assert_allclose(seen, np.einsum("dk,nkc->ndc", sh_basis(directions), g.sh), atol=1e-4)


def riff(kind: bytes, body: bytes) -> bytes:
    """A WebP container with one chunk."""
    return b"RIFF" + struct.pack("<I", 12 + len(body)) + b"WEBP" + kind + struct.pack("<I", len(body)) + body


def refused(path, data: bytes | None = None, read=lambda path: read_gaussians(path, report=str)) -> str:
    """The one line with which the file is refused."""
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(BadInput) as error:
        read(path)
    message = str(error.value)
    assert str(path) in message and "\n" not in message
    return message
