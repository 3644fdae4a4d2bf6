"""Sensors of robust noise where what chooses them is known: no hypothesis is weighed by a bound."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

X, Z, Z1, Z2 = pgm.variables("x z z1 z2")
M = pgm.Discrete("m", states=("a", "b"))
NOISES = [pgm.StudentT(4.0), pgm.Huber(1.5)]
PRIOR = [pgm.GaussianCPD(X, 0.0, 1.0)]
MOVE = [pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.1)]
READ = np.array([[1.0], [9.0], [2.0], [1.0]])
MODES = np.array([0, 0, 1, 0])


def sensor(noise, child, other):
    return (
        pgm.LinearGaussianCPD(child, {X: 1.0}, cov=0.1, noise=noise),
        pgm.LinearGaussianCPD(other, {X: 1.0}, cov=1.0),
    )


def chains(noise):
    """A chain whose sensor an observed mode chooses, and its twin of two sensors; evidence each."""
    robust, plain = sensor(noise, Z, Z)
    chosen = pgm.SwitchingCPD(Z, M, {"a": robust, "b": plain})
    model = pgm.DynamicBayesianNetwork(PRIOR, MOVE, [chosen])
    twin = pgm.DynamicBayesianNetwork(PRIOR, MOVE, list(sensor(noise, Z1, Z2)))
    first = MODES[:, None] == 0
    seen = {Z1: np.where(first, READ, np.nan), Z2: np.where(first, np.nan, READ)}
    return (model, {Z: READ, M: MODES}), (twin, seen)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_a_chain_equals_that_of_two_sensors(noise, run):
    (model, given), (twin, seen) = chains(noise)
    found, due = run(model, given), run(twin, seen)
    assert found.log_evidence_kind == "bound"
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)
    assert_allclose(found[X].cov, due[X].cov, atol=1e-12)
    assert found.filtered.log_evidence_kind == "bound"


def test_online():
    (model, given), _ = chains(NOISES[0])
    robot = pgm.OnlineFilter(model)
    belief = robot.initial()
    for reading, mode in zip(READ, MODES, strict=True):
        belief = robot.update(robot.predict(belief), {Z: reading, M: mode})
    due = pgm.filter(model, given)
    assert_allclose(belief[X].mean, due[X].mean[-1], atol=1e-12)
    assert_allclose(belief[X].cov, due[X].cov[-1], atol=1e-12)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
def test_a_network_without_time_equals_its_twin(noise):
    robust, plain = sensor(noise, Z, Z)
    table = pgm.TableCPD(M, table=[0.4, 0.6])
    chosen = pgm.SwitchingCPD(Z, M, {"a": robust, "b": plain})
    graph = pgm.compile(pgm.BayesianNetwork([*PRIOR, table, chosen]))
    twin = pgm.compile(pgm.BayesianNetwork([*PRIOR, robust]))
    schedule = pgm.Calibration(60)
    found = pgm.infer(graph, {Z: [5.0], M: "a"}, schedule=schedule)
    due = pgm.infer(twin, {Z: [5.0]}, schedule=schedule)
    assert found.log_evidence_kind == "bound"
    assert_allclose(found.log_evidence, due.log_evidence + np.log(0.4), rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)
    # Where nothing continuous is hidden, the densities themselves weigh the states.
    weighed = pgm.infer(graph, {Z: [5.0], X: [1.0]})
    logs = [cpd.log_density(np.array([5.0]), {X: np.array([1.0])}) for cpd in (robust, plain)]
    share = np.array([0.4, 0.6]) * np.exp(np.ravel(logs))
    assert_allclose(weighed[M].probabilities, share / share.sum(), rtol=1e-12)


def test_what_is_refused():
    (model, given), _ = chains(NOISES[0])
    with pytest.raises(pgm.ModelError, match="weighs the readings of robust noise again"):
        pgm.smooth(model, given, iterations=5)
    with pytest.raises(pgm.ModelError, match="this is a bound"):
        pgm.audit(pgm.smooth(model, given), rng=0)
    with pytest.raises(pgm.GraphError, match="here there is none"):
        pgm.most_probable(pgm.compile(model, 4), given)


@pytest.mark.parametrize("noise", NOISES, ids=repr)
def test_observed_modes_of_the_motion(noise):
    """One motion of an input, which is one or the other, is the twin."""
    k, u = pgm.Discrete("k", states=("slow", "fast")), pgm.Variable("u")
    robust, _ = sensor(noise, Z, Z)
    moves = {
        "slow": pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.1),
        "fast": pgm.LinearGaussianCPD(X, {X.previous: 1.0}, offset=2.0, cov=0.1),
    }
    model = pgm.DynamicBayesianNetwork(PRIOR, [pgm.SwitchingCPD(X, k, moves)], [robust])
    pushed = pgm.LinearGaussianCPD(X, {X.previous: 1.0, u: 2.0}, cov=0.1)
    twin = pgm.DynamicBayesianNetwork(PRIOR, [pushed], [robust])
    found = pgm.smooth(model, {Z: READ, k: MODES})
    due = pgm.smooth(twin, {Z: READ, u: MODES[:, None].astype(float)})
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)


def test_the_kind_of_a_nonlinear_bound():
    bent = pgm.NonlinearGaussianCPD(Z, X, lambda x: np.sin(x) + x, cov=0.1, noise=NOISES[0])
    chosen = pgm.SwitchingCPD(Z, M, {"a": bent, "b": sensor(None, Z, Z)[1]})
    model = pgm.DynamicBayesianNetwork(PRIOR, MOVE, [chosen])
    found = pgm.filter(model, {Z: READ, M: MODES})
    assert found.log_evidence_kind == "linearised bound"


def test_runs_of_known_states_in_a_network_without_time():
    robust, plain = sensor(NOISES[0], Z, Z)
    table = pgm.TableCPD(M, table=[0.4, 0.6])
    chosen = pgm.SwitchingCPD(Z, M, {"a": robust, "b": plain})
    graph = pgm.compile(pgm.BayesianNetwork([*PRIOR, table, chosen]))
    schedule = pgm.Calibration(60)
    both = pgm.infer(graph, {Z: [[5.0], [4.0]], M: ["a", "b"]}, schedule=schedule)
    for run, (value, state) in enumerate([([5.0], "a"), ([4.0], "b")]):
        alone = pgm.infer(graph, {Z: value, M: state}, schedule=schedule)
        assert_allclose(both.log_evidence[run], alone.log_evidence, rtol=1e-9)
        assert_allclose(both[X].mean[run], alone[X].mean, atol=1e-9)
