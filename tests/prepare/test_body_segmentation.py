"""A body in parts: weights spread in its cage, cages cut, what hands hold, Gaussians that follow their part."""

import numpy as np
from numpy.testing import assert_allclose

from assets.asset import Cage
from assets.gaussians import Gaussians
from bench.physics import box
from core.distance_grid import DistanceGrid
from core.tetmesh import boundary_surface, shared_face_pairs
from prepare.cage.embedding_hosts import embed
from prepare.rig.body_segmentation import Segments, cut, held_by_hands, split_vertices
from prepare.rig.landmarks import Solid, distance_to_segment
from prepare.rig.skin_weights import diffuse_weights, isolated_patches, largest_influences, without_spikes


def trousers(gap: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Two legs of 0.1 x 0.8 x 0.1 m under a waist of 0.2 m; without a gap they touch all along."""
    x, tets, _ = box((0.25, 1.0, 0.1), (5, 20, 2))
    middle = x[tets].mean(1)
    if gap:
        tets = tets[~((np.abs(middle[:, 0] - 0.125) < 0.025) & (middle[:, 1] < 0.8))]
    used, tets = np.unique(tets, return_inverse=True)
    return x[used], tets.reshape(-1, 4)


def test_diffused_weights_are_shares_and_differ_little_between_neighbours():
    x, tets = trousers()
    rng = np.random.default_rng(0)
    target = np.eye(3)[rng.integers(0, 3, len(x))]
    weights = diffuse_weights(x, tets, np.full(len(x), 1 / 0.05**2), target)
    assert_allclose(weights.sum(1), 1, atol=1e-9)
    assert weights.min() > -1e-12 and weights.max() < 1 + 1e-12
    smooth = diffuse_weights(x, tets, np.full(len(x), 1 / 0.5**2), np.eye(2)[(x[:, 1] > 0.5).astype(int)])
    ends = np.concatenate([tets[:, [i, j]] for i in range(4) for j in range(i)])
    assert np.abs(smooth[ends[:, 0]] - smooth[ends[:, 1]]).max() < 0.2  # of targets that jump by 1
    joints, four = largest_influences(np.random.default_rng(1).dirichlet(np.ones(9), 50))
    assert_allclose(four.sum(1), 1, atol=1e-6)
    assert (four[:, 0] >= four[:, 3]).all() and joints.max() < 9


def grid_of(inside, low, high, spacing: float = 0.025) -> DistanceGrid:
    """A grid of -1 where inside(x) of points (..., 3), else 1."""
    shape = np.ceil((np.subtract(high, low)) / spacing).astype(int) + 1
    x = np.asarray(low) + spacing * np.moveaxis(np.indices(shape), 0, -1)
    return DistanceGrid(np.where(inside(x), -1.0, 1.0).astype(np.float16), np.asarray(low, np.float64), spacing)


def test_weights_do_not_bleed_from_leg_to_leg():
    """5 cm across the gap, but more than a metre through the waist: distance is measured inside the solid."""

    def inside(p):
        x, y = p[..., 0], p[..., 1]
        return (x > 0) & (x < 0.25) & (y > 0) & (y < 1) & ((np.abs(x - 0.125) > 0.025) | (y > 0.8))

    solid = Solid.of(grid_of(inside, (-0.05, -0.05, -0.05), (0.3, 1.05, 0.15)))
    legs = [(np.array([c, 0.05, 0.05]), np.array([c, 0.75, 0.05])) for c in (0.05, 0.2)]
    off = solid.geodesic_distances(legs)
    p = solid.points
    low, left = p[:, 1] < 0.5, p[:, 0] < 0.125
    assert (off[low & left, 1] > 0.25).all() and (off[low & ~left, 0] > 0.25).all()
    assert off[low & left, 0].max() < 0.2  # its own leg is near
    euclid = np.hypot(p[:, 0] - 0.2, p[:, 2] - 0.05)
    assert euclid[low & left].min() < 0.15  # what a straight line would have taken for near


def test_what_a_hand_holds_is_found_and_covered():
    """A ball, and a stick, at the end of an arm; neither a bump that is too small nor a ball far from all hands is."""
    arm = np.array([0.0, 1.0, 0.0]), np.array([0.5, 1.0, 0.0])
    hands = {"left": (np.array([0.45, 1.0, 0.0]), arm[1])}

    def solid_with(*more) -> tuple[Solid, np.ndarray]:
        def inside(p):
            found = distance_to_segment(p.reshape(-1, 3), *arm).reshape(p.shape[:-1]) < 0.06
            for piece in more:
                found |= piece(p)
            return found

        solid = Solid.of(grid_of(inside, (-0.4, 0.4, -0.4), (1.0, 1.4, 0.4), 0.02))
        return solid, solid.geodesic_distances([arm])[:, 0] / 0.06

    def ball(c, r):
        return lambda p: np.linalg.norm(p - c, axis=-1) < r

    def stick(p):
        return (np.abs(p[..., 0] - 0.5) < 0.04) & (np.abs(p[..., 2]) < 0.04) & (p[..., 1] > 0.5) & (p[..., 1] < 1.3)

    found = held_by_hands(*solid_with(ball((0.55, 0.85, 0.0), 0.15)), hands, 1.7)
    assert len(found) == 1 and found[0][0] == "left"
    ((center, radius),) = found[0][2]
    assert_allclose(center, (0.55, 0.85, 0.0), atol=0.03)
    assert abs(radius - 0.15) < 0.03
    solid, radii = solid_with(stick)
    found = held_by_hands(solid, radii, hands, 1.7)
    beyond = solid.points[(radii > 1.6) & (solid.points[:, 1] < 0.95)]
    pieces = [balls for _, _, balls in found]
    covered = np.any([np.linalg.norm(beyond - c, axis=1) < r for balls in pieces for c, r in balls], axis=0)
    assert len(pieces[0]) > 1 and covered.mean() > 0.8
    assert held_by_hands(*solid_with(ball((0.0, 0.9, 0.0), 0.12)), hands, 1.7) == []
    assert held_by_hands(*solid_with(ball((0.5, 0.96, 0.0), 0.062)), hands, 1.7) == []


def test_a_gaussian_that_would_be_a_spike_follows_what_is_calm():
    """A bar is drawn out to four times its length over a tenth of it: nothing that follows it grows as much, and what
    is far from there stays as it was."""
    x, tets, _ = box((1.0, 0.1, 0.1), (20, 2, 2))
    cage = Cage(x.astype(np.float32), tets.astype(np.int32), boundary_surface(tets).astype(np.int32))
    n = 400
    rng = np.random.default_rng(0)
    means = rng.uniform((0.02, 0.02, 0.02), (0.98, 0.08, 0.08), (n, 3))
    quats = np.tile([1.0, 0, 0, 0], (n, 1))
    g = Gaussians.of(means, quats, np.full((n, 3), np.log(0.004)), np.zeros(n), np.zeros((n, 1, 3)))
    embedded = embed(g.means, g.quats, np.exp(g.log_scales), x, tets)
    drawn = x.astype(np.float64).copy()
    drawn[:, 0] += 0.3 * np.clip((x[:, 0] - 0.5) / 0.1, 0, 1)
    label = np.zeros(len(tets), int)
    parts = Segments(label, np.zeros(n, int), lambda a, b, c: a == b)
    new = without_spikes(embedded, g, cage, parts, np.stack([x.astype(np.float64), drawn]))

    def growth(e):
        y = [np.einsum("nkj,nkjd->nkd", e.weights.astype(np.float64), p[tets[e.host]]) for p in (x, drawn)]
        F = [np.swapaxes(p[:, 1:] - p[:, :1], 1, 2) for p in y]
        return np.linalg.norm(F[1] @ np.linalg.inv(F[0]), ord=2, axis=(1, 2))

    assert growth(embedded).max() > 3 and growth(new).max() < 1.9  # root mean square of 1.35
    far, moved = np.abs(means[:, 0] - 0.55) > 0.2, (new.host != embedded.host).any(1)
    assert moved.sum() > 20 and not moved[far].any()


def test_a_cage_is_cut_where_the_skeleton_is_not_joined():
    """Legs that touch all along part up to the waist, where they hold; not a bit of volume is lost."""
    x, tets = trousers(gap=False)
    cage = Cage(x.astype(np.float32), tets.astype(np.int32), boundary_surface(tets).astype(np.int32))
    label = (x[tets].mean(1)[:, 0] > 0.15).astype(int)
    label[7] = 1  # a tet of the left leg that is told to be the right one's hangs on nothing
    new, label, source = cut(cage, label, lambda a, b, c: c[:, 1] > 0.8)
    new.check("cut")
    assert_allclose(new.volumes().sum(), cage.volumes().sum(), rtol=1e-6)
    assert_allclose(new.vertices, cage.vertices[source])
    assert len(new.vertices) > len(cage.vertices)
    below = new.vertices[new.tets].mean(1)[:, 1] < 0.7
    left, right = (np.unique(new.tets[below & (label == k)]) for k in (0, 1))
    assert len(np.intersect1d(left, right)) == 0
    assert label[7] == 0


def test_nothing_is_split_where_all_faces_hold():
    x, tets, _ = box((1, 1, 1), (2, 2, 2))
    new, source = split_vertices(tets, shared_face_pairs(tets) // 4)
    assert (new == tets).all() and (source == np.arange(len(x))).all()


def test_a_small_patch_alone_in_free_flesh_is_not_led():
    """On a line of vertices 1 apart: patches 1 and 5 across. Alone of its joint, one 5 across goes too, but not of a
    limb's last joint."""
    x = np.stack([np.arange(40.0), np.zeros(40), np.zeros(40)], 1)
    ends = np.stack([np.arange(39), np.arange(1, 40)], 1)
    driven, leader = np.zeros(40, bool), np.zeros(40, int)
    for low, high, joint in ((0, 12, 0), (14, 16, 0), (18, 24, 1), (26, 32, -1), (34, 40, 0)):
        driven[low:high], leader[low:high] = True, joint
    found = isolated_patches(x, ends, driven, 4.0, leader)
    assert sorted(set(np.flatnonzero(found))) == [14, 15, *range(18, 24)]
