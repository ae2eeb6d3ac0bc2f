"""Motion in an asset: skinning, blending, coming round, and the file's group."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assets import animation
from assets.asset import Asset
from core.errors import BadInput
from tests.assets.test_asset import edited, put, refused, some_asset


def some_motion(frames: int = 12, seed: int = 0) -> animation.Animation:
    """Three joints in a row that turn at random, and the five vertices of some_asset()."""
    rng = np.random.default_rng(seed)
    parents = np.array([-1, 0, 1], np.int32)
    rest = (rng.normal(size=(3, 3)), unit(rng.normal(size=(3, 4))), rng.uniform(0.5, 2, (3, 3)))
    turns = unit(rest[1] + 0.3 * rng.normal(size=(frames, 3, 4)))
    inverse = np.linalg.inv(animation.world_matrices(parents, rest))
    weights = rng.dirichlet(np.ones(4), 5).astype(np.float32)
    joints = rng.integers(0, 3, (5, 4)).astype(np.int32)
    moving = (np.tile(rest[0], (frames, 1, 1)), turns, np.tile(rest[2], (frames, 1, 1)))
    driven = np.array([True, True, False, True, False])
    return animation.Animation(
        ["a", "b", "c"], parents, inverse, rest, moving, 30.0, np.arange(5), joints, weights, driven
    )


def unit(q):
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def test_skinning_is_the_sum_over_joints_and_rest_is_rest():
    a, rng = some_motion(), np.random.default_rng(1)
    x = rng.normal(size=(5, 3))
    assert_allclose(a.skinned(x, a.matrices(0.0)), x, atol=1e-6)  # weights are float32
    M = a.matrices(2.0)
    for i in range(5):
        expected = sum(w * (M[j] @ [*x[i], 1.0]) for w, j in zip(a.weights[i].astype(float), a.joints[i], strict=True))
        assert_allclose(a.skinned(x, M)[i], expected[:3], atol=1e-12)


def test_the_motion_begins_at_rest_and_comes_round_without_a_jump():
    a = some_motion()
    step = 1e-6  # [s]
    times = [0.0, 0.3, 0.7, 1.0, 1.0 + a.duration, 2 * a.duration, 3 * a.duration, 5.0]  # seams among them
    for t in times:
        before, after = (a.matrices(max(t + s, 0.0)) for s in (-step, step))
        assert np.abs(after - before).max() < 1e3 * step  # a radian a frame, some lengths of 3
    assert_allclose(a.matrices(0.0), np.tile(np.eye(4), (3, 1, 1)), atol=1e-12)
    assert_allclose(a.matrices(3.0), a.matrices(3.0 + 2 * a.duration), atol=1e-9)


def test_a_motion_that_ends_elsewhere_is_led_home():
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.normal(size=(31, 2, 3)), 0)
    q = unit(np.cumsum(rng.normal(size=(31, 2, 4)), 0) + 10)
    s = np.ones((31, 2, 3))
    new = animation.close_loop((t, q, s), 0.5, 30.0)
    assert [len(x) for x in new] == [30, 30, 30]
    assert_allclose(new[0][:15], t[:15])  # untouched before the last half second
    jump = np.abs(new[0][-1] - new[0][0]).max()
    assert jump < np.abs(t[-1] - t[0]).max()
    assert jump < 3 * np.abs(np.diff(t, axis=0)).max()


def test_a_closed_turn_leads_to_its_first_frame():
    """From any attitude, about axes that do not commute: with nine tenths of the gap closed, a tenth of it is left."""
    rng = np.random.default_rng(1)
    q = unit(np.cumsum(rng.normal(0, 0.05, (61, 4, 4)), axis=0) + rng.normal(size=(4, 4)))
    zero = np.zeros((61, 4, 3))
    turned = animation.close_loop((zero, q, zero + 1), 1.0, 60.0)[1]

    def between(a, b):
        return 2 * np.arccos(np.abs((a * b).sum(-1)).clip(0, 1))

    gaps = between(q[0], q[-1])
    assert gaps.min() > 0.2
    assert (between(turned[0], turned[-1]) < 0.02 * gaps + between(q[-1], q[-2])).all()
    assert_allclose(turned[0], q[0])


def test_slerp_is_uniform_and_takes_the_shorter_way():
    a, angle = np.array([1.0, 0, 0, 0]), 1.2
    b = np.array([np.cos(angle / 2), np.sin(angle / 2), 0, 0])
    for u in (0.0, 0.25, 0.9, 1.0):
        assert_allclose(animation.slerp(a, -b, u), [np.cos(u * angle / 2), np.sin(u * angle / 2), 0, 0], atol=1e-12)
    assert_allclose(animation.slerp(a, a, 0.5), a)


def test_parts_of_a_matrix_make_it_again():
    rng = np.random.default_rng(4)
    local = (rng.normal(size=(9, 3)), unit(rng.normal(size=(9, 4))), rng.uniform(0.2, 3, (9, 3)))
    m = animation.local_matrices(local)
    t, q, s, off = animation.decompose(m)
    assert_allclose(animation.local_matrices((t, q, s)), m, atol=1e-12)
    assert off.max() < 1e-12
    sheared = np.eye(4)
    sheared[0, 1] = 0.5
    mirrored = np.diag([-1.0, 1, 1, 1])
    assert (animation.decompose(np.stack([sheared, mirrored]))[3] > 0.1).all()
    assert_allclose(animation.interpolate_poses((t, q, s), (t, q, s), 0.3)[0], t)


def test_the_file_gives_back_what_it_was_given(tmp_path):
    path = tmp_path / "a.h5"
    replace(some_asset(), animation=some_motion()).save(path)
    a, b = some_motion(), Asset.load(path).animation
    assert b.names == a.names and b.fps == a.fps
    for name in ("parents", "vertices", "joints", "driven", "weights"):
        assert_allclose(getattr(b, name), getattr(a, name))
    assert_allclose(b.matrices(1.7), a.matrices(1.7), atol=1e-5)  # stored as float32
    some_asset().save(path)
    assert Asset.load(path).animation is None  # as in files of before


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (put("animation/parents", np.array([0, 2, 1], np.int32)), "before its parent"),
        (put("animation/vertices", np.array([0, 1, 2, 3, 5], np.int32)), "outside 0..4"),
        (put("animation/vertices", np.array([0, 1, 1, 3, 4], np.int32)), "twice"),
        (put("animation/joints", np.full((5, 4), 3, np.int32)), "joint outside"),
        (put("animation/weights", np.full((5, 4), 0.5, np.float32)), "sum to 1"),
        (put("animation/weights", np.full((5, 4), np.nan, np.float32)), "not finite"),
        (put("animation/rotations", np.zeros((12, 3, 4), np.float32)), "normalised"),
        (put("animation/scales", np.zeros((12, 3, 3), np.float32)), "scale"),
        (put("animation/translations", np.zeros((0, 3, 3), np.float32)), "shape"),
        (put("animation/inverse_bind", np.zeros((3, 4, 4))), "inverted"),
        (put("animation/rest_translations", np.full((3, 3), np.inf, np.float32)), "finite"),
        (put("animation/driven", np.zeros(4, np.uint8)), "shape"),
        (lambda f: f["animation"].attrs.__setitem__("fps", 0.0), "frames a second"),
        (lambda f: f["animation"].attrs.__setitem__("names", "{"), "JSON"),
        (lambda f: f["animation"].attrs.__setitem__("names", '["a"]'), "shape"),
        (lambda f: f["animation"].__delitem__("weights"), "missing"),
    ],
)
def test_a_damaged_motion_is_refused(tmp_path, edit, says):
    assert says in refused(edited(tmp_path, edit, replace(some_asset(), animation=some_motion())))


def test_a_motion_needs_a_cage(tmp_path):
    with pytest.raises(BadInput, match="no cage"):
        replace(some_asset(), cage=None, embedding=None, animation=some_motion()).save(tmp_path / "a.h5")
