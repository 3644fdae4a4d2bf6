"""Long chains of one state variable, against a textbook and in exact arithmetic."""

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

import pgm
from pgm.beliefs.markov import single_state
from pgm.beliefs.markov.chain import StateChain
from pgm.beliefs.markov.single_state import DirectChain

EQUAL = {"rtol": 1e-11, "atol": 1e-15}


def textbook(prior, motions, weights):
    """The filter, the smoother and the log-evidence of a hidden Markov model, step by step."""
    known, log_evidence = [prior * weights[0]], 0.0
    for motion, weight in zip(motions, weights[1:], strict=True):
        total = known[-1].sum()
        known[-1], log_evidence = known[-1] / total, log_evidence + np.log(total)
        known.append(weight * (motion.T @ known[-1]))
    log_evidence += np.log(known[-1].sum())
    known[-1] = known[-1] / known[-1].sum()
    message, smoothed = np.ones(len(prior)), []
    for step in range(len(motions), -1, -1):
        joint = known[step] * message
        smoothed.append(joint / joint.sum())
        if step:
            message = motions[step - 1] @ (weights[step] * message)
            message /= message.sum()
    return np.array(known), np.array(smoothed[::-1]), log_evidence


def hidden(rng, size, letters=4, *, sticky=False):
    """Declare a hidden Markov model."""
    x, z = pgm.Discrete("x", size), pgm.Discrete("z", letters)
    prior, motion = rng.dirichlet(np.ones(size)), rng.dirichlet(np.full(size, 0.3), size)
    if sticky:
        motion = 1e-9 * motion + (1 - 1e-9) * np.eye(size)
    seen = rng.dirichlet(np.ones(letters), size)
    return x, z, prior, motion, seen


def model(x, z, prior, motion, seen):
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(x, table=prior)],
        transition=[pgm.TableCPD(x, given=x.previous, table=motion)],
        observation=[pgm.TableCPD(z, given=x, table=seen)],
    )


@pytest.mark.parametrize("sticky", [False, True])
@pytest.mark.parametrize(("size", "steps"), [(2, 1000), (7, 1003), (16, 64), (40, 300), (3, 63)])
def test_a_textbook(size, steps, sticky):
    rng = np.random.default_rng(size)
    x, z, *parts = hidden(rng, size, sticky=sticky)
    states = rng.integers(-1, 4, steps)
    weights = np.array(
        [np.ones(size), *(parts[2][:, s] if s >= 0 else np.ones(size) for s in states)]
    )
    known, smoothed, log_evidence = textbook(parts[0], [parts[1]] * steps, weights)
    network = model(x, z, *parts)
    posterior = pgm.smooth(network, {z: states})
    assert isinstance(posterior._outcome._chain, DirectChain)
    assert_allclose(posterior.filtered[x].values, known, **EQUAL)
    assert_allclose(posterior[x].values, smoothed, **EQUAL)
    assert_allclose(posterior.log_evidence, log_evidence, rtol=1e-12)
    runs = pgm.smooth(network, {z: np.stack([states[::-1], states])})
    assert_allclose(runs[x].values[1], smoothed, **EQUAL)
    assert_allclose(runs.filtered[x].values[1], known, **EQUAL)
    lagged = pgm.smooth(network, {z: states}, lag=5)
    due = textbook(parts[0], [parts[1]] * 25, weights[:26])[1]
    assert_allclose(lagged[x.at(20)].values, due[20], **EQUAL)


