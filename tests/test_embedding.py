"""The run-time stage of the two-level embedding, against float64 and against the analytic deformation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.asset import Embedded
from assets.errors import BadInput
from assets.gaussians import Gaussians, matrices_of_quats
from prepare.embed import embed
from tests.bars import random_gaussians, tet_bar

BAR = tet_bar((10, 2, 2), (1.0, 0.2, 0.2))
SCHEMES = ("two-level", "one-level")


def symmetric(six):
    """(N, 3, 3) of (xx, xy, xz, yy, yz, zz)."""
    return six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


def covariances(gaussians):
    A = matrices_of_quats(gaussians.quats) * np.exp(gaussians.log_scales.astype(float))[:, None]
    return A @ np.moveaxis(A, 1, 2)


def embed_in_bar(gaussians, bar=BAR, **options) -> Embedded:
    return embed(gaussians.means, gaussians.quats, np.exp(gaussians.log_scales), *bar, **options)


class Carried:
    """Gaussians in a cage on the device: `to(x)` gives means, covariances and quaternions for vertices x."""

    def __init__(self, ti, gaussians, bar=BAR, *, scheme="two-level", embedded=None, **options):
        from sim.embedding import EmbeddedPart, Embedding

        e = embedded or embed_in_bar(gaussians, bar)
        self.stage = Embedding([EmbeddedPart(e.host, e.weights, gaussians, *bar)], scheme=scheme, **options)
        n = len(gaussians)
        self.x = ti.Vector.field(3, ti.f32, len(bar[0]))
        self.out = [ti.Vector.field(k, ti.f32, n) for k in (3, 6, 4)]

    def to(self, x):
        self.x.from_numpy(np.asarray(x, np.float32))
        self.stage.deform(self.x, *self.out)
        mean, cov, rotation = (f.to_numpy() for f in self.out)
        return mean, symmetric(cov), rotation


@pytest.fixture(scope="module")
def gaussians():
    """Inside, across the surface and outside of the bar."""
    return random_gaussians(np.random.default_rng(1), 500, low=(-0.1, -0.1, -0.1), high=(1.1, 0.3, 0.3), sigma=0.02)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rest_gives_rest(ti_cpu, gaussians, scheme):
    mean, cov, rotation = Carried(ti_cpu, gaussians, scheme=scheme).to(BAR[0])
    assert_allclose(mean, gaussians.means, atol=5e-7)  # a few ulp at 1 m
    rest = covariances(gaussians)
    assert (np.linalg.norm(cov - rest, axis=(1, 2)) < 2e-5 * np.linalg.norm(rest, axis=(1, 2))).all()
    assert_allclose(rotation, np.tile([1, 0, 0, 0], (len(rotation), 1)), atol=1e-5)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_affine_motion_is_reproduced_exactly(ti_cpu, gaussians, scheme):
    """mu -> A mu + t and Sigma -> A Sigma A^T, wherever the hosts are."""
    rng = np.random.default_rng(0)
    A, t = np.eye(3) + 0.5 * rng.normal(size=(3, 3)), rng.normal(size=3)
    mean, cov, _ = Carried(ti_cpu, gaussians, scheme=scheme).to(BAR[0] @ A.T + t)
    assert_allclose(mean, gaussians.means @ A.T + t, atol=2e-6)
    want = A @ covariances(gaussians) @ A.T
    assert (np.linalg.norm(cov - want, axis=(1, 2)) < 2e-5 * np.linalg.norm(want, axis=(1, 2))).all()


def test_a_rigid_turn_gives_its_quaternion(ti_cpu, gaussians):
    carried = Carried(ti_cpu, gaussians)
    for q in ([0.5, -0.5, 0.5, 0.5], [0.0, 0.6, 0.8, 0.0], [0.1, 0.2, -0.3, 0.9]):
        q = np.array(q) / np.linalg.norm(q)
        R = matrices_of_quats(q)
        _, _, rotation = carried.to(BAR[0] @ R.T + [0.3, 1.0, -2.0])
        assert_allclose(matrices_of_quats(rotation), np.tile(R, (len(rotation), 1, 1)), atol=2e-5)


def reference(gaussians, embedded, rest, tets, x):
    """The equations of the paper, literally, in float64: mean, F, Sigma."""
    W = embedded.weights.astype(float) / embedded.weights.astype(float).sum(2, keepdims=True)
    y0, y = (np.einsum("nkj,nkjc->nkc", W, p.astype(float)[tets[embedded.host]]) for p in (rest, x))
    D, Y = (np.moveaxis(a[:, 1:] - a[:, :1], 1, 2) for a in (y0, y))
    F = Y @ np.linalg.inv(D)
    mean = y.mean(1) + np.einsum("nij,nj->ni", F, gaussians.means - y0.mean(1))
    return mean, F, F @ covariances(gaussians) @ np.moveaxis(F, 1, 2)


def test_the_device_agrees_with_the_equations_in_float64(ti_cpu, gaussians):
    """Random vertices: every F is different, many are inverted."""
    x = BAR[0] + np.random.default_rng(2).normal(size=BAR[0].shape).astype(np.float32) * 0.03
    embedded = embed_in_bar(gaussians)
    mean, cov, rotation = Carried(ti_cpu, gaussians, embedded=embedded).to(x)
    want_mean, F, want_cov = reference(gaussians, embedded, *BAR, x)
    assert_allclose(mean, want_mean, atol=3e-6)
    assert (np.linalg.norm(cov - want_cov, axis=(1, 2)) < 1e-4 * np.linalg.norm(want_cov, axis=(1, 2))).all()
    # q is the best rotation if tr(R^T F) is the largest there is: s1 + s2 + sign(det) s3
    R = matrices_of_quats(rotation)
    s = np.linalg.svd(F, compute_uv=False)
    best = s[:, 0] + s[:, 1] + np.sign(np.linalg.det(F)) * s[:, 2]
    assert_allclose(np.einsum("nij,nij->n", R, F), best, rtol=1e-4)
    assert_allclose(np.linalg.norm(rotation, axis=1), 1, atol=1e-6)


def test_bodies_are_offset_and_others_are_left_alone(ti_cpu):
    from sim.embedding import EmbeddedPart, Embedding

    ti, rng = ti_cpu, np.random.default_rng(3)
    a, b = random_gaussians(rng, 37), random_gaussians(rng, 50)
    ea, eb = embed_in_bar(a), embed_in_bar(b)
    n = len(BAR[0])
    stage = Embedding(
        [
            EmbeddedPart(ea.host, ea.weights, a, *BAR, vertex_offset=5, gaussian_offset=10),
            EmbeddedPart(eb.host, eb.weights, b, *BAR, vertex_offset=5 + n, gaussian_offset=60),
        ],
        with_rotation=False,
    )
    x, mean, cov = (
        ti.Vector.field(3, ti.f32, 5 + 2 * n),
        ti.Vector.field(3, ti.f32, 115),
        ti.Vector.field(6, ti.f32, 115),
    )
    x.from_numpy(np.concatenate([np.full((5, 3), np.nan), BAR[0], BAR[0] + [0, 2, 0]]).astype(np.float32))
    mean.fill(-7.0)
    stage.deform(x, mean, cov)
    got = mean.to_numpy()
    assert_allclose(got[10:47], a.means, atol=5e-7)
    assert_allclose(got[60:110], b.means + [0, 2, 0], atol=1e-6)
    assert (got[:10] == -7).all() and (got[47:60] == -7).all() and (got[110:] == -7).all()
    stage.destroy()


def test_nothing_to_carry(ti_cpu):
    from sim.embedding import Embedding

    stage = Embedding([])
    stage.deform(None, None, None, None)
    assert stage.count == 0


def test_a_flat_local_tetrahedron_is_refused(ti_cpu):
    from sim.embedding import EmbeddedPart, Embedding

    one = Gaussians.of([[0.5, 0.1, 0.1]], [[1, 0, 0, 0]], [[-5, -5, -5]], [0], np.zeros((1, 1, 3)))
    weights = np.full((1, 4, 4), 0.25, np.float32)
    with pytest.raises(BadInput, match=r"Gaussian 0 .* flat"):
        Embedding([EmbeddedPart(np.zeros((1, 4), np.int32), weights, one, *BAR)])
