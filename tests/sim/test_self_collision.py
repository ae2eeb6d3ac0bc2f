"""Bodies that meet themselves: a bar folded over, a crumpled ring; what is not folded costs and meets nothing."""

import numpy as np
import pytest

from bench.physics import box, torus
from core.material import Material
from core.tetmesh import tet_volumes
from core.vocabulary import Hand
from sim.bodies import SoftBody
from sim.contact.broad_phase import can_fold
from sim.model import RestShape
from tests.support.soft_world import soft_solver, vertices_of

DT = 1 / 60
LENGTH, THICK, EDGE = 0.4, 0.04, 0.02
BAR, TETS, SURFACE = box((LENGTH, THICK, THICK), (20, 2, 2))
BAR = BAR - [LENGTH / 2, THICK / 2, THICK / 2]
RING, RING_TETS, RING_SURFACE = torus(0.08, 0.016, 24, 2)
RUBBER = Material(3e4, 0.3, 1000.0, damping=8.0)
FAR = np.array([0.0, 0.0, 2.0])  # where the ring is
UPPER, LOWER = BAR[:, 0] > LENGTH / 4, BAR[:, 0] < -LENGTH / 4  # the halves' outer parts


@pytest.fixture(scope="module")
def bar(ti_cpu):
    """A bar of square section, and far away a ring; no gravity."""
    bodies = [
        SoftBody("bar", BAR, TETS, SURFACE, RUBBER),
        SoftBody("ring", RING, RING_TETS, RING_SURFACE, RUBBER, position=tuple(FAR)),
    ]
    return soft_solver(bodies, floor=False, gravity=(0, 0, 0))


def start(solver, x=BAR, v=None, ring=RING):
    velocity = np.zeros((len(BAR) + len(RING), 3))
    velocity[: len(BAR)] = 0.0 if v is None else v
    solver.restore({"x": np.concatenate([x, ring + FAR]), "v": velocity})


def bent(radius=0.06):
    """The bar as a U: its middle on a half circle, its ends straight and `2 radius` apart along y."""
    along, y, z = BAR.T
    arc = np.clip(along, -radius * np.pi / 2, radius * np.pi / 2)
    angle, rest = arc / radius, along - arc
    away = radius + y
    return np.stack(
        [away * np.cos(angle) - rest * np.sin(angle), away * np.sin(angle) + rest * np.cos(angle), -z], axis=1
    )


def listed(solver):
    """Depths [m] of the rows that carry something, and how many rows there are at all."""
    rows = solver.contacts.constraints
    r = rows.candidate.to_numpy()[: rows.candidate_count[None]]
    active = r[np.linalg.norm(rows.impulse.to_numpy()[r], axis=1) > 0]
    return -rows.phi.to_numpy()[active], len(r)


def apart(x):
    """Height of the upper half above the lower one [m]."""
    return x[UPPER, 1].mean() - x[LOWER, 1].mean()


@pytest.mark.parametrize(("cells", "folds"), [((8, 2, 2), True), ((4, 4, 4), False)])
def test_a_bar_can_meet_itself_and_a_block_cannot(cells, folds):
    """Bodies of a few cells a side are not searched: their neighbours would count as contacts."""
    x, tets, surface = box(EDGE * np.array(cells), cells)
    assert can_fold(RestShape(x, tets, surface, None)) == folds


@pytest.mark.long
def test_a_body_in_its_rest_shape_meets_nothing(bar):
    """At rest, thrown at 8 m/s, and spinning at 20 rad/s."""
    for v in (0.0 * BAR, 0.0 * BAR + (8, -3, 1), np.cross([0, 3, 20], BAR)):
        start(bar, v=v)
        for _ in range(3):
            bar.step(DT, [])
            depths, count = listed(bar)
            assert len(depths) == 0
            assert count == 0 or v[0, 2] != 0  # what spins may be looked at, though it meets nothing


def test_halves_that_meet_do_not_pass(bar):
    """Folded to a U, the halves come together at 5 m/s; they bounce off, and the bar is straight again."""
    start(bar, bent(), np.where(UPPER, -2.5, 0)[:, None] * [0, 1, 0] + np.where(LOWER, 2.5, 0)[:, None] * [0, 1, 0])
    deepest, met = 0.0, False
    for _ in range(30):
        bar.step(DT, [])
        depths, _ = listed(bar)
        deepest, met = max(deepest, depths.max(initial=0.0)), met or len(depths) > 0
        assert apart(vertices_of(bar)[0]) > 0.0
    assert met and deepest < 0.1 * EDGE, deepest  # four times as deep if they were taken for what began inside
    for _ in range(120):
        bar.step(DT, [])
    x = vertices_of(bar)[0]
    assert np.linalg.norm(x[UPPER].mean(0) - x[LOWER].mean(0)) > 0.98 * 0.75 * LENGTH
    assert listed(bar)[1] == 0


def test_what_hands_folded_unfolds(bar):
    """Two hands press the ends of the U together, to half their thickness, and let go."""
    start(bar, bent())
    ends = [bent()[BAR[:, 0] > LENGTH / 2 - 1e-6].mean(0), bent()[BAR[:, 0] < -LENGTH / 2 + 1e-6].mean(0)]
    deepest, met = 0.0, False
    for k in range(60):
        way = min(k / 40, 1.0) * (0.06 - 0.01) * np.array([0, 1, 0])
        hands = [Hand(tuple(ends[0] - way), grip=k > 0), Hand(tuple(ends[1] + way), grip=k > 0)]
        bar.step(DT, hands)
        depths, _ = listed(bar)
        deepest, met = max(deepest, depths.max(initial=0.0)), met or len(depths) > 2
    assert met and deepest < 0.3 * EDGE, deepest
    x = vertices_of(bar)[0]
    middle = np.abs(np.abs(BAR[:, 0]) - LENGTH / 4) < 0.03  # between bend and hands
    assert x[middle & (BAR[:, 0] > 0), 1].mean() > x[middle & (BAR[:, 0] < 0), 1].mean()
    for _ in range(150):
        bar.step(DT, [])
    x = vertices_of(bar)[0]
    assert np.linalg.norm(x[UPPER].mean(0) - x[LOWER].mean(0)) > 0.98 * 0.75 * LENGTH
    assert (tet_volumes(x, TETS) > 0).all()


def test_a_crumpled_ring_recovers(bar):
    """Squeezed to a third and bent through itself; it finds its shape again, turned somehow."""
    rng = np.random.default_rng(1)
    crumpled = RING * [0.35, 1, 0.35] + 0.03 * np.sin(60 * RING @ rng.normal(size=(3, 3)))
    start(bar, ring=crumpled)
    for _ in range(240):
        bar.step(DT, [])
    x = vertices_of(bar)[1]
    assert (tet_volumes(x, RING_TETS) > 0).all()
    u, _, vt = np.linalg.svd((x - x.mean(0)).T @ (RING - RING.mean(0)))
    turned = (RING - RING.mean(0)) @ (u @ vt).T
    assert np.linalg.norm(x - x.mean(0) - turned, axis=1).max() < 2e-3
