"""Four unknowns on a ring."""

from itertools import product

import numpy as np
import pytest

import pgm
from models.rings import discrete_ring, gaussian_ring, places, spins


@pytest.mark.parametrize("diagonals", [False, True])
def test_the_posterior_of_spins_is_an_ising_model(diagonals):
    network, evidence = discrete_ring(-0.7, diagonals=diagonals)
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0)] + diagonals * [(0, 2), (1, 3)]
    weights = np.zeros((2,) * 4)
    for states in product((0, 1), repeat=4):
        prior = np.prod([(1 - p, p)[s] for s, p in zip(states, (0.3, 0.6, 0.45, 0.4), strict=True)])
        s = 2 * np.array(states) - 1
        weights[states] = prior * np.exp(-0.7 * sum(s[i] * s[j] for i, j in pairs))
    weights /= weights.sum()
    posterior = pgm.infer(pgm.compile(network), evidence)
    for k, spin in enumerate(spins):
        due = weights.sum(axis=tuple(i for i in range(4) if i != k))
        assert posterior[spin].probabilities == pytest.approx(due, abs=1e-12)


@pytest.mark.parametrize("span", [2, 3])
def test_readings_add_places_up(span):
    network, evidence = gaussian_ring(0.5, span=span)
    rows = np.array([[(j - k) % 4 < span for j in range(4)] for k in range(4)], dtype=float)
    information = np.eye(4) + 0.5 * rows.T @ rows
    vector = np.array([0.0, 1.0, -1.0, 2.0]) + 0.5 * rows.T @ [1.0, 0.0, 2.0, -1.0]
    posterior = pgm.infer(pgm.compile(network), evidence)
    cov = np.linalg.inv(information)
    assert posterior.joint(*places).mean == pytest.approx(cov @ vector)
    assert posterior.joint(*places).cov == pytest.approx(cov)
