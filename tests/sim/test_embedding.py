"""The run-time stage of the two-level embedding, against float64 and against the analytic deformation."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from assets.asset import CageEmbedding
from assets.gaussians import Gaussians
from core.errors import BadInput
from core.rotation import matrices_from_quaternions
from prepare.cage.embedding_hosts import embed
from sim.embedding import BodySpan, EmbeddedBody, Embedding
from tests.support.samples import random_gaussians, tet_bar

BAR = tet_bar((10, 2, 2), (1.0, 0.2, 0.2))
SCHEMES = ("two-level", "one-level")


def symmetric(six):
    """(N, 3, 3) of (xx, xy, xz, yy, yz, zz)."""
    return six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


def covariances(gaussians):
    A = matrices_from_quaternions(gaussians.quats) * np.exp(gaussians.log_scales.astype(float))[:, None]
    return A @ np.moveaxis(A, 1, 2)


def embed_in_bar(gaussians, bar=BAR, **options) -> CageEmbedding:
    return embed(gaussians.means, gaussians.quats, np.exp(gaussians.log_scales), *bar, **options)


class Carried:
    """Gaussians in a cage on the device: `to(x)` gives means, covariances and quaternions for vertices x."""

    def __init__(self, ti, gaussians, bar=BAR, *, scheme="two-level", embedded=None, **options):
        self.embedded = e = embedded or embed_in_bar(gaussians, bar)
        self.embedding = Embedding([EmbeddedBody(e.host, e.weights, gaussians, *bar)], scheme=scheme, **options)
        n = len(gaussians)
        self.x = ti.Vector.field(3, ti.f32, len(bar[0]))
        self.out = [ti.Vector.field(k, ti.f32, n) for k in (3, 6, 4)]

    def to(self, x):
        self.x.from_numpy(np.asarray(x, np.float32))
        self.embedding.deform(self.x, *self.out)
        mean, cov, rotation = (f.to_numpy() for f in self.out)
        return mean, symmetric(cov), rotation


@pytest.fixture(scope="module")
def gaussians():
    """Inside, across the surface and outside of the bar."""
    return random_gaussians(np.random.default_rng(1), 500, low=(-0.1, -0.1, -0.1), high=(1.1, 0.3, 0.3), sigma=0.02)


@pytest.fixture(scope="module")
def carried(ti_cpu, gaussians):
    """The Gaussians in the bar, by scheme."""
    embedded = embed_in_bar(gaussians)
    return {scheme: Carried(ti_cpu, gaussians, scheme=scheme, embedded=embedded) for scheme in SCHEMES}


def random_motion():
    rng = np.random.default_rng(0)
    return np.eye(3) + 0.5 * rng.normal(size=(3, 3)), rng.normal(size=3)


@pytest.mark.parametrize("motion, atol", [((np.eye(3), np.zeros(3)), 5e-7), (random_motion(), 2e-6)], ids=["rest", "A"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_affine_motion_is_reproduced_exactly(carried, gaussians, scheme, motion, atol):
    """mu -> A mu + t and Sigma -> A Sigma A^T, wherever the hosts are; at rest to a few ulp at 1 m."""
    A, t = motion
    mean, cov, rotation = carried[scheme].to(BAR[0] @ A.T + t)
    assert_allclose(mean, gaussians.means @ A.T + t, atol=atol)
    want = A @ covariances(gaussians) @ A.T
    assert (np.linalg.norm(cov - want, axis=(1, 2)) < 2e-5 * np.linalg.norm(want, axis=(1, 2))).all()
    if not t.any():
        assert_allclose(rotation, np.tile([1, 0, 0, 0], (len(rotation), 1)), atol=1e-5)


@pytest.mark.parametrize("stretch", [2.0, 3.9, 40.0, 1e4])
def test_an_extreme_stretch_throws_no_spikes(carried, gaussians, stretch):
    """Up to four times as long nothing is bounded; beyond, a Gaussian keeps its shape and is no longer than that."""
    A = np.diag([stretch, 1.0, 1.0 / stretch])
    _, cov, _ = carried["two-level"].to(BAR[0] @ A.T)
    rest = covariances(gaussians)
    want = A @ rest @ A.T
    bound = 16.0 * np.trace(rest, axis1=1, axis2=2) / np.trace(want, axis1=1, axis2=2)
    assert (bound < 1.0).all() if stretch > 10 else (bound >= 1.0).all()
    want *= np.minimum(bound, 1.0)[:, None, None]
    assert (np.linalg.norm(cov - want, axis=(1, 2)) < 1e-4 * np.linalg.norm(want, axis=(1, 2))).all()
    assert (np.sqrt(np.linalg.eigvalsh(cov)[:, 2]) <= 4.001 * np.sqrt(np.trace(rest, axis1=1, axis2=2))).all()


def reference(gaussians, embedded, rest, tets, x):
    """The equations of the paper, literally, in float64: mean, F, Sigma."""
    W = embedded.weights.astype(float) / embedded.weights.astype(float).sum(2, keepdims=True)
    y0, y = (np.einsum("nkj,nkjc->nkc", W, p.astype(float)[tets[embedded.host]]) for p in (rest, x))
    D, Y = (np.moveaxis(a[:, 1:] - a[:, :1], 1, 2) for a in (y0, y))
    F = Y @ np.linalg.inv(D)
    mean = y.mean(1) + np.einsum("nij,nj->ni", F, gaussians.means - y0.mean(1))
    return mean, F, F @ covariances(gaussians) @ np.moveaxis(F, 1, 2)


def test_the_device_agrees_with_the_equations_in_float64(carried, gaussians):
    """Random vertices: every F is different, many are inverted."""
    x = BAR[0] + np.random.default_rng(2).normal(size=BAR[0].shape).astype(np.float32) * 0.03
    mean, cov, rotation = carried["two-level"].to(x)
    want_mean, F, want_cov = reference(gaussians, carried["two-level"].embedded, *BAR, x)
    assert_allclose(mean, want_mean, atol=3e-6)
    assert (np.linalg.norm(cov - want_cov, axis=(1, 2)) < 1e-4 * np.linalg.norm(want_cov, axis=(1, 2))).all()
    # q is the best rotation if tr(R^T F) is the largest there is: s1 + s2 + sign(det) s3
    R = matrices_from_quaternions(rotation)
    s = np.linalg.svd(F, compute_uv=False)
    best = s[:, 0] + s[:, 1] + np.sign(np.linalg.det(F)) * s[:, 2]
    assert_allclose(np.einsum("nij,nij->n", R, F), best, rtol=1e-4)
    assert_allclose(np.linalg.norm(rotation, axis=1), 1, atol=1e-6)


def test_parts_come_go_move_and_grow(ti_cpu):
    """A copy five times as large carries Gaussians five times as large, farther than stretch alone may go."""
    ti, rng = ti_cpu, np.random.default_rng(4)
    a, b = random_gaussians(rng, 37), random_gaussians(rng, 50)
    n = len(BAR[0])
    parts = [EmbeddedBody(e.host, e.weights, g, *BAR) for g, e in ((a, embed_in_bar(a)), (b, embed_in_bar(b)))]
    parts = [replace(parts[0], gaussian_offset=10), replace(parts[1], vertex_offset=n, gaussian_offset=47)]
    embedding = Embedding(parts, with_rotation=False, headroom=4.0)
    packed = embedding.bodies
    assert not embedding.fits([BodySpan(0, 0, 10), BodySpan(1, n, 47), BodySpan(1, 2 * n, 97)] * 30, packed)
    bodies = [BAR[0], BAR[0] + [0, 2, 0], 5 * BAR[0] - [3, 0, 0]]
    x = ti.Vector.field(3, ti.f32, 3 * n)
    mean, cov = ti.Vector.field(3, ti.f32, 150), ti.Vector.field(6, ti.f32, 150)

    def check(*carried):
        """(Gaussians, body, size): which parts are where."""
        spans, first, wanted = [], 10, [np.full((10, 3), -7.0)]
        for k, (g, _, size) in enumerate(carried):
            spans.append(BodySpan(0 if g is a else 1, k * n, first, size))
            first += len(g)
        assert embedding.fits(spans, packed)
        embedding.load(spans, packed)
        points = [bodies[body] for _, body, _ in carried]
        x.from_numpy(np.concatenate([*points, *[BAR[0]] * (3 - len(points))]).astype(np.float32))
        mean.fill(-7.0)
        embedding.deform(x, mean, cov)
        for g, body, size in carried:
            wanted.append(size * g.means + bodies[body][0] - size * BAR[0][0])
        wanted.append(np.full((150 - first, 3), -7.0))
        assert_allclose(mean.to_numpy(), np.concatenate(wanted), atol=3e-6)
        sizes = np.concatenate([np.full(len(g), size) for g, _, size in carried])
        rest = np.concatenate([covariances(g) for g, _, _ in carried]) * sizes[:, None, None] ** 2
        assert_allclose(symmetric(cov.to_numpy()[10:first]), rest, rtol=2e-3, atol=1e-7)
        assert embedding.count == first - 10

    check((a, 0, 1.0), (b, 1, 1.0))
    check((a, 0, 1.0), (b, 1, 1.0), (a, 2, 5.0))
    check((b, 1, 1.0), (a, 2, 5.0))
    check((b, 2, 5.0), (a, 0, 1.0), (b, 1, 1.0))
    check((a, 0, 1.0), (b, 1, 1.0))
    embedding.destroy()


def test_nothing_to_carry(ti_cpu):
    embedding = Embedding([])
    embedding.deform(None, None, None, None)
    assert embedding.count == 0


def test_a_flat_local_tetrahedron_is_refused(ti_cpu):
    one = Gaussians.of([[0.5, 0.1, 0.1]], [[1, 0, 0, 0]], [[-5, -5, -5]], [0], np.zeros((1, 1, 3)))
    weights = np.full((1, 4, 4), 0.25, np.float32)
    with pytest.raises(BadInput, match=r"Gaussian 0 .* flat"):
        Embedding([EmbeddedBody(np.zeros((1, 4), np.int32), weights, one, *BAR)])


def test_tiny_gaussians_far_from_the_origin_keep_their_digits(ti_cpu):
    """A rigid motion to 5 m, Gaussians of 0.1 and 0.01 mm, local tetrahedra as small (floor=0): 1e-3 is asked for.

    The paper's y1 - y0 in float32 loses all but two digits; the anchored sums are limited by the vertices' own.
    """
    R, t = matrices_from_quaternions(np.array([0.3, -0.5, 0.7, 0.2]) / np.sqrt(0.87)), np.array([3.0, -3.0, 3.0])
    x = (BAR[0] @ R.T + t).astype(np.float32)
    for sigma in (1e-4, 1e-5):
        tiny = random_gaussians(np.random.default_rng(4), 2000, sigma=sigma, spread=0)
        embedded = embed_in_bar(tiny, k=1.0, floor=0)
        # Covariance of a probe that shows all of F; the local tetrahedra are the tiny ones'
        mean, cov, rotation = Carried(ti_cpu, probes_of(tiny), embedded=embedded).to(x)
        assert_allclose(mean, tiny.means @ R.T + t, atol=2e-6)
        want = R @ PROBE @ R.T
        error = np.linalg.norm(cov - want, axis=(1, 2)).max() / np.linalg.norm(want)
        turned = np.abs(matrices_from_quaternions(rotation) - R).max()
        y = np.einsum("nkj,nkjc->nkc", embedded.weights, x[BAR[1][embedded.host]])
        rest = np.einsum("nkj,nkjc->nkc", embedded.weights.astype(float), BAR[0].astype(float)[BAR[1][embedded.host]])
        D, Y = (np.moveaxis(a[:, 1:] - a[:, :1], 1, 2) for a in (rest, y))
        plain = np.linalg.norm(Y @ np.linalg.inv(D) - R, axis=(1, 2)).max()
        print(f"sigma {sigma:g} m: covariance {error:.1e}, rotation {turned:.1e}; float32 corners: F {plain:.1e}")
        assert error < 5e-5 and turned < 5e-5
        assert plain > 20 * error


PROBE = np.diag([1e-4, 4e-4, 9e-4])


def probes_of(gaussians) -> Gaussians:
    """The same centres with one and the same covariance: what differs afterwards is F alone."""
    scales = np.tile(np.log(np.sqrt(np.diag(PROBE))), (len(gaussians), 1))
    n = len(gaussians)
    return Gaussians.of(gaussians.means, np.tile([1, 0, 0, 0], (n, 1)), scales, np.zeros(n), np.zeros((n, 1, 3)))


def twist(x, *, turn=np.pi, stretch=0.3, centre=0.1):
    """Turn a bar of 1 m along x about its axis by `turn` [rad] and stretch it ever more: positions and gradients F."""
    angle = turn * x[:, 0]
    c, s = np.cos(angle), np.sin(angle)
    y, z = x[:, 1] - centre, x[:, 2] - centre
    moved = np.stack([x[:, 0] * (1 + stretch * x[:, 0]), c * y - s * z, s * y + c * z], 1)
    F = np.zeros((len(x), 3, 3))
    F[:, 0, 0] = 1 + 2 * stretch * x[:, 0]
    F[:, 1, 0], F[:, 2, 0] = turn * (-s * y - c * z), turn * (c * y - s * z)
    F[:, 1, 1], F[:, 1, 2], F[:, 2, 1], F[:, 2, 2] = c, -s, s, c
    return moved, F


@pytest.mark.parametrize(
    "where, low, high, least",
    [("inside", (0, 0, 0), (1, 0.2, 0.2), (2.8, 2.0)), ("surface", (0, 0.19, 0), (1, 0.2, 0.2), (3.5, 2.5))],
)
def test_two_levels_are_several_times_smoother_than_one(ti_cpu, where, low, high, least):
    """The paper's claim: neighbours stay alike where the cage's tets meet.

    A bar is twisted by 180 degrees and stretched; its tets are 5 cm wide, the Gaussians 5 mm. Jump: how much the
    covariances of neighbours differ beyond what the analytic deformation does to the same two.
    """
    bar = tet_bar((20, 4, 4), (1.0, 0.2, 0.2))
    real = random_gaussians(np.random.default_rng(5), 40_000, low=low, high=high, sigma=0.005)
    _, F = twist(real.means.astype(float))
    truth = F @ PROBE @ np.moveaxis(F, 1, 2)
    _, near = cKDTree(real.means).query(real.means, k=5)
    embedded, jumps = embed_in_bar(real, bar), {}
    for scheme in SCHEMES:
        _, cov, _ = Carried(ti_cpu, probes_of(real), bar, scheme=scheme, embedded=embedded).to(twist(bar[0])[0])
        off = cov - truth
        jump = (
            np.linalg.norm(off[:, None] - off[near[:, 1:]], axis=(2, 3)) / np.linalg.norm(truth, axis=(1, 2))[:, None]
        )
        error = np.median(np.linalg.norm(off, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2)))
        jumps[scheme] = np.percentile(jump, [95, 100])
        print(f"{where}, {scheme}: jump 95% {jumps[scheme][0]:.4f}, worst {jumps[scheme][1]:.4f}; error {error:.4f}")
    ratio = jumps["one-level"] / jumps["two-level"]
    print(f"{where}: two levels are {ratio[0]:.1f} times smoother (95%), {ratio[1]:.1f} times (worst)")
    assert (ratio > least).all()
