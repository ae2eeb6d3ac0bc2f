"""Corrections that are learned of photographs beside the Gaussians: exposures and poses."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
from numpy.testing import assert_allclose, assert_array_equal

from prepare.train.capture_files import read_capture
from prepare.train.photographs import reduced
from prepare.train.seeds import seeds
from prepare.train.train_options import TrainOptions
from prepare.train.trainer import Trainer, read_checkpoint, write_checkpoint
from prepare.train.view_corrections import IDENTITY, POSE_REACH, Exposure, Exposures, Poses, common_twists, twisted
from tests.support.painted_capture import photographs, write_capture


def test_the_gradient_through_an_exposure(ti_cpu):
    """Of L = sum w . (A c + b): dL/dA = sum w c^T, dL/db = sum w, dL/dc = A^T w; the map itself as in NumPy."""
    rng, (height, width) = np.random.default_rng(0), (5, 70)  # more than a block of a row
    rgb, weight = rng.random((1, 8, 80, 3), np.float32), rng.normal(size=(8, 80, 3)).astype(np.float32)
    affine = (IDENTITY + 0.2 * rng.normal(size=(3, 4))).astype(np.float32)
    exposure = Exposure(8, 80)
    drawn, d_rgb = ti.Vector.field(3, ti.f32, (1, 8, 80)), ti.Vector.field(3, ti.f32, (8, 80))
    drawn.from_numpy(rgb)
    d_rgb.from_numpy(weight)
    exposure.set(affine)

    @ti.kernel
    def passes():
        exposure.apply(drawn, height, width)
        exposure.backward(drawn, d_rgb, height, width)

    passes()
    c, w = rgb[0, :height, :width], weight[:height, :width]
    assert_allclose(exposure.rgb.to_numpy()[0, :height, :width], c @ affine[:, :3].T + affine[:, 3], atol=1e-6)
    expected = np.concatenate([np.einsum("yxk,yxj->kj", w, c), w.sum(axis=(0, 1))[:, None]], axis=1)
    assert_allclose(exposure.d_affine.to_numpy(), expected, atol=1e-4)
    assert_allclose(d_rgb.to_numpy()[:height, :width], w @ affine[:, :3], atol=1e-6)
    assert_allclose(d_rgb.to_numpy()[height:], weight[height:])
    exposure.destroy()


def test_the_exposures_of_all_views_have_the_identity_as_their_mean():
    exposures, rng = Exposures(4), np.random.default_rng(1)
    for k in range(12):
        exposures.step(k % 3, rng.random((3, 4)) + 0.5, k / 12)
    assert_allclose(np.mean([exposures.of(v) for v in range(4)], axis=0), IDENTITY, atol=1e-12)
    assert (exposures.of(0) < exposures.of(3)).all()  # down the gradient, beside the view that was not seen


def test_a_pose_moves_down_the_gradient_of_its_twist():
    """L = sum G . world_to_camera: the gradient is that of finite differences."""
    rng = np.random.default_rng(2)
    given = [twisted(rng.normal(size=3), rng.normal(size=3)) for _ in range(2)]
    poses, G, extent = Poses(given, 2.5, 1000), rng.normal(size=(3, 4)), 2.5
    poses.learn(1, G, 0.0)
    for k in range(6):
        twist = np.zeros(6)
        twist[k] = 1e-6
        change = twisted(twist[:3], extent * twist[3:]) @ given[1] - given[1]
        slope = (G * change[:3]).sum() / 1e-6
        assert poses.first[1, k] == pytest.approx(0.1 * slope, rel=1e-4)
    assert (poses.values[1] * poses.first[1]).sum() < 0.0 and is_rigid(poses.of(1))


@pytest.mark.parametrize("steps", [60, 3000])
def test_however_long_a_training_is_a_pose_can_move_as_far(steps):
    """Pulled the same way each time by nearly POSE_REACH; three views take turns."""
    first, last = Poses([np.eye(4)] * 3, 1.0, steps).rates
    way = sum(first * (last / first) ** (k / steps) for k in range(0, steps, 3))
    assert way == pytest.approx(POSE_REACH, rel=0.15)


def test_poses_leave_the_capture_in_its_place():
    """A world that turns, moves or grows a little is no correction; what is one of a single view stays one."""
    rng, extent = np.random.default_rng(3), 2.5
    given = [twisted(rng.normal(size=3), rng.normal(size=3)) for _ in range(5)]
    common = common_twists(np.array(given), extent)
    for k in range(7):
        world, size = np.zeros(6), 1.0
        if k < 6:
            world[k] = 1e-6
        else:
            size += 1e-6
        twists = []
        for pose in given:
            moved = pose @ twisted(world[:3], world[3:])
            moved[:3, 3] /= size
            change = (moved @ np.linalg.inv(pose) - np.eye(4)) / 1e-6
            turn = [change[2, 1], change[0, 2], change[1, 0]]
            twists.append([*turn, *change[:3, 3] / extent])
        twists = np.ravel(twists)
        assert_allclose(common @ (common.T @ twists), twists, atol=1e-4)
    poses = Poses(given, extent, 1000)
    for k in range(50):
        poses.learn(k % 5, rng.normal(size=(3, 4)) if k % 5 else np.ones((3, 4)), k / 50)
    assert_allclose(common.T @ poses.values.ravel(), 0.0, atol=1e-12)
    assert np.linalg.norm(poses.values[0]) > 1e-4


def is_rigid(matrix: np.ndarray) -> bool:
    """True for a rigid transform."""
    return np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3)) and np.linalg.det(matrix[:3, :3]) > 0


def test_a_dim_photograph_is_given_a_dim_exposure_and_a_cut_training_goes_on(ti_cpu, tmp_path):
    """All colours of one photograph are halved; the pose of one is turned by half a degree."""
    pictures = [reduced(p, 2) for p in photographs()[:4]]
    pictures[1] = pictures[1]._replace(pixels=pictures[1].pixels // 2)
    off = twisted(np.array([0.0, np.radians(0.5), 0.0]), np.zeros(3))
    camera = pictures[2].camera
    pictures[2] = pictures[2]._replace(camera=replace(camera, world_to_camera=off @ camera.world_to_camera))
    write_capture(tmp_path / "painted")
    given = read_capture(tmp_path / "painted")
    start = seeds(given, degree=0, count=100, rng=np.random.default_rng(0))
    options = TrainOptions(steps=400, cap=100, degree=0, exposure=True, poses=True)
    trainer = Trainer(pictures, start, given.extent, options)
    for _ in range(60):
        trainer.step()
    gains = [np.diag(trainer.exposures.of(v)[:, :3]).mean() for v in range(4)]
    assert gains[1] < min(gains[0], gains[2], gains[3]) - 0.1
    write_checkpoint(tmp_path / "a.h5", trainer.state(), {"exposure": True, "poses": True})
    state = read_checkpoint(tmp_path / "a.h5", {"exposure": True, "poses": True}, trainer.state(), 4)
    before = trainer.exposures.values.copy(), trainer.poses.values.copy()
    for _ in range(4):
        trainer.step()
    assert (trainer.poses.values != before[1]).any()
    trainer.restore(state)
    assert_array_equal(trainer.exposures.values, before[0])
    assert_array_equal(trainer.poses.values, before[1])
    assert_array_equal(trainer.views.cameras[2].world_to_camera, trainer.poses.of(2))
    trainer.destroy()
