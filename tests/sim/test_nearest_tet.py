"""The search for the tets that points may come into, against all tets in turn (float64)."""

import numpy as np
import pytest

from bench.sample_meshes import torus
from core.material import Material
from sim.soft_body import SoftBody
from tests.support.soft_world import soft_solver

RUBBER = Material(young=3e4, poisson=0.4, density=1100.0)
APART = 0.25  # [m] between the rings' middles; their bodies are 0.04 m from one another
DT = 1 / 60


def outside(x, corners):
    """Distance (N, T) [m] of each point x (N, 3) beyond the worst face of each tet (T, 4, 3), 0 inside."""
    worst = np.zeros((len(x), len(corners)))
    for j, face in enumerate([(1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)]):
        a, b, c = (corners[:, k] for k in face)
        n = np.cross(b - a, c - a)
        n *= (np.sign(np.einsum("ij,ij->i", n, a - corners[:, j])) / np.linalg.norm(n, axis=1))[:, None]
        worst = np.maximum(worst, x @ n.T - (n * a).sum(1))
    return worst


@pytest.fixture(scope="module")
def rings(ti_cpu):
    ring = torus(0.08, 0.025, 24, 3)
    bodies = [SoftBody(f"ring{k}", *ring, RUBBER, position=(k * APART, 0, 0.01 * k)) for k in range(2)]
    return soft_solver(bodies, floor=False, gravity=(0, 0, 0))


def found(rings, speed):
    """Points of the two rings, at `speed` towards each other: where, whose, host (-1: none), the cell's size."""
    rings.reset()
    q = rings.snapshot()
    half = rings.vertex_offset[1]
    v = np.zeros_like(q["x"])
    v[:half, 0], v[half:, 0] = speed, -speed
    rings.restore({"x": q["x"], "v": v})
    rings.step(1e-7)  # searches, and hardly moves
    contacts = rings.contacts
    n = contacts.samples.count[None]
    rings.state.detect_dt[None] = DT
    contacts.detect()
    listed = (
        contacts.constraints.candidate.to_numpy()[: contacts.constraints.candidate_count[None]]
        - contacts.deformable.begin
    )
    host = np.full(n, -1)
    mine = listed[(listed >= 0) & (listed < n)]
    host[mine] = contacts.deformable.hosts.host.to_numpy()[mine]
    ids, weight = contacts.samples.ids.to_numpy()[:n], contacts.samples.weight.to_numpy()[:n]
    x = rings.x.to_numpy().astype(np.float64)
    points = (weight[:, :, None] * x[ids]).sum(1)
    return points, contacts.samples.body.to_numpy()[:n], host, contacts.deformable.hosts.hash.cell[None], x


@pytest.mark.long
@pytest.mark.parametrize("speed", [3.0, 12.0])
def test_what_is_fast_finds_the_nearest_tet_of_the_other_from_afar(rings, speed):
    points, body, host, cell, x = found(rings, speed)
    tets, of = rings.state.tets.to_numpy()[: rings.state.sizes.tets], rings.state.body_of_tet.to_numpy()
    far_and_found = 0
    for b in range(2):
        mine, others = np.flatnonzero(body == b), np.flatnonzero(of[: len(tets)] != b)
        distance = outside(points[mine], x[tets[others]])
        nearest = distance.min(1)
        listed = host[mine] >= 0
        way = 2 * speed * DT
        towards = np.array([1.0 if b == 0 else -1.0, 0.0, 0.0])  # in the other's frame, with the speed of both
        path = [outside(points[mine] + f * way * towards, x[tets[others]]).min(1) for f in np.linspace(0, 1, 20)]
        assert listed[np.min(path, 0) == 0.0].all()  # what flies into the other until the next search
        assert not listed[nearest > 1.5 * way + 0.01].any()
        middles = x[tets].mean(1)
        gap = np.linalg.norm(points[mine[listed], None] - middles[others], axis=2).min(1)
        chosen = np.linalg.norm(points[mine[listed]] - middles[host[mine[listed]]], axis=1)
        assert (chosen <= gap + 2 * cell).all()
        far_and_found += (nearest[listed] > cell).sum()
    assert far_and_found > 30


def test_what_is_slow_lists_nothing(rings):
    assert (found(rings, 0.3)[2] < 0).all()
