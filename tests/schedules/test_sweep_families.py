"""The sweeps of chains with another family of beliefs: tables, of a hidden Markov model."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.schedules import sweep

EQUAL = {"rtol": 1e-12, "atol": 1e-14}


class Tables:
    """A hidden Markov model with its readings: beliefs are probabilities, (states, *runs).

    Parameters
    ----------
    prior : ndarray
        (states,).
    motions : list of ndarray
        p(x_t | x_{t−1}) for t = 1..T, (states before, states after).
    likelihoods : list of dict of ndarray
        p(z | x), (states, *runs), of the readings of each step.
    """

    def __init__(self, prior, motions, likelihoods):
        self.prior, self.motions, self.likelihoods = prior, motions, likelihoods
        self.predicted, self.known, self.log_densities = [], [], []

    def start(self):
        lead = next(iter(self.likelihoods[0]), np.zeros(1)).shape[1:]
        return np.multiply.outer(self.prior, np.ones(lead))

    def predict(self, step, belief):
        return self.motions[step - 1].T @ belief

    def take(self, step, belief):
        joint = np.prod([belief, *self.likelihoods[step]], axis=0)
        total = joint.sum(axis=0)
        return joint / total, np.log(total)

    def keep(self, step, predicted, known, log_density):
        assert step == len(self.known)
        self.predicted.append(predicted)
        self.known.append(known)
        self.log_densities.append(log_density)

    def back(self, step, belief):
        """Σ p(x_t | x_{t+1}, readings up to t) p(x_{t+1} | all readings)."""
        ratio = belief / self.predicted[step + 1]
        return self.known[step] * (self.motions[step] @ ratio)


STATES, LETTERS, T = 3, 4, 7


def drawn(rng, *shape):
    """Conditional tables, their last axis summing to one."""
    return rng.dirichlet(np.ones(shape[-1]), shape[:-1])


@pytest.mark.parametrize("lead", [(), (5,)])
@pytest.mark.parametrize("readings", [1, 2])
def test_a_hidden_markov_model_is_its_unrolled_network(lead, readings):
    rng = np.random.default_rng(2)
    prior, sensor = drawn(rng, STATES), drawn(rng, STATES, LETTERS)
    motions = list(drawn(rng, T, STATES, STATES))
    seen = rng.integers(0, LETTERS, (T + 1, readings, *lead))
    seen[3] = -1  # nothing is read there
    likelihoods = [
        [sensor[:, z] for z in row] if step != 3 else [] for step, row in enumerate(seen)
    ]

    family = Tables(prior, motions, likelihoods)
    sweep.forward(family, T, family)
    smoothed = dict(sweep.backward(family, T, family.known[-1]))
    assert list(smoothed) == list(range(T, -1, -1))

    x = [pgm.Discrete(f"x{t}", list("abc")) for t in range(T + 1)]
    z = [[pgm.Discrete(f"z{t}{k}", list("stuv")) for k in range(readings)] for t in range(T + 1)]
    cpds = [pgm.TableCPD(x[0], table=prior)]
    cpds += [pgm.TableCPD(b, a, table=p) for (a, b), p in zip(pairwise(x), motions, strict=True)]
    cpds += [pgm.TableCPD(own, a, table=sensor) for a, row in zip(x, z, strict=True) for own in row]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))

    def network(last):
        return pgm.infer(
            graph, {z[t][k]: seen[t, k] for t in range(last + 1) for k in range(readings)}
        )

    log_evidence = 0.0
    for step in range(T + 1):
        due = network(step)
        log_evidence = log_evidence + family.log_densities[step]
        assert_allclose(np.moveaxis(family.known[step], 0, -1), due[x[step]].values, **EQUAL)
        assert_allclose(log_evidence, due.log_evidence, **EQUAL)
    for step in range(T + 1):
        assert_allclose(np.moveaxis(smoothed[step], 0, -1), due[x[step]].values, **EQUAL)
