"""Quaternions beside those of SciPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from pgm.kernels import quaternions

RNG = np.random.default_rng(0)
DRAWN = RNG.uniform(-np.pi, np.pi, (1000, 3)) * [1.0, 0.499, 1.0]


def matrices(quaternion):
    return Rotation.from_quat(quaternion).as_matrix()


def test_angles_make_the_rotation():
    due = Rotation.from_euler("xyz", DRAWN).as_matrix()  # axes that stay
    assert_allclose(matrices(quaternions.of_angles(DRAWN)), due, atol=1e-14)


def test_angles_come_back():
    assert_allclose(quaternions.angles(quaternions.of_angles(DRAWN)), DRAWN, atol=1e-12)
    assert_allclose(quaternions.angles(-quaternions.of_angles(DRAWN)), DRAWN, atol=1e-12)


@pytest.mark.parametrize("pitch", [0.5 * np.pi, -0.5 * np.pi])
def test_straight_up_or_down(pitch):
    angles = DRAWN.copy()
    angles[:, 1] = pitch
    found = quaternions.angles(quaternions.of_angles(angles))
    assert_allclose(found[:, :2], np.broadcast_to([0.0, pitch], (1000, 2)), atol=1e-7)
    due = matrices(quaternions.of_angles(angles))
    assert_allclose(matrices(quaternions.of_angles(found)), due, atol=1e-12)


def test_turns_are_of_no_account():
    angles = DRAWN + 2 * np.pi * RNG.integers(-9, 9, DRAWN.shape)
    assert_allclose(quaternions.angles(quaternions.of_angles(angles)), DRAWN, atol=1e-12)
