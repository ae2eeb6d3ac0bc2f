"""Skinned props: parts that carry Gaussians, hands that follow joints, and Gaussians without shadows."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets.gaussians import concatenate
from core.material import Material
from core.spherical_harmonics import C0
from core.vocabulary import Body, Hand, Light
from display.protocol import Frame
from display.user_commands import PlayDemo
from display.xr import avatar
from display.xr.actions import Controller
from display.xr.hand_joints import FINGERS, JOINT_COUNT, WRIST, posed, rotation_about
from display.xr.poses import pose_matrix
from render.skinned_props import HIDDEN_DISTANCE, SkinnedProps
from render.splats import Splats
from scenes.scene import Scene

LIGHT = Light(position=(0.5, 2.0, 0.3))


@pytest.fixture(scope="module")
def all_skins():
    return avatar.skins()


@pytest.fixture(scope="module")
def drawn(ti_cpu, all_skins):
    splats = Splats(concatenate([s.gaussians for s in all_skins]))
    return splats, SkinnedProps(splats, all_skins, 0)


def values(splats):
    """mean, cov, opacity, colour of all."""
    n = splats.count
    cov = splats.cov.to_numpy()[:n]
    i, j = np.triu_indices(3)
    full = np.zeros((n, 3, 3))
    full[:, i, j] = full[:, j, i] = cov
    return splats.mean.to_numpy()[:n], full, splats.opacity.to_numpy()[:n], 0.5 + C0 * splats.sh.to_numpy()[:n, 0]


def test_what_is_hidden_is_away_and_transparent(drawn):
    splats, props = drawn
    props.place(avatar.hidden(), LIGHT)
    mean, _, opacity, _ = values(splats)
    assert (mean >= HIDDEN_DISTANCE).all() and (opacity == 0.0).all()


def test_gaussians_follow_their_parts_as_the_formula_says(drawn, all_skins):
    """Sheared, stretched and moved parts, against float64."""
    splats, props = drawn
    rng = np.random.default_rng(1)
    poses = np.concatenate(
        [np.eye(3) + 0.3 * rng.normal(size=(avatar.PART_COUNT, 3, 3)), rng.normal(size=(avatar.PART_COUNT, 3, 1))], 2
    )
    assert props.place(poses, LIGHT)
    assert not props.place(poses, LIGHT)  # nothing new
    mean, cov, opacity, colour = values(splats)
    g = concatenate([s.gaussians for s in all_skins])
    part, weight = (np.concatenate([getattr(s, n) for s in all_skins]) for n in ("part", "weight"))
    A = np.einsum("nk,nkrc->nrc", weight, poses[part])
    c0, (i, j) = g.covariances, np.triu_indices(3)
    S = np.zeros((len(g), 3, 3))
    S[:, i, j] = S[:, j, i] = c0
    assert_allclose(mean, np.einsum("nrc,nc->nr", A[..., :3], g.means) + A[..., 3], atol=2e-6)
    assert_allclose(cov, A[..., :3] @ S @ np.swapaxes(A[..., :3], 1, 2), atol=1e-9, rtol=1e-3)
    assert_allclose(opacity, g.opacities, atol=1e-6)
    normal = np.concatenate([s.normal for s in all_skins])
    base = 0.5 + C0 * g.sh[:, 0]
    flat = np.linalg.norm(normal, axis=1) == 0
    assert_allclose(colour[flat], base[flat], atol=1e-5)  # what glows is not shaded
    n = np.linalg.inv(np.swapaxes(A[..., :3], 1, 2)) @ normal[..., None]
    n = (np.sign(np.linalg.det(A[..., :3]))[:, None] * n[..., 0])[~flat]
    way = np.array(LIGHT.position) - mean[~flat]
    facing = (n * way).sum(1) / np.linalg.norm(n, axis=1) / np.linalg.norm(way, axis=1)
    bright = (colour / base)[~flat].mean(1)
    assert np.corrcoef(bright, facing)[0, 1] > 0.8  # the rest is light from above
    assert (bright > 0.4).all() and (bright < 1.3).all()


def test_the_hands_bound_pose_is_the_model_itself(all_skins):
    for left in (True, False):
        poses = avatar.skinning_transforms(posed(avatar.BIND_BENDS, left=left), left=left)
        used = [j for f in FINGERS for j in f[:-1]] + [WRIST]
        assert_allclose(poses[used], np.tile(np.eye(3, 4), (len(used), 1, 1)), atol=1e-9)


def test_a_turned_hand_is_turned_as_a_whole():
    at = pose_matrix(np.array([0.3, 1.0, -0.2]), rotation_about((1, 2, 3), 1.1))
    poses = avatar.skinning_transforms(posed(avatar.BIND_BENDS).transformed(at), left=False)
    used = [j for f in FINGERS for j in f[:-1]] + [WRIST]
    assert_allclose(poses[used], np.tile(at[:3], (len(used), 1, 1)), atol=1e-9)


def test_the_skin_lies_around_the_bones(all_skins):
    """Within the thickness of flesh, closed (a point inside sees skin in all directions), left as right."""
    left, right = (s for s in all_skins if s.part.max() < 2 * JOINT_COUNT and s.solid)
    assert_allclose(left.gaussians.means * [-1, 1, 1], right.gaussians.means, atol=1e-7)
    joints, x, n = posed(avatar.BIND_BENDS), right.gaussians.means, right.normal
    assert 2000 < len(x) < 5000
    away = np.min([segment(x, joints.position[j], joints.position[j + 1]) for f in FINGERS for j in f[:-1]], axis=0)
    hand = x[:, 2] < 0.0
    assert away[hand].max() < 0.035 and away[hand].min() > 0.003
    for j in (FINGERS[1][2], FINGERS[3][1], FINGERS[0][2]):
        ways = x - joints.position[j]
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        probes = np.random.default_rng(0).normal(size=(200, 3))
        probes /= np.linalg.norm(probes, axis=1, keepdims=True)
        assert (probes @ ways.T).max(1).min() > 0.95
    assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-6)
    assert_allclose(right.weight.sum(1), 1.0, atol=1e-6)


def segment(x, a, b):
    t = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(x - a - t[:, None] * (b - a), axis=1)


def test_what_casts_no_shadow_comes_first(all_skins):
    solid = [s.solid for s in all_skins]
    assert solid == sorted(solid) and not solid[0] and solid[-1]
    assert max(int(s.part.max()) for s in all_skins) < avatar.PART_COUNT


def test_a_controller_is_where_it_is_held_and_its_finger_as_long_as_it_is_out():
    grip, stage = (
        pose_matrix(np.array([0.1, 1.2, -0.3]), rotation_about((0, 1, 0), 0.4)),
        pose_matrix(np.array([1.0, 0, 2.0]), np.eye(3)),
    )
    parts = avatar.hidden()
    avatar.show_hand(parts, 1, Controller(grip=grip), stage, 0.5)
    assert np.isnan(parts[avatar.CONTROLLER]).all()
    assert_allclose(parts[avatar.CONTROLLER + 1], (stage @ grip)[:3])
    end = parts[avatar.FINGER + 1] @ [0, 0, -0.09, 1]
    assert_allclose(np.linalg.norm(end - (stage @ grip)[:3, 3]), 0.045)
    assert_allclose(parts[avatar.FINGERTIP + 1][:, 3], end)
    avatar.show_hand(parts, 1, Controller(grip=grip), stage, 0.0)


def test_a_ray_goes_from_the_hand_to_the_spot():
    parts, start, end = avatar.hidden(), np.array([0.2, 1.2, 0.3]), np.array([1.0, 0.0, -1.0])
    avatar.show_ray(parts, start, end)
    assert_allclose(parts[avatar.RAY] @ [0, 0, 0, 1], start)
    assert_allclose(parts[avatar.RAY] @ [0, 0, -1, 1], end)
    assert np.linalg.norm(parts[avatar.TARGET][:, 3] - end) < 0.05


def test_the_hand_of_a_scripted_player_is_drawn_while_it_acts(ti_cpu):
    """It touches what it holds from the player's side; before it acts, and after, there is none."""
    from display.world import World

    class Game:
        duration, score, message = 0.05, 0, ""
        held: tuple[Hand, ...] = (Hand((0.1, 0.3, -0.2), grip=True, reach=0.05),)

        def reset(self): ...
        def update(self, time, bodies): ...
        def hands(self, time, bodies):
            return list(self.held)

    ring = Body("ring_red", Material.named("silicone"), position=(0.0, 0.1, 0.0))
    scene = Scene([ring], None, (0.0, 0.6, 0.9), (0.0, 0.1, 0.0), game=Game())
    world = World(scene, width=16, height=16, props=avatar.scripted_skins())

    def drawn_hand() -> np.ndarray:
        world.step(Frame(1 / 60, 0.0, []))
        means = world.device.splats.mean.to_numpy()[world.device.still : world.device.first]
        return means[np.abs(means).max(axis=1) < HIDDEN_DISTANCE]

    assert len(drawn_hand()) == 0
    world.apply([PlayDemo(True)])
    hand = drawn_hand()
    assert len(hand) == len(avatar.scripted_skins()[1].gaussians)  # the right one
    far = np.linalg.norm(hand - Game.held[0].position, axis=1)
    assert far.min() < 0.03 and far.max() < 0.3
    assert (hand.mean(0) - Game.held[0].position)[2] > 0.03  # towards the player
    for _ in range(4):
        last = drawn_hand()
    assert len(last) == 0 and not world.demo