@pytest.mark.parametrize("room", [1, 3 * 40, 11 * 40])
@pytest.mark.parametrize("runs", [1, 2])
def test_steps_in_parts_of_any_length(monkeypatch, room, runs):
    """Messages are scaled although parts are too short for the sweep within them to do so."""
    monkeypatch.setattr(single_state, "ROOM", room * runs)
    monkeypatch.setattr(StateChain, "smoothed_beliefs", None)  # what is used where digits are lost
    rng = np.random.default_rng(5)
    x, z, prior, motion, seen = hidden(rng, 40)
    seen = np.column_stack([1e-4 * seen[:, :3], 1.0 - 1e-4 * seen[:, :3].sum(axis=1)])
    states = rng.integers(0, 3, (runs, 400))
    posterior = pgm.smooth(model(x, z, prior, motion, seen), {z: states if runs > 1 else states[0]})
    for run in range(runs):
        weights = np.array([np.ones(40), *seen[:, states[run]].T])
        _, smoothed, log_evidence = textbook(prior, [motion] * 400, weights)
        values, logs = posterior[x].values, posterior.log_evidence
        assert_allclose(values[run] if runs > 1 else values, smoothed, **EQUAL)
        assert_allclose(logs[run] if runs > 1 else logs, log_evidence, rtol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
def test_commands_and_sparse_matrices(first):
    rng = np.random.default_rng(1)
    x, z, prior, motion, seen = hidden(rng, 5)
    u = pgm.Discrete("u", 2)
    other = sparse.csr_array(np.roll(np.eye(5), 1, axis=1))
    cpd = pgm.TableCPD(x, given=(x.previous, u), table={"0": motion, "1": other})
    network = model(x, z, prior, motion, seen).replace(transition=[cpd])
    commands, states = rng.integers(0, 2, 200), rng.integers(0, 4, 200)
    commands[0] = first
    motions = [other.toarray() if k else motion for k in commands]
    weights = np.array([np.ones(5), *seen[:, states].T])
    _, smoothed, log_evidence = textbook(prior, motions, weights)
    posterior = pgm.smooth(network, {z: states, u: commands})
    assert_allclose(posterior[x].values, smoothed, **EQUAL)
    assert_allclose(posterior.log_evidence, log_evidence, rtol=1e-12)
    runs = pgm.smooth(network, {z: np.stack([states[::-1], states]), u: commands})
    assert isinstance(runs._outcome._chain, DirectChain)
    assert_allclose(runs[x].values[1], smoothed, **EQUAL)
    assert_allclose(runs.log_evidence[1], log_evidence, rtol=1e-12)


@pytest.mark.parametrize("others", [(), ("dim",), ("noise",), ("dim", "noise")])
def test_sensors_of_which_some_are_missing_in_some_runs(others):
    """Weights are laid out for many steps: of one sensor or several, read at some of the steps."""
    rng = np.random.default_rng(3)
    x, z, *parts = hidden(rng, 5)
    prior, motion, seen = parts
    w, v = pgm.Discrete("w", 2), pgm.Discrete("v", 2)
    dim, noise = rng.dirichlet(np.ones(2), 5), np.array([0.3, 0.7])
    tables = {"dim": pgm.TableCPD(w, given=x, table=dim), "noise": pgm.TableCPD(v, table=noise)}
    network = model(x, z, *parts)
    network = network.replace(observation=[*network.observation, *(tables[k] for k in others)])
    steps, due = 90, np.unique(rng.integers(1, 91, 60))
    states, faint = rng.integers(-1, 4, (2, steps)), rng.integers(0, 2, (2, len(due)))
    blank = rng.integers(-1, 2, (2, steps))
    evidence = {z: states}
    evidence |= {w: pgm.sightings(faint, step=due)} if "dim" in others else {}
    evidence |= {v: blank} if "noise" in others else {}
    posterior = pgm.smooth(network, evidence)
    for run in range(2):
        weights = np.ones((steps + 1, 5))
        for k, state in enumerate(states[run], start=1):
            weights[k] *= seen[:, state] if state >= 0 else 1.0
        if "dim" in others:
            weights[due] *= dim[:, faint[run]].T
        if "noise" in others:
            weights[1:] *= np.where(blank[run] >= 0, noise[blank[run]], 1.0)[:, None]
        known, smoothed, log_evidence = textbook(prior, [motion] * steps, weights)
        own = {each: values[run] for each, values in evidence.items() if each != w}
        own |= {w: pgm.sightings(faint[run], step=due)} if "dim" in others else {}
        alone = pgm.smooth(network, own)
        assert isinstance(alone._outcome._chain, DirectChain)
        assert_allclose(alone[x].values, smoothed, **EQUAL)
        assert_allclose(alone.filtered[x].values, known, **EQUAL)
        assert_allclose(alone.log_evidence, log_evidence, rtol=1e-12)
        assert_allclose(posterior[x].values[run], smoothed, **EQUAL)
        assert_allclose(posterior.log_evidence[run], log_evidence, rtol=1e-12)


def test_a_hundred_thousand_steps():
    rng = np.random.default_rng(0)
    x, z, *parts = hidden(rng, 3)
    network = model(x, z, *parts)
    states = rng.integers(0, 4, 100_000)
    posterior = pgm.smooth(network, {z: states})
    weights = np.array([np.ones(3), *parts[2][:, states].T])
    _, smoothed, log_evidence = textbook(parts[0], [parts[1]] * len(states), weights)
    assert_allclose(posterior[x].values, smoothed, **EQUAL)
    assert_allclose(posterior.log_evidence, log_evidence, rtol=1e-12)


def exactly(prior, motion, weights):
    """The filtered and the smoothed beliefs with fifty digits, and exponents without an end."""
    with mpmath.workdps(50):
        motion = [[mpmath.mpf(p) for p in row] for row in np.asarray(motion).tolist()]
        weights = [[mpmath.mpf(w) for w in row] for row in np.asarray(weights).tolist()]
        states = range(len(motion))
        forward = [[mpmath.mpf(p) * w for p, w in zip(prior, weights[0], strict=True)]]
        for w in weights[1:]:
            a = forward[-1]
            forward.append([w[j] * sum(a[i] * motion[i][j] for i in states) for j in states])
        back = [[mpmath.mpf(1)] * len(motion)]
        for w in weights[:0:-1]:
            b = back[-1]
            back.append([sum(motion[i][j] * w[j] * b[j] for j in states) for i in states])
        joint = [
            [a * b for a, b in zip(*pair, strict=True)]
            for pair in zip(forward, back[::-1], strict=True)
        ]
        return [
            np.array([[float(p / sum(row)) for p in row] for row in rows])
            for rows in (forward, joint)
        ]


@pytest.mark.parametrize("steps", [40, 400])
@pytest.mark.parametrize("leak", [0.0, 1e-9, 1e-300])
def test_a_hypothesis_comes_back_from_below_the_smallest_number(leak, steps):
    """Evidence speaks for one of two states as strongly as then for the other."""
    x, z = pgm.Discrete("x", 2), pgm.Discrete("z", 2)
    motion = np.array([[1.0 - leak, leak], [0.0, 1.0]])
    seen = np.array([[1 - 1e-12, 1e-12], [1e-12, 1 - 1e-12]])
    states = np.repeat([1, 0, 1], [steps, steps + 1, 1])
    network = model(x, z, np.array([0.5, 0.5]), motion, seen)
    filtered, smoothed = exactly([0.5, 0.5], motion, [np.ones(2), *seen[:, states].T])
    posterior = pgm.smooth(network, {z: states})
    assert_allclose(posterior.filtered[x].values, filtered, rtol=1e-9, atol=1e-300)
    assert_allclose(posterior[x].values, smoothed, rtol=1e-9, atol=1e-300)
    runs = pgm.smooth(network, {z: np.stack([states, states])})
    assert_allclose(runs[x].values[1], smoothed, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("steps", [3, 100])
def test_an_impossible_state_hides_no_other(steps):
    """A state that cannot be, which all that comes later speaks for, takes no other's digits."""
    x, z = pgm.Discrete("x", 3), pgm.Discrete("z", 2)
    seen = np.array([[0.5, 0.5], [1e-20, 1.0 - 1e-20], [3e-20, 1.0 - 3e-20]])
    network = model(x, z, np.array([0.0, 0.5, 0.5]), np.eye(3), seen)
    states = np.zeros(steps, dtype=int)
    _, smoothed = exactly([0.0, 0.5, 0.5], np.eye(3), [np.ones(3), *seen[:, states].T])
    posterior = pgm.smooth(network, {z: states})
    assert_allclose(posterior[x].values, smoothed, rtol=1e-9, atol=1e-300)
    chain = StateChain(posterior._outcome._slices).run()
    due = chain.smoothed_beliefs()
    assert_allclose(due, smoothed, rtol=1e-9, atol=1e-300)


def test_predictions_of_small_probability_are_no_zeros():
    """Where probabilities below 1e-8 were taken for zero, the answer would be (.5, .5)."""
    x, z = pgm.Discrete("x", 2), pgm.Discrete("z", 2)
    network = model(
        x,
        z,
        np.array([1.0, 0.0]),
        np.array([[1.0, 0.0], [0.0, 1.0]]),
        np.array([[1e-12, 1.0 - 1e-12], [1.0, 0.0]]),
    )
    posterior = pgm.smooth(network, {z: [0, 0, 0]})
    assert_allclose(posterior[x].values, [[1.0, 0.0]] * 4, rtol=0, atol=0)
    assert_allclose(posterior.log_evidence, 3 * np.log(1e-12), rtol=1e-12)


def test_many_sharp_measurements_of_a_step():
    x, z = pgm.Discrete("x", 2), pgm.Discrete("z", 2)
    seen = np.array([[1e-30, 1.0], [2e-30, 1.0]])
    seen[:, 1] -= seen[:, 0]
    network = model(x, z, np.array([0.25, 0.75]), np.eye(2), seen)
    posterior = pgm.filter(network, {z: pgm.sightings([0] * 40, step=[1] * 40)}, steps=2)
    due = np.array([0.25, 0.75 * 2.0**40])
    assert_allclose(posterior[x.at(1)].values, due / due.sum(), rtol=1e-12)
    assert_allclose(posterior.log_evidence, np.log(due.sum()) + 40 * np.log(1e-30), rtol=1e-13)
