"""Tracks of markers: what a file must hold, where markers are in a cage, and how the body sets off."""

import numpy as np
import pytest

from core.errors import BadInput
from prepare.fit.marker_tracks import marker_weights, noise_of, read_tracks, rigid_pose, start_of
from tests.support.samples import tet_bar

RNG = np.random.default_rng(0)
TIMES = np.arange(30) / 60
REST = RNG.uniform(0, 1, (8, 3)) * [0.3, 0.1, 0.1]
FALLING = REST + np.array([0.4, 1.0, 0.0]) * TIMES[:, None, None] - [0, 4.905, 0] * TIMES[:, None, None] ** 2


def file_of(tmp_path, **changes):
    arrays = {"times": TIMES, "points": FALLING, "rest": REST} | changes
    np.savez(tmp_path / "p.npz", **{name: value for name, value in arrays.items() if value is not None})
    return tmp_path / "p.npz"


def test_a_file_is_read_with_the_defaults_of_what_it_lacks(tmp_path):
    t = read_tracks(file_of(tmp_path, planes=np.array([[0.0, 2.0, 0.0, 0.4]])))
    np.testing.assert_allclose(t.planes, [[0, 1, 0, 0.2]])  # of n x >= d with a unit normal
    assert t.held is None and t.release == np.inf and t.gravity.tolist() == [0, -9.81, 0] and t.seen.all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rest": None}, "has no rest; a file of tracks has times, points and rest"),
        ({"rest": REST[:7]}, "for 30 times and 7 markers"),
        ({"points": FALLING[..., :2]}, r"points has shape \(30, 8, 2\), expected \(n, n, 3\)"),
        ({"times": TIMES[::-1]}, "times must ascend"),
        ({"times": TIMES[:5], "points": FALLING[:5]}, "5 frames; at least 12"),
        ({"times": np.where(TIMES > 0.3, np.nan, TIMES)}, "times is not finite"),
        ({"points": np.full_like(FALLING, np.nan)}, "the thing leaves the picture"),
        ({"points": np.where(TIMES[:, None, None] < 0.1, np.nan, FALLING)}, "seen in the first 5 frames"),
        ({"planes": np.zeros((1, 4))}, "normal of a plane is zero"),
        ({"pose": np.diag([1.0, 2.0, 1.0, 1.0])}, "pose is not a rigid motion"),
        ({"rest": np.array([["a"] * 3] * 8)}, "cannot be read as a .npz file of numbers"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, changes, said):
    with pytest.raises(BadInput, match=said) as e:
        read_tracks(file_of(tmp_path, **changes))
    assert "\n" not in str(e.value)


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    (tmp_path / "p.npz").write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(BadInput, match="cannot be read"):
        read_tracks(tmp_path / "p.npz")


def test_markers_go_where_an_affine_motion_takes_them_and_far_ones_are_refused():
    x, tets = tet_bar((3, 1, 1), (0.3, 0.1, 0.1))
    points = np.concatenate([REST, [[0.15, 0.104, 0.05]]])  # the last a little outside
    A = np.eye(3) + 0.3 * RNG.normal(size=(3, 3))
    W = marker_weights(x, tets, points, "here")
    np.testing.assert_allclose(W @ (x @ A.T + 1), points @ A.T + 1, atol=1e-6)
    with pytest.raises(BadInput, match=r"here: marker 3 is 90\.\d cm outside the asset"):
        marker_weights(x, tets, np.concatenate([REST[:3], [[0.1, 1.0, 0.05]]]), "here")


def test_noise_and_start_of_a_thrown_body(tmp_path):
    noisy = FALLING + 2e-4 * RNG.normal(size=FALLING.shape)
    noisy[1, 0] = np.nan
    t = read_tracks(file_of(tmp_path, points=noisy))
    np.testing.assert_allclose(noise_of(t), 2e-4, rtol=0.25)
    place, velocity, known = start_of(t)
    assert known.all()
    np.testing.assert_allclose(place, REST, atol=1e-3)
    np.testing.assert_allclose(velocity.mean(0), [0.4, 1.0, 0.0], atol=0.03)


def test_the_nearest_rigid_motion_is_found():
    c, s = np.cos(2.0), np.sin(2.0)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    pose = rigid_pose(REST, REST @ R.T + [1, 2, 3])
    np.testing.assert_allclose(pose[:3], np.c_[R, [1, 2, 3]], atol=1e-12)
