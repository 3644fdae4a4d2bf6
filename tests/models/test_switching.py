"""Switching networks: turns against integration, and what is drawn of crossings."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from models import switching, tracking


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.12, -2.0])
def test_a_known_turn_is_the_exponential_of_its_motion(rate):
    generator = np.zeros((4, 4))
    generator[0, 2] = generator[1, 3] = 1.0
    generator[2, 3], generator[3, 2] = -rate, rate
    assert_allclose(tracking.known_turn(0.7, rate), expm(0.7 * generator), atol=1e-14)
    if not rate:
        assert_array_equal(tracking.known_turn(0.7, 0.0), tracking.constant_velocity(0.7))


def test_two_blips_a_step_of_both_targets():
    drawn = switching.draw_crossing(runs=50, steps=9, clutter=0.0, seed=1)
    assert drawn.truth.shape == (50, 10, 4)
    assert_array_equal(np.bincount(drawn.step), [0, *[2] * 9])
    read = np.sort(drawn.blips.reshape(50, 9, 2), axis=-1)
    places = np.sort(drawn.truth[:, 1:, [0, 2]], axis=-1)
    assert 0.4 < (read - places).std() < 0.55


def test_blips_of_nothing_are_as_many_as_said():
    drawn = switching.draw_crossing(runs=200, steps=9, clutter=0.3, seed=2)
    read = drawn.blips.reshape(200, 9, 2)
    apart = np.abs(read[..., None] - drawn.truth[:, 1:, None, [0, 2]]).min(axis=-1)
    # One of nothing lies by chance near a target, too: two of three deviations' 3 m in 60.
    assert np.mean(apart > 1.5) == pytest.approx(0.3 * (1 - 2 * 3.0 / 60.0), abs=0.03)
