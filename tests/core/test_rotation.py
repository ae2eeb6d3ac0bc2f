"""Rotations on the host, against SciPy."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from core.rotation import (
    conjugate_quaternions,
    matrices_from_quaternions,
    multiply_quaternions,
    quaternions_from_matrices,
)


def test_quaternions_and_matrices_are_those_of_scipy():
    """Also half turns, where three of the four formulas for a quaternion divide by nearly nothing."""
    rng = np.random.default_rng(0)
    axes = np.concatenate([np.eye(3), rng.normal(size=(40, 3))])
    turns = axes / np.linalg.norm(axes, axis=1)[:, None] * rng.choice([1e-9, 1.0, np.pi - 1e-9, np.pi], (len(axes), 1))
    rotations = Rotation.from_rotvec(turns)
    q, R = rotations.as_quat(scalar_first=True), rotations.as_matrix()
    assert_allclose(matrices_from_quaternions(3.0 * q), R, atol=1e-15)
    found = quaternions_from_matrices(R)
    assert_allclose(np.abs((found * q).sum(1)), 1.0, atol=1e-15)
    assert (np.take_along_axis(found, np.abs(found).argmax(1)[:, None], 1) > 0).all()
    assert_allclose(matrices_from_quaternions(found.reshape(-1, 1, 4))[:, 0], R, atol=1e-15)


def test_products_and_conjugates_are_those_of_matrices():
    a, b = np.random.default_rng(1).normal(size=(2, 20, 4))
    A, B = matrices_from_quaternions(a), matrices_from_quaternions(b)
    assert_allclose(matrices_from_quaternions(multiply_quaternions(a, b)), A @ B, atol=1e-14)
    assert_allclose(matrices_from_quaternions(conjugate_quaternions(a)), A.transpose(0, 2, 1), atol=1e-14)
