"""A robot among landmarks whose places it hardly knows."""

import numpy as np
import pytest

import pgm
from models.networks import pose, velocity
from models.unknown_landmarks import landmark_clusters, place, reading, unknown_landmarks

SEEN = [(0, 0), (1, 1), (2, 0), (3, 1)]
GUESSES = [(2.0, 1.0), (4.0, -1.0)]


@pytest.fixture
def network():
    return unknown_landmarks(3, SEEN, GUESSES)


def test_the_factorisation(network):
    due = {pose.at(0): (), place(0): (), place(1): ()}
    due |= {pose.at(t): (pose.at(t - 1), velocity.at(t)) for t in (1, 2, 3)}
    due |= {reading(t, k): (pose.at(t), place(k)) for t, k in SEEN}
    assert {cpd.child: cpd.given for cpd in network.cpds} == due
    assert set(network.inputs) == {velocity.at(t) for t in (1, 2, 3)}


def test_jacobians_change_nothing(network):
    plain = pgm.BayesianNetwork(
        pgm.NonlinearGaussianCPD(cpd.child, cpd.given, cpd.function, cpd.cov)
        if isinstance(cpd, pgm.NonlinearGaussianCPD)
        else cpd
        for cpd in network.cpds
    )
    controls = {velocity.at(t): np.array([1.0, 0.3]) for t in (1, 2, 3)}
    drawn = network.sample(inputs=controls, rng=0)
    evidence = controls | {reading(t, k): drawn[reading(t, k)] for t, k in SEEN}
    schedule = pgm.Calibration(iterations=50)
    ours, other = (
        pgm.infer(pgm.compile(each), evidence, schedule=schedule) for each in (network, plain)
    )
    for variable in (pose.at(3), place(0), place(1)):
        assert ours[variable].mean == pytest.approx(other[variable].mean, abs=1e-6)
        assert ours[variable].cov == pytest.approx(other[variable].cov, abs=1e-6)


@pytest.mark.parametrize(("carried", "loops"), [((), 2), ((0,), 1), ((1,), 1), ((0, 1), 0)])
def test_each_landmark_that_is_not_carried_along_makes_a_loop(network, carried, loops):
    graph = landmark_clusters(network, carried)
    graph.check()
    assert len(graph.sepsets) - (len(graph) - 1) == loops
    assert graph.is_tree == (not loops)
    for t in (1, 2):
        assert set(graph.sepsets[t - 1, t]) == {pose.at(t), *(place(k) for k in carried)}
