"""A linear model, its runs, and what a right and a wrong model make of them."""

import numpy as np
import pytest

import pgm
from models import networks
from models.networks import point, shift

RIGHT = networks.linear()
# It believes in half the deviation that its sensor has.
WRONG = networks.linear(sensor_std=0.25)


@pytest.fixture(scope="session")
def sample():
    controls = np.tile([0.5, 0.2], (40, 1))
    return RIGHT.sample({shift: controls}, runs=300, rng=5)


@pytest.fixture(scope="session")
def truth(sample):
    return sample[point]


@pytest.fixture(scope="session")
def right(sample):
    return pgm.smooth(RIGHT, sample.evidence)


@pytest.fixture(scope="session")
def wrong(sample):
    return pgm.smooth(WRONG, sample.evidence)
