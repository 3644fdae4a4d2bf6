"""A small turned building, and the variables of a robot in it."""

import numpy as np
import pytest

import pgm
from pgm.maps import OccupancyMap

BEAMS = 12
X = pgm.Variable("x", components=("x", "y", "heading"), angles=("heading",))
Z = pgm.Variable("z", components=tuple(f"b{k}" for k in range(BEAMS)))


@pytest.fixture(scope="session")
def x():
    return X


@pytest.fixture(scope="session")
def z():
    return Z


@pytest.fixture(scope="session")
def angles():
    return np.linspace(-2.0, 2.5, BEAMS)


@pytest.fixture(scope="session")
def building():
    """Two rooms with a door, rubble, and an unknown corner; its frame is turned."""
    occupied = np.zeros((30, 40))
    occupied[[0, -1]] = occupied[:, [0, -1]] = 1.0
    occupied[:, 20] = 1.0
    occupied[12:16, 20] = 0.0
    occupied[np.random.default_rng(3).random((30, 40)) < 0.03] = 0.9
    occupied[24:29, 32:39] = np.nan
    return OccupancyMap(occupied, 0.1, (5.0, -2.0, 0.4))
